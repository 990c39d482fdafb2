"""Seeds: minimal samples that contain the true pose, places that matches vote for."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rholoc.density import Evidence
from rholoc.geometry import Lens, Pose, pose_distances
from rholoc.geometry.lenses import rays_of
from rholoc.localization import Localizer
from rholoc.localization.index.map_index import MapIndex
from rholoc.localization.index.matches import Matches
from rholoc.localization.pose.ascent import gains
from rholoc.localization.pose.ransac import lo_ransac
from rholoc.localization.pose.rivals import shares
from rholoc.localization.pose.seeds import (
    groups_by_votes,
    minimal_samples,
    place_of_prior,
    view_votes,
    views_by_prior,
    vote_for_places,
)
from rholoc.localization.types import Prior
from rholoc.maps import Map

TRUE = Pose.from_heading(np.array([0.3, -0.2, 1.4]), np.array([0.8, 0.6, 0.0]), 0.1).T_map_camera


def seen(count: int, false: int = 0, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Rays (M, 3) of points (M, 3) in front of a camera; the last ``false`` rays are of something else."""
    rng = np.random.default_rng(seed)
    local = np.column_stack([rng.uniform(-1, 1, count), rng.uniform(-0.8, 0.8, count), rng.uniform(2, 5, count)])
    rays = local / np.linalg.norm(local, axis=1)[:, None]
    rays[count - false :] = rays[: count - false][rng.permutation(count - false)[:false]]
    return rays, local @ TRUE[:3, :3].T + TRUE[:3, 3]


def evidence(rays: np.ndarray, points: np.ndarray) -> Evidence:
    count = len(rays)
    covariances = np.tile(1e-6 * np.eye(3), (count, 1, 1))
    return Evidence.of(np.arange(count), rays, points, covariances, np.full(count, 0.5), 500.0)


@pytest.mark.parametrize(("count", "false"), [(4, 0), (30, 12)])
def test_the_best_sample_is_the_true_pose(count: int, false: int) -> None:
    rays, points = seen(count, false)
    poses = minimal_samples(evidence(rays, points), np.full(count, 0.5), np.arange(count), 300, 5)
    assert 0 < len(poses) <= 5
    apart_m, turned_rad = pose_distances(poses[0], TRUE)
    assert apart_m < 1e-3
    assert turned_rad < 1e-3


def test_samples_are_of_different_detections() -> None:
    rays, points = seen(6)
    some = evidence(rays, points)
    assert len(minimal_samples(some, np.full(6, 0.5), np.array([0, 0, 1, 1, 0, 1]), 100, 5)) == 0
    three = evidence(rays[:3], points[:3])
    assert len(minimal_samples(three, np.full(3, 0.5), np.arange(3), 100, 5)) == 0


def test_samples_are_drawn_by_chance_and_the_same_each_time() -> None:
    rays, points = seen(30, 12)
    chances = np.r_[np.full(18, 0.9), np.full(12, 1e-9)]
    first = minimal_samples(evidence(rays, points), chances, np.arange(30), 3, 1)
    np.testing.assert_array_equal(first, minimal_samples(evidence(rays, points), chances, np.arange(30), 3, 1))
    assert pose_distances(first[0], TRUE)[0] < 1e-3  # three draws suffice where what is drawn is right


def test_ransac_finds_the_pose_and_counts_what_agrees() -> None:
    rays, points = seen(40, 15)
    found = lo_ransac(rays, points, 500.0, 4.0, 1000)
    assert pose_distances(found[0], TRUE)[0] < 1e-3
    assert 25 <= found[1] <= 27
    four = lo_ransac(rays[:4], points[:4], 500.0, 4.0, 1000)
    assert four[1] == 4
    assert lo_ransac(rays[:3], points[:3], 500.0, 4.0, 1000) is None
    rng = np.random.default_rng(1)
    astray = rays_of(Lens.PINHOLE, rng.uniform(-1, 1, (5, 2)), ())
    assert lo_ransac(astray, rng.uniform(-1, 1, (5, 3)), 500.0, 0.01, 100) is None


def test_votes_are_chances_of_what_a_view_saw_and_a_landmark_votes_once(localizer: Localizer) -> None:
    index = localizer.index
    rows = index.visibility[[7]].indices[:20]
    votes = view_votes(index, Matches(np.arange(20), rows, np.full(20, 0.5)))
    size = max(len(index.visibility[[7]].indices), 50)
    assert votes[7] == pytest.approx(10 / np.sqrt(size))
    assert votes.max() == votes[7] or index.visibility[[int(votes.argmax())]].indices.size < size
    doubled = view_votes(index, Matches(np.arange(60), np.tile(rows, 3), np.full(60, 0.5)))
    assert doubled[7] == pytest.approx(20 / np.sqrt(size))


def test_places_are_different_and_near_a_prior_where_there_is_one(localizer: Localizer) -> None:
    index = localizer.index
    rows = np.unique(np.concatenate([index.visibility[[view]].indices for view in (3, 40)]))
    matches = Matches(np.arange(len(rows)), rows, np.full(len(rows), 0.5))
    places = vote_for_places(index, matches, 3, 6, None)
    assert len({place.view for place in places}) == len(places) > 1
    assert [place.votes for place in places] == sorted((place.votes for place in places), reverse=True)
    for place in places:
        assert np.isin(index.visibility[[place.view]].indices, place.landmarks).all()
    pose = Pose(index.map.views.T_map_camera[40])
    near = vote_for_places(index, matches, 1, 6, Prior(pose, 0.1, 0.1))
    assert np.linalg.norm(index.view_positions[near[0].view] - pose.position) < 1.1
    assert vote_for_places(index, Matches.none(), 3, 6, None) == []


