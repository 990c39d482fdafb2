"""A frame goes in, a pose comes out: the three ways to send it, over a real socket."""

import base64
import json
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import cv2
import httpx
import numpy as np
import pytest

from rholoc.features import get_extractor
from rholoc.localization import Localizer

STAGES = {"queue", "load", "decode", "extract", "match", "seed", "ascend", "verify", "diagnose", "total"}


def descriptor_query(world, **options):
    """The picture's features as a descriptor set."""
    found = get_extractor("gray").extract(world.image)
    return {
        "camera": {"width": world.camera.width, "height": world.camera.height},
        "features": {
            "pixels": found.pixels.tolist(),
            "channels": ["L"] * len(found),
            "descriptors": [row.tobytes().hex() for row in found.descriptors],
            "sizes_px": found.sizes.tolist(),
            "angles_deg": np.degrees(found.angles.astype(float)).tolist(),
        },
        **options,
    }


def send_picture(service, world, path="/v1/maps/room/localize", **params):
    headers = {"Content-Type": "image/png"}
    return httpx.post(service.url + path, params=params, content=world.png(), headers=headers, timeout=30)


def test_a_picture_gets_its_pose(service, picture_world):
    answer = send_picture(service, picture_world, fx=520, fy=520, cx=319.5, cy=239.5, dof=6).json()
    assert answer["localized"]
    assert answer["reason"] is None
    pose = answer["pose"]
    np.testing.assert_allclose(pose["position"], picture_world.pose.position, atol=0.02)
    assert np.dot(pose["heading"], picture_world.pose.heading) > np.cos(np.radians(0.5))
    np.testing.assert_allclose(np.array(pose["T_map_camera"])[:3, 3], pose["position"])
    assert abs(np.linalg.norm(pose["quaternion_xyzw"]) - 1) < 1e-9
    covariance = np.array(answer["covariance"])
    assert covariance.shape == (6, 6)
    assert (np.linalg.eigvalsh(covariance) > 0).all()
    assert 0.5 <= answer["confidence"] <= answer["recognized"] <= 1
    assert answer["alternatives"] == []
    assert answer["inliers"] <= answer["matches"]
    assert (answer["map"], answer["map_version"], answer["scale"]) == ("room", 3, "metric")
    assert answer["map_id"] == picture_world.map_.info.id


def test_every_stage_is_timed(service, picture_world):
    timings = send_picture(service, picture_world).json()["timings_ms"]
    assert set(timings) == STAGES
    assert timings["extract"] > 0
    assert sum(value for stage, value in timings.items() if stage != "total") <= timings["total"] + 1


def test_the_three_ways_give_the_same_pose(service, picture_world):
    url = service.url + "/v1/maps/room/localize"
    options = {"camera": {"fx": 520, "fy": 520, "cx": 319.5, "cy": 239.5}, "dof": 6}
    query = descriptor_query(picture_world, dof=6)
    blob = base64.b64encode(bytes.fromhex("".join(query["features"]["descriptors"]))).decode()
    packed = {**query, "features": {**query["features"], "descriptors": blob}}
    files = {"image": ("a.png", picture_world.png(), "image/png"), "request": (None, json.dumps(options))}
    answers = [
        send_picture(service, picture_world, fx=520, fy=520, cx=319.5, cy=239.5, dof=6),
        httpx.post(url, files=files, timeout=30),
        httpx.post(url, json=query, timeout=30),
        httpx.post(url, json=packed, timeout=30),
    ]
    poses = [answer.json()["pose"]["T_map_camera"] for answer in answers]
    for pose in poses[1:]:
        np.testing.assert_allclose(pose, poses[0], atol=1e-9)


def test_sizes_and_angles_may_be_left_out(service, picture_world):
    query = descriptor_query(picture_world)
    del query["features"]["sizes_px"], query["features"]["angles_deg"], query["features"]["channels"]
    answer = httpx.post(service.url + "/v1/maps/room/localize", json=query, timeout=30).json()
    assert answer["localized"]


def test_a_prior_is_taken(service, picture_world):
    position = ",".join(map(str, picture_world.pose.position))
    answer = send_picture(
        service, picture_world, prior_position=position, prior_heading="0.8,0.6,0", prior_radius_m=0.5
    ).json()
    np.testing.assert_allclose(answer["pose"]["position"], picture_world.pose.position, atol=0.02)


