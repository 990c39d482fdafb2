"""The focal length: a wrong one is noticed, an unknown one is found."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr

from rholoc.density import Evidence
from rholoc.features import FeatureSet
from rholoc.geometry import Camera, Pose
from rholoc.localization import Cause, Intrinsics, Localizer, Query
from rholoc.localization.index.map_error import worst_sigma
from rholoc.localization.index.matches import Matches
from rholoc.localization.pose.ascent import ascend_with_focal, freed_focal
from rholoc.localization.pose.focal import (
    belief_beside,
    check_focal,
    focal_seed,
    verify_with_focal,
)
from rholoc.localization.pose.rematching import Verified, evidence_of, verify
from rholoc.localization.types import Dof
from rholoc.mapping.edit.correcting import set_distance
from rholoc.maps import Map, load_map
from rholoc.recordings import read_image


def corners(point_room: Any) -> list[Pose]:
    """A view into each of three corners."""
    poses: list[Pose] = point_room.into_corners()
    return poses[1::3]


@pytest.mark.parametrize("scale", [0.7, 0.85, 1.2, 1.346])
def test_a_wrong_focal_length_is_refused_and_named(localizer: Localizer, point_room: Any, scale: float) -> None:
    wrong = point_room.camera.zoomed(scale)
    for seed, truth in enumerate(corners(point_room)):
        answer = localizer.localize(Query(point_room.see(truth, 300 + seed), wrong))
        assert not answer.localized
        assert answer.diagnosis.cause is Cause.WRONG_CAMERA
        named_px = float(answer.diagnosis.message.split("about ")[1].split(" px")[0])
        assert named_px == pytest.approx(point_room.camera.focal, rel=0.03)


@pytest.mark.parametrize("scales", [(0.5, 0.5), (2.0, 2.0), (0.5, 1.0), (0.8, 1.0), (1.0, 0.5), (2.0, 1.0)])
def test_a_focal_length_that_is_far_off_or_only_one_of_the_two_is_refused(
    localizer: Localizer, point_room: Any, scales: tuple[float, float]
) -> None:
    camera, truth = point_room.camera, point_room.walk(13, sideways_m=0.1)[3]
    wrong = replace(camera, fx=camera.fx * scales[0], fy=camera.fy * scales[1])
    answer = localizer.localize(Query(point_room.see(truth, 303), wrong))
    assert not answer.localized
    assert answer.diagnosis.cause is Cause.WRONG_CAMERA


@pytest.mark.parametrize("width", [480, 960])
def test_a_picture_that_was_stretched_is_localized_by_its_own_camera(
    localizer: Localizer, point_room: Any, width: int
) -> None:
    camera = point_room.camera
    stretched = camera.resized(width, camera.height)
    for seed, truth in enumerate(corners(point_room)):
        seen = point_room.see(truth, 400 + seed)
        pixels = ((seen.pixels + 0.5) * (width / camera.width, 1) - 0.5).astype(np.float32)
        answer = localizer.localize(Query(replace(seen, pixels=pixels), stretched))
        assert np.linalg.norm(answer.pose.position - truth.position) < 0.02


@pytest.mark.parametrize(("scale", "least_m", "most_m"), [(1.0, 0.0, 0.02), (0.9, 0.03, 1.0), (1.1, 0.03, 1.0)])
def test_a_free_focal_length_moves_a_pose_where_the_one_given_is_wrong(
    localizer: Localizer, point_room: Any, scale: float, least_m: float, most_m: float
) -> None:
    camera = point_room.camera.zoomed(scale)
    for seed, truth in enumerate(corners(point_room)):
        query = Query(point_room.see(truth, 300 + seed), camera)
        rays = camera.rays(query.features.pixels)
        found = verify(localizer.index, query, rays, truth.T_map_camera)
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
    localizer = Localizer(room_map, min_recognized=0.0)
    for seed, truth in enumerate(corners(point_room)):
        seen = point_room.see(truth, 500 + seed)
        answer = localizer.localize(Query(seen, point_room.camera.zoomed(guess), intrinsics=Intrinsics.UNKNOWN))
        assert answer.focal_sigma_px is not None
        error = answer.pose.position - truth.position
        assert np.linalg.norm(error) < 0.1
        assert error @ np.linalg.solve(answer.covariance[:3, :3], error) < 11.3  # 99 % of a chi-square of three
        assert abs(answer.camera.focal - point_room.camera.focal) < 3 * answer.focal_sigma_px


def test_a_wall_straight_ahead_does_not_tell_the_focal_length_and_an_answer_knows_that(
    localizer: Localizer, point_room: Any
) -> None:
    facing = point_room.walk(13)
    for seed, truth in enumerate((facing[0], facing[4], facing[8])):
        query = Query(point_room.see(truth, 600 + seed), point_room.camera, intrinsics=Intrinsics.UNKNOWN)
        answer = localizer.localize(query)
        assert answer.confidence < 0.5
        if answer.pose is not None:
            off_m = np.linalg.norm(answer.pose.position - truth.position)
            assert off_m < min(0.5, 2 * worst_sigma(answer.covariance[:3, :3]))
        assert localizer.localize(replace(query, max_sigma_m=0.05)).pose is None


def test_an_estimated_focal_length_makes_the_pose_less_certain(room_map: Map, point_room: Any) -> None:
    localizer, seen = Localizer(room_map, min_recognized=0.0), point_room.see(corners(point_room)[0], 9)
    given = localizer.localize(Query(seen, point_room.camera))
    unknown = localizer.localize(Query(seen, point_room.camera, intrinsics=Intrinsics.UNKNOWN))
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


@pytest.mark.parametrize(("scale", "belief"), [(1.0, 1.0), (0.85, 0.05), (1.1, 0.1)])
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
    assert found.belief * found.exact == pytest.approx(belief, abs=0.12)
    if scale != 1.0:
        assert abs(found.focal_px - point_room.camera.focal) < found.sigma_px < 0.25 * found.focal_px


@pytest.mark.parametrize("length_m", [0.8, 0.9])  # numbers that end so that a wrong focal length explains a bit more
def test_a_wall_does_not_speak_against_a_focal_length_but_leaves_the_distance_open(length_m: float) -> None:
    """One of the shipped map's queries: 298 matches, 5 mm off, and a tenth longer fits as well, from 25 cm behind."""
    shipped = Path(__file__).resolve().parents[2] / "maps"
    map_ = set_distance(load_map(shipped / "testsite.rho"), np.zeros(3), np.array([0.0, 1.0, 0.0]), length_m)
    localizer = Localizer(map_)
    picture = read_image(shipped / "queries" / "1.jpg")
    answer = localizer.localize(Query.of_picture(picture, localizer.extractor, map_.info.camera))
    assert answer.recognized > 0.99
    assert 0.5 < answer.confidence < 0.99
    assert answer.pose is not None
    assert 0.05 < worst_sigma(answer.covariance[:3, :3]) < 0.25


