"""Look-alikes: places that show the same, things of a place in a picture of another."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rholoc.features import FeatureSet
from rholoc.geometry import Pose
from rholoc.localization import Dof, Localizer, Query, SeveralFrames, localize_together
from rholoc.localization.index.matches import Matches
from rholoc.localization.pose.ascent import Optimum
from rholoc.localization.pose.rematching import verify
from rholoc.localization.pose.rivals import _unexplained, are_rivals, rival_seeds, shares


@pytest.fixture(scope="module")
def twin_room(point_room: Any) -> Any:
    """A room that looks the same after half a turn."""
    half = point_room.points[: len(point_room.points) // 2]
    other = half * (-1, -1, 1)
    descriptors = point_room.descriptors[: len(half)]
    return type(point_room)(np.vstack([half, other]), np.vstack([descriptors, descriptors]), point_room.camera)


def test_a_room_that_is_its_own_twin_is_not_answered_with_confidence(twin_room: Any) -> None:
    localizer = Localizer(twin_room.map_of(twin_room.walk(80), "twin"), min_recognized=0.0)
    for seed, truth in enumerate(twin_room.walk(9, sideways_m=0.1)[1:3]):
        answer = localizer.localize(Query(twin_room.see(truth, 70 + seed), twin_room.camera, Dof.FREE))
        assert answer.recognized < 0.75  # of two equal places neither is likelier than a half
        assert answer.alternatives
        other = answer.alternatives[0]
        assert other.weight > 0.25
        assert answer.recognized + sum(one.weight for one in answer.alternatives) <= 1 + 1e-9
        both = {round(float(pose.position @ truth.position) / 0.2) for pose in (answer.pose, other.pose) if pose}
        mirrored = truth.position * (-1, -1, 1)
        assert both == {round(float(at @ truth.position) / 0.2) for at in (truth.position, mirrored)}
        withheld = Localizer(localizer.map, min_recognized=0.99, index=localizer.index).localize(
            Query(twin_room.see(truth, 70 + seed), twin_room.camera, Dof.FREE)
        )
        assert not withheld.localized
        assert [one.weight for one in withheld.alternatives] == [
            answer.recognized,
            *(one.weight for one in answer.alternatives),
        ][:4]


def test_several_frames_of_it_are_not_answered_as_if_there_were_no_other(twin_room: Any) -> None:
    localizer = Localizer(twin_room.map_of(twin_room.walk(80), "twin"), min_recognized=0.0)
    truths = twin_room.walk(40, sideways_m=0.1)[5:14:4]
    frames = tuple(Query(twin_room.see(truth, 80 + i), twin_room.camera, Dof.FREE) for i, truth in enumerate(truths))
    asked = SeveralFrames(frames, np.array([truth.T_map_camera for truth in truths]))
    assert localize_together(localizer, asked).first.recognized < 0.9


def _in_a_crowd(seen: FeatureSet, kept: np.ndarray, seed: int) -> FeatureSet:
    """Some of the features of a picture, amid others that nobody has seen."""
    rng, count = np.random.default_rng(seed), 400
    strange = FeatureSet(
        rng.uniform(0, (640, 480), (count, 2)).astype(np.float32),
        np.zeros(count, np.uint8),
        rng.integers(0, 256, (count, seen.descriptors.shape[1]), dtype=np.uint8),
        np.full(count, 31, np.float32),
        np.zeros(count, np.float32),
    )
    return FeatureSet.concatenate([seen.take(np.flatnonzero(kept)), strange])


def test_what_should_be_seen_and_is_not_speaks_against_a_pose(localizer: Localizer, point_room: Any) -> None:
    missing = np.zeros(2)
    for seed, truth in enumerate(point_room.walk(12, sideways_m=0.1)[:8]):
        seen = point_room.see(truth, seed)
        thing = seen.pixels[:, 0] < 250
        for i, kept in enumerate((np.ones(len(seen), dtype=bool), thing)):
            query = Query(_in_a_crowd(seen, kept, seed), point_room.camera, Dof.FREE)
            rays = point_room.camera.rays(query.features.pixels)
            found = verify(localizer.index, query, rays, truth.T_map_camera)
            assert found is not None
            missing[i] += found.support.missing
    of_the_place, of_the_thing = missing
    assert of_the_thing > 4 * of_the_place
    assert of_the_thing > 40


def test_matches_in_one_corner_say_no_more_than_a_few() -> None:
    def share(own: float, rival: float) -> float:
        return float(shares(np.ones(2), np.array([own, rival]))[0])

    assert share(100.0, 100.0) == 0.5
    assert share(155.0, 105.0) > 0.95
    assert share(70.0, 110.0) < 0.05


def test_one_true_place_is_divided_among_all_poses_and_what_is_hardly_a_place_takes_hardly_any_of_it() -> None:
    three = shares(np.ones(3), np.full(3, 50.0))
    np.testing.assert_allclose(three, 1 / 3)
    alone = shares(np.array([0.99, 0.01, 0.0]), np.array([50.0, 45.0, 60.0]))
    assert alone.sum() == pytest.approx(1)
    assert alone[0] > 0.99
    assert shares(np.zeros(1), np.zeros(1)) == [1.0]


@pytest.mark.parametrize(
    ("apart_m", "turned_deg", "rivals"), [(0.19, 9.0, False), (0.21, 0.0, True), (0.0, 11.0, True), (0.0, 0.0, False)]
)
def test_poses_that_differ_in_place_or_heading_are_rivals(apart_m: float, turned_deg: float, rivals: bool) -> None:
    def verified(pose: Pose) -> Any:
        return SimpleNamespace(optimum=SimpleNamespace(T_map_camera=pose.T_map_camera))

    turned = np.deg2rad(turned_deg)
    one = Pose.from_heading(np.zeros(3), np.array([1.0, 0, 0]), 0.0)
    other = Pose.from_heading(np.array([0, apart_m, 0]), np.array([np.cos(turned), np.sin(turned), 0]), 0.0)
    assert are_rivals(verified(one), verified(other)) is rivals


def _found(T: np.ndarray, inliers: int) -> Any:
    """A verified pose, as far as its rivals ask."""
    return SimpleNamespace(optimum=Optimum(T, 1.0, np.ones(inliers)), inliers=inliers)


def test_what_is_24_pixels_off_or_behind_the_camera_is_unexplained(localizer: Localizer, point_room: Any) -> None:
    truth, index, camera = point_room.walk(9)[4], localizer.index, point_room.camera
    pixels = camera.project((index.landmarks - truth.position) @ truth.R_map_camera)
    shown = np.flatnonzero(camera.contains(pixels))[:3]
    (behind,) = np.flatnonzero((index.landmarks - truth.position) @ truth.heading < -1)[:1]
    off = np.array([[0.0, 23.5], [24.5, 0.0], [-18.0, 15.0]])
    seen = point_room.see(truth, 0).take(np.arange(4))
    seen = replace(seen, pixels=np.vstack([pixels[shown] + off, [[320, 240]]]).astype(np.float32))
    pairs = Matches(np.arange(4), np.append(shown, behind), np.full(4, 0.5))
    unexplained = _unexplained(index, pairs, Query(seen, camera), _found(truth.T_map_camera, 4))
    assert unexplained.detections.tolist() == [1, 3]


@pytest.mark.parametrize(
    ("inliers", "agreeing", "seeds"), [(0, 7, 0), (0, 8, 2), (40, 8, 2), (60, 11, 0), (60, 12, 2), (10_000, 500, 0)]
)
def test_a_rival_has_eight_matches_and_a_fifth_of_those_of_the_pose(
    localizer: Localizer, point_room: Any, monkeypatch: pytest.MonkeyPatch, inliers: int, agreeing: int, seeds: int
) -> None:
    truth = point_room.walk(9)[4]
    seen = point_room.see(truth, 3)
    away = Pose.from_heading(truth.position, -truth.heading).T_map_camera  # which explains nothing
    nearest = localizer.index.nearest_everywhere(seen)
    rays = point_room.camera.rays(seen.pixels)
    asked: list[tuple[Any, ...]] = []

    def ransac(plane: Any, points: Any, *how: Any) -> Any:
        asked.append((len(plane), *how))
        return truth.T_map_camera, agreeing

    monkeypatch.setattr("rholoc.localization.pose.rivals.lo_ransac", ransac)
    query, found = Query(seen, point_room.camera), _found(away, inliers)
    rivals = list(rival_seeds(localizer.index, nearest, query, rays, found))
    assert len(rivals) == seeds
    fewest = max(8, 0.2 * inliers)
    for count, *how in asked:
        assert count >= fewest
        assert how == [point_room.camera.focal, 12.0, 300, 30]
    assert len(asked) == (2 if inliers < 100 else 0)
    half = localizer.index.nearest_everywhere(seen, np.arange(0, len(seen), 2))  # half as many can be expected
    some = list(rival_seeds(localizer.index, half, query, rays, found))
    assert len(some) == (2 if agreeing >= max(8, 0.1 * inliers) and inliers < 100 else 0)
    monkeypatch.setattr("rholoc.localization.pose.rivals.lo_ransac", lambda *_: None)
    assert list(rival_seeds(localizer.index, nearest, query, rays, found)) == []
