"""The floor and the walls of a room: planes fitted to its mesh, which close the gaps where pictures show no texture."""

from dataclasses import dataclass

import cv2
import numpy as np

from rholoc.geometry import BoolArray, FloatArray
from rholoc.mapping.room.fusion import TRUNCATION, DistanceGrid
from rholoc.mapping.room.surface import Quads, normals_of

_FLAT = 0.85  # cosine of a floor's normals with up
_STEEP = 0.35  # cosine of a wall's normals with up
_FLOOR_SHARE = 0.04  # of the vertices that face up, within a floor's height
_MIN_WALL = 60  # vertices
_OF_LARGEST = 0.15  # of the vertices of the largest plane of a direction
_MIN_HEIGHT = 0.4  # of the room's
_MAX_BEHIND = 0.25  # of all vertices: what is seen through doors and windows
_ANGLES = 90  # bins of a right angle
_SAME_DIRECTION = 0.94  # cosine between the normals of a wall
_THICK = 2.0  # voxels, of a plane's points from it
_OUTER = (0.02, 0.98)  # quantiles of a wall's points between which it is closed
_CORNER_REACH = 0.25  # of the room's diagonal: how far a wall is continued to the next
_TOP = 0.97  # quantile of the wall's vertices up to which it is closed
_WEIGHT = 1e-6  # of a distance that no picture measured


@dataclass(frozen=True, eq=False)
class Wall:
    """A vertical plane n · (x, y) = offset, in the grid's axes, and the part of it that is closed.

    Attributes:
        normal: (2,) unit, towards the room.
        offset: signed distance of the plane from the origin along the normal.
        ends: start and end of the closed part along :attr:`along`, the normal rotated by 90° anti-clockwise.
        top: height of the closed part's upper edge.
    """

    normal: FloatArray
    offset: float
    ends: tuple[float, float]
    top: float

    @property
    def along(self) -> FloatArray:
        """(2,) unit vector along the wall."""
        return np.array([-self.normal[1], self.normal[0]])


def floor_height(mesh: Quads, size: float) -> float:
    """Height of the floor: of the mesh's lowest horizontal surface with over 4 % of the vertices that face up.

    ``size`` is the edge of a voxel. Without such a surface, the 2 % quantile of the mesh's heights.
    """
    heights = mesh.vertices[:, 2]
    flat = heights[normals_of(*mesh)[:, 2] > _FLAT]
    lowest = float(np.quantile(heights, 0.02))
    if not len(flat):
        return lowest
    counts, edges = np.histogram(flat, bins=max(1, int(np.ptp(flat) / (2 * size))))
    large = np.flatnonzero(counts + np.append(counts[1:], 0) > _FLOOR_SHARE * len(flat))
    if not len(large):
        return lowest
    first = large[0] + int(counts[min(large[0] + 1, len(counts) - 1)] > counts[large[0]])
    inside = flat[(flat >= edges[first]) & (flat <= edges[first + 1])]
    return float(np.median(inside)) if len(inside) else lowest


def walls_of(mesh: Quads, size: float) -> list[Wall]:
    """The outermost wall on each of four sides at right angles, as far as a mesh with voxels of ``size`` shows them.

    They reach to their common corners and have the height of the tallest.
    """
    normals = normals_of(*mesh)
    steep = np.abs(normals[:, 2]) < _STEEP
    vertices, normals = mesh.vertices[steep], normals[steep]
    if not len(vertices):
        return []
    turn = _main_direction(normals)
    found = [
        wall
        for side in range(4)
        if (wall := _outermost(mesh, vertices, normals, turn + side * np.pi / 2, size)) is not None
    ]
    reach = _CORNER_REACH * float(np.linalg.norm(np.ptp(mesh.vertices[:, :2], axis=0)))
    top = max((wall.top for wall in found), default=0.0)
    return [_continued(wall, found, reach, top) for wall in found]


def _main_direction(normals: FloatArray) -> float:
    """Most frequent angle [rad] of normals (N, 3) about z, modulo 90°."""
    angles = np.arctan2(normals[:, 1], normals[:, 0]) % (np.pi / 2)
    counts, edges = np.histogram(angles, bins=_ANGLES, range=(0, np.pi / 2))
    around = sum(np.roll(counts, by) for by in (-2, -1, 0, 1, 2))
    return float(edges[np.argmax(around)] + np.pi / 4 / _ANGLES)


