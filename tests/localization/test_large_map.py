"""A large map: the place first, then as in any map."""

from __future__ import annotations

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
    likeliest_views,
    localize_together,
    localizer_of,
)
from rholoc.maps import Map

_ROOMS, _ROOM_PITCH_M = 40, 20.0


def _row_of_rooms(room: Map) -> Map:
    """Rooms alike in shape, each with descriptors of its own, side by side; the first one is ``room`` itself."""
    rng = np.random.default_rng(5)
    count, views = len(room), len(room.view_times)
    parts = []
    for number in range(_ROOMS):
        shift = np.array([number * _ROOM_PITCH_M, 0, 0])
        T = room.T_map_camera.copy()
        T[:, :3, 3] += shift
        mask = rng.integers(0, 256, room.descriptors.shape, dtype=np.uint8) if number else np.uint8(0)
        parts.append(((room.landmarks + shift).astype(np.float32), T, room.descriptors ^ mask))
    rooms = np.arange(_ROOMS, dtype=np.int32)
    return replace(
        room,
        channels=np.tile(room.channels, _ROOMS),
        landmarks=np.concatenate([part[0] for part in parts]),
        covariances=np.tile(room.covariances, (_ROOMS, 1, 1)),
        descriptors=np.concatenate([part[2] for part in parts]),
        descriptor_features=np.concatenate([room.descriptor_features + count * n for n in rooms]),
        view_times=np.arange(_ROOMS * views, dtype=np.float64),
        T_map_camera=np.concatenate([part[1] for part in parts]),
        observation_views=np.concatenate([room.observation_views + views * n for n in rooms]),
        observation_features=np.concatenate([room.observation_features + count * n for n in rooms]),
        observations=None,
        view_covariances=None,
        colours=None,
    )


@pytest.fixture(scope="module")
def large(room_map: Map) -> LargeMapLocalizer:
    return LargeMapLocalizer(_row_of_rooms(room_map))


def test_poses_are_those_of_the_room_alone(large: LargeMapLocalizer, localizer: Localizer, point_room: Any) -> None:
    for seed, truth in enumerate(point_room.walk(8, sideways_m=0.1)):
        query = Query(point_room.see(truth, 500 + seed), point_room.camera, Dof.FREE)
        answer, alone = large.localize(query), localizer.localize(query)
        assert answer.localized
        assert alone.localized
        assert answer.pose is not None
        apart_m, turned_rad = pose_distances(answer.pose.T_map_camera, truth.T_map_camera)
        assert apart_m < 0.03
        assert turned_rad < np.deg2rad(1)
        assert answer.inliers >= 0.9 * alone.inliers
        assert {"place", "match", "verify"} <= answer.timings_ms.keys()


def test_features_are_named_by_their_rows_in_the_whole_map(large: LargeMapLocalizer, point_room: Any) -> None:
    truth = point_room.walk(8, sideways_m=0.1)[3]
    answer = large.localize(Query(point_room.see(truth, 1), point_room.camera, Dof.FREE))
    seen = (large.map.landmarks[answer.inlier_features] - truth.position) @ truth.R_map_camera
    off_px = np.linalg.norm(point_room.camera.project(seen) - answer.inlier_pixels, axis=1)
    assert np.median(off_px) < 3


def test_a_part_is_small_however_large_the_map(large: LargeMapLocalizer, point_room: Any) -> None:
    seen = point_room.see(point_room.walk(8)[2], 7)
    part, _ = large.around([seen])
    assert len(part.map.view_times) <= 128
    assert len(part.map) <= 6000
    assert len(part.map) < len(large.map) / 5


def test_a_prior_is_tried_first_and_not_believed_against_the_picture(large: LargeMapLocalizer, point_room: Any) -> None:
    truth = point_room.walk(8, sideways_m=0.1)[4]
    seen = point_room.see(truth, 11)
    elsewhere = Pose.from_heading(truth.position + np.array([5 * _ROOM_PITCH_M, 0, 0]), truth.heading)
    for prior in (Prior(truth, 0.5, 0.3), Prior(elsewhere, 0.5, 0.3)):
        answer = large.localize(Query(seen, point_room.camera, Dof.FREE, prior=prior))
        assert answer.pose is not None
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
    assert [view.view < len(room_map.view_times) for view in views] == [True] * 3


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
    monkeypatch.setattr("rholoc.localization.large_map.LARGE_MAP", len(large.map) - 1)
    assert isinstance(localizer_of(large.map), LargeMapLocalizer)
