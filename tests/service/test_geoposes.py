"""GeoPoses of answers, against pyproj and SciPy; and OSCP's GeoPoseProtocol, versions 1 and 2."""

import base64
from dataclasses import replace

import cv2
import httpx
import numpy as np
import pytest
from pyproj import Transformer
from scipy.spatial.transform import Rotation

from rholoc.features import get_extractor
from rholoc.geometry import angles_between
from rholoc_client import Client

PNG = {"content-type": "image/png"}
EARTH = {"latitude_deg": 52.52, "longitude_deg": 13.405, "height_m": 74.0, "heading_deg": 30.0}
OSCP = {"Accept": "application/vnd.oscp+json;version=2.0"}


@pytest.fixture(scope="module")
def located(serve, picture_world):
    """A service with a map that lies on Earth, and the same map without a place."""
    running = serve()
    for name in ("room", "elsewhere", "sited"):
        (running.settings.maps_dir / f"{name}.rho").write_bytes(picture_world.rho())
    corrected = httpx.post(
        f"{running.url}/v1/maps/room/corrections",
        json={
            "kind": "earth",
            "heading_deg": EARTH["heading_deg"],
            "points": [{"map": [0.0, 0.0, 0.0], **{k: v for k, v in EARTH.items() if k != "heading_deg"}}],
        },
    )
    assert corrected.status_code == 200, corrected.text
    assert corrected.json()["earth"]["latitude_deg"] == pytest.approx(52.52, abs=1e-9)
    assert corrected.json()["corrections"][-1]["residual_m"] == pytest.approx(0, abs=1e-6)
    return running


def ask(located, picture_world, kind, name="room"):
    found = httpx.post(
        f"{located.url}/v1/maps/{name}/localize", params={"geopose": kind}, content=picture_world.png(), headers=PNG
    )
    assert found.status_code == 200, found.text
    return found.json()


def expected(pose, earth):
    """ECEF position of the camera and rotation from its body to ECEF, by pyproj and SciPy alone."""
    enu = Transformer.from_pipeline(
        f"+proj=topocentric +ellps=WGS84 +lat_0={earth['latitude_deg']} +lon_0={earth['longitude_deg']} "
        f"+h_0={earth['height_m']}"
    )
    # y points heading_deg clockwise from north
    to_enu = Rotation.from_euler("z", -earth["heading_deg"], degrees=True)
    ecef = enu.transform(*to_enu.apply(pose["position"]), direction="INVERSE")
    zero = np.array(enu.transform(0.0, 0.0, 0.0, direction="INVERSE"))
    axes = np.column_stack([np.array(enu.transform(*one, direction="INVERSE")) - zero for one in np.eye(3).tolist()])
    T = np.array(pose["T_map_camera"])
    right, down, forward = T[:3, 0], T[:3, 1], T[:3, 2]
    return np.array(ecef), axes @ to_enu.as_matrix() @ np.column_stack([forward, -right, -down])


def claimed(lat, lon, h, rotation):
    """The same of a GeoPose."""
    ecef = Transformer.from_pipeline("+proj=cart +ellps=WGS84").transform(lon, lat, h)
    enu = Transformer.from_pipeline(f"+proj=topocentric +ellps=WGS84 +lat_0={lat} +lon_0={lon} +h_0={h}")
    axes = np.column_stack(
        [np.array(enu.transform(*one, direction="INVERSE")) - np.array(ecef) for one in np.eye(3).tolist()]
    )
    return np.array(ecef), axes @ rotation.as_matrix()


def agree(theirs, ours):
    assert np.linalg.norm(theirs[0] - ours[0]) < 1e-3
    np.testing.assert_allclose(theirs[1], ours[1], atol=1e-6)


@pytest.mark.parametrize("kind", ["quaternion", "ypr", "advanced"])
def test_a_geopose_says_where_the_camera_is_on_earth(located, picture_world, kind):
    answer = ask(located, picture_world, kind)
    geopose = answer["geopose"]
    if kind == "ypr":
        angles = [geopose["angles"][name] for name in ("yaw", "pitch", "roll")]
        rotation = Rotation.from_euler("ZYX", angles, degrees=True)
    else:
        rotation = Rotation.from_quat([geopose["quaternion"][one] for one in "xyzw"])
    if kind == "advanced":
        frame = geopose["frameSpecification"]
        assert (frame["authority"], frame["id"]) == ("/geopose/1.0", "LTP-ENU")
        place = dict(one.split("=") for one in frame["parameters"].split("&"))
        lat, lon, h = (float(place[name]) for name in ("latitude", "longitude", "height"))
        assert geopose["validTime"] > 1.7e12
    else:
        lat, lon, h = (geopose["position"][name] for name in ("lat", "lon", "h"))
    agree(claimed(lat, lon, h, rotation), expected(answer["pose"], EARTH))