def test_where_too_few_matches_were_made_other_focal_lengths_are_tried_around_the_pose(
    localizer: Localizer, point_room: Any
) -> None:
    truth, camera = corners(point_room)[0], point_room.camera.zoomed(0.85)
    query = Query(point_room.see(truth, 700), camera)
    verified = verify(localizer.index, query, camera.rays(query.features.pixels), truth.T_map_camera)
    assert verified is not None
    place = localizer.index.match_everywhere(query.features).likeliest_first()
    found = check_focal(localizer.index, query, verified, place.take(np.arange(7)))
    assert found.focal_px == pytest.approx(point_room.camera.focal, rel=0.03)
    assert found.belief < 0.3
    assert found.of_others is not None
    assert 0.1 < worst_sigma(found.of_others[:3, :3]) < 1.0


@pytest.mark.parametrize("share", [0.5, 0.75, 1.1, 2.0])
@pytest.mark.parametrize("portrait", [False, True])
def test_a_seed_of_an_unknown_focal_length_is_within_a_guess(
    localizer: Localizer, point_room: Any, share: float, portrait: bool
) -> None:
    """Guesses are a sixth apart and reach from 0.5 to 2 times the longer side."""
    width, height = (480, 640) if portrait else (640, 480)
    true = Camera(width, height, 640 * share, 640 * share, width / 2, height / 2)
    truth = corners(point_room)[1]
    index = localizer.index
    pixels = true.project((index.landmarks - truth.position) @ truth.R_map_camera)
    shown = np.flatnonzero(true.contains(pixels))
    count = len(shown)
    zeros = np.zeros(count, np.float32)
    descriptors = np.zeros((count, 32), np.uint8)
    seen = FeatureSet(pixels[shown].astype(np.float32), np.zeros(count, np.uint8), descriptors, zeros, zeros)
    query = Query(seen, true.zoomed(1.3), intrinsics=Intrinsics.UNKNOWN)
    matches = Matches(np.arange(count), shown, np.full(count, 0.5))
    found = focal_seed(index, matches, query, 500)
    assert found is not None
    T, camera = found
    assert abs(np.log(camera.focal / true.focal)) < 1.05 * np.log(1.17)
    assert np.linalg.norm(T[:3, 3] - truth.position) < 0.6
    assert focal_seed(index, matches.take(np.arange(7)), query, 500) is None


