"""Times of waypoints whose order alone is known, from the pauses of the walk."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from math import comb

import numpy as np
from scipy.ndimage import uniform_filter1d

from rholoc.errors import InvalidWaypoints
from rholoc.geometry import FloatArray
from rholoc.recordings import Imu, Waypoint
from rholoc.recordings.walk.stillness import MIN_PAUSE_S, is_still

_STILL_IMAGE = 0.1  # image widths a second: maximum at rest without an IMU …
_TREMBLING_IMAGE = 0.15  # … and at rest by the IMU
_MOMENT_S = 0.3
_TOLERANCE_S = 0.1  # a pause may be this much too short: the moving average blurs its ends
_MAX_CHOICES = 2000


def find_pauses(times: FloatArray, motion: FloatArray, imu: Imu | None) -> FloatArray:
    """Start and end (P, 2) [s] of every rest of a second or more, by IMU and images; none of a single frame.

    Args:
        times: (N,) of the frames [s].
        motion: (N,) image motion before each frame, as a share of the image's longer side.
        imu: of the same recording; None to use the images alone.
    """
    if len(times) < 2:
        return np.zeros((0, 2))
    interval_s = float(np.median(np.diff(times)))
    rate = uniform_filter1d(motion / interval_s, max(1, round(_MOMENT_S / interval_s)), mode="nearest")
    if imu is None:
        still = rate <= _STILL_IMAGE
    else:
        is_at_rest = np.interp(times, imu.times, is_still(imu).astype(np.float64), left=0.0, right=0.0) > 0.5
        still = is_at_rest & (rate <= _TREMBLING_IMAGE)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]])))
    spans = np.column_stack([times[edges[::2]], times[edges[1::2] - 1]])
    return np.asarray(spans[spans[:, 1] - spans[:, 0] >= MIN_PAUSE_S - _TOLERANCE_S])


def times_are_known(waypoints: Sequence[Waypoint]) -> bool:
    """Whether no waypoint's time is NaN."""
    return not any(np.isnan(waypoint.time) for waypoint in waypoints)


def choices_of_pauses(waypoints: Sequence[Waypoint], pauses: FloatArray) -> Iterator[tuple[Waypoint, ...]]:
    """All order-preserving assignments of waypoints to pauses (P, 2) [s], those to the longest pauses first.

    A waypoint's time is the middle of its pause.

    Only the longest pauses are used if there were more than 2000 assignments.

    Raises:
        InvalidWaypoints: there are fewer pauses than waypoints.
    """
    count = len(waypoints)
    if len(pauses) < count:
        raise InvalidWaypoints(
            f"The walk has {len(pauses)} pauses of a second or more, but there are {count} waypoints without a time.",
            "Stand still for a second and a half at each waypoint, or give each its time or frame.",
        )
    taken = len(pauses)
    while comb(taken, count) > _MAX_CHOICES:
        taken -= 1
    longest = np.argsort(pauses[:, 0] - pauses[:, 1], kind="stable")[:taken]
    for chosen in combinations(longest.tolist(), count):
        middles = np.sort(pauses[list(chosen)].mean(axis=1))
        yield tuple(replace(waypoint, time=float(t)) for waypoint, t in zip(waypoints, middles, strict=True))
