"""The focal length: a wrong one is noticed, an unknown one is found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from rholoc.density import Evidence
from rholoc.features import FeatureSet
from rholoc.geometry import Camera, FloatArray, Pose, on_plane
from rholoc.localization import Cause, Intrinsics, Localizer, Query, focal
from rholoc.localization.ascent import ascend_with_focal, freed_focal
from rholoc.localization.focal import (
    FocalEstimate,
    _belief,
    _compared,
    _fits,
    _sensible,
    _spread,
    check_focal,
    focal_seed,
    verify_with_focal,
)
from rholoc.localization.map_uncertainty import worst_sigma
from rholoc.localization.matches import Matches
from rholoc.localization.types import Dof
from rholoc.localization.verification import evidence_of, verify
from rholoc.mapping.correcting import set_distance
from rholoc.maps import Map, load_map
from rholoc.recordings import read_image


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
    localizer = Localizer(room_map, min_recognized=0.0)
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


def test_a_wall_straight_ahead_does_not_tell_the_focal_length_and_an_answer_knows_that(
    localizer: Localizer, point_room: Any
) -> None:
    facing = point_room.walk(13)
    for seed, truth in enumerate((facing[0], facing[4], facing[8])):
        query = Query(point_room.see(truth, 600 + seed), point_room.camera, intrinsics=Intrinsics.UNKNOWN)
        answer = localizer.localize(query)
        assert answer.confidence < 0.5
        if answer.pose is not None:
            assert answer.covariance is not None
            off_m = np.linalg.norm(answer.pose.position - truth.position)
            assert off_m < min(0.5, 2 * worst_sigma(answer.covariance[:3, :3]))
        assert localizer.localize(replace(query, max_sigma_m=0.05)).pose is None


def test_an_estimated_focal_length_makes_the_pose_less_certain(room_map: Map, point_room: Any) -> None:
    localizer, seen = Localizer(room_map, min_recognized=0.0), point_room.see(corners(point_room)[0], 9)
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
    assert found.belief == pytest.approx(belief, abs=0.12)
    if scale == 1.0:
        assert found.moved_m < 0.02
    else:
        assert 0.1 < found.moved_m < 1.0
        assert abs(found.focal_px - point_room.camera.focal) < 3 * found.sigma_px < 0.2 * found.focal_px


@pytest.mark.parametrize(
    ("moved_m", "scale", "sigma", "belief"),
    [
        (0.05, 2.0, 0.0, 1.0),  # a pose that hardly moves is right either way
        (0.075, 2.0, 0.0, 0.5),
        (0.1, 2.0, 0.0, 0.0),
        (3.0, 0.5, 0.0, 0.0),
        (1.0, np.exp(0.012), 0.0, 1.0),  # as two calibrations differ
        (1.0, np.exp(-0.015), 0.0, 0.6),
        (1.0, np.exp(0.018), 0.0, 0.2),
        (1.0, np.exp(0.06), 0.0, 0.0),
        (1.0, np.exp(0.9 * np.hypot(0.03, 0.015)), 0.03, 0.8),
        (1.0, 2.0, np.inf, 1.0),
    ],
)
def test_a_focal_length_is_doubted_where_it_does_harm_and_is_off(
    moved_m: float, scale: float, sigma: float, belief: float
) -> None:
    assert _belief(moved_m, scale, sigma) == pytest.approx(belief)


@pytest.mark.parametrize(
    ("more", "known", "belief"), [(-0.01, 200, 1.0), (0.04, 200, 0.6), (0.04, 8, 1.0), (0.06, 8, 0.1)]
)
def test_a_focal_length_is_doubted_where_another_explains_more_than_shared_errors_would_or_is_known(
    localizer: Localizer, point_room: Any, more: float, known: int, belief: float
) -> None:
    """By so much more, as a share of all, and by so many matches."""
    truth, seen = corners(point_room)[0], point_room.see(corners(point_room)[0], 700)
    cameras = (point_room.camera.zoomed(0.85), point_room.camera)
    wrong, right = (
        verify(localizer.index, Query(seen, camera), camera.rays(seen.pixels), truth.T_map_camera) for camera in cameras
    )
    assert wrong is not None
    assert right is not None
    some = np.arange(min(known, len(wrong.evidence)))
    of_some = replace(wrong.optimum, density=wrong.optimum.density[some])
    given = replace(wrong, evidence=wrong.evidence.take(some), optimum=of_some)
    other = replace(right, optimum=replace(right.optimum, value=(1 + more) * wrong.optimum.value))
    assert _compared(given, [(1 / 0.85, other)]) == pytest.approx(belief, abs=0.1)
    lesser = replace(right, optimum=replace(right.optimum, value=0.5 * wrong.optimum.value))
    assert _compared(given, [(1.0, lesser), (1 / 0.85, other)]) == pytest.approx(belief, abs=0.1)


def test_a_focal_length_that_nothing_is_held_against_is_believed(localizer: Localizer, point_room: Any) -> None:
    truth, camera = corners(point_room)[0], point_room.camera
    query = Query(point_room.see(truth, 700), camera)
    verified = verify(localizer.index, query, camera.rays(query.features.pixels), truth.T_map_camera)
    assert verified is not None
    assert _compared(verified, []) == 1.0


@pytest.mark.parametrize("length_m", [0.8, 0.9])  # numbers that end so that a wrong focal length explains a bit more
def test_a_wall_does_not_speak_against_a_focal_length(length_m: float) -> None:
    """One of the shipped map's queries: 298 matches, 5 mm off, and a tenth longer fits as well, from 25 cm behind."""
    shipped = Path(__file__).resolve().parents[2] / "maps"
    map_ = set_distance(load_map(shipped / "testsite.rho"), np.zeros(3), np.array([0.0, 1.0, 0.0]), length_m)
    localizer = Localizer(map_)
    picture = read_image(shipped / "queries" / "1.jpg")
    assert localizer.localize(Query.of_picture(picture, localizer.extractor, map_.info.camera)).confidence > 0.8


