"""Rooms made of textured boxes: one seen from inside, the others, which must not overlap, from outside.

That is all the geometry there is. Posters, windows and doors are painted on the faces, so every visible surface
is a textured rectangle, and which box hides which follows from separating planes alone. A building is many such rooms,
which see each other through openings in their walls.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from rholoc.geometry import BoolArray, ByteArray, FloatArray
from rholoc.lazy import lazy

_TOUCHING_M = 1e-6
_NEAR_M = 1e-3  # a line that passes a box's extent at this distance does not meet the box, however it is rounded
_CORNERS = np.stack(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5], indexing="ij"), axis=-1).reshape(-1, 3)
FACE_NAMES = ("x+", "y+", "x-", "y-", "z+", "z-")


class Source(Enum):
    """Kind of a light source."""

    WINDOW = "window"
    LAMP = "lamp"


@dataclass(frozen=True, eq=False)
class Paint:
    """Paint of a face. Row 0 is the top of an upright face; columns run to the right as seen.

    Attributes:
        albedo: (H, W, 3) BGR, gamma-encoded reflectance.
        glow: (H, W) bool or None: where the face is a source of light.
        source: what kind of source that is.
    """

    albedo: ByteArray
    glow: BoolArray | None = None
    source: Source | None = None


@dataclass(frozen=True, eq=False)
class Face:
    """A textured rectangle: points ``origin + a·right + b·down`` with a, b in [0, 1], map frame, metres."""

    origin: FloatArray
    right: FloatArray
    down: FloatArray
    paint: Paint

    @property
    def width_m(self) -> float:
        """Length of ``right`` [m]."""
        return float(np.linalg.norm(self.right))

    @property
    def height_m(self) -> float:
        """Length of ``down`` [m]."""
        return float(np.linalg.norm(self.down))

    @lazy
    def normal(self) -> FloatArray:
        """The unit normal (3,), towards the side from which the face is seen."""
        normal = np.cross(self.down, self.right)
        return np.asarray(normal / np.linalg.norm(normal))

    def points(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Points (..., 3) at the fractions ``a`` of ``right`` and ``b`` of ``down``."""
        return np.asarray(self.origin + np.asarray(a)[..., None] * self.right + np.asarray(b)[..., None] * self.down)


