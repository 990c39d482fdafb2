"""How far off the priors are that benchmarks ask with."""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.geometry import Pose, pose_matrix


class PriorKind(StrEnum):
    """The prior that a frame is asked with."""

    NONE = "no prior"
    NEAR = "prior 10 cm and 4° off"
    ROUGH = "prior 40 cm and 15° off"
    WRONG = "prior 5 m and 90° off"


OFF = {PriorKind.NEAR: (0.1, 4.0), PriorKind.ROUGH: (0.4, 15.0), PriorKind.WRONG: (5.0, 90.0)}
"""By how many metres and degrees."""


def pose_off(pose: Pose, kind: PriorKind, rng: np.random.Generator) -> Pose | None:
    """A pose that is so far off another, in random directions; None where there is to be no prior."""
    if kind not in OFF:
        return None
    off_m, off_deg = OFF[kind]
    apart, axis = (direction / np.linalg.norm(direction) for direction in rng.normal(size=(2, 3)))
    turn = Rotation.from_rotvec(np.radians(off_deg) * axis).as_matrix()
    return Pose(pose_matrix(turn @ pose.R_map_camera, pose.position + off_m * apart))