def test_an_estimated_focal_lengths_belief_is_that_the_pose_is_within_half_a_metre(
    localizer: Localizer, point_room: Any
) -> None:
    truth, camera = corners(point_room)[0], point_room.camera.zoomed(1.05)
    query = Query(point_room.see(truth, 700), camera, intrinsics=Intrinsics.UNKNOWN)
    matches = localizer.index.match_everywhere(query.features)
    found = verify_with_focal(localizer.index, query, truth.T_map_camera, matches)
    assert found is not None
    verified, estimate, refined = found
    assert verified.focal_free
    sigma_m = np.sqrt(np.linalg.eigvalsh(verified.covariance[:3, :3]).max())
    assert estimate.belief == pytest.approx(ndtr(0.5 / sigma_m) - ndtr(-0.5 / sigma_m))
    assert estimate.exact == 1
    assert estimate.focal_px == refined.camera.focal == pytest.approx(point_room.camera.focal, rel=0.02)
    assert 0.001 < estimate.sigma_px / estimate.focal_px < 0.1
    few = matches.take(np.arange(9))
    absurd = replace(query, camera=point_room.camera.zoomed(0.3))
    assert verify_with_focal(localizer.index, absurd, truth.T_map_camera, few) is None


@pytest.mark.parametrize(
    ("value", "moved_m", "belief"),
    [
        (90.0, 0.5, 1.0),
        (102.4, 0.5, 1.0),
        (104.0, 0.5, 1.0),
        (160.0, 0.5, 0.0),
        (160.0, 0.05, 1.0),
        (160.0, 0.075, 0.5),
    ],
)
def test_another_focal_length_counts_by_how_much_more_it_explains_and_what_it_changes(
    point_room: Any, verified_at: Callable[..., Verified], value: float, moved_m: float, belief: float
) -> None:
    """Of poses without matches curvature says nothing, as in front of a wall."""
    pose = corners(point_room)[0]
    T = pose.T_map_camera.copy()
    T[0, 3] += moved_m
    others = [(1.0, verified_at(pose, value=80.0)), (2.0, verified_at(Pose(T), value=value))]
    assert belief_beside(verified_at(pose, value=100.0), others) == pytest.approx(belief, abs=0.1)
    assert belief_beside(verified_at(pose, value=100.0), []) == 1.0
