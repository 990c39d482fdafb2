"""Odometry → measured steps between moments."""

from collections.abc import Iterator

import numpy as np

from rholoc.geometry import FloatArray, interpolated_poses
from rholoc.recordings import Odometry

_LONGEST_GAP_S = 1.0  # between rows


def odometry_steps(odometry: Odometry, times: FloatArray) -> Iterator[tuple[int, FloatArray, float, float]]:
    """Steps from one of the times (K,) [s] to the next, where the odometry covers both and what lies between.

    Yields:
        The number of the first of the two, T_first_second (4, 4), and one sigma of each coordinate [m] and of the
        rotation about each axis [rad].
    """
    rows = odometry.times
    inside = np.flatnonzero((times >= rows[0]) & (times <= rows[-1]))
    if len(inside) < 2 or len(rows) < 2:
        return
    T = interpolated_poses(rows, odometry.T_odom_camera, times[inside])
    variances = [
        np.interp(times[inside], rows, np.concatenate([[0.0], np.cumsum(sigma[1:] ** 2)]))
        for sigma in (odometry.sigma_m, odometry.sigma_rad)
    ]
    gaps = rows[:-1][np.diff(rows) > _LONGEST_GAP_S], rows[1:][np.diff(rows) > _LONGEST_GAP_S]
    for i, k in enumerate(inside[:-1].tolist()):
        start, end = times[k], times[inside[i + 1]]
        if inside[i + 1] == k + 1 and not np.any((gaps[0] < end) & (gaps[1] > start)):
            sigma_m, sigma_rad = (float(np.sqrt(variance[i + 1] - variance[i])) for variance in variances)
            yield k, np.linalg.inv(T[i]) @ T[i + 1], sigma_m, sigma_rad