def test_a_focal_lengths_spread_is_thrice_its_curvatures_and_at_most_itself() -> None:
    assert [_spread(sigma) for sigma in (0.0, 0.02, 0.4, np.inf)] == pytest.approx([0.0, 0.06, 1.0, 1.0])


@pytest.mark.parametrize(
    ("moved_m", "gain", "fits"), [(0.014, 0.49, True), (0.016, 0.49, False), (0.014, 0.51, False), (0.016, 0.51, False)]
)
def test_a_focal_length_fits_where_freeing_it_changes_nothing_around_the_pose_and_in_its_place(
    localizer: Localizer, point_room: Any, monkeypatch: pytest.MonkeyPatch, moved_m: float, gain: float, fits: bool
) -> None:
    truth, camera = corners(point_room)[0], point_room.camera
    query = Query(point_room.see(truth, 700), camera)
    verified = verify(localizer.index, query, camera.rays(query.features.pixels), truth.T_map_camera)
    assert verified is not None
    every = localizer.index.match_everywhere(query.features)
    place = every.take(np.arange(min(len(every), len(verified.wide)) - 1))  # as many as around the pose would hide one
    assert len(place) > 60
    changes = {len(verified.wide): (0.0, 0.0), len(place): (moved_m, gain)}

    def freed(evidence: Evidence, T: FloatArray, tolerance_px: float, dof: Dof) -> tuple[float, float]:
        assert tolerance_px == 14.0
        return changes[len(evidence)]

    monkeypatch.setattr("rholoc.localization.focal.freed_focal", freed)
    assert _fits(localizer.index, query, verified, place) is fits
    changes = {len(verified.wide): (moved_m, gain), len(place): (0.0, 0.0)}
    assert _fits(localizer.index, query, verified, place) is fits
    changes = dict.fromkeys((59, 60, len(verified.wide)), (0.0, 0.0))
    assert not _fits(localizer.index, query, verified, place.take(np.arange(59)))
    assert _fits(localizer.index, query, verified, place.take(np.arange(60)))
    few = replace(verified, wide=place.take(np.arange(59)))
    assert not _fits(localizer.index, query, few, place.take(np.arange(60)))


def test_too_few_matches_say_nothing_of_the_focal_length(localizer: Localizer, point_room: Any) -> None:
    truth, camera = corners(point_room)[0], point_room.camera.zoomed(0.85)
    query = Query(point_room.see(truth, 700), camera)
    verified = verify(localizer.index, query, camera.rays(query.features.pixels), truth.T_map_camera)
    assert verified is not None
    place = localizer.index.match_everywhere(query.features).likeliest_first()
    nothing = check_focal(localizer.index, query, verified, place.take(np.arange(7)))
    assert nothing == FocalEstimate(camera.focal, camera.focal, 0.0, 1.0)
    some = check_focal(localizer.index, query, verified, place.take(np.arange(8)))
    assert some.focal_px != camera.focal


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