def test_a_priors_place_is_none_where_no_view_is_near_or_looks_its_way(localizer: Localizer, point_room: Any) -> None:
    index = localizer.index
    pose = Pose(index.map.views.T_map_camera[10])
    here = place_of_prior(index, Prior(pose, 0.5, 0.2), 5)
    assert here.view == 10
    away = Pose.from_heading(pose.position + np.array([50.0, 0, 0]), pose.heading, 0.0)
    assert place_of_prior(index, Prior(away, 0.5, 0.2), 5) is None
    up = Pose.from_heading(pose.position, np.array([0.0, 0.01, 1.0]) / np.hypot(0.01, 1), 0.0)
    assert place_of_prior(index, Prior(up, 0.5, 0.2), 5) is None


def test_of_two_poses_the_better_supported_has_the_greater_share() -> None:
    for nets, share in (((40.0, 40.0), 0.5), ((52.0, 40.0), 1 / (1 + np.exp(-1))), ((1e6, 0.0), 1.0)):
        np.testing.assert_allclose(shares(np.ones(2), np.array(nets)), (share, 1 - share), atol=1e-12)


def test_views_of_the_same_are_places_once_each(room_map: Map) -> None:
    """Two views that saw the same: each is the other's nearest companion, and none comes twice."""
    features = np.concatenate([[0, 1, 2], [0, 1, 2], [3, 4]])
    index = MapIndex(
        replace(
            room_map,
            views=replace(room_map.views, times=room_map.views.times[:3], T_map_camera=room_map.views.T_map_camera[:3]),
            observations=replace(
                room_map.observations,
                views=np.array([0, 0, 0, 1, 1, 1, 2, 2], np.int32),
                features=features.astype(np.int32),
            ),
        )
    )
    matches = Matches(np.arange(5), np.arange(5), np.full(5, 0.5))
    views = [place.view for place in vote_for_places(index, matches, 9, 1, None)]
    assert sorted(views) == [0, 1, 2]
    np.testing.assert_allclose(view_votes(index, matches), np.array([1.5, 1.5, 1.0]) / np.sqrt(50))
    far = Prior(
        Pose(index.map.views.T_map_camera[2]), 1e-3 + np.linalg.norm(np.ptp(index.view_positions, axis=0)) - 1, 0.1
    )
    assert near_votes(index, matches, far) == pytest.approx([1.5, 1.0])
    apart_m = np.linalg.norm(index.view_positions - index.view_positions[2], axis=1)
    beside = Prior(far.pose, float(apart_m[:2].min()) - 1 - 1e-6, 0.1)
    assert near_votes(index, matches, beside) == pytest.approx([1.0, 0.15])
    assert [place.view for place in vote_for_places(index, matches, 9, 4, None)] == [0, 2]


def near_votes(index: MapIndex, matches: Matches, prior: Prior) -> list[float]:
    """The votes of the first places, a prior considered, held against those of 50 features."""
    return [place.votes * np.sqrt(50) for place in vote_for_places(index, matches, 2, 4, prior)]


def test_groups_are_of_those_that_share_most_and_half_of_a_group_is_looked_at_with_it() -> None:
    shared = np.array(
        [
            [9, 5, 7, 6, 0, 0, 1],
            [5, 9, 0, 0, 0, 0, 0],
            [7, 0, 9, 0, 0, 0, 0],
            [6, 0, 0, 9, 0, 0, 0],
            [0, 0, 0, 0, 9, 9, 0],
            [0, 0, 0, 0, 9, 9, 0],
            [1, 0, 0, 0, 0, 0, 9],
        ],
        dtype=np.float64,
    )
    votes = np.array([5.0, 1.0, 4.0, 2.0, 3.0, 2.5, 0.0])

    def groups(each: int) -> list[tuple[int, list[int]]]:
        return [(view, some.tolist()) for view, some in groups_by_votes(votes, lambda view: shared[view], each)]

    assert groups(4) == [(0, [0, 2, 3, 1]), (4, [4, 5]), (3, [3, 0]), (1, [1, 0])]
    assert groups(1) == [(0, [0]), (2, [2]), (4, [4]), (5, [4]), (3, [3]), (1, [1])]
    assert groups(9) == [(0, [0, 2, 3, 1, 6]), (4, [4, 5])]


def test_views_about_a_prior_stand_a_metre_further_and_look_thirty_degrees_aside_at_most() -> None:
    heading = np.array([0.6, 0.8, 0.0])
    pose = Pose.from_heading(np.array([1.0, 2.0, 1.5]), heading)
    away_m = np.array([1.4, 1.6, 0.0, 0.0, 0.3])
    turned = np.array([0.0, 0.0, np.deg2rad(49), np.deg2rad(51), np.deg2rad(20)])
    positions = pose.position + away_m[:, None] * (0.0, 0.6, 0.8)
    angles = np.arctan2(0.8, 0.6) + turned
    headings = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(5)])
    prior = Prior(pose, 0.5, np.deg2rad(20))
    assert views_by_prior(positions, headings, prior).tolist() == [4, 2, 0]  # by metres and radians together


def test_all_samples_come_in_the_order_of_their_values() -> None:
    rays, points = seen(12, 4)
    some = evidence(rays, points)
    every = minimal_samples(some, np.full(12, 0.5), np.arange(12), 60, 1000)
    assert len(every) > 60  # a sample has up to four solutions
    values = gains(some, every, 12.0)
    assert (np.diff(values) <= 0).all()
    np.testing.assert_array_equal(minimal_samples(some, np.full(12, 0.5), np.arange(12), 60, 7), every[:7])
    np.testing.assert_allclose(
        every[:, :3, :3] @ every[:, :3, :3].transpose(0, 2, 1), np.tile(np.eye(3), (len(every), 1, 1)), atol=1e-6
    )