def test_a_site_gives_its_maps_a_geopose(located, picture_world):
    assert ask(located, picture_world, "quaternion", "sited")["geopose"] is None
    with Client(located.url) as client:
        client.put_site("campus", {"maps": [{"map": "sited", "pose": {"position": [10.0, 20.0, 3.0]}}], "earth": EARTH})
        answer = client.localize("sited", picture_world.png(), geopose="quaternion")
        client.delete_site("campus")
    position = answer.geopose["position"]
    rotation = Rotation.from_quat([answer.geopose["quaternion"][one] for one in "xyzw"])
    T = np.array(answer.pose.T_map_camera)
    in_site = {"position": (T[:3, 3] + [10, 20, 3]).tolist(), "T_map_camera": T}
    agree(claimed(position["lat"], position["lon"], position["h"], rotation), expected(in_site, EARTH))
    assert answer.site.earth.latitude_deg == pytest.approx(position["lat"])


def test_an_answer_has_none_unless_it_is_asked_for(located, picture_world):
    assert httpx.post(
        f"{located.url}/v1/maps/room/localize", content=picture_world.png(), headers=PNG
    ).json()["geopose"] is None  # fmt: skip
    refused = httpx.post(
        f"{located.url}/v1/maps/room/localize", params={"geopose": "wkt"}, content=picture_world.png(), headers=PNG
    )
    assert refused.status_code == 422


def oscp(picture_world, **reading):
    camera = picture_world.camera
    params = {"model": "OPENCV", "modelParams": [camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5, 0, 0, 0, 0]}
    return {
        "id": "7d7f0a1c",
        "timestamp": 1767607200000,
        "type": "geopose",
        "sensors": [{"id": "0", "type": "camera"}],
        "sensorReadings": {
            "cameraReadings": [
                {
                    "timestamp": 1767607200000,
                    "sensorId": "0",
                    "privacy": {"dataRetention": []},
                    "sequenceNumber": 0,
                    "imageFormat": "PNG",
                    "size": [camera.width, camera.height],
                    "imageBytes": base64.b64encode(picture_world.png()).decode(),
                    "params": params,
                    **reading,
                }
            ]
        },
        "priorPoses": [],
    }


def post(located, body, **headers):
    return httpx.post(f"{located.url}/geopose", params={"maps": "room"}, json=body, headers={**OSCP, **headers})


def test_version_2_is_spoken(located, picture_world):
    assert httpx.get(f"{located.url}/geopose").json() == {"status": "running"}
    found = post(located, oscp(picture_world))
    assert found.status_code == 200, found.text
    assert found.headers["content-type"] == "application/vnd.oscp+json;version=2.0"
    answer = found.json()
    assert (answer["id"], answer["timestamp"], answer["type"]) == ("7d7f0a1c", 1767607200000, "geopose")
    assert 0 < answer["accuracy"]["position"] < 0.1
    assert 0 < answer["accuracy"]["orientation"] < 2
    other = ask(located, picture_world, "quaternion")["geopose"]
    assert answer["geopose"]["position"]["lat"] == pytest.approx(other["position"]["lat"], abs=1e-8)


def test_version_1_is_spoken(located, picture_world):
    body = oscp(picture_world)
    (reading,) = body["sensorReadings"]["cameraReadings"]
    body["sensors"][0]["params"] = reading.pop("params")
    kept = {name: reading[name] for name in ("sequenceNumber", "imageFormat", "size", "imageBytes")}
    body["sensorReadings"] = [{"timestamp": 1, "sensorId": "0", "privacy": {}, "reading": kept}]
    found = post(located, body, Accept="application/vnd.oscp+json;version=1.0")
    assert found.status_code == 200, found.text
    assert found.headers["content-type"].endswith("version=1.0")
    assert found.json()["geopose"]["position"]["lat"] == pytest.approx(52.52, abs=1e-3)


