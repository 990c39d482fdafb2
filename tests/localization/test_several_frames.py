"""Several frames, one density: what one frame cannot tell, several do."""

from __future__ import annotations

import time
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidDescriptors, InvalidInput
from rholoc.features import FeatureSet
from rholoc.geometry import Pose, pose_distances, pose_matrix
from rholoc.localization import (
    Belief,
    Dof,
    Intrinsics,
    Localizer,
    Query,
    Reason,
    SeveralFrames,
    localize_together,
    several_frames,
)
from rholoc.localization.matches import Matches
from rholoc.localization.seeds import Place
from rholoc.localization.several_frames import _Candidate, _Joint

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
        assert found.first.pose is not None
        assert found.first.covariance is not None
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
    assert found.first.reason is not None
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


def _candidate(recognized: float) -> _Candidate:
    return _Candidate((), np.zeros((0, 6, 6)), Belief(recognized, 1.0))


@pytest.mark.parametrize(
    ("confidences", "deadline_s", "best", "tried"),
    [
        ([0.3, 0.7, 0.5], None, 0.7, 3),
        ([None, 0.3, None], None, 0.3, 3),
        ([0.3, 0.9, 0.95], None, 0.9, 2),
        ([0.95], None, 0.95, 1),
        ([0.3, 0.7], 0.0, 0.3, 1),
        ([0.3, 0.7], 1000.0, 0.7, 2),
        ([None, 0.7], 0.0, None, 1),
    ],
)
def test_places_are_tried_until_one_is_sure_or_time_is_up(
    localizer: Localizer,
    point_room: Any,
    monkeypatch: pytest.MonkeyPatch,
    confidences: list[float | None],
    deadline_s: float | None,
    best: float | None,
    tried: int,
) -> None:
    asked = _asked(point_room, point_room.walk(9)[:2], 20)
    frames = (replace(asked.frames[0], deadline_s=deadline_s), *asked.frames[1:])
    joint = _Joint(localizer, replace(asked, frames=frames))
    five = Matches(np.arange(5), np.arange(5), np.full(5, 0.5))
    answers = iter([None if one is None else _candidate(one) for one in confidences])
    pools: list[int] = []

    def every() -> Any:
        for number in range(len(confidences)):
            pools.append(number)
            yield [five, five]

    given: list[Any] = []
    monkeypatch.setattr(joint, "_pools", every)
    monkeypatch.setattr(joint, "_candidate", lambda _: next(answers))
    monkeypatch.setattr(joint, "_looked_for", lambda _: [])
    monkeypatch.setattr(joint, "_answer", lambda *answer: given.append(answer))
    joint.localize()
    ((candidate, reason, matched),) = given
    assert (candidate and candidate.belief.recognized) == best
    assert len(pools) == tried
    assert matched == 10
    assert reason is (Reason.DEADLINE if deadline_s == 0.0 else Reason.NO_AGREEMENT)


@pytest.mark.parametrize(("count", "reason"), [(2, Reason.NO_MATCHES), (3, Reason.NO_AGREEMENT)])
def test_fewer_than_six_matches_are_none(
    localizer: Localizer, point_room: Any, monkeypatch: pytest.MonkeyPatch, count: int, reason: Reason
) -> None:
    joint = _Joint(localizer, _asked(point_room, point_room.walk(9)[:2], 20))
    few = Matches(np.arange(count), np.arange(count), np.full(count, 0.5))
    monkeypatch.setattr(joint, "_pools", lambda: iter([[few, few]]))
    monkeypatch.setattr(joint, "_verified", lambda _: None)
    answer = joint.localize()
    assert answer.first.reason is reason
    assert answer.first.matches == 2 * count
    assert answer.first.inlier_pixels.shape == (0, 2)
    assert answer.first.inlier_features.shape == (0,)


