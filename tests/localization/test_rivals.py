"""Look-alikes: places that show the same, things of a place in a picture of another."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from rholoc.features import FeatureSet
from rholoc.geometry import Pose
from rholoc.localization import Dof, Localizer, Query, SeveralFrames, localize_together
from rholoc.localization.pose.rematching import verify
from rholoc.localization.pose.rivals import are_rivals, shares
from rholoc.tracking.follow import answer_of
from rholoc_client.tracking import Track


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


@pytest.fixture(scope="module")
def poster_room(twin_room: Any) -> Any:
    """That room with a poster on one of its walls."""
    rng = np.random.default_rng(7)
    poster = np.column_stack([rng.uniform(-1.8, -0.4, 60), np.full(60, -2.5), rng.uniform(0.8, 2.2, 60)])
    points = np.vstack([twin_room.points, poster])
    descriptors = np.vstack([twin_room.descriptors, rng.integers(0, 256, (60, 32), dtype=np.uint8)])
    return type(twin_room)(points, descriptors, twin_room.camera)


@pytest.fixture(scope="module")
def poster_localizer(poster_room: Any) -> Localizer:
    return Localizer(poster_room.map_of(_around(np.linspace(0, 2 * np.pi, 100), 1.0), "poster"))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_a_walk_past_a_poster_tells_which_half_of_a_room_it_is_and_claims_nothing_wrong_before(
    poster_room: Any, poster_localizer: Localizer, seed: int
) -> None:
    turns = np.linspace(-0.3, 1.6 * np.pi, 150)
    walk = _around(turns, 1 + np.random.default_rng(seed).uniform(-0.1, 0.1))
    track, T_odom_camera = Track(), np.eye(4)
    for i, (before, now) in enumerate(pairwise(walk)):
        step = np.linalg.inv(before.T_map_camera) @ now.T_map_camera
        step[:3, 3] *= 1.02
        T_odom_camera = T_odom_camera @ step
        track.frame(i / 10, T_odom_camera)
        if track.wants_answer:
            track.ask()
            query = Query(poster_room.see(now, 1000 * seed + i), poster_room.camera, Dof.FREE)
            track.answered(answer_of(poster_localizer.localize(query), metric=True))
        said = track.now()
        if said.pose is not None:
            assert np.linalg.norm(said.pose.position - now.position) < 0.1
    assert said.pose is not None
    assert said.reset_counter == 0


def _around(turns: np.ndarray, radius_m: float) -> list[Pose]:
    """Poses on a circle that look outwards."""
    outwards = [np.array([np.cos(t), np.sin(t), 0.0]) for t in turns]
    return [Pose.from_heading(radius_m * out + (0, 0, 1.4), out - (0, 0, 0.05)) for out in outwards]


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
    ("apart_m", "turned_deg", "rivals"), [(0.49, 19.0, False), (0.51, 0.0, True), (0.0, 21.0, True), (0.0, 0.0, False)]
)
def test_poses_that_differ_in_place_or_heading_are_rivals(
    verified_at: Any, apart_m: float, turned_deg: float, rivals: bool
) -> None:
    turned = np.deg2rad(turned_deg)
    one = Pose.from_heading(np.zeros(3), np.array([1.0, 0, 0]), 0.0)
    other = Pose.from_heading(np.array([0, apart_m, 0]), np.array([np.cos(turned), np.sin(turned), 0]), 0.0)
    assert are_rivals(verified_at(one), verified_at(other)) is rivals