@pytest.mark.parametrize("kind", ["RGBA32", "RGB24", "GRAY8"])
def test_raw_pixels_are_a_picture(located, picture_world, kind):
    conversion = {"RGBA32": cv2.COLOR_BGR2RGBA, "RGB24": cv2.COLOR_BGR2RGB, "GRAY8": cv2.COLOR_BGR2GRAY}[kind]
    pixels = base64.b64encode(cv2.cvtColor(picture_world.image, conversion).tobytes()).decode()
    assert post(located, oscp(picture_world, imageFormat=kind, imageBytes=pixels)).status_code == 200


@pytest.mark.parametrize(
    ("reading", "status", "code"),
    [
        ({"imageBytes": "no base64!"}, 422, "invalid_image"),
        ({"imageBytes": base64.b64encode(b"a picture").decode()}, 422, "invalid_image"),
        ({"imageBytes": "", "imageFormat": "GRAY8", "size": [0, 0]}, 422, "invalid_image"),
        ({"params": {"model": "OPENCV", "modelParams": [500.0]}}, 422, "invalid_camera"),
        ({"params": {"model": "THIN_PRISM", "modelParams": [500.0]}}, 422, "invalid_camera"),
        ({"params": {"model": "PINHOLE", "modelParams": [500.0, 500.0, 1.0, 1.0]}, "size": []}, 422, "invalid_camera"),
        ({"imageBytes": 5}, 422, "invalid_request"),
    ],
)
def test_readings_that_are_none_are_refused(located, picture_world, reading, status, code):
    refused = post(located, oscp(picture_world, **reading))
    assert (refused.status_code, refused.json()["code"]) == (status, code), refused.text


def test_what_cannot_be_answered_is_404_and_another_version_is_refused(located, picture_world):
    grey = base64.b64encode(cv2.imencode(".png", np.full((480, 640, 3), 90, np.uint8))[1].tobytes()).decode()
    assert post(located, oscp(picture_world, imageBytes=grey)).status_code == 404
    nowhere = httpx.post(f"{located.url}/geopose", params={"maps": "elsewhere"}, json=oscp(picture_world))
    assert (nowhere.status_code, nowhere.json()["message"]) == (404, "The map elsewhere has no place on Earth.")
    other = post(located, oscp(picture_world), Accept="application/vnd.oscp+json;version=3.0")
    assert other.status_code == 422
    mistyped = httpx.post(f"{located.url}/geopose", params={"map": "room"}, json=oscp(picture_world))
    assert (mistyped.status_code, mistyped.json()["code"]) == (422, "invalid_request")
    for body in ([], {"id": "1"}, {"id": "1", "timestamp": 1, "sensorReadings": []}, {"sensorReadings": [3, None]}):
        assert post(located, body).status_code == 422


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


@pytest.fixture(scope="module")
def seen(service, picture_world):
    """The landscape of the picture."""
    return send_picture(service, picture_world).json()


def test_the_landscape_is_highest_at_the_pose(seen, picture_world):
    assert seen["localized"]
    np.testing.assert_allclose(seen["pose"]["position"], picture_world.pose.position, atol=0.02)
    values = np.array(seen["values"])
    row, column = np.unravel_index(values.argmax(), values.shape)
    x, y, z = seen["origin"] + seen["spacing"] * np.array([column, row, 0])
    np.testing.assert_allclose([x, y], seen["pose"]["position"][:2], atol=1.5 * seen["spacing"])
    assert abs(z - seen["pose"]["position"][2]) < 1e-3
    assert values.max() > 3 * np.median(values)


def test_ascents_lead_to_the_pose(seen):
    gains = [way["gain_nats"] for way in seen["ways"]]
    assert gains == sorted(gains)
    best = seen["ways"][-1]["positions"]
    assert np.linalg.norm(np.subtract(best[-1], seen["pose"]["position"])) < 0.05
    assert len(best) > 3


def test_a_descriptor_set_has_the_same_landscape(service, picture_world, seen):
    camera = {"width": 640, "height": 480, **CAMERA}
    query = {"camera": camera, "features": descriptor_set(picture_world), "dof": 6}
    described = httpx.post(service.url + LANDSCAPE, json=query, timeout=30).json()
    np.testing.assert_allclose(described["pose"]["position"], seen["pose"]["position"], atol=0.01)


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
