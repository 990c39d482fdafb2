"""Pairs of keyframes whose rotation the gyroscope contradicts: repeated texture that looks like one place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from rholoc.geometry import BoolArray, FloatArray
from rholoc.recordings import Imu
from rholoc.trajectory.imu import allowed_apart, calibrate_gyro, camera_rotations
from rholoc.trajectory.two_view import VerifiedPair

_EXPLAINED = 0.8  # the share of a pair's matches that two cameras turned as the gyroscope felt must explain
_CLOSE = 0.006  # radians: about three pixels


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
        images a moment apart, most of what is seen is the same. Then a pair is not judged by its own rotation, which
        a plane or a short way leaves open though its matches are right, but by its matches: whether any two cameras
        turned as was felt could have seen them. A right pair dropped may be what holds a part of the walk in place.
        """
        gyro = calibrate_gyro(self.times, _chained(sequential, len(self.times)), self.imu)
        if gyro is None or not (gyro.fits and gyro.mounting_is_known):
            return list(sequential), list(loops)
        R_start_camera = camera_rotations(self.imu, gyro, self.times)

        def agrees(pair: VerifiedPair) -> bool:
            felt = R_start_camera[pair.second].inv() * R_start_camera[pair.first]
            allowed = float(allowed_apart(self.times[pair.second] - self.times[pair.first]))
            return _apart(pair.R_second_first, felt) <= allowed or _could_be(pair.seen, felt, allowed)

        return [pair for pair in sequential if agrees(pair)], [pair for pair in loops if agrees(pair)]


def _apart(R: FloatArray, felt: Rotation) -> float:
    return float((Rotation.from_matrix(R).inv() * felt).magnitude())


def _could_be(seen: FloatArray, felt: Rotation, allowed: float) -> bool:
    """Whether matches (2, M, 2) may be of two cameras whose rotation is within ``allowed`` radians of the felt one."""
    first, second = (np.column_stack([xy, np.ones(len(xy))]) for xy in seen)
    way = np.linalg.svd(np.cross(felt.apply(first), second))[2][2]

    def pose(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        return (Rotation.from_rotvec(x[:3]) * felt).as_matrix(), x[3:] / np.linalg.norm(x[3:])

    def apart(x: FloatArray) -> FloatArray:
        return _apart_in_plane(first, second, *pose(x)) / _CLOSE

    limit = np.r_[np.full(3, allowed), np.full(3, np.inf)]
    fit = least_squares(apart, np.r_[0.0, 0.0, 0.0, way], loss="cauchy", bounds=(-limit, limit), max_nfev=50)
    explained = (np.abs(apart(fit.x)) < 1) & _in_front(first, second, *pose(fit.x))
    return bool(explained.mean() >= _EXPLAINED)


def _apart_in_plane(first: FloatArray, second: FloatArray, R: FloatArray, t: FloatArray) -> FloatArray:
    """How far from its epipolar geometry each match (N, 3), (N, 3) is, to first order in the image planes (Sampson)."""
    E = np.cross(np.eye(3), t).T @ R
    in_second, in_first = first @ E.T, second @ E
    norm = np.hypot(np.linalg.norm(in_second[:, :2], axis=1), np.linalg.norm(in_first[:, :2], axis=1))
    return np.asarray((second * in_second).sum(axis=1) / norm)


def _in_front(first: FloatArray, second: FloatArray, R: FloatArray, t: FloatArray) -> BoolArray:
    """Which matches (N, 3), (N, 3) lie before both cameras, with t or with -t, whichever puts more of them there."""
    turned = first @ R.T
    aa, bb, ab = (turned**2).sum(axis=1), (second**2).sum(axis=1), (turned * second).sum(axis=1)
    at, bt = turned @ t, second @ t
    # the depths that bring depth_1 * turned + t nearest to depth_2 * second, but for a positive factor
    of_first, of_second = ab * bt - bb * at, aa * bt - ab * at
    before = (of_first > 0) & (of_second > 0)
    behind = (of_first < 0) & (of_second < 0)
    return np.asarray(before if before.sum() >= behind.sum() else behind)


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
