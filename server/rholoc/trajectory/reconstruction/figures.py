"""Statistics of an adjustment: pose covariances, scale uncertainty, median depth."""

import numpy as np

from rholoc.geometry import FloatArray, evenly
from rholoc.trajectory.optimization.adjustment import Adjusted
from rholoc.trajectory.visual.tracks import Observations


def spread_covariances(adjusted: Adjusted, count: int, computed: int) -> FloatArray:
    """Pose covariances (K, 6, 6) of K = ``count`` ≥ 2 keyframes: computed for ``computed`` of them, interpolated
    between.

    NaN where unbounded.
    """
    some = evenly(count, computed)
    found = adjusted.covariances(some.tolist())
    after = np.clip(np.searchsorted(some, np.arange(count)), 1, len(some) - 1)
    share = ((np.arange(count) - some[after - 1]) / (some[after] - some[after - 1]))[:, None, None]
    return np.asarray((1 - share) * found[after - 1] + share * found[after])


def scale_sigma_of(adjusted: Adjusted) -> float:
    """Relative standard deviation of the walk's scale, from the keyframe furthest from the first; inf if unbounded."""
    away = adjusted.state.positions - adjusted.state.positions[0]
    far = int(np.argmax(np.linalg.norm(away, axis=1)))
    length = max(float(np.linalg.norm(away[far])), 1e-9)
    covariance = adjusted.covariances([far])[0, :3, :3]
    along = away[far] / length
    sigma = float(np.sqrt(along @ covariance @ along)) / length
    return sigma if np.isfinite(sigma) else np.inf


def median_depth_of(observations: Observations, adjusted: Adjusted) -> float:
    """Median depth of the used points before their cameras, in the state's unit."""
    state, used = adjusted.state, adjusted.used
    points, T = state.points[observations.tracks[used]], state.T_map_camera[observations.keyframes[used]]
    depths = np.einsum("ni,ni->n", points - T[:, :3, 3], T[:, :3, 2])
    return float(np.median(depths[depths > 0]))


def depths_of(observations: Observations, adjusted: Adjusted, count: int) -> FloatArray:
    """Median depth (K,) of the used points that each of K = ``count`` keyframes sees, in the state's unit; NaN without
    any.
    """
    state, used = adjusted.state, adjusted.used
    rows = observations.keyframes[used]
    T = state.T_map_camera[rows]
    depths = np.einsum("ni,ni->n", state.points[observations.tracks[used]] - T[:, :3, 3], T[:, :3, 2])
    return np.array([np.median(depths[rows == k]) if (rows == k).any() else np.nan for k in range(count)])
