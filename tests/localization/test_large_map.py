"""A large map: the place first, then as in any map."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rholoc.errors import InvalidDescriptors
from rholoc.features import FeatureSet
from rholoc.geometry import Pose, pose_distances
from rholoc.localization import (
    Dof,
    LargeMapLocalizer,
    Localizer,
    Prior,
    Query,
    SeveralFrames,
    large_map,
    likeliest_views,
    localize_together,
    localizer_of,
)
from rholoc.localization.index.map_index import MapIndex
from rholoc.localization.index.matches import Matches
from rholoc.localization.large_map import PlaceIndex
from rholoc.localization.pose.seeds import view_votes
from rholoc.maps import Map, without_memory

_ROOMS, _ROOM_PITCH_M = 40, 20.0


def _row_of_rooms(room: Map) -> Map:
    """Rooms alike in shape, each with descriptors of its own, side by side; the first one is ``room`` itself."""
    rng = np.random.default_rng(5)
    count, views = len(room), len(room.views)
    parts = []
    for number in range(_ROOMS):
        shift = np.array([number * _ROOM_PITCH_M, 0, 0])
        T = room.views.T_map_camera.copy()
        T[:, :3, 3] += shift
        mask = rng.integers(0, 256, room.descriptors.values.shape, dtype=np.uint8) if number else np.uint8(0)
        parts.append(((room.landmarks.positions + shift).astype(np.float32), T, room.descriptors.values ^ mask))
    rooms = np.arange(_ROOMS, dtype=np.int32)
    return without_memory(
        replace(
            room,
            landmarks=replace(
                room.landmarks,
                channels=np.tile(room.landmarks.channels, _ROOMS),
                positions=np.concatenate([part[0] for part in parts]),
                covariances=np.tile(room.landmarks.covariances, (_ROOMS, 1, 1)),
                colours=None,
            ),
            descriptors=replace(
                room.descriptors,
                values=np.concatenate([part[2] for part in parts]),
                features=np.concatenate([room.descriptors.features + count * n for n in rooms]),
            ),
            views=replace(
                room.views,
                times=np.arange(_ROOMS * views, dtype=np.float64),
                T_map_camera=np.concatenate([part[1] for part in parts]),
                covariances=None,
            ),
            observations=replace(
                room.observations,
                views=np.concatenate([room.observations.views + views * n for n in rooms]),
                features=np.concatenate([room.observations.features + count * n for n in rooms]),
            ),
        )
    )


@pytest.fixture(scope="module")
def large(room_map: Map) -> LargeMapLocalizer:
    return LargeMapLocalizer(_row_of_rooms(room_map))


def test_poses_are_those_of_the_room_alone(large: LargeMapLocalizer, localizer: Localizer, point_room: Any) -> None:
    for seed, truth in enumerate(point_room.walk(8, sideways_m=0.1)[::2]):
        query = Query(point_room.see(truth, 500 + seed), point_room.camera, Dof.FREE)
        answer, alone = large.localize(query), localizer.localize(query)
        assert answer.localized
        assert alone.localized
        apart_m, turned_rad = pose_distances(answer.pose.T_map_camera, truth.T_map_camera)
        assert apart_m < 0.03
        assert turned_rad < np.deg2rad(1)
        assert answer.inliers >= 0.9 * alone.inliers
        assert {"place", "match", "verify"} <= answer.timings_ms.keys()


def test_features_are_named_by_their_rows_in_the_whole_map(large: LargeMapLocalizer, point_room: Any) -> None:
    truth = point_room.walk(8, sideways_m=0.1)[3]
    answer = large.localize(Query(point_room.see(truth, 1), point_room.camera, Dof.FREE))
    seen = (large.map.landmarks.positions[answer.inlier_features] - truth.position) @ truth.R_map_camera
    off_px = np.linalg.norm(point_room.camera.project(seen) - answer.inlier_pixels, axis=1)
    assert np.median(off_px) < 3


def test_a_part_is_small_however_large_the_map(large: LargeMapLocalizer, point_room: Any) -> None:
    seen = point_room.see(point_room.walk(8)[2], 7)
    part, _ = large.around([seen])
    assert len(part.map.views) <= 128
    assert len(part.map) <= 6000
    assert len(part.map) < len(large.map) / 5


def test_a_prior_is_tried_first_and_not_believed_against_the_picture(large: LargeMapLocalizer, point_room: Any) -> None:
    truth = point_room.walk(8, sideways_m=0.1)[4]
    seen = point_room.see(truth, 11)
    elsewhere = Pose.from_heading(truth.position + np.array([5 * _ROOM_PITCH_M, 0, 0]), truth.heading)
    for prior in (Prior(truth, 0.5, 0.3), Prior(elsewhere, 0.5, 0.3)):
        answer = large.localize(Query(seen, point_room.camera, Dof.FREE, prior=prior))
        assert pose_distances(answer.pose.T_map_camera, truth.T_map_camera)[0] < 0.03
        assert answer.near_prior is (prior.pose is truth)


def test_several_frames_and_places_are_found(large: LargeMapLocalizer, room_map: Map, point_room: Any) -> None:
    truths = point_room.walk(40, sideways_m=0.1)[5:15:4]
    frames = tuple(Query(point_room.see(truth, 40 + n), point_room.camera, Dof.FREE) for n, truth in enumerate(truths))
    found = localize_together(large, SeveralFrames(frames, np.array([truth.T_map_camera for truth in truths])))
    for pose, truth in zip(found.poses, truths, strict=True):
        assert pose_distances(pose.T_map_camera, truth.T_map_camera)[0] < 0.02
    assert found.first.inlier_features.max() < len(room_map)
    views = likeliest_views(large, frames[0].features, 3)
    assert [view.view < len(room_map.views) for view in views] == [True] * 3


def test_an_unknown_place_has_no_pose(large: LargeMapLocalizer, point_room: Any) -> None:
    seen = point_room.see(point_room.walk(8)[2], 7)
    rng = np.random.default_rng(2)
    strange = replace(seen, descriptors=rng.integers(0, 256, seen.descriptors.shape, dtype=np.uint8))
    assert not large.localize(Query(strange, point_room.camera, Dof.FREE)).localized
    nothing = FeatureSet(
        *(getattr(seen, name)[:0] for name in ("pixels", "channels", "descriptors", "sizes", "angles"))
    )
    assert not large.localize(Query(nothing, point_room.camera, Dof.FREE)).localized


def test_a_deadline_that_passed_is_said(large: LargeMapLocalizer, point_room: Any) -> None:
    seen = point_room.see(point_room.walk(8)[2], 7)
    answer = large.localize(Query(seen, point_room.camera, Dof.FREE, deadline_s=0.0))
    assert answer.reason == "deadline"


def test_features_of_another_kind_are_refused(large: LargeMapLocalizer, point_room: Any) -> None:
    seen = point_room.see(point_room.walk(8)[2], 7)
    longer = replace(seen, descriptors=np.zeros((len(seen), 48), np.uint8))
    with pytest.raises(InvalidDescriptors, match="48 bytes"):
        large.localize(Query(longer, point_room.camera))


def test_a_map_is_large_by_its_landmarks(
    room_map: Map, large: LargeMapLocalizer, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert isinstance(localizer_of(room_map), Localizer)
    assert large_map.LARGE_MAP == 30_000
    monkeypatch.setattr("rholoc.localization.large_map.LARGE_MAP", len(large.map) - 1)
    assert isinstance(localizer_of(large.map), LargeMapLocalizer)


def _small(room_map: Map) -> Map:
    """Seven landmarks that five views saw, one of them twice."""
    views = np.repeat(np.arange(5), [3, 3, 2, 4, 2])
    features = np.array([0, 1, 2, 1, 2, 3, 4, 5, 0, 4, 5, 6, 2, 6])
    return replace(
        room_map,
        landmarks=replace(
            room_map.landmarks,
            channels=np.zeros(7, np.uint8),
            positions=room_map.landmarks.positions[:7],
            covariances=room_map.landmarks.covariances[:7],
        ),
        descriptors=replace(
            room_map.descriptors,
            values=np.random.default_rng(3).integers(0, 256, (10, 32), dtype=np.uint8),
            features=np.array([0, 0, 1, 2, 3, 3, 3, 4, 5, 6], np.int32),
        ),
        views=replace(room_map.views, times=room_map.views.times[:5], T_map_camera=room_map.views.T_map_camera[:5]),
        observations=replace(room_map.observations, views=views.astype(np.int32), features=features.astype(np.int32)),
    )


def test_views_are_voted_for_as_in_any_map(room_map: Map) -> None:
    for map_ in (room_map, _small(room_map)):
        index, places = MapIndex(map_), PlaceIndex(map_)
        rng = np.random.default_rng(1)
        landmarks = rng.integers(0, len(map_), 40)
        matches = Matches(np.arange(40), landmarks, rng.uniform(0.1, 0.9, 40))
        np.testing.assert_allclose(places.votes(matches), view_votes(index, matches), rtol=1e-5)
        views = len(map_.views)
        for view in (0, views // 2, views - 1):
            np.testing.assert_array_equal(places.shared_with(view), index.shared_with(view))
    assert places.votes(Matches.none()).tolist() == [0.0] * 5


def test_features_are_looked_up_by_each_landmarks_first_descriptor(room_map: Map) -> None:
    map_ = _small(room_map)
    places, zeros = PlaceIndex(map_), np.zeros(4, np.float32)
    own = map_.descriptors.values[[9, 7, 5, 0]]  # the first ones of 6, 4 and 0, and the second of 3
    features = FeatureSet(np.zeros((4, 2), np.float32), np.zeros(4, np.uint8), own, zeros, zeros)
    found = places.nearest(features)
    assert found.landmarks.shape == (4, 4)
    assert found.detections.tolist() == [0, 1, 2, 3]
    assert found.landmarks[[0, 1, 3], 0].tolist() == [6, 4, 0]
    assert found.distances[:, 0].tolist()[::3] == [0.0, 0.0]
    assert found.distances[2, 0] > 0
    some = places.nearest(features, np.array([3, 1]))
    assert some.detections.tolist() == [3, 1]
    np.testing.assert_array_equal(some.landmarks, found.landmarks[[3, 1]])