def test_places_are_taken_rank_by_rank_and_a_frame_without_one_has_no_matches(
    localizer: Localizer, point_room: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = _asked(point_room, point_room.walk(9)[:2], 60)
    joint = _Joint(localizer, asked)
    rows = [np.arange(first, len(localizer.map), 3) for first in range(3)]
    places = [[Place(0, rows[0], 3.0), Place(1, rows[1], 2.0), Place(2, rows[2], 1.0)], [Place(2, rows[2], 1.0)]]
    each = iter(places)
    monkeypatch.setattr("rholoc.localization.several_frames.vote_for_places", lambda *_: next(each))
    everywhere, *pools = joint._pools()
    assert [len(pool) for pool in pools] == [2, 2, 2]
    for one, frame in zip(everywhere, asked.frames, strict=True):
        assert len(one) == len(localizer.index.match_everywhere(frame.features))
    for rank, (first, second) in enumerate(pools):
        expected = localizer.index.match_within(asked.frames[0].features, rows[rank])
        np.testing.assert_array_equal(first.landmarks, expected.landmarks)
        expected = localizer.index.match_within(asked.frames[1].features, rows[2])
        np.testing.assert_array_equal(second.landmarks, expected.landmarks if rank == 0 else [])
        assert len(expected) > 0


def test_the_rigs_seed_is_asked_of_all_frames_matches(
    localizer: Localizer, point_room: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    truths = point_room.walk(40, sideways_m=0.1)[5:15:4]
    asked = _asked(point_room, truths, 30)
    joint = _Joint(localizer, asked)
    matches = [localizer.index.match_everywhere(frame.features) for frame in asked.frames]
    T = joint._seed(matches)
    assert T is not None
    for found, truth in zip(T @ asked.T_rig_cameras, truths, strict=True):
        assert pose_distances(found, truth.T_map_camera)[0] < 0.1
    nothing = Matches.none()
    assert joint._seed([matches[0].take(np.arange(5)), nothing, nothing]) is None
    pose, agreeing = SimpleNamespace(R=np.eye(3), t=np.array([1.0, 2, 3])), 6
    settings: list[dict[str, Any]] = []

    def estimate(plane: Any, points: Any, mounted: Any, cameras: Any, asked: dict[str, Any], more: Any) -> Any:
        settings.append(asked)
        assert [camera["params"] for camera in cameras] == [[point_room.camera.focal, 0.0, 0.0]] * 3
        for own, one, rays in zip(plane, used, joint.rays, strict=True):
            seen = rays[one.likeliest_first().detections]
            np.testing.assert_allclose(own, point_room.camera.focal * seen[:, :2] / seen[:, 2:])
        return pose, {"num_inliers": agreeing}

    monkeypatch.setattr("rholoc.geometry.resection.poselib.estimate_generalized_absolute_pose", estimate)
    used = [matches[0].take(np.arange(6)), nothing, nothing]
    found = joint._seed(used)
    assert found is not None
    np.testing.assert_allclose(found[:3, 3], (-1, -2, -3))
    agreeing, used = 5, matches
    assert joint._seed(matches) is None
    agreeing, pose = 6, SimpleNamespace(R=np.full((3, 3), np.nan), t=np.zeros(3))
    assert joint._seed(matches) is None
    expected = {"max_iterations": 1000, "min_iterations": 30, "max_reproj_error": 12.0, "success_prob": 0.9999}
    assert settings == [expected] * 3


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


def test_frames_are_matched_again_within_either_radius(
    localizer: Localizer, point_room: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    truths = point_room.walk(40, sideways_m=0.1)[5:15:4]
    joint = _Joint(localizer, _asked(point_room, truths, 60))
    tolerances_px: list[tuple[float, ...]] = []
    radii_px: list[float] = []
    climb, match_near = several_frames.ascend_together, localizer.index.match_near
    monkeypatch.setattr(several_frames, "ascend_together", lambda *how: (tolerances_px.append(how[4]), climb(*how))[1])
    monkeypatch.setattr(localizer.index, "match_near", lambda *how: (radii_px.append(how[3]), match_near(*how))[1])
    candidate = joint._verified(np.array([truth.T_map_camera for truth in truths]))
    assert candidate is not None
    assert tolerances_px == [(14.0, 7.0, 4.0), (5.0, 4.0)]
    assert radii_px == [14.0] * 3 + [5.0] * 3
    assert candidate.belief.confidence > 0.9
    five = match_near(joint.frames[0].features, point_room.camera, truths[0].T_map_camera, 5.0)[0].take(np.arange(5))
    nothing = np.zeros(60)
    for last, found in ((0, False), (1, True)):
        counts = iter([five, five.take(np.arange(last)), Matches.none()] * 2)
        monkeypatch.setattr(localizer.index, "match_near", lambda *_, counts=counts: (next(counts), nothing))
        again = joint._verified(np.array([truth.T_map_camera for truth in truths]))
        assert (again is not None) is found
