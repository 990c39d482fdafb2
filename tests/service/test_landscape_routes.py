"""What densities look like over HTTP: where a feature may be seen from, and the landscape around a frame's pose."""

from __future__ import annotations

from dataclasses import replace

import httpx
import numpy as np

from rholoc.features import get_extractor
from rholoc.geometry import angles_between

LANDSCAPE = "/v1/maps/room/landscape"
CAMERA = {"fx": 520, "fy": 520, "cx": 319.5, "cy": 239.5}


def send_picture(service, world, **params):
    return httpx.post(
        service.url + LANDSCAPE,
        params={**CAMERA, "dof": 6, **params},
        content=world.png(),
        headers={"Content-Type": "image/png"},
        timeout=30,
    )


def descriptor_set(world):
    found = get_extractor("gray").extract(world.image)
    return {
        "pixels": found.pixels.tolist(),
        "channels": ["L"] * len(found),
        "descriptors": [row.tobytes().hex() for row in found.descriptors],
    }


def test_the_landscape_is_highest_at_the_pose(service, picture_world):
    seen = send_picture(service, picture_world).json()
    assert seen["localized"]
    np.testing.assert_allclose(seen["pose"]["position"], picture_world.pose.position, atol=0.02)
    values = np.array(seen["values"])
    row, column = np.unravel_index(values.argmax(), values.shape)
    x, y, z = seen["origin"] + seen["spacing"] * np.array([column, row, 0])
    np.testing.assert_allclose([x, y], seen["pose"]["position"][:2], atol=1.5 * seen["spacing"])
    assert abs(z - seen["pose"]["position"][2]) < 1e-3
    assert values.max() > 3 * np.median(values)


def test_ascents_lead_to_the_pose(service, picture_world):
    seen = send_picture(service, picture_world).json()
    gains = [way["gain_nats"] for way in seen["ways"]]
    assert gains == sorted(gains)
    best = seen["ways"][-1]["positions"]
    assert np.linalg.norm(np.subtract(best[-1], seen["pose"]["position"])) < 0.05
    assert len(best) > 3


def test_a_descriptor_set_has_the_same_landscape(service, picture_world):
    camera = {"width": 640, "height": 480, **CAMERA}
    query = {"camera": camera, "features": descriptor_set(picture_world), "dof": 6}
    seen = httpx.post(service.url + LANDSCAPE, json=query, timeout=30).json()
    picture = send_picture(service, picture_world).json()
    np.testing.assert_allclose(seen["pose"]["position"], picture["pose"]["position"], atol=0.01)


def test_a_blank_picture_has_none(service, picture_world):
    blank = replace(picture_world, image=np.full_like(picture_world.image, 90))
    seen = send_picture(service, blank).json()
    assert not seen["localized"]
    assert seen["pose"] is None
    assert seen["values"] == seen["ways"] == []


def test_a_landscape_keeps_its_deadline(service, picture_world):
    answer = send_picture(service, picture_world, deadline_ms=1)
    assert answer.json()["code"] == "deadline_exceeded"


def test_several_frames_have_no_landscape(service, picture_world):
    camera = {"width": 640, "height": 480, **CAMERA}
    pose = {"position": [0, 0, 0], "quaternion_xyzw": [0, 0, 0, 1]}
    frame = {**pose, "features": descriptor_set(picture_world), "camera": camera}
    answer = httpx.post(service.url + LANDSCAPE, json={"frames": [frame, frame]}, timeout=30)
    assert answer.json()["code"] == "invalid_request"


def test_a_feature_says_where_it_may_be_seen_from(service, picture_world):
    map_ = picture_world.map_
    found = httpx.get(f"{service.url}/v1/maps/room/features/7").json()
    np.testing.assert_allclose(found["position"], map_.landmarks.positions[7], atol=1e-3)
    away = map_.views.positions[found["views"]] - map_.landmarks.positions[7]
    distance = np.linalg.norm(away, axis=1)
    assert (distance > found["nearest"]).all()
    assert (distance < found["farthest"]).all()
    angle = np.degrees(angles_between(away, np.array(found["direction"])))
    assert (angle < found["half_angle_deg"]).all()


def test_a_feature_that_is_not_there_is_refused(service, picture_world):
    for number, code in ((len(picture_world.map_), "invalid_input"), (-1, "invalid_request"), ("x", "invalid_request")):
        answer = httpx.get(f"{service.url}/v1/maps/room/features/{number}")
        assert answer.json()["code"] == code
        assert answer.status_code in (400, 422)
