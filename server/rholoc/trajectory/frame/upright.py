"""Upward direction by the no-roll prior."""

from dataclasses import dataclass

import numpy as np

from rholoc.geometry import FloatArray

_MAX_ROLL_DEG = 3.0  # RMS over the frames, for the prior to hold
_MIN_TURN_DEG = 15.0  # RMS spread of the x axes, for their common normal to be defined


@dataclass(frozen=True, eq=False)
class Up:
    """An estimate of the upward direction.

    Attributes:
        direction: (3,), unit, in the frame of the poses.
        roll_deg: RMS angle between the cameras' x axes and the horizontal.
        turn_deg: RMS spread of the x axes about the direction.
    """

    direction: FloatArray
    roll_deg: float
    turn_deg: float

    @property
    def holds(self) -> bool:
        """Whether the prior holds (roll up to 3°) and fixes the direction (turn of at least 15°)."""
        return self.roll_deg <= _MAX_ROLL_DEG and self.turn_deg >= _MIN_TURN_DEG


def up_without_roll(R_world_camera: FloatArray) -> Up:
    """Direction most nearly perpendicular to all camera x axes, from rotations (N, 3, 3), by least squares.

    The paper's upright model: the camera pitches and turns but does not roll, so its x axis stays horizontal. The sign
    makes the cameras' y axes point down.
    """
    _, singular, Vt = np.linalg.svd(R_world_camera[:, :, 0], full_matrices=False)
    direction = Vt[2]
    if np.mean(R_world_camera[:, :, 1] @ direction) > 0:
        direction = -direction
    spread = np.degrees(np.arcsin(np.clip(singular / np.sqrt(len(R_world_camera)), 0, 1)))
    return Up(direction, float(spread[2]), float(spread[1]))


def rotation_to_upright(up: FloatArray) -> FloatArray:
    """A rotation (3, 3) that takes ``up`` (3,), of any length, to the z axis; its turn about z is arbitrary."""
    z = up / np.linalg.norm(up)
    x = np.cross([0.0, 1.0, 0.0], z) if abs(z[1]) < 0.9 else np.cross([0.0, 0.0, 1.0], z)
    x /= np.linalg.norm(x)
    basis = np.stack([x, np.cross(z, x), z])
    return np.asarray(basis)
