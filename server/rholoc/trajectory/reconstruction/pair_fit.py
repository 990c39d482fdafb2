"""Verified pairs of pictures against the poses of a reconstruction."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rholoc.geometry import FloatArray, IntArray
from rholoc.geometry.graphs import components
from rholoc.trajectory.checks.given_poses import epipolar_errors
from rholoc.trajectory.optimization.problem import State
from rholoc.trajectory.visual.matching import VerifiedPair

MAX_PAIR_ERROR = 5e-3  # median epipolar error of a pair that fits, as a share of the focal length …
_CONTRADICTING = 15e-3  # … and of one that contradicts two poses
_MAX_CONTRADICTED = 1 / 3  # of the matches that link added pictures to a reconstruction


def pair_error(pair: VerifiedPair, rays: Sequence[FloatArray], T: FloatArray) -> float:
    """Median epipolar error of a pair's matches under the poses T (K, 4, 4), on the plane z = 1; for wide lenses in
    radians. ``rays`` are those of every picture's features.
    """
    a, b = rays[pair.first][pair.matches[:, 0]], rays[pair.second][pair.matches[:, 1]]
    return float(np.median(epipolar_errors(np.linalg.inv(T[pair.second]) @ T[pair.first], a, b)))


def without_contradicted(
    extended: tuple[State, IntArray], members: IntArray, pairs: Sequence[VerifiedPair], rays: Sequence[FloatArray]
) -> tuple[State, IntArray]:
    """Remove pictures that were added to a reconstruction at a place that only looks alike.

    Added pictures stay or go together with those that pairs link them to. They go if over a third of the matches that
    link them to the reconstruction contradict their poses: a picture at the right place fits what all others show.

    Args:
        extended: state without points, and the pictures (N,) with a pose.
        members: the pictures of the reconstruction before, among these.
        pairs: verified, of all pictures.
        rays: of every picture's features.
    """
    state, now = extended
    added = np.setdiff1d(now, members)
    if len(added) == 0:
        return extended
    count = len(rays)
    T = np.full((count, 4, 4), np.nan)
    T[now] = state.T_map_camera
    placed, is_added = np.isin(np.arange(count), now), np.isin(np.arange(count), added)
    every = np.array([(pair.first, pair.second) for pair in pairs], dtype=np.int64).reshape(-1, 2)
    rows = np.flatnonzero(placed[every].all(axis=1) & is_added[every].any(axis=1))
    near, ends = [pairs[k] for k in rows.tolist()], every[rows]
    contradicts = np.array([pair_error(pair, rays, T) > _CONTRADICTING for pair in near], dtype=np.bool_)
    matches = np.array([len(pair.matches) for pair in near], dtype=np.float64)
    inside = is_added[ends].all(axis=1)
    together = ends[inside & ~contradicts]
    group = components(count, together)
    outside = np.where(is_added[ends[:, 0]], ends[:, 0], ends[:, 1])
    linked, against = (
        np.bincount(group[outside[some]], matches[some], minlength=count) for some in (~inside, ~inside & contradicts)
    )
    stays = ~(is_added & (against > _MAX_CONTRADICTED * linked)[group])[now]
    return replace(state, T_map_camera=state.T_map_camera[stays]), now[stays]
