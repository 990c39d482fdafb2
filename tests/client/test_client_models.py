"""Answers of the service → the client's dataclasses, and codes of its errors."""

import pytest

from rholoc_client import Busy, OnEarth, ServiceError, Site, SiteMap
from rholoc_client.models import parse_job, parse_localization, parse_site

COVARIANCE = [[float(i == j) for j in range(6)] for i in range(6)]
POSE = {
    "position": [1.0, 2.0, 1.5], "heading": [1.0, 0.0, 0.0], "roll_deg": 2.0, "quaternion_xyzw": [0.5, -0.5, 0.5, -0.5],
    "T_map_camera": [[0.0, 0.0, 1.0, 1.0], [-1.0, 0.0, 0.0, 2.0], [0.0, -1.0, 0.0, 1.5], [0.0, 0.0, 0.0, 1.0]],
}  # fmt: skip
ANSWER = {
    "localized": True, "reason": None, "pose": POSE, "covariance": COVARIANCE, "recognized": 0.99, "confidence": 0.9,
    "matches": 200, "inliers": 120, "map": "hall", "map_id": "1" * 32, "map_version": 2, "scale": "metric",
    "timings_ms": {"search": 12.5}, "alternatives": [{"weight": 0.01, "pose": POSE, "covariance": None}],
}  # fmt: skip
JOB = {
    "id": "1" * 32, "recording": "2" * 32, "map": "hall", "state": "queued", "stage": "received", "progress": 0.0,
    "message": "", "log": ["begun"], "error": None, "created": 1.0, "started": None, "ended": None, "attempts": 0,
}  # fmt: skip


def test_an_answer_of_a_service_that_says_less_has_defaults():
    found = parse_localization(ANSWER)
    assert found.pose.T_map_camera[0] == (0.0, 0.0, 1.0, 1.0)
    assert found.covariance[1] == (0.0, 1.0, 0.0, 0.0, 0.0, 0.0)
    assert found.reason is None
    assert found.alternatives[0].covariance is None
    assert found.alternatives[0].pose == found.pose
    assert (found.camera, found.site, found.agreeing, found.frames, found.near) == (None, None, None, (), ())
    assert parse_localization({**ANSWER, "frames": None, "near": None, "camera": None}) == found


def test_an_answer_may_have_everything_and_members_that_are_not_known_yet():
    camera = {"width": 640, "height": 480, "fx": 500.0, "fy": 500.0, "cx": 320.0, "cy": 240.0, "focal_sigma_px": 3.0}
    earth = {"latitude_deg": 50.1, "longitude_deg": 8.6, "height_m": 110.0, "heading_deg": None, "tomorrow": 1}
    site = {
        "site": "campus", "version": 3, "floor": "1", "position": [4.0, 5.0, 6.0], "heading": [0.0, 1.0, 0.0],
        "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0], "covariance": None, "earth": earth,
    }  # fmt: skip
    agreeing = {"pixels": [[10.0, 20.0]], "landmarks": [[1.0, 2.0, 3.0]]}
    frames = [{"pose": POSE, "inliers": 60}, {"pose": None, "inliers": 0}]
    further = {"camera": camera, "site": site, "agreeing": agreeing, "frames": frames, "near": ["door"], "tomorrow": 1}
    found = parse_localization({**ANSWER, **further})
    assert (found.camera.width, found.camera.distortion, found.focal_sigma_px) == (640, (), 3.0)
    assert (found.site.position, found.site.covariance) == ((4.0, 5.0, 6.0), None)
    assert found.site.earth == OnEarth(50.1, 8.6, 110.0, None)
    assert (found.agreeing.pixels, found.agreeing.landmarks) == (((10.0, 20.0),), ((1.0, 2.0, 3.0),))
    assert [(one.pose == found.pose, one.inliers) for one in found.frames] == [(True, 60), (False, 0)]
    assert found.near == ("door",)


def test_a_map_of_a_site_may_have_no_pose():
    pose = {"position": [1.0, 0.0, 0.0], "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0]}
    placed = {"map": "hall", "floor": "1", "pose": pose, "given": True, "covariance": COVARIANCE, "present": True}
    missing = {**placed, "map": "lab", "pose": None, "given": False, "covariance": None}
    links = [{"first": "hall", "second": "lab"}]
    answer = {"name": "campus", "version": 1, "maps": [placed, missing], "links": links, "earth": None}
    covariance = tuple(map(tuple, COVARIANCE))
    assert parse_site(answer) == Site(
        "campus",
        1,
        (
            SiteMap("hall", "1", (1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), True, covariance, True),
            SiteMap("lab", "1", None, None, False, None, True),
        ),
        tuple(links),
    )


def test_a_jobs_error_is_told_by_three_members():
    assert parse_job(JOB).error_code is None
    assert (parse_job(JOB).log, parse_job(JOB).warnings) == (("begun",), ())
    failed = parse_job({**JOB, "error": {"code": "cancelled", "message": "Ended.", "hint": "Again."}})
    assert (failed.error_code, failed.error_message, failed.error_hint) == ("cancelled", "Ended.", "Again.")


@pytest.mark.parametrize("member", ["localized", "pose"])
def test_what_every_service_says_must_be_there(member):
    with pytest.raises(KeyError):
        parse_localization({name: value for name, value in ANSWER.items() if name != member})


def test_an_error_of_ones_own_keeps_the_code_that_it_states():
    class Refused(ServiceError):
        code = "no"

    assert Refused("No.").code == "no"
    assert Busy("Later.").code == "busy"
