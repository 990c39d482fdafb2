"""What is said of an odometry: its size, and by how much it drifts."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.evaluation.odometry import measure_odometry
from rholoc.geometry import FloatArray, Similarity, pose_matrix


def _walk(count: int = 60) -> FloatArray:
    angle = np.linspace(0, 5, count)
    positions = np.column_stack([2 * np.cos(angle), np.sin(angle), 0.1 * angle])
    return pose_matrix(Rotation.from_euler("z", angle[:, None]).as_matrix(), positions)


def test_another_frame_and_size_are_no_drift() -> None:
    truth = _walk()
    moved = Similarity(0.5, Rotation.from_euler("xyz", [0.3, -0.2, 1.0]).as_matrix(), np.array([1.0, 2.0, 3.0]))
    found = measure_odometry(moved.poses(truth), truth)
    assert found is not None
    assert found.scale == pytest.approx(2)
    assert found.rms_m == pytest.approx(0, abs=1e-9)
    assert found.drift == pytest.approx(0, abs=1e-9)
    np.testing.assert_allclose(found.aligned, truth, atol=1e-9)


def test_a_heading_that_turns_away_is_drift() -> None:
    """Straight on for 10 m, while the odometry turns by 0.01 rad a metre: the end of L metres is 0.005 L² aside."""
    way = np.linspace(0, 10, 101)
    truth = pose_matrix(np.tile(np.eye(3), (101, 1, 1)), np.column_stack([way, 0 * way, 0 * way]))
    bent = pose_matrix(
        Rotation.from_euler("z", 0.01 * way[:, None]).as_matrix(), np.column_stack([way, 0.005 * way**2, 0 * way])
    )
    found = measure_odometry(bent, truth)
    assert found is not None
    assert found.path_m == pytest.approx(10)
    expected = np.mean([0.005 * length for length in (1.0, 2.0, 4.0)])
    assert found.drift == pytest.approx(expected, rel=0.2)


def test_a_camera_at_rest_has_no_odometry() -> None:
    assert measure_odometry(_walk(), np.tile(np.eye(4), (60, 1, 1))) is None
    assert measure_odometry(_walk()[:3], _walk()[:3]) is None
