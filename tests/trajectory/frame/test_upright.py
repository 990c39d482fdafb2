"""The no-roll prior."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.geometry import FloatArray, angles_between, rotation_from_heading
from rholoc.trajectory.frame.upright import Up, rotation_to_upright, up_without_roll


def _cameras(turn_deg: float, roll_deg: float) -> FloatArray:
    rng = np.random.default_rng(0)
    yaw = np.radians(rng.uniform(-turn_deg, turn_deg, 60))
    pitch = np.radians(rng.uniform(-30, 10, 60))
    headings = np.column_stack([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)])
    rolls = np.radians(rng.normal(0, roll_deg, 60)) if roll_deg else np.zeros(60)
    return np.stack([rotation_from_heading(h, float(r)) for h, r in zip(headings, rolls, strict=True)])


def test_up_of_cameras_that_do_not_roll() -> None:
    frame = Rotation.random(rng=np.random.default_rng(2)).as_matrix()
    up = up_without_roll(frame @ _cameras(60, 1.0))
    angle_deg = np.degrees(angles_between(up.direction, frame[:, 2]))
    assert angle_deg < 0.5
    assert up.holds
    np.testing.assert_allclose(rotation_to_upright(up.direction) @ up.direction, [0, 0, 1], atol=1e-12)


def test_rolling_cameras_do_not_tell_up() -> None:
    assert not up_without_roll(_cameras(60, 10.0)).holds


def test_cameras_that_do_not_turn_do_not_tell_up() -> None:
    assert not up_without_roll(_cameras(3, 0.0)).holds


@pytest.mark.parametrize(
    "up", [[0.0, 0.0, 1.0], [0.3, -0.2, 0.8], [0.0, 5.0, 0.0], [0.0, 0.9, 0.1], [0.1, -3.0, 0.2], [2.0, 0, 0]]
)
def test_up_of_any_length_is_turned_to_the_z_axis(up: list[float]) -> None:
    R = rotation_to_upright(np.array(up))
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1)
    np.testing.assert_allclose(R @ up, [0, 0, np.linalg.norm(up)], atol=1e-12)
    assert R[0, 1] == pytest.approx(0) or abs(up[1]) > 0.85 * np.linalg.norm(up)  # x stays across y, while it can


@pytest.mark.parametrize(
    ("roll_deg", "turn_deg", "holds"),
    [
        (2.9, 40.0, True),
        (3.1, 40.0, False),
        (0.1, 15.1, True),
        (0.1, 14.9, False),
        (2.9, 11.7, False),
        (4.0, 90.0, False),
    ],
)
def test_the_prior_holds_for_cameras_that_turn_and_do_not_roll(roll_deg: float, turn_deg: float, holds: bool) -> None:
    assert Up(np.array([0.0, 0, 1]), roll_deg, turn_deg).holds is holds


def test_of_cameras_that_turn_and_roll_alike_nothing_is_known() -> None:
    assert Up(np.array([0.0, 0, 1]), 2.9, 11.5).holds is False
    assert Up(np.array([0.0, 0, 1]), 2.9, 15.5).holds is True


@pytest.mark.parametrize(("turn_deg", "roll_deg"), [(20.0, 0.0), (30.0, 2.0)])
def test_roll_and_turn_are_root_mean_squares(turn_deg: float, roll_deg: float) -> None:
    """Cameras half of which look to the left by so much, and half to the right; likewise rolled."""
    yaw = np.tile([turn_deg, -turn_deg], 20)
    roll = np.repeat([roll_deg, -roll_deg], 20)
    R = Rotation.from_euler("zy", np.column_stack([roll, yaw]), degrees=True).as_matrix()
    found = up_without_roll(R)
    np.testing.assert_allclose(found.direction, [0, -1, 0], atol=0.02)  # y points down
    assert found.turn_deg == pytest.approx(turn_deg, rel=0.01)
    assert found.roll_deg == pytest.approx(roll_deg, rel=0.02, abs=1e-5)