def test_several_maps_are_asked_and_one_answers(service, picture_world):
    for maps in ("all", "loose,room"):
        answer = send_picture(service, picture_world, "/v1/localize", maps=maps).json()
        assert answer["localized"]
        assert answer["map"] in ("room", "loose")
    assert send_picture(service, picture_world, "/v1/localize", maps="loose").json()["map"] == "loose"


def test_an_arbitrary_scale_is_said(service, picture_world):
    assert send_picture(service, picture_world, "/v1/maps/loose/localize").json()["scale"] == "arbitrary"


def test_no_pose_is_an_answer(service, picture_world):
    blank = cv2.imencode(".jpg", np.full((480, 640, 3), 128, np.uint8))[1].tobytes()
    answer = httpx.post(
        service.url + "/v1/maps/loose/localize", content=blank, headers={"Content-Type": "image/jpeg"}, timeout=30
    )
    assert answer.status_code == 200
    body = answer.json()
    assert (body["localized"], body["reason"], body["pose"]) == (False, "no_features", None)
    assert body["scale"] == "arbitrary"
    assert set(body["timings_ms"]) == STAGES


def test_a_deadline_is_kept(service, picture_world):
    body = send_picture(service, picture_world, deadline_ms=0.001).json()
    assert (body["localized"], body["reason"]) == (False, "deadline")


def test_a_full_queue_answers_busy(serve, picture_world, monkeypatch):
    running = serve(concurrency=1, queue_length=1)
    (running.settings.maps_dir / "room.rho").write_bytes(picture_world.rho())
    go_on, entered = threading.Event(), threading.Event()
    localize = Localizer.localize

    def slow(self, query):
        entered.set()
        go_on.wait(100)
        return localize(self, query)

    monkeypatch.setattr(Localizer, "localize", slow)
    with ThreadPoolExecutor(2) as pool:
        first = pool.submit(send_picture, running, picture_world)
        assert entered.wait(100)
        second = pool.submit(send_picture, running, picture_world)
        waiting = running.app.state.rholoc.frames.compute
        while not waiting.full:
            time.sleep(0.01)
        refused = send_picture(running, picture_world)
        unready = httpx.get(running.url + "/readyz")
        go_on.set()
        assert [first.result().status_code, second.result().status_code] == [200, 200]
    assert refused.status_code == 503
    assert refused.json()["code"] == "busy"
    assert int(refused.headers["Retry-After"]) >= 1
    assert unready.status_code == 503
    assert unready.json()["checks"]["compute"] != "ok"
    assert send_picture(running, picture_world).status_code == 200


@pytest.mark.slow
def test_a_map_is_swapped_between_two_requests(serve, picture_world):
    running = serve()
    files = {version: picture_world.rho(version=version, id=f"{version:032x}") for version in (1, 2)}
    url = running.url + "/v1/maps/room"
    httpx.put(url, content=files[1])
    stop, seen, bad = threading.Event(), [], []

    def keep_asking():
        while not stop.is_set():
            answer = send_picture(running, picture_world)
            if answer.status_code != 200 or int(answer.json()["map_id"], 16) != answer.json()["map_version"]:
                bad.append(answer.text)
            else:
                seen.append(answer.json()["map_version"])

    with ThreadPoolExecutor(2) as pool:
        asking = [pool.submit(keep_asking) for _ in range(2)]
        for version in (2, 1, 2, 1, 2):
            assert httpx.put(url, content=files[version]).status_code == 200
            assert send_picture(running, picture_world).json()["map_version"] == version
        stop.set()
        for one in asking:
            one.result()
    assert not bad
    assert set(seen) == {1, 2}


@pytest.mark.parametrize("name", ["X-Request-ID"])
def test_every_answer_has_a_request_id(service, picture_world, name):
    assert send_picture(service, picture_world).headers[name]
    assert httpx.get(service.url + "/nowhere").headers[name]
    assert httpx.get(service.url + "/healthz", headers={name: "robot-7"}).headers[name] == "robot-7"
    strange = httpx.get(service.url + "/healthz", headers={name: "a b<script>"}).headers[name]
    assert strange != "a b<script>"


