"""A robot's last poses by odometry, and its pose at the moment of a picture."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque

from rholoc_client.tracking.rigid import FloatArray
from rholoc_ros.geometry import interpolated

_MAX_GAP_NS = 250_000_000  # between two messages: a robot can turn in more
_KEPT = 1000


class OdometryBuffer:
    """The last poses T_odom_base, by stamp [ns]."""

    def __init__(self) -> None:
        self._stamps: deque[int] = deque(maxlen=_KEPT)
        self._poses: deque[FloatArray] = deque(maxlen=_KEPT)

    def add(self, stamp_ns: int, T_odom_base: FloatArray) -> None:
        """Take in a pose (4, 4). A stamp that is not after the last one starts the buffer over: the clock went back."""
        if self._stamps and stamp_ns <= self._stamps[-1]:
            self._stamps.clear()
            self._poses.clear()
        self._stamps.append(stamp_ns)
        self._poses.append(T_odom_base)

    def at(self, stamp_ns: int) -> FloatArray | None:
        """T_odom_base (4, 4) at a stamp, interpolated; None before the first pose, after the last, and in a gap."""
        i = bisect_left(self._stamps, stamp_ns)
        if i == len(self._stamps):
            return None
        if self._stamps[i] == stamp_ns:
            return self._poses[i]
        if i == 0 or self._stamps[i] - self._stamps[i - 1] > _MAX_GAP_NS:
            return None
        share = (stamp_ns - self._stamps[i - 1]) / (self._stamps[i] - self._stamps[i - 1])
        return interpolated(self._poses[i - 1], self._poses[i], share)
