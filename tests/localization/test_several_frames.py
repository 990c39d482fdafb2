"""Several frames, one density: what one frame cannot tell, several do."""

import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidDescriptors, InvalidInput
from rholoc.features import FeatureSet
from rholoc.geometry import Pose, pose_distances, pose_matrix
from rholoc.localization import (
    Cause,
    Dof,
    Intrinsics,
    Localizer,
    Query,
    Reason,
    SeveralFrames,
    localize_together,
)

_ODOMETRY = np.linalg.inv(pose_matrix(Rotation.from_euler("xyz", (0.3, -0.2, 0.9)).as_matrix(), np.array([4.0, 1, -2])))


def _asked(point_room: Any, truths: list[Pose], features: int, **uncertainty: float) -> SeveralFrames:
    """Frames with few features each, their relative poses in a frame that has nothing to do with the map's."""
    frames = []
    for seed, truth in enumerate(truths):
        seen = point_room.see(truth, 300 + seed)
        rng = np.random.default_rng(seed)
        few = np.sort(rng.choice(len(seen), min(features, len(seen)), replace=False))
        frames.append(Query(seen.take(few), point_room.camera, Dof.FREE))
    T = np.array([_ODOMETRY @ truth.T_map_camera for truth in truths])
    return SeveralFrames(tuple(frames), T, **uncertainty)


def test_frames_that_are_too_poor_alone_are_localized_together(localizer: Localizer, point_room: Any) -> None:
    truths = point_room.walk(40, sideways_m=0.1)[5:25:4]
    asked = _asked(point_room, truths, 14)
    alone = [localizer.localize(frame).confidence for frame in asked.frames]
    found = localize_together(localizer, asked)
    assert found.first.localized
    assert found.first.confidence > max(alone)
    for pose, truth in zip(found.poses, truths, strict=True):
        apart_m, turned_rad = pose_distances(pose.T_map_camera, truth.T_map_camera)
        assert apart_m < 0.03
        assert turned_rad < np.deg2rad(0.7)
    assert found.first.inliers == sum(found.inliers)
    assert len(found.first.inlier_features) == found.first.inliers


def test_frames_whose_gravity_contradicts_their_poses_are_refused(localizer: Localizer, point_room: Any) -> None:
    truths = point_room.walk(40, sideways_m=0.1)[5:25:8]
    asked = _asked(point_room, truths, 200)
    down = [truth.T_map_camera[:3, :3].T @ [0.0, 0.0, -1.0] for truth in truths]

    def localized(gravities: list[np.ndarray]) -> bool:
        frames = tuple(replace(frame, gravity=one) for frame, one in zip(asked.frames, gravities, strict=True))
        return localize_together(localizer, replace(asked, frames=frames)).first.localized

    assert localized(down)
    assert not localized([*down[:-1], Rotation.from_euler("z", 30, degrees=True).apply(down[-1])])


def test_drifting_odometry_gives_where_the_frames_know_better(localizer: Localizer, point_room: Any) -> None:
    truths = point_room.walk(40, sideways_m=0.1)[5:25:4]
    exact = _asked(point_room, truths, 200, sigma_m=0.03, sigma_rad=0.02)
    T = exact.T_rig_cameras.copy()
    for i in range(1, len(T)):
        T[i:, :3, 3] += (0.02, -0.015, 0.01)  # at every step
    drifting = SeveralFrames(exact.frames, T, 0.03, 0.02)
    stiff = SeveralFrames(exact.frames, T, 0.001, 0.001)

    def worst_m(asked: SeveralFrames) -> float:
        poses = localize_together(localizer, asked).poses
        return max(pose_distances(p.T_map_camera, t.T_map_camera)[0] for p, t in zip(poses, truths, strict=True))

    assert worst_m(drifting) < 0.02
    assert worst_m(stiff) > 2 * worst_m(drifting)


