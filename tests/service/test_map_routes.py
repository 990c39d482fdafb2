"""Maps over HTTP: listed, uploaded, renamed, deleted, taken away."""

import asyncio
import json
from dataclasses import replace

import cv2
import httpx
import numpy as np
import pytest

from rholoc.geometry import Similarity
from rholoc.mapping.edit.moving import move_map
from rholoc.maps import Cloud, load_map, map_to_bytes
from rholoc.reports import MapReport, report_from_json
from rholoc_client import AsyncClient, Camera, CameraProfile, Client, InvalidCamera, InvalidName, UnknownCamera


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
    np.testing.assert_allclose(room["bounds_m"][0], picture_world.map_.landmarks.positions.min(axis=0))
    report = httpx.get(service.url + "/v1/maps/room/report").json()
    assert report_from_json(MapReport, report["report"]) == picture_world.map_.info.report
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
    np.testing.assert_array_equal(
        load_map(tmp_path / "taken.rho").landmarks.positions, picture_world.map_.landmarks.positions
    )
    assert httpx.delete(f"{url}/newer").status_code == 204
    assert httpx.get(f"{url}/newer").status_code == 404
    assert not list((service.settings.data_dir / "uploads").iterdir())


def test_further_points_and_pictures_of_views(serve, picture_world):
    picture = cv2.imencode(".jpg", picture_world.image)[1].tobytes()
    cloud = Cloud(np.ones((2, 3), np.float32), np.full((2, 3), 7, np.uint8), np.zeros(2, np.int32))
    map_ = replace(
        picture_world.map_, views=replace(picture_world.map_.views, pictures=(b"", picture, picture, b"")), cloud=cloud
    )
    for kept in (True, False):
        running = serve(keep_pictures=kept)
        url = f"{running.url}/v1/maps/seen"
        assert httpx.put(url, content=map_to_bytes(map_)).status_code == 201
        points = httpx.get(f"{url}/points").content
        assert points == b"\2\0\0\0" + np.ones(6, "<f4").tobytes() + b"\7" * 6
        detail = httpx.get(url).json()
        assert (detail["points"], detail["pictures"], detail["levelling"]) == (2, kept, None)
        taken = httpx.get(f"{url}/views/1/picture.jpg")
        if kept:
            assert (taken.content, taken.headers["Content-Type"]) == (picture, "image/jpeg")
        for view in (0, 4) if kept else (1,):
            answer = httpx.get(f"{url}/views/{view}/picture.jpg")
            assert (answer.status_code, answer.json()["code"]) == (404, "unknown_picture")


def test_a_scene_is_levelled_where_the_map_is_not_upright(service, picture_world):
    turned = replace(picture_world.map_, info=replace(picture_world.map_.info, upright=False))
    url = f"{service.url}/v1/maps/leaning"
    httpx.put(url, content=map_to_bytes(move_map(turned, Similarity(1.0, np.diag([1.0, -1.0, -1.0]), np.zeros(3)))))
    R = np.array(httpx.get(url).json()["levelling"])
    plain, level = (httpx.get(f"{url}/scene{query}").content for query in ("", "?level=true"))
    count = 4 * len(turned)
    before, after = (np.frombuffer(one, "<f4", count, 8).reshape(-1, 4)[:, :3] for one in (plain, level))
    np.testing.assert_allclose(after, before @ R.T, atol=1e-5)
    np.testing.assert_allclose(R @ [0, 0, -1], [0, 0, 1], atol=0.1)
    httpx.delete(url)


def test_a_scene_is_what_a_viewer_draws(service, picture_world):
    content = httpx.get(service.url + "/v1/maps/room/scene").content
    features, views = np.frombuffer(content, "<u4", 2)
    numbers = np.frombuffer(content, "<f4", offset=8)
    landmarks, path = np.split(numbers, [4 * features])
    map_ = picture_world.map_
    assert (features, views, path.size) == (len(map_), len(map_.views.times), 7 * views)
    np.testing.assert_array_equal(landmarks.reshape(-1, 4)[:, :3], map_.landmarks.positions)
    np.testing.assert_allclose(landmarks.reshape(-1, 4)[:, 3], 0.002)
    np.testing.assert_allclose(path.reshape(-1, 7)[:, :3], map_.views.positions)
    np.testing.assert_allclose(path.reshape(-1, 7)[0, 3:], [*picture_world.pose.heading, 0], atol=1e-6)


CAMERA = Camera(520.0, 520.0, 319.5, 239.5, width=640, height=480)
PROFILE = {"width": 640, "height": 480, "fx": 520.0, "fy": 520.0, "cx": 319.5, "cy": 239.5}


@pytest.fixture
def client(service):
    with Client(service.url) as client:
        yield client
        for one in client.cameras():
            client.delete_camera(one.name)


def localize(service, world, body=None, **params):
    if body is not None:
        files = {"image": ("a.png", world.png(), "image/png"), "request": (None, json.dumps(body))}
        return httpx.post(service.url + "/v1/maps/room/localize", files=files, timeout=30)
    headers = {"Content-Type": "image/png"}
    url = service.url + "/v1/maps/room/localize"
    return httpx.post(url, params=params, content=world.png(), headers=headers, timeout=30)


