"""The no-roll prior."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.geometry import FloatArray, rotation_from_heading
from rholoc.trajectory.frame.upright import rotation_to_upright, up_without_roll


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
    angle_deg = np.degrees(np.arccos(np.clip(up.direction @ frame[:, 2], -1, 1)))
    assert angle_deg < 0.5
    assert up.holds
    np.testing.assert_allclose(rotation_to_upright(up.direction) @ up.direction, [0, 0, 1], atol=1e-12)


def test_rolling_cameras_do_not_tell_up() -> None:
    assert not up_without_roll(_cameras(60, 10.0)).holds


def test_cameras_that_do_not_turn_do_not_tell_up() -> None:
    assert not up_without_roll(_cameras(3, 0.0)).holds