@pytest.mark.parametrize("features", [25, 200])
@pytest.mark.parametrize(("moved_m", "turned_deg"), [((0.8, 0, 0), 0.0), ((0.0, 0.15, -0.2), 0.0), ((0, 0, 0), 25.0)])
def test_frames_that_contradict_their_relative_pose_are_refused_and_the_frame_named(
    localizer: Localizer, point_room: Any, features: int, moved_m: tuple[float, ...], turned_deg: float
) -> None:
    asked = _asked(point_room, point_room.walk(40, sideways_m=0.1)[5:25:8], features)
    T = asked.T_rig_cameras.copy()
    T[2] = T[2] @ pose_matrix(Rotation.from_euler("y", turned_deg, degrees=True).as_matrix(), np.array(moved_m))
    answer = localize_together(localizer, replace(asked, T_rig_cameras=T)).first
    assert not answer.localized
    assert answer.diagnosis.cause is Cause.WRONG_MOTION
    assert answer.diagnosis.message.startswith("Frame 2 ")


def test_a_relative_pose_that_is_off_by_less_than_its_uncertainty_contradicts_nothing(
    localizer: Localizer, point_room: Any
) -> None:
    truths = point_room.walk(40, sideways_m=0.1)[5:25:8]
    asked = _asked(point_room, truths, 200, sigma_m=0.3, sigma_rad=0.2)
    T = asked.T_rig_cameras.copy()
    T[2, :3, 3] += (0.1, -0.1, 0.05)
    found = localize_together(localizer, replace(asked, T_rig_cameras=T))
    assert found.first.localized
    for pose, truth in zip(found.poses, truths, strict=True):
        assert pose_distances(pose.T_map_camera, truth.T_map_camera)[0] < 0.03


def test_a_rig_whose_cameras_look_apart(localizer: Localizer, point_room: Any) -> None:
    ahead = point_room.walk(9)[4]
    aside = Pose(
        pose_matrix(ahead.R_map_camera @ Rotation.from_euler("y", 50, degrees=True).as_matrix(), ahead.position)
    )
    asked = _asked(point_room, [ahead, aside], 25)
    found = localize_together(localizer, asked)
    assert found.first.localized
    assert pose_distances(found.poses[1].T_map_camera, aside.T_map_camera)[0] < 0.03


def test_the_covariance_holds_what_the_errors_are(localizer: Localizer, point_room: Any) -> None:
    inside = []
    walk = point_room.walk(40, sideways_m=0.1)
    for start in range(12):
        truths = walk[start : start + 9 : 4]
        found = localize_together(localizer, _asked(point_room, truths, 60))
        error = found.first.pose.position - truths[0].position
        inside.append(error @ np.linalg.solve(found.first.covariance[:3, :3], error) < 7.81)
    assert np.mean(inside) >= 0.85


def test_frames_of_another_place_have_no_pose(localizer: Localizer, point_room: Any) -> None:
    asked = _asked(point_room, point_room.walk(9)[:3], 100)
    rng = np.random.default_rng(0)
    strange = tuple(
        Query(
            FeatureSet(
                one.features.pixels,
                one.features.channels,
                rng.integers(0, 256, one.features.descriptors.shape, dtype=np.uint8),
                one.features.sizes,
                one.features.angles,
            ),
            one.camera,
        )
        for one in asked.frames
    )
    found = localize_together(localizer, SeveralFrames(strange, asked.T_rig_cameras))
    assert not found.first.localized
    assert found.first.reason is Reason.NO_MATCHES
    assert found.poses == ()


@pytest.mark.parametrize("count", [0, 1, 11])
def test_too_few_or_too_many_frames(point_room: Any, count: int) -> None:
    truths = point_room.walk(12)[:count]
    with pytest.raises(InvalidInput, match=f"{count} frames"):
        _asked(point_room, truths, 20) if count else SeveralFrames((), np.zeros((0, 4, 4)))


@pytest.mark.parametrize("broken", [np.diag([1.0, 1, -1, 1]), np.diag([2.0, 2, 2, 1]), np.full((4, 4), np.nan)])
def test_relative_poses_that_are_no_rotations(point_room: Any, broken: np.ndarray) -> None:
    asked = _asked(point_room, point_room.walk(9)[:2], 20)
    with pytest.raises(InvalidInput, match="not a rigid motion"):
        SeveralFrames(asked.frames, np.array([np.eye(4), broken]))


