"""The transform map→odom as it is broadcast: it follows the tracker's at a bounded rate, or it is silent."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rholoc_client.tracking.rigid import FloatArray, motion_between, moved
from rholoc_ros.geometry import map_to_odom


@dataclass(frozen=True)
class CorrectionLimits:
    """How the broadcast transform may change.

    Attributes:
        speed_m_s, turn_deg_s: rate at which a correction may move and turn the robot in the map.
        lag_m, lag_deg: a larger correction is not blended in. The broadcast pauses, then starts at the new place.
        pause_s: shortest pause: until the transforms sent before, which are future-dated, have expired.
    """

    speed_m_s: float
    turn_deg_s: float
    lag_m: float
    lag_deg: float
    pause_s: float


class Correction:
    """The broadcast T_map_odom.

    Rates are measured at the robot, not at the origin of odometry: far from there, a small turn is a long way.
    """

    def __init__(self, limits: CorrectionLimits) -> None:
        self._limits = limits
        self._sent: FloatArray | None = None
        self._sent_s = -math.inf

    def step(self, now_s: float, target: FloatArray | None, T_odom_base: FloatArray) -> FloatArray | None:
        """T_map_odom (4, 4) to broadcast now; None: broadcast nothing.

        Args:
            now_s: the time of the broadcast.
            target: T_map_odom (4, 4) by the tracker; None while it has no pose.
            T_odom_base: (4, 4) about where the robot is.
        """
        limits = self._limits
        if now_s < self._sent_s:  # the clock went back
            self._sent, self._sent_s = None, -math.inf
        if target is None:
            self._sent = None
            return None
        if self._sent is None:
            if now_s < self._sent_s + limits.pause_s:
                return None
            self._sent, self._sent_s = target, now_s
            return target
        shown = self._sent @ T_odom_base
        motion = motion_between(shown, target @ T_odom_base)
        apart_m, apart_rad = float(np.linalg.norm(motion[:3])), float(np.linalg.norm(motion[3:]))
        if apart_m > limits.lag_m or apart_rad > math.radians(limits.lag_deg):
            self._sent = None
            return None
        seconds = now_s - self._sent_s
        share = min(
            1.0,
            limits.speed_m_s * seconds / max(apart_m, 1e-12),
            math.radians(limits.turn_deg_s) * seconds / max(apart_rad, 1e-12),
        )
        self._sent, self._sent_s = map_to_odom(moved(shown, share * motion), T_odom_base), now_s
        return self._sent
