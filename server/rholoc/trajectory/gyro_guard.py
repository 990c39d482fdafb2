"""Pairs of keyframes whose rotation the gyroscope contradicts: repeated texture that looks like one place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.geometry import FloatArray
from rholoc.recordings import Imu
from rholoc.trajectory.imu import allowed_apart, calibrate_gyro, camera_rotations
from rholoc.trajectory.two_view import VerifiedPair


@dataclass(frozen=True, eq=False)
class GyroGuard:
    """The gyroscope beside K keyframes.

    Attributes:
        times: (K,) seconds, of the keyframes.
        imu: of the same recording.
    """

    times: FloatArray
    imu: Imu

    def keep(
        self, sequential: Sequence[VerifiedPair], loops: Sequence[VerifiedPair]
    ) -> tuple[list[VerifiedPair], list[VerifiedPair]]:
        """The pairs of either kind that the gyroscope does not contradict; all, where it cannot be calibrated.

        It is calibrated against the rotations between neighbours, which no repeated texture confuses: of any two
        images a moment apart, most of what is seen is the same.
        """
        gyro = calibrate_gyro(self.times, _chained(sequential, len(self.times)), self.imu)
        if gyro is None or not (gyro.fits and gyro.mounting_is_known):
            return list(sequential), list(loops)
        R_start_camera = camera_rotations(self.imu, gyro, self.times)

        def agrees(pair: VerifiedPair) -> bool:
            felt = R_start_camera[pair.second].inv() * R_start_camera[pair.first]
            apart = (Rotation.from_matrix(pair.R_second_first).inv() * felt).magnitude()
            return bool(apart <= allowed_apart(self.times[pair.second] - self.times[pair.first]))

        return [pair for pair in sequential if agrees(pair)], [pair for pair in loops if agrees(pair)]


def _chained(pairs: Sequence[VerifiedPair], count: int) -> FloatArray:
    """Rotations R_world_camera (K, 3, 3) along the walk, each from its nearest matched predecessor."""
    nearest: dict[int, VerifiedPair] = {}
    for pair in pairs:
        if pair.second not in nearest or pair.first > nearest[pair.second].first:
            nearest[pair.second] = pair
    R = np.tile(np.eye(3), (count, 1, 1))
    for k in range(1, count):
        if k in nearest:
            R[k] = R[nearest[k].first] @ nearest[k].R_second_first.T
        else:
            R[k] = R[k - 1]
    return R
