"""What is said of an odometry: its size, and by how much it drifts."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.geometry import FloatArray, Similarity, pose_matrix
from rholoc_lab.evaluation.odometry import measure_odometry


def _walk(count: int = 60) -> FloatArray:
    angle = np.linspace(0, 5, count)
    positions = np.column_stack([2 * np.cos(angle), np.sin(angle), 0.1 * angle])
    return pose_matrix(Rotation.from_euler("z", angle[:, None]).as_matrix(), positions)


def test_another_frame_and_size_are_no_drift() -> None:
    truth = _walk()
    moved = Similarity(0.5, Rotation.from_euler("xyz", [0.3, -0.2, 1.0]).as_matrix(), np.array([1.0, 2.0, 3.0]))
    found = measure_odometry(moved.poses(truth), truth, upright=False)
    assert found is not None
    assert found.scale == pytest.approx(2)
    assert found.rms_m == pytest.approx(0, abs=1e-9)
    assert found.drift == pytest.approx(0, abs=1e-9)
    np.testing.assert_allclose(found.aligned, truth, atol=1e-9)


def test_gravity_is_not_aligned_away() -> None:
    """Positions that bend upwards would be fitted best by a tilt, which then is off in every rotation."""
    truth = _walk()
    turned = Similarity(0.5, Rotation.from_euler("z", 1.0).as_matrix(), np.array([1.0, 2.0, 3.0]))
    bent = truth.copy()
    bent[:, 2, 3] += 0.1 * bent[:, 0, 3]
    free, upright = (measure_odometry(turned.poses(bent), truth, upright=upright) for upright in (False, True))
    assert free is not None
    assert upright is not None
    assert free.median_deg > 2
    assert upright.median_deg == pytest.approx(0, abs=0.2)
    np.testing.assert_allclose(upright.aligned[:, 2, :3], truth[:, 2, :3], atol=1e-9)
    exact = measure_odometry(turned.poses(truth), truth, upright=True)
    assert exact is not None
    assert (exact.scale, exact.rms_m) == (pytest.approx(2), pytest.approx(0, abs=1e-9))


def test_a_truth_that_is_not_upright_is_aligned_freely() -> None:
    moved = Similarity(1.0, Rotation.from_euler("x", np.pi / 2).as_matrix(), np.zeros(3))
    found = measure_odometry(_walk(), moved.poses(_walk()), upright=True)
    assert found is not None
    assert found.rms_m == pytest.approx(0, abs=1e-9)


def test_a_heading_that_turns_away_is_drift() -> None:
    """Straight on for 10 m, while the odometry turns by 0.01 rad a metre: the end of L metres is 0.005 L² aside."""
    way = np.linspace(0, 10, 101)
    truth = pose_matrix(np.tile(np.eye(3), (101, 1, 1)), np.column_stack([way, 0 * way, 0 * way]))
    bent = pose_matrix(
        Rotation.from_euler("z", 0.01 * way[:, None]).as_matrix(), np.column_stack([way, 0.005 * way**2, 0 * way])
    )
    found = measure_odometry(bent, truth, upright=False)
    assert found is not None
    assert found.path_m == pytest.approx(10)
    expected = np.mean([0.005 * length for length in (1.0, 2.0, 4.0)])
    assert found.drift == pytest.approx(expected, rel=0.2)


def test_a_camera_at_rest_has_no_odometry() -> None:
    assert measure_odometry(_walk(), np.tile(np.eye(4), (60, 1, 1)), upright=True) is None
    assert measure_odometry(_walk()[:3], _walk()[:3], upright=True) is None