def _outermost(mesh: Quads, vertices: FloatArray, normals: FloatArray, angle: float, size: float) -> Wall | None:
    """Outermost vertical wall whose normal, towards the room, is at ``angle`` [rad] from x (within 20°).

    A wall needs 60 vertices, 0.15 × those of the largest parallel plane, 0.4 × the room's height, and at most a quarter
    of the mesh's vertices behind it. None if there is none. ``vertices`` and ``normals`` (N, 3) are those of the mesh's
    steep parts; ``size`` is the edge of a voxel.
    """
    normal = np.array([np.cos(angle), np.sin(angle)])
    points = vertices[normals[:, :2] @ normal > _SAME_DIRECTION]
    offsets = points[:, :2] @ normal
    if len(points) < _MIN_WALL:
        return None
    height = float(np.subtract(*np.quantile(mesh.vertices[:, 2], (0.99, 0.01))))
    edges = np.arange(offsets.min(), offsets.max() + 2 * _THICK * size, _THICK * size)
    counts, _ = np.histogram(offsets, edges)
    large = max(_MIN_WALL, _OF_LARGEST * counts.max())
    for k in np.flatnonzero(counts >= large).tolist():
        mine = points[(offsets >= edges[k] - 0.5 * _THICK * size) & (offsets <= edges[k + 1] + 0.5 * _THICK * size)]
        own, offset = _fitted(mine, normal)
        behind = float((mesh.vertices[:, :2] @ own < offset - 3 * _THICK * size).mean())
        if np.ptp(mine[:, 2]) > _MIN_HEIGHT * height and behind < _MAX_BEHIND:
            ends = np.quantile(mine[:, :2] @ [-own[1], own[0]], _OUTER)
            return Wall(own, offset, (float(ends[0]), float(ends[1])), float(np.quantile(mine[:, 2], _TOP)))
    return None


def _fitted(points: FloatArray, normal: FloatArray) -> tuple[FloatArray, float]:
    """Normal (2,) and offset of the vertical plane closest to points (N, 3), within 20° of ``normal`` (2,), or that."""
    middle = points[:, :2].mean(axis=0)
    _, _, Vt = np.linalg.svd(points[:, :2] - middle, full_matrices=False)
    own = Vt[1] if Vt[1] @ normal > 0 else -Vt[1]
    if own @ normal < _SAME_DIRECTION:
        own = normal
    return own, float(own @ middle)


def _continued(wall: Wall, others: list[Wall], reach: float, top: float) -> Wall:
    """A wall of height ``top`` whose ends move to the corners with adjacent walls, if these are within ``reach``."""
    low, high = wall.ends
    for other in others:
        across = float(other.normal @ wall.along)
        if abs(across) < 0.5:
            continue
        corner = (other.offset - wall.offset * float(other.normal @ wall.normal)) / across
        if across > 0 and abs(corner - low) < reach:
            low = corner
        elif across < 0 and abs(corner - high) < reach:
            high = corner
    return Wall(wall.normal, wall.offset, (low, high), top)


def close_gaps(grid: DistanceGrid, floor: float, walls: list[Wall]) -> None:
    """Continue the floor and the walls through voxels that no picture shows, in place. The voxels' weight becomes 1e-6.
    ``floor`` is the floor's height.
    """
    x, y, z = (
        grid.origin[k] + grid.size * np.arange(n).reshape([-1 if k == j else 1 for j in range(3)])
        for k, n in enumerate(grid.weights.shape)
    )
    reach = TRUNCATION * grid.size
    unknown = ~grid.known
    for wall in walls:
        d = (x * wall.normal[0] + y * wall.normal[1] - wall.offset) / reach
        along = x * wall.along[0] + y * wall.along[1]
        within = (along >= wall.ends[0]) & (along <= wall.ends[1]) & (z >= floor - reach) & (z <= wall.top)
        _set(grid, unknown & (np.abs(d) < 1) & within, np.broadcast_to(d, unknown.shape))
    above = np.broadcast_to((z - floor) / reach, unknown.shape)
    inside = _floor_area(grid, walls, x, y)
    _set(grid, unknown & (np.abs(above) < 1) & inside[..., None], above)


def _set(grid: DistanceGrid, voxels: BoolArray, distances: FloatArray) -> None:
    """Set the masked voxels in place; those that another plane has set keep the smaller of both distances."""
    d = distances[voxels]
    first = grid.weights[voxels] == 0
    grid.distances[voxels] = np.where(first, d, np.minimum(grid.distances[voxels], d))
    grid.weights[voxels] = _WEIGHT


def _floor_area(grid: DistanceGrid, walls: list[Wall], x: FloatArray, y: FloatArray) -> BoolArray:
    """Mask (X, Y) of the convex hull of the columns, at x and y, that show anything, cut off behind the walls."""
    seen = np.asarray(grid.known.any(axis=2), dtype=np.uint8)
    hull = np.zeros_like(seen)
    points = cv2.findNonZero(seen)
    if points is not None:
        cv2.fillConvexPoly(hull, cv2.convexHull(points), 1)
    inside = hull.astype(bool)
    for wall in walls:
        d = (x * wall.normal[0] + y * wall.normal[1] - wall.offset)[..., 0]
        inside &= d > -TRUNCATION * grid.size
    return inside