@dataclass(frozen=True, eq=False)
class Box:
    """An upright box, turned by ``yaw`` about the vertical through its centre.

    Attributes:
        centre: (3,) metres, map frame.
        size: (3,) metres along the box's own axes.
        yaw: radians.
        paints: the paint of each face by its name in ``FACE_NAMES``; faces that are missing are not drawn.
        piece: of furniture, that it is a part of; empty where it is fixed.
    """

    centre: FloatArray
    size: FloatArray
    yaw: float
    paints: dict[str, Paint]
    piece: str = ""

    @lazy
    def axes(self) -> FloatArray:
        """The box's unit axes as rows (3, 3), map frame."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])

    @lazy
    def corners(self) -> FloatArray:
        """Corners (8, 3) [m], map frame, x of the box counting slowest."""
        return np.asarray(self.centre + (_CORNERS * self.size) @ self.axes)

    @lazy
    def bounds(self) -> FloatArray:
        """Least and greatest coordinates (2, 3) [m] of the corners, map frame."""
        return np.array([self.corners.min(axis=0), self.corners.max(axis=0)])

    def cuts(self, start: FloatArray, end: FloatArray, margin: float) -> BoolArray:
        """Mask (N,) of the lines from points ``start`` to points ``end`` (N, 3) that pass through the box, without
        the share ``margin`` at either end.
        """
        axes = self.axes.astype(np.float32)
        half = (0.5 * self.size).astype(np.float32)
        near = np.full(len(start), margin, dtype=np.float32)
        far = np.full(len(start), 1 - margin, dtype=np.float32)
        offset, way = start - self.centre.astype(np.float32), end - start
        for axis in range(3):
            origin, step = offset @ axes[axis], way @ axes[axis]
            step[np.abs(step) < 1e-9] = 1e-9
            first, second = (-half[axis] - origin) / step, (half[axis] - origin) / step
            near = np.maximum(near, np.minimum(first, second))
            far = np.minimum(far, np.maximum(first, second))
        return np.asarray(far - near > margin)

    def faces(self, inside: bool = False) -> list[Face]:
        """The painted faces in the order of ``paints``, seen from outside or from ``inside``."""
        return [self._face(name, paint, inside) for name, paint in self.paints.items()]

    def _face(self, name: str, paint: Paint, inside: bool) -> Face:
        """The named face, seen from outside or from ``inside``."""
        x, y, z = self.axes * self.size[:, None]
        normal, right, down = {
            "x+": (x, y, -z),
            "x-": (-x, -y, -z),
            "y+": (y, -x, -z),
            "y-": (-y, x, -z),
            "z+": (z, x, -y),
            "z-": (-z, x, y),
        }[name]
        if inside:
            right = -right
        return Face(self.centre + 0.5 * (normal - right - down), right, down, paint)


@dataclass(frozen=True, eq=False)
class Scene:
    """A room and what stands in it, in the map frame (z up, metres)."""

    room: Box
    boxes: tuple[Box, ...]

    def moved(self, shift: FloatArray) -> Scene:
        """The same scene with everything moved by ``shift`` (3,) metres."""
        return Scene(
            replace(self.room, centre=self.room.centre + shift),
            tuple(replace(box, centre=box.centre + shift) for box in self.boxes),
        )

    @property
    def faces(self) -> list[Face]:
        """All faces: the room's first, then each box's in the order of ``boxes``."""
        return self.room.faces(inside=True) + [face for box in self.boxes for face in box.faces()]

    def blocked(self, start: FloatArray, end: FloatArray, margin: float = 1e-4) -> BoolArray:
        """Mask (...) of where a box stands between points ``start`` (..., 3) and ``end`` (..., 3), without the share
        ``margin`` of the way at either end.
        """
        start, end = np.broadcast_arrays(np.asarray(start, np.float32), np.asarray(end, np.float32))
        shape, start, end = start.shape[:-1], start.reshape(-1, 3), end.reshape(-1, 3)
        low, high = np.minimum(start, end).T.copy(), np.maximum(start, end).T.copy()  # (3, N)
        hit = np.zeros(len(start), dtype=bool)
        bottom, top = low.min(axis=1, initial=np.inf), high.max(axis=1, initial=-np.inf)
        for box in self.boxes:
            least, most = box.bounds + _NEAR_M * np.array([[-1.0], [1.0]])
            if (bottom >= most).any() or (top <= least).any():
                continue
            near = ~hit
            for axis in range(3):
                near &= (low[axis] < most[axis]) & (high[axis] > least[axis])
            rows = np.flatnonzero(near)
            if len(rows):
                hit[rows] = box.cuts(start[rows], end[rows], margin)
        return hit.reshape(shape)


@dataclass(frozen=True, eq=False)
class Portal:
    """An opening in a room's wall.

    Attributes:
        corners: (4, 3) metres, map frame, in order around the opening.
        into: the index of the room that is seen through it.
    """

    corners: FloatArray
    into: int


@dataclass(frozen=True, eq=False)
class Building:
    """Rooms that touch each other, each convex and with its own furniture, in the map frame (z up, metres).

    Attributes:
        rooms: what each room is, seen from inside.
        names: of the rooms; doorways and stairs are rooms too.
        portals: the openings in each room's walls.
    """

    rooms: tuple[Scene, ...]
    names: tuple[str, ...]
    portals: tuple[tuple[Portal, ...], ...]

    @classmethod
    def of(cls, scene: Scene) -> Building:
        """A single room without openings."""
        return cls((scene,), ("room",), ((),))

    @property
    def faces(self) -> list[Face]:
        """All faces, room after room, as of :attr:`Scene.faces`."""
        return [face for room in self.rooms for face in room.faces]

    def moved(self, shift: FloatArray) -> Building:
        """The same building with everything moved by ``shift`` (3,) metres."""
        portals = tuple(tuple(Portal(p.corners + shift, p.into) for p in openings) for openings in self.portals)
        return Building(tuple(room.moved(shift) for room in self.rooms), self.names, portals)

    def room_at(self, point: FloatArray) -> int:
        """The index of the room that a point (3,) is in, or of the nearest."""
        return int(np.argmin(self.outside(point[None])[:, 0]))

    def outside(self, points: FloatArray) -> FloatArray:
        """Distances (rooms, N) [m] by which points (N, 3) are outside each room's walls; negative inside."""
        return np.stack(
            [
                (np.abs((points - room.room.centre) @ room.room.axes.T) - 0.5 * room.room.size).max(axis=1)
                for room in self.rooms
            ]
        )


class DrawOrder:
    """The order in which disjoint boxes are painted, back to front, found by separating planes.

    Of two boxes with a plane between them, the one on the far side of it, seen from the eye, cannot hide the other.
    """

    def __init__(self, boxes: tuple[Box, ...]) -> None:
        self._axes = np.array([box.axes for box in boxes]).reshape(-1, 3, 3)
        self._centres = np.array([box.centre for box in boxes]).reshape(-1, 3)
        corners = np.array([box.corners for box in boxes]).reshape(-1, 8, 3)
        spans = np.einsum("iak,jck->iajc", self._axes, corners)  # the extent of box j along the axes of box i
        own = np.einsum("iak,ick->iac", self._axes, corners)
        self._low, self._high = own.min(axis=2), own.max(axis=2)
        self._after = spans.min(axis=3) >= self._high[:, :, None] - _TOUCHING_M
        self._before = spans.max(axis=3) <= self._low[:, :, None] + _TOUCHING_M

    def __call__(self, eye: FloatArray) -> list[int]:
        """The boxes' indices from back to front as seen from ``eye`` (3,), metres, map frame."""
        at = np.einsum("iak,k->ia", self._axes, eye)
        beyond_high, beyond_low = (at >= self._high)[:, :, None], (at <= self._low)[:, :, None]
        own_cannot_hide = ((self._after & beyond_high) | (self._before & beyond_low)).any(axis=1)
        other_cannot_hide = ((self._after & ~beyond_high) | (self._before & ~beyond_low)).any(axis=1)
        cannot_hide = own_cannot_hide | other_cannot_hide.T
        first = cannot_hide & ~cannot_hide.T  # first[i, j]: i is painted before j
        waiting = first.sum(axis=0)
        distance = np.linalg.norm(self._centres - eye, axis=1)
        order: list[int] = []
        left = np.ones(len(distance), dtype=bool)
        while left.any():
            ready = left & (waiting == 0)
            candidates = np.flatnonzero(ready if ready.any() else left)  # a cycle is broken at its farthest box
            chosen = int(candidates[np.argmax(distance[candidates])])
            order.append(chosen)
            left[chosen] = False
            waiting = waiting - first[chosen]
        return order
