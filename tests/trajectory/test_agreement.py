"""Whether two reconstructions from different keyframes are the same."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.geometry import FloatArray, pose_matrix
from rholoc.trajectory.alignment import Similarity
from rholoc.trajectory.structure_from_motion import Reconstruction
from rholoc.trajectory.visual import agreement

_ALTERNATE = np.arange(0, 60, 2)


def _reconstruction(T_world_camera: FloatArray) -> Reconstruction:
    return Reconstruction(np.arange(len(T_world_camera)), T_world_camera, np.zeros(4), np.zeros(4), 0.5, 1000, 2.0)


def _walk() -> FloatArray:
    t = np.linspace(0, 3, 60)
    R = Rotation.from_rotvec(np.outer(t / 2, [0.0, 1.0, 0.0])).as_matrix()
    return pose_matrix(R, np.column_stack([t, np.sin(t), 0.1 * np.cos(5 * t)]))


def _other(T: FloatArray) -> Reconstruction:
    """Every other keyframe, in another frame and scale."""
    frame = Similarity(0.3, Rotation.random(rng=np.random.default_rng(1)).as_matrix(), np.array([1.0, 2.0, 3.0]))
    return _reconstruction(frame.poses(T[_ALTERNATE]))


def test_the_same_walk_in_other_frames_agrees() -> None:
    trusted, why, distance, angle_deg = agreement(_reconstruction(_walk()), _other(_walk()), _ALTERNATE)
    assert trusted, why
    assert distance == pytest.approx(0, abs=1e-6)
    assert angle_deg == pytest.approx(0, abs=1e-3)


def test_a_part_that_stands_elsewhere_disagrees() -> None:
    torn = _walk()
    torn[48:, :3, 3] += [0.0, 0.5, 0.0]
    trusted, why, distance, _ = agreement(_reconstruction(_walk()), _other(torn), _ALTERNATE)
    assert distance < 0.02  # for most of the walk is right
    assert not trusted
    assert "disagree" in why


def test_a_walk_that_is_bent_disagrees() -> None:
    bent = _walk()
    bent[:, :3, :3] = Rotation.from_rotvec(np.outer(np.linspace(0, 0.3, 60), [0, 0, 1])).as_matrix() @ bent[:, :3, :3]
    assert not agreement(_reconstruction(_walk()), _other(bent), _ALTERNATE)[0]


def test_too_few_common_keyframes_are_not_trusted() -> None:
    half = _other(_walk())
    few = Reconstruction(half.placed[:12], half.T_world_camera[:12], np.zeros(4), np.zeros(4), 0.5, 1000, 2.0)
    trusted, why, distance, _ = agreement(_reconstruction(_walk()), few, _ALTERNATE)
    assert not trusted
    assert "Only 12 of 30" in why
    assert np.isnan(distance)