def test_an_error_of_the_services_own_shows_no_traceback(service, picture_world, monkeypatch):
    def broken(self, query):
        raise ZeroDivisionError("secret detail")

    monkeypatch.setattr(Localizer, "localize", broken)
    answer = send_picture(service, picture_world)
    assert answer.status_code == 500
    assert answer.json()["code"] == "internal"
    assert answer.json()["request_id"] == answer.headers["X-Request-ID"]
    assert "secret" not in answer.text
    assert "Traceback" not in answer.text


def test_the_agreeing_matches_are_reported_on_request(service, picture_world):
    def ask(**options):
        return httpx.post(
            f"{service.url}/v1/maps/room/localize",
            params={"dof": 6, **options},
            content=picture_world.png(),
            headers={"Content-Type": "image/png"},
        ).json()

    assert ask()["agreeing"] is None
    answer = ask(with_matches=True)
    pixels, landmarks = np.array(answer["agreeing"]["pixels"]), np.array(answer["agreeing"]["landmarks"])
    assert len(pixels) == len(landmarks) >= answer["inliers"] > 0
    T_camera_map = np.linalg.inv(answer["pose"]["T_map_camera"])
    projected = picture_world.camera.project(landmarks @ T_camera_map[:3, :3].T + T_camera_map[:3, 3])
    assert np.median(np.linalg.norm(projected - pixels, axis=1)) < 2


@pytest.mark.parametrize(("option", "row"), [("max_sigma_m", 0), ("max_sigma_deg", 3)])
def test_whoever_needs_an_exact_pose_asks_for_one(service, picture_world, option, row):
    intrinsics = {"fx": 520, "fy": 520, "cx": 319.5, "cy": 239.5}
    given = send_picture(service, picture_world, **intrinsics).json()
    sigma = np.linalg.eigvalsh(np.array(given["covariance"])[row : row + 3, row : row + 3])[-1] ** 0.5
    assert send_picture(service, picture_world, **intrinsics, **{option: 2 * sigma}).json()["localized"]
    answer = send_picture(service, picture_world, **intrinsics, **{option: sigma / 2}).json()
    assert (answer["localized"], answer["pose"], answer["covariance"]) == (False, None, None)
    assert (answer["reason"], answer["diagnosis"]["cause"]) == ("too_inexact", "too_inexact")
    assert option in answer["diagnosis"]["hint"]
    assert answer["recognized"] >= 0.5
    refused = send_picture(service, picture_world, **intrinsics, **{option: 0})
    assert (refused.status_code, refused.json()["code"]) == (422, "invalid_request")


def test_a_frame_that_is_not_localized_is_answered_with_the_likeliest_cause(service, picture_world):
    wrong = send_picture(service, picture_world, fx=700, fy=700, cx=319.5, cy=239.5).json()
    assert not wrong["localized"] or wrong["confidence"] < 1
    black = cv2.imencode(".png", np.zeros_like(picture_world.image))[1].tobytes()
    url, png = f"{service.url}/v1/maps/room/localize", {"Content-Type": "image/png"}
    diagnosis = httpx.post(url, content=black, headers=png).json()["diagnosis"]
    assert diagnosis["cause"] == "too_dark"
    assert diagnosis["message"].endswith(".")
    assert diagnosis["hint"].endswith(".")
    assert send_picture(service, picture_world).json()["diagnosis"] is None


def test_unknown_intrinsics_are_estimated(service, picture_world):
    answer = send_picture(service, picture_world, intrinsics="unknown").json()
    assert answer["camera"] is None or answer["camera"]["focal_sigma_px"] > 0
    assert send_picture(service, picture_world).json()["camera"] is None
    refused = send_picture(service, picture_world, intrinsics="unknown", fx=500)
    assert (refused.status_code, refused.json()["code"]) == (422, "invalid_camera")


def test_degrees_of_freedom_are_named_in_every_way(service, picture_world):
    for dof in ("auto", 5, 6):
        assert send_picture(service, picture_world, dof=dof).json()["localized"]
        body = descriptor_query(picture_world, dof=dof)
        assert httpx.post(f"{service.url}/v1/maps/room/localize", json=body).json()["localized"]