def test_an_uncertainty_must_be_positive(point_room: Any) -> None:
    with pytest.raises(InvalidInput, match="not positive"):
        _asked(point_room, point_room.walk(9)[:2], 20, sigma_m=0.0)


def test_features_of_another_kind_are_refused(localizer: Localizer, point_room: Any) -> None:
    asked = _asked(point_room, point_room.walk(9)[:2], 20)
    seen = asked.frames[1].features
    short = FeatureSet(seen.pixels, seen.channels, seen.descriptors[:, :16].copy(), seen.sizes, seen.angles)
    mixed = SeveralFrames((asked.frames[0], Query(short, point_room.camera)), asked.T_rig_cameras)
    with pytest.raises(InvalidDescriptors):
        localize_together(localizer, mixed)


def test_links_are_from_each_frame_to_the_next_and_time_runs(point_room: Any) -> None:
    truths = point_room.walk(9)[:3]
    asked = _asked(point_room, truths, 20)
    assert [(link.a, link.b, link.sigma_m, link.sigma_rad) for link in asked.links] == [
        (0, 1, 0.005, 0.003),
        (1, 2, 0.005, 0.003),
    ]
    for link in asked.links:
        expected = np.linalg.inv(truths[link.a].T_map_camera) @ truths[link.b].T_map_camera
        np.testing.assert_allclose(link.T_a_b, expected, atol=1e-9)
    assert asked.within(0.3) is asked
    first, *others = asked.frames
    hurried = SeveralFrames((replace(first, deadline_s=1.0), *others), asked.T_rig_cameras)
    assert hurried.within(0.3).frames[0].deadline_s == pytest.approx(0.7)
    assert hurried.within(2.0).frames[0].deadline_s == 0.0
    assert hurried.within(0.3).frames[1:] == asked.frames[1:]
    for wrong in ({"sigma_m": np.inf}, {"sigma_rad": 0.0}, {"sigma_rad": np.nan}):
        with pytest.raises(InvalidInput, match="not positive"):
            replace(asked, **wrong)
    assert len(_asked(point_room, point_room.walk(12)[:10], 20).links) == 9
    not_homogeneous = asked.T_rig_cameras.copy()
    not_homogeneous[1, 3] = (0, 0, 0.1, 1)
    with pytest.raises(InvalidInput, match="not a rigid motion"):
        replace(asked, T_rig_cameras=not_homogeneous)


def test_frames_of_unknown_intrinsics_are_refused(localizer: Localizer, point_room: Any) -> None:
    asked = _asked(point_room, point_room.walk(9)[:2], 20)
    unknown = replace(asked.frames[1], intrinsics=Intrinsics.UNKNOWN)
    with pytest.raises(InvalidInput, match="need their intrinsics"):
        localize_together(localizer, replace(asked, frames=(asked.frames[0], unknown)))


def test_what_is_not_sure_enough_is_not_given_out(localizer: Localizer, point_room: Any) -> None:
    asked = _asked(point_room, point_room.walk(40, sideways_m=0.1)[5:15:4], 30)
    strict = Localizer(localizer.map, min_recognized=1.1, index=localizer.index)
    found = localize_together(strict, asked)
    started = time.perf_counter()
    given = localize_together(localizer, asked)
    spent_ms = 1e3 * (time.perf_counter() - started)
    assert found.poses == ()
    assert found.first.reason is Reason.NOT_RECOGNIZED
    assert found.first.pose is found.first.covariance is None
    assert found.inliers == given.inliers
    assert given.first.reason is None
    assert given.first.matches > 0
    assert 0 < given.first.timings_ms["match"] <= spent_ms
    assert given.first.covariance is not None
    shown = point_room.camera.project(
        (localizer.index.landmarks[given.first.inlier_features[: given.inliers[0]]] - given.poses[0].position)
        @ given.poses[0].R_map_camera
    )
    assert np.median(np.linalg.norm(shown - given.first.inlier_pixels, axis=1)) < 3
