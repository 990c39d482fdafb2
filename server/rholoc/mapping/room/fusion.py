"""Depth views → truncated signed distances on a grid (Curless and Levoy, SIGGRAPH 1996)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rholoc.geometry import BoolArray, FloatArray
from rholoc.mapping.room.depth_views import DepthView

MAX_VOXELS = 4_000_000
TRUNCATION = 3.0  # voxels
_OUTER = (0.01, 0.99)  # quantiles of the points along each axis that the grid holds
_MARGIN = 3  # voxels around them
_SAMPLED_STEP = 4  # pixels


@dataclass(eq=False)
class DistanceGrid:
    """Truncated signed distances of voxels to the nearest surface, positive in front of it.

    Attributes:
        origin: (3,) centre of voxel (0, 0, 0), in the grid's axes.
        size: edge of a voxel, in the map's unit.
        R_grid_map: (3, 3) rotation from the map frame to the grid's axes, whose z is up.
        distances: (X, Y, Z) float32, -1 to 1, in units of ``TRUNCATION`` voxels.
        weights: (X, Y, Z) float32, 0 where nothing is known.
    """

    origin: FloatArray
    size: float
    R_grid_map: FloatArray
    distances: FloatArray
    weights: FloatArray

    @property
    def known(self) -> BoolArray:
        """(X, Y, Z) mask of voxels whose distance is known."""
        return np.asarray(self.weights > 0)


def sampled_points(views: Sequence[DepthView]) -> FloatArray:
    """Points (P, 3) of known depth, of every fourth pixel and row of all views, in the map frame."""
    return np.concatenate([view.points(_SAMPLED_STEP)[0] for view in views] or [np.zeros((0, 3))])


def voxel_size(points: FloatArray, finest: float, surface_voxels: int) -> float:
    """Smallest of the sizes ``finest`` × 1.15ⁿ of a voxel that is large enough for points (P, 3).

    The points then occupy at most ``surface_voxels`` voxels, and the box of their 1 % to 99 % quantiles (with margin)
    has at most ``MAX_VOXELS``.
    """
    size = finest
    low, high = np.quantile(points, _OUTER, axis=0)
    while True:
        box = np.prod(np.ceil((high - low) / size) + 2 * _MARGIN)
        cells = np.floor((points - low) / size).astype(np.int64)
        if box <= MAX_VOXELS and len(np.unique(cells @ [1, 1 << 20, 1 << 40])) <= surface_voxels:
            return size
        size *= 1.15


def fused(views: Sequence[DepthView], points: FloatArray, size: float, R_grid_map: FloatArray) -> DistanceGrid:
    """Fuse depth views into a grid with voxels of ``size`` around ``points`` (P, 3), both in the map frame; the grid's
    axes are turned by ``R_grid_map`` (3, 3).
    """
    placed = points @ R_grid_map.T
    low, high = np.quantile(placed, _OUTER, axis=0)
    origin = low - _MARGIN * size
    shape = tuple((np.ceil((high - low) / size) + 2 * _MARGIN + 1).astype(int).tolist())
    blank = np.zeros(shape, dtype=np.float32)
    grid = DistanceGrid(origin, size, R_grid_map, blank + 1, blank)
    for view in views:
        _add(grid, view)
    return grid


def _add(grid: DistanceGrid, view: DepthView) -> None:
    """Average a view's truncated distances into the grid, weighted by 1 / depth²."""
    R = grid.R_grid_map @ view.T_map_camera[:3, :3]
    centre = grid.R_grid_map @ view.T_map_camera[:3, 3]
    box = _box(grid, view, centre, R)
    if box is None:
        return
    axes = [
        grid.origin[k] + grid.size * np.arange(box[k].start, box[k].stop, dtype=np.float32) - centre[k]
        for k in range(3)
    ]
    R32 = R.astype(np.float32)
    x, y, z = (
        axes[0][:, None, None] * R32[0, k] + axes[1][:, None] * R32[1, k] + axes[2] * R32[2, k] for k in range(3)
    )
    ahead = np.flatnonzero(z.ravel() > grid.size)
    z = z.ravel()[ahead]
    u = np.rint(x.ravel()[ahead] * (view.focal / z) + view.centre[0]).astype(np.int32)
    v = np.rint(y.ravel()[ahead] * (view.focal / z) + view.centre[1]).astype(np.int32)
    side = len(view.depth)
    inside = (u >= 0) & (v >= 0) & (u < side) & (v < side)
    ahead, z, u, v = ahead[inside], z[inside], u[inside], v[inside]
    distance = (view.depth[v, u] - z) / np.float32(TRUNCATION * grid.size)
    with np.errstate(invalid="ignore"):
        seen = distance > -1
    ahead, z, distance = ahead[seen], z[seen], distance[seen]
    weight = 1 / (z * z)
    at = np.unravel_index(ahead, grid.weights[box].shape)
    distances, weights = grid.distances[box], grid.weights[box]
    total = weights[at] + weight
    distances[at] += weight / total * (np.minimum(distance, 1) - distances[at])
    weights[at] = total


def _box(grid: DistanceGrid, view: DepthView, centre: FloatArray, R: FloatArray) -> tuple[slice, slice, slice] | None:
    """The part of the grid that a view can see up to its farthest depth; None if that is empty. ``centre`` (3,) and R
    (3, 3) are the view's position and rotation in the grid's axes.
    """
    if not np.isfinite(view.depth).any():
        return None
    farthest = float(np.nanquantile(view.depth, 0.99)) + TRUNCATION * grid.size
    ends = (np.array([[0.0, 0.0], [len(view.depth) - 1.0] * 2]) - view.centre) / view.focal
    corners = np.array([[0, 0, 0], *([a, b, 1] for a in ends[:, 0] for b in ends[:, 1])]) * farthest
    placed = (corners @ R.T + centre - grid.origin) / grid.size
    low = np.maximum(np.floor(placed.min(axis=0)), 0).astype(int)
    high = np.minimum(np.ceil(placed.max(axis=0)) + 1, grid.weights.shape).astype(int)
    if np.any(high <= low):
        return None
    first, second, third = (slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
    return first, second, third
