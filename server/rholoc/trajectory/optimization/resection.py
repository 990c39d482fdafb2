"""Resection of pictures missing from a reconstruction."""

from dataclasses import replace

import numpy as np

from rholoc.geometry import BoolArray, FloatArray, IntArray
from rholoc.trajectory.optimization.points import residuals_px, triangulate
from rholoc.trajectory.optimization.problem import State
from rholoc.trajectory.visual.tracks import Observations
from rholoc.trajectory.visual.two_view import absolute_pose

_ROUNDS = 5  # each may add pictures that see only points of the round before
_MIN_POINTS = 15
_MIN_INLIER_SHARE = 0.4
_TOLERANCE_PX = 4.0
_MIN_PARALLAX_DEG = 1.5
_MAX_OFF_PX = 4.0  # median reprojection error of a known point


def with_missing_placed(
    observations: Observations, members: IntArray, state: State, count: int
) -> tuple[State, IntArray]:
    """Add the pictures that see enough known points to a reconstruction (P3P in LO-RANSAC): 15 inliers and 40 %.

    Args:
        observations: of all ``count`` pictures.
        members: (N,) the pictures with a pose, increasing.
        state: of these pictures.
        count: number of all pictures.

    Returns:
        State of all pictures with a pose, without points, and their numbers.
    """
    T = np.full((count, 4, 4), np.nan)
    T[members] = state.T_map_camera
    placed = np.zeros(count, dtype=np.bool_)
    placed[members] = True
    for _ in range(_ROUNDS):
        points, known = known_points(observations, np.flatnonzero(placed), replace(state, T_map_camera=T[placed]))
        added = False
        for k in np.flatnonzero(~placed).tolist():
            pose = _resected(observations, k, points, known, state)
            if pose is not None:
                T[k], placed[k], added = pose, True, True
        if not added:
            break
    now = np.flatnonzero(placed)
    return replace(state, T_map_camera=T[now], points=np.zeros((0, 3))), now


def known_points(observations: Observations, members: IntArray, state: State) -> tuple[FloatArray, BoolArray]:
    """Points (M, 3) triangulated from the pictures ``members`` (N,), increasing, at the poses of ``state``; NaN if not
    triangulated. And a mask (M,) of the reliable ones, which have 1.5° of parallax and all errors below 4 px.
    """
    seen = observations.at(np.isin(observations.keyframes, members))
    seen = replace(seen, keyframes=np.searchsorted(members, seen.keyframes))
    found, parallax_deg = triangulate(seen, state)
    off_px = residuals_px(seen, state, found)
    worst = np.zeros(len(found))
    np.maximum.at(worst, seen.tracks, off_px)
    points = np.full((observations.points, 3), np.nan)
    points[: len(found)] = found
    known = np.zeros(observations.points, dtype=np.bool_)
    known[: len(found)] = (parallax_deg > _MIN_PARALLAX_DEG) & (worst < _MAX_OFF_PX)
    return points, known


def _resected(
    observations: Observations, k: int, points: FloatArray, known: BoolArray, state: State
) -> FloatArray | None:
    """Pose T_map_camera (4, 4) of picture ``k`` by the known points that it sees; None if too few agree."""
    rows = np.flatnonzero(observations.keyframes == k)
    rows = rows[known[observations.tracks[rows]]]
    if len(rows) < _MIN_POINTS:
        return None
    rays = state.camera.rays(observations.pixels[rows])
    T, inliers = absolute_pose(rays, points[observations.tracks[rows]], _TOLERANCE_PX / state.camera.focal)
    return T if inliers >= max(_MIN_POINTS, _MIN_INLIER_SHARE * len(rows)) else None
