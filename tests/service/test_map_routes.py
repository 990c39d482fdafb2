"""Maps over HTTP: listed, uploaded, renamed, deleted, taken away."""

from __future__ import annotations

import io
import xml.etree.ElementTree as ET

import cv2
import httpx
import numpy as np
import pytest

from rholoc.maps import Map, load_map
from rholoc.maps.point_files import landmark_sigmas, map_to_ply, map_to_vtp, view_counts
from rholoc.maps.preview import map_to_png


def test_maps_are_listed(service, picture_world):
    answer = httpx.get(service.url + "/v1/maps").json()
    assert [one["name"] for one in answer["maps"]] == ["loose", "room"]
    loose, room = answer["maps"]
    assert (loose["scale"], room["scale"]) == ("arbitrary", "metric")
    assert room["landmarks"] == len(picture_world.map_)
    assert room["camera"]["fx"] == picture_world.camera.fx
    assert room["size_bytes"] == (service.settings.maps_dir / "room.rho").stat().st_size


def test_a_map_tells_of_itself(service, picture_world):
    room = httpx.get(service.url + "/v1/maps/room").json()
    assert room["sources"][0]["name"] == "walk"
    assert room["waypoints"][0]["name"] == "W1"
    np.testing.assert_allclose(room["bounds_m"][0], picture_world.map_.landmarks.min(axis=0))
    report = httpx.get(service.url + "/v1/maps/room/report").json()
    assert report["report"] == picture_world.map_.info.report
    assert report["map_version"] == 3


def test_a_map_is_put_renamed_replaced_taken_and_deleted(service, picture_world, tmp_path):
    url, content = service.url + "/v1/maps", picture_world.rho(version=1)
    assert httpx.put(f"{url}/new", content=content).status_code == 201
    assert httpx.put(f"{url}/new", content=picture_world.rho(version=2)).status_code == 200
    renamed = httpx.patch(f"{url}/new", json={"name": "newer"})
    assert (renamed.json()["name"], renamed.json()["version"]) == ("newer", 2)
    taken = httpx.get(f"{url}/newer/download")
    assert 'filename="newer.rho"' in taken.headers["Content-Disposition"]
    (tmp_path / "taken.rho").write_bytes(taken.content)
    np.testing.assert_array_equal(load_map(tmp_path / "taken.rho").landmarks, picture_world.map_.landmarks)
    assert httpx.delete(f"{url}/newer").status_code == 204
    assert httpx.get(f"{url}/newer").status_code == 404
    assert not list((service.settings.data_dir / "uploads").iterdir())


def test_the_preview_is_a_picture(service):
    answer = httpx.get(service.url + "/v1/maps/room/preview.png", timeout=30)
    assert answer.headers["Content-Type"] == "image/png"
    picture = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_COLOR)
    assert min(picture.shape[:2]) > 500
    assert picture.std() > 5


def without_features(map_: Map) -> Map:
    """A map with views and no landmark."""
    from dataclasses import replace

    return replace(
        map_,
        channels=map_.channels[:0],
        landmarks=map_.landmarks[:0],
        covariances=map_.covariances[:0],
        descriptors=map_.descriptors[:0],
        descriptor_features=map_.descriptor_features[:0],
        view_offsets=map_.view_offsets * 0,
        view_features=map_.view_features[:0],
    )


@pytest.mark.parametrize("empty", [False, True])
def test_ply_holds_the_landmarks(picture_world, empty):
    map_ = without_features(picture_world.map_) if empty else picture_world.map_
    content = map_to_ply(map_)
    head, _, body = content.partition(b"end_header\n")
    assert f"element vertex {len(map_)}\n".encode() in head
    names = [line.split()[-1].decode() for line in head.splitlines() if line.startswith(b"property")]
    assert names == ["x", "y", "z", "sigma", "views", "channel"]
    vertices = np.frombuffer(body, [("xyz", "<f4", 3), ("sigma", "<f4"), ("views", "<i4"), ("channel", "u1")])
    np.testing.assert_array_equal(vertices["xyz"], map_.landmarks)
    np.testing.assert_allclose(vertices["sigma"], 0.002, rtol=1e-4)
    np.testing.assert_array_equal(vertices["views"], 4)


@pytest.mark.parametrize("empty", [False, True])
def test_vtp_holds_the_landmarks(picture_world, empty):
    import base64

    map_ = without_features(picture_world.map_) if empty else picture_world.map_
    tree = ET.parse(io.BytesIO(map_to_vtp(map_)))
    arrays = {node.get("Name"): base64.b64decode(node.text)[8:] for node in tree.iter("DataArray")}
    np.testing.assert_array_equal(np.frombuffer(arrays["points"], "<f4").reshape(-1, 3), map_.landmarks)
    np.testing.assert_array_equal(np.frombuffer(arrays["sigma_m"], "<f4"), landmark_sigmas(map_))
    np.testing.assert_array_equal(np.frombuffer(arrays["views"], "<i4"), view_counts(map_))
    np.testing.assert_array_equal(np.frombuffer(arrays["offsets"], "<i8"), np.arange(1, len(map_) + 1))


def test_an_empty_map_has_a_preview(picture_world):
    assert map_to_png(without_features(picture_world.map_)).startswith(b"\x89PNG")


def test_point_files_are_served(service, picture_world):
    url = service.url + "/v1/maps/room/download"
    assert httpx.get(url, params={"format": "ply"}).content == map_to_ply(picture_world.map_)
    vtp = httpx.get(url, params={"format": "vtp"})
    assert vtp.content == map_to_vtp(picture_world.map_)
    assert 'filename="room.vtp"' in vtp.headers["Content-Disposition"]
