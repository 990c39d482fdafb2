"""Choose the frames of a trajectory that become views, and those held out for the report."""

import numpy as np

from rholoc.geometry import FloatArray, IntArray, pose_distances

_METRES_PER_RADIAN = 1.0
VIEW_STEP = 0.05  # metres moved plus radians turned from view to view; in a map of arbitrary scale, of its unit
_HOLD_OUT_EVERY = 10
_MAX_VIEWS = 2000


def choose_views(T_map_camera: FloatArray, hold_out: bool, step: float = VIEW_STEP) -> tuple[IntArray, IntArray]:
    """Rows of the views and of the held-out frames, ascending, from a trajectory's poses (K, 4, 4) in order of time.

    With ``hold_out`` and at least 30 poses, every tenth pose is held out. Among the others, a view is taken whenever
    the camera has moved by ``step`` (metres plus radians), or by more if that gave more than 2000.
    """
    rows = np.arange(len(T_map_camera))
    held_out = (
        rows[_HOLD_OUT_EVERY // 2 :: _HOLD_OUT_EVERY] if hold_out and len(rows) >= 3 * _HOLD_OUT_EVERY else rows[:0]
    )
    rest = np.setdiff1d(rows, held_out)
    moved = _motion(T_map_camera[rest])
    step = max(step, float(moved[-1]) / _MAX_VIEWS)
    bins = np.floor(moved / step)
    first_in_step = np.concatenate([[True], np.diff(bins) > 0])
    return rest[first_in_step], held_out


def _motion(T_map_camera: FloatArray) -> FloatArray:
    """(K,) accumulated motion since the first pose: metres plus radians."""
    moved, turned = pose_distances(T_map_camera[:-1], T_map_camera[1:])
    return np.concatenate([[0.0], np.cumsum(moved + _METRES_PER_RADIAN * turned)])