@pytest.mark.parametrize(("agreeing", "found"), [(None, False), (6, False), (7, True)])
def test_a_seed_of_an_unknown_focal_length_has_eight_matches_that_agree(
    localizer: Localizer, point_room: Any, monkeypatch: pytest.MonkeyPatch, agreeing: int | None, found: bool
) -> None:
    query = Query(point_room.see(corners(point_room)[0], 9), point_room.camera, intrinsics=Intrinsics.UNKNOWN)
    matches = localizer.index.match_everywhere(query.features)
    guesses: list[float] = []

    def ransac(rays: FloatArray, points: FloatArray, focal_px: float, *how: Any) -> tuple[FloatArray, int] | None:
        guesses.append(focal_px)
        assert how == (0.02 * 640, 500, 50)
        likeliest = matches.likeliest_first()
        seen = on_plane(point_room.camera.rays(query.features.pixels[likeliest.detections]))
        np.testing.assert_allclose(on_plane(rays) * focal_px, seen * point_room.camera.focal)
        return None if agreeing is None else (np.eye(4), agreeing + (len(guesses) == 3))

    monkeypatch.setattr(focal, "lo_ransac", ransac)
    seed = focal_seed(localizer.index, matches, query, 500)
    np.testing.assert_allclose(guesses, 640 * 0.5 * 1.17 ** np.arange(10))
    assert (seed is not None) is found  # the third guess has one more
    if seed is not None:
        assert seed[1].focal == pytest.approx(guesses[2])


def test_an_estimated_focal_lengths_belief_is_that_the_place_is_within_ten_centimetres(
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
    assert estimate.belief == pytest.approx(norm.cdf(0.5 / sigma_m) - norm.cdf(-0.5 / sigma_m))
    assert estimate.belief * estimate.exact == pytest.approx(norm.cdf(0.1 / sigma_m) - norm.cdf(-0.1 / sigma_m))
    assert estimate.focal_px == refined.camera.focal == pytest.approx(point_room.camera.focal, rel=0.02)
    assert estimate.moved_m == 0.0
    assert 0.001 < estimate.sigma_px / estimate.focal_px < 0.1
    few = matches.take(np.arange(9))
    absurd = replace(query, camera=point_room.camera.zoomed(0.3))
    assert verify_with_focal(localizer.index, absurd, truth.T_map_camera, few) is None


def test_a_focal_length_is_sought_ever_more_closely_until_it_stays(
    localizer: Localizer, point_room: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth, camera, index = corners(point_room)[0], point_room.camera.zoomed(0.85), localizer.index
    query = Query(point_room.see(truth, 700), camera)
    matches = index.match_everywhere(query.features)
    verified = verify(index, query, camera.rays(query.features.pixels), truth.T_map_camera)
    assert verified is not None
    climb, match_near = focal.ascend_with_focal, index.match_near
    climbs: list[tuple[float, ...]] = []
    changes: list[float] = []
    radii_px: list[float] = []

    def ascended(evidence: Any, T: Any, tolerances_px: tuple[float, ...], dof: Any) -> Any:
        climbs.append(tolerances_px)
        found = climb(evidence, T, tolerances_px, dof)
        changes.append(abs(np.log(found[1])))
        return found

    monkeypatch.setattr(focal, "ascend_with_focal", ascended)
    monkeypatch.setattr(index, "match_near", lambda *how: (radii_px.append(how[3]), match_near(*how))[1])
    check_focal(index, query, verified, matches)
    compared = climbs.count((5.0, 4.0))
    rounds = len(climbs) - compared
    assert rounds in (2, 3)
    assert compared in (1, 2, 3)
    assert climbs == [(40.0, 15.0, 5.0)] + [(14.0, 7.0, 4.0)] * (rounds - 1) + [(5.0, 4.0)] * compared
    verification_px = [14.0, 5.0]
    assert radii_px == [14.0] * (rounds if changes[rounds - 1] >= 0.02 else rounds - 1) + verification_px * compared
    assert min(changes[: rounds - 1]) >= 0.02
    assert min(changes[rounds:-1], default=1) >= 0.003
    assert compared == 3 or changes[-1] < 0.003
    for given in (climbs, changes, radii_px):
        given.clear()
    assert verify_with_focal(index, query, truth.T_map_camera, matches) is not None
    rounds = len(climbs)
    assert climbs == [(24.0, 12.0, 6.0)] + [(14.0, 7.0, 4.0)] * (rounds - 1)
    assert radii_px == [14.0] * (rounds - 1) + verification_px
    assert min(changes[1:-1], default=1) >= 0.02

    scale, turned = 1.03, verified.optimum  # which never stays: three rounds are made
    monkeypatch.setattr(focal, "ascend_with_focal", lambda *_: (climbs.append(()), (turned, scale, 0.01))[1])
    climbs.clear()
    assert check_focal(index, query, verified, matches).focal_px == pytest.approx(camera.focal * 1.03**3)
    assert len(climbs) == 3
    climbs.clear()
    verify_with_focal(index, query, truth.T_map_camera, matches)
    assert len(climbs) == 4
    scale = 100.0
    assert verify_with_focal(index, query, truth.T_map_camera, matches) is None
    scale = 1.019  # which is near enough
    climbs.clear()
    check_focal(index, query, verified, matches)
    assert len(climbs) == 1