def test_a_camera_is_stored_listed_and_deleted(service, client):
    url = service.url + "/v1/cameras/pixel-7"
    assert httpx.put(url, json=PROFILE).status_code == 201
    answer = httpx.put(url, json={**PROFILE, "calibration": {"rms_px": 0.2}})
    assert answer.status_code == 200
    assert answer.json() == {
        "name": "pixel-7",
        **PROFILE,
        "distortion": [],
        "lens": "pinhole",
        "calibration": {"rms_px": 0.2},
    }
    assert httpx.get(url).json() == answer.json()
    assert httpx.get(service.url + "/v1/cameras").json() == {"cameras": [answer.json()], "unreadable": {}}
    assert httpx.delete(url).status_code == 204
    assert httpx.get(url).json()["code"] == "unknown_camera"
    assert httpx.delete(url).status_code == 404


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"fx": -1}, "invalid_camera"),
        ({"cx": 5000}, "invalid_camera"),
        ({"distortion": [0.1]}, "invalid_camera"),
        ({"fx": "wide"}, "invalid_request"),
        ({"width": None}, "invalid_request"),
        ({"zoom": 2}, "invalid_request"),
    ],
)
def test_absurd_cameras_are_refused(service, client, change, code):
    answer = httpx.put(service.url + "/v1/cameras/bad", json={**PROFILE, **change})
    assert (answer.status_code, answer.json()["code"]) == (422, code)
    assert client.cameras() == []


def test_numbers_that_are_not_finite_are_refused(service, client):
    for body in ('{"fx": NaN}', '{"calibration": {"rms_px": NaN}}'):
        values = json.dumps({**PROFILE, **json.loads(body)})
        answer = httpx.put(
            service.url + "/v1/cameras/bad", content=values, headers={"Content-Type": "application/json"}
        )
        assert answer.status_code == 422
    assert client.cameras() == []


def test_a_broken_file_is_named_and_the_others_are_listed(service, client):
    client.put_camera("good", CAMERA)
    folder = service.settings.maps_dir / "cameras"
    (folder / "broken.json").write_text("{")
    try:
        listed = httpx.get(service.url + "/v1/cameras").json()
    finally:
        (folder / "broken.json").unlink()
    assert [one["name"] for one in listed["cameras"]] == ["good"]
    assert "broken" in listed["unreadable"]["broken"]


def test_a_request_can_name_its_camera(service, picture_world, client):
    client.put_camera("half", Camera(260.0, 260.0, 159.5, 119.5, width=320, height=240))
    for answer in (
        localize(service, picture_world, camera="half", dof=6),
        localize(service, picture_world, {"camera": {"name": "half"}, "dof": 6}),
    ):
        np.testing.assert_allclose(answer.json()["pose"]["position"], picture_world.pose.position, atol=0.02)
    answer = client.localize("room", picture_world.png(), camera="half", dof=6)
    np.testing.assert_allclose(answer.pose.position, picture_world.pose.position, atol=0.02)


def test_another_camera_gives_another_answer(service, picture_world, client):
    client.put_camera("tele", Camera(1500.0, 1500.0, 319.5, 239.5, width=640, height=480))
    answer = client.localize("room", picture_world.png(), camera="tele", dof=6)
    assert not answer.localized or np.linalg.norm(np.subtract(answer.pose.position, picture_world.pose.position)) > 0.1


def test_names_that_cannot_serve_are_refused(service, picture_world, client):
    client.put_camera("tall", Camera(520.0, 520.0, 239.5, 319.5, width=480, height=640))
    client.put_camera("good", CAMERA)
    with pytest.raises(UnknownCamera, match=r"There is no camera nikon\. There are: good, tall\."):
        client.localize("room", picture_world.png(), camera="nikon")
    with pytest.raises(InvalidName):
        client.localize("room", picture_world.png(), camera="../x")
    with pytest.raises(InvalidCamera, match="480×640"):
        client.localize("room", picture_world.png(), camera="tall")
    assert localize(service, picture_world, camera="good", fx=500).json()["code"] == "invalid_camera"


def test_an_upload_that_names_an_unknown_camera_is_refused(service, client, tmp_path):
    (tmp_path / "walk.mp4").write_bytes(b"\0\0\0\x18ftypisom" + bytes(64))
    with pytest.raises(UnknownCamera):
        client.upload_recording(tmp_path / "walk.mp4", "hall", camera="nikon")


def test_both_clients_keep_cameras(service, client):
    profile = CameraProfile("pixel-7", CAMERA, {"rms_px": 0.21})

    async def keep():
        async with AsyncClient(service.url) as asynchronous:
            assert await asynchronous.put_camera("pixel-7", CAMERA, {"rms_px": 0.21}) == profile
            assert await asynchronous.cameras() == [profile]
            assert await asynchronous.camera("pixel-7") == profile
            await asynchronous.delete_camera("pixel-7")

    asyncio.run(keep())
    with pytest.raises(UnknownCamera):
        client.camera("pixel-7")
