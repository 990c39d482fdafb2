"""Named cameras over HTTP and through the client, and requests that name one."""

from __future__ import annotations

import asyncio
import json

import httpx
import numpy as np
import pytest

from rholoc_client import AsyncClient, Camera, CameraProfile, Client, InvalidCamera, InvalidName, UnknownCamera

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
