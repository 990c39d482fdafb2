"""The focal length: a wrong one is noticed, an unknown one is found."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rholoc.density import Evidence
from rholoc.geometry import Pose
from rholoc.localization import Cause, Intrinsics, Localizer, Query
from rholoc.localization.ascent import ascend_with_focal, freed_focal
from rholoc.localization.focal import _sensible, check_focal
from rholoc.localization.types import Dof
from rholoc.localization.verification import evidence_of, verify
from rholoc.maps import Map


def corners(point_room: Any) -> list[Pose]:
    """Views into the room's corners, where near and far is to be seen."""
    walk = point_room.walk(13, sideways_m=0.1)
    return [walk[i] for i in (2, 6, 10)]


@pytest.mark.parametrize("scale", [0.7, 0.85, 1.2, 1.346])
def test_a_wrong_focal_length_is_refused_and_named(localizer: Localizer, point_room: Any, scale: float) -> None:
    wrong = point_room.camera.zoomed(scale)
    for seed, truth in enumerate(corners(point_room)):
        answer = localizer.localize(Query(point_room.see(truth, 300 + seed), wrong))
        assert not answer.localized
        assert answer.diagnosis is not None
        assert answer.diagnosis.cause is Cause.WRONG_CAMERA
        named_px = float(answer.diagnosis.message.split("about ")[1].split(" px")[0])
        assert named_px == pytest.approx(point_room.camera.focal, rel=0.03)


@pytest.mark.parametrize(("scale", "least_m", "most_m"), [(1.0, 0.0, 0.02), (0.9, 0.03, 1.0), (1.1, 0.03, 1.0)])
def test_a_free_focal_length_moves_a_pose_where_the_one_given_is_wrong(
    localizer: Localizer, point_room: Any, scale: float, least_m: float, most_m: float
) -> None:
    camera = point_room.camera.zoomed(scale)
    for seed, truth in enumerate(corners(point_room)):
        query = Query(point_room.see(truth, 300 + seed), camera)
        rays = camera.rays(query.features.pixels)
        found = verify(localizer.index, query, rays, truth.T_map_camera)
        assert found is not None
        evidence = evidence_of(localizer.index, found.wide, rays, camera)
        moved_m, gain = freed_focal(evidence, found.optimum.T_map_camera, 14.0, Dof.FREE)
        assert least_m <= moved_m <= most_m
        assert gain >= 0


@pytest.mark.parametrize("scale", [0.99, 1.0, 1.01])
def test_a_focal_length_that_is_right_within_a_percent_is_believed(
    localizer: Localizer, point_room: Any, scale: float
) -> None:
    for seed, truth in enumerate(corners(point_room)):
        answer = localizer.localize(Query(point_room.see(truth, 400 + seed), point_room.camera.zoomed(scale)))
        assert answer.localized
        assert answer.camera is None


@pytest.mark.parametrize("guess", [0.5, 1.0, 2.5])
def test_an_unknown_focal_length_is_estimated_with_the_pose(room_map: Map, point_room: Any, guess: float) -> None:
    localizer = Localizer(room_map, min_confidence=0.0)
    for seed, truth in enumerate(corners(point_room)):
        seen = point_room.see(truth, 500 + seed)
        answer = localizer.localize(Query(seen, point_room.camera.zoomed(guess), intrinsics=Intrinsics.UNKNOWN))
        assert answer.pose is not None
        assert answer.covariance is not None
        assert answer.camera is not None
        assert answer.focal_sigma_px is not None
        error = answer.pose.position - truth.position
        assert np.linalg.norm(error) < 0.1
        assert error @ np.linalg.solve(answer.covariance[:3, :3], error) < 11.3  # 99 % of a chi-square of three
        assert abs(answer.camera.focal - point_room.camera.focal) < 3 * answer.focal_sigma_px


def test_a_wall_straight_ahead_does_not_tell_the_focal_length_and_no_pose_is_made_up(
    localizer: Localizer, point_room: Any
) -> None:
    facing = point_room.walk(13)
    for seed, truth in enumerate((facing[0], facing[4], facing[8])):
        query = Query(point_room.see(truth, 600 + seed), point_room.camera, intrinsics=Intrinsics.UNKNOWN)
        answer = localizer.localize(query)
        assert answer.pose is None or np.linalg.norm(answer.pose.position - truth.position) < 0.1


def test_an_estimated_focal_length_makes_the_pose_less_certain(room_map: Map, point_room: Any) -> None:
    localizer, seen = Localizer(room_map, min_confidence=0.0), point_room.see(corners(point_room)[0], 9)
    given = localizer.localize(Query(seen, point_room.camera))
    unknown = localizer.localize(Query(seen, point_room.camera, intrinsics=Intrinsics.UNKNOWN))
    assert given.covariance is not None
    assert unknown.covariance is not None
    assert np.trace(unknown.covariance[:3, :3]) > 2 * np.trace(given.covariance[:3, :3])
    assert unknown.confidence < given.confidence


def test_the_ascent_finds_the_focal_length(point_room: Any) -> None:
    truth = corners(point_room)[0]
    rng = np.random.default_rng(1)
    landmarks = rng.uniform(-2, 2, (200, 3)) @ truth.R_map_camera.T + truth.position + 4 * truth.heading
    pixels = point_room.camera.project((landmarks - truth.position) @ truth.R_map_camera)
    wrong = point_room.camera.zoomed(1.15)
    spread, chances = np.tile(1e-8 * np.eye(3), (200, 1, 1)), np.full(200, 0.9)
    evidence = Evidence.of(np.arange(200), wrong.rays(pixels), landmarks, spread, chances, wrong.focal)
    optimum, scale, _ = ascend_with_focal(evidence, truth.T_map_camera, (80.0, 40.0, 10.0, 4.0), Dof.FREE, 20)
    assert scale == pytest.approx(1 / 1.15, rel=1e-3)
    assert np.linalg.norm(optimum.T_map_camera[:3, 3] - truth.position) < 0.005


@pytest.mark.parametrize(
    ("scale", "sensible"), [(0.36, False), (0.38, True), (1.0, True), (4.3, True), (4.4, False), (-1.0, False)]
)
def test_cameras_of_20_to_120_degrees_exist(point_room: Any, scale: float, sensible: bool) -> None:
    """From 0.3 to 3.5 times the longer side; the room's camera has 520 of 640 px."""
    assert _sensible(point_room.camera, scale) == sensible


@pytest.mark.parametrize(("scale", "belief"), [(1.0, 1.0), (0.85, 0.3), (1.1, 0.86)])
def test_what_the_matches_say_of_a_given_focal_length(
    localizer: Localizer, point_room: Any, scale: float, belief: float
) -> None:
    truth, camera = corners(point_room)[0], point_room.camera.zoomed(scale)
    seen = point_room.see(truth, 700)
    query = Query(seen, camera)
    verified = verify(localizer.index, query, camera.rays(seen.pixels), truth.T_map_camera)
    assert verified is not None
    found = check_focal(localizer.index, query, verified, localizer.index.match_everywhere(seen))
    assert found.focal_px == pytest.approx(point_room.camera.focal, rel=0.02)
    assert found.belief == pytest.approx(belief, abs=0.12)
    if scale == 1.0:
        assert found.moved_m < 0.02
    else:
        assert 0.1 < found.moved_m < 1.0
        assert abs(found.focal_px - point_room.camera.focal) < 3 * found.sigma_px < 0.2 * found.focal_px
