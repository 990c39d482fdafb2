"""Rearrange a room's furniture."""

import math
from dataclasses import dataclass, replace

import numpy as np

from rholoc.geometry import FloatArray
from rholoc.simulation.scene import Box, Scene

_QUARTER_RAD = 0.5 * math.pi
_MIN_MOVED_M = 0.7
_APART_M = 0.02  # of two pieces
_CLEAR_M = 0.45  # around the places to keep free
_TRIES = 400
_FULL_HEIGHT = 0.99  # of the room: what is as high is built in


def rearranged(scene: Scene, share: float, seed: int, free: FloatArray) -> tuple[Scene, tuple[str, ...]]:
    """The room with a share of its pieces of furniture, rounded up, at other walls or elsewhere at their own.

    Each keeps its back to the wall and what stands on it. What is fixed stays.

    Args:
        scene: the room.
        share: 0..1.
        seed: which pieces, and where to.
        free: (N, 3) metres, map frame: places, such as those of cameras, that nothing is put on.

    Returns:
        The room, and the names of the pieces that were moved.

    Raises:
        ValueError: there is no room for so many elsewhere.
    """
    rng = np.random.default_rng([seed, 211])
    pieces = sorted({box.piece for box in scene.boxes if box.piece})
    wanted = math.ceil(share * len(pieces))
    moved: list[str] = []
    for piece in rng.permutation(pieces).tolist():
        if len(moved) == wanted:
            break
        placed = _placed_elsewhere(scene, piece, rng, free)
        if placed is not None:
            scene = placed
            moved.append(piece)
    if len(moved) < wanted:
        raise ValueError(f"only {len(moved)} of {wanted} pieces of furniture find another place")
    return scene, tuple(moved)


@dataclass(frozen=True, eq=False)
class _Wall:
    """A wall seen from above: from ``start`` (2,) along ``along`` (2,), a unit vector, for ``length`` metres.

    The room is to its left.
    """

    start: FloatArray
    along: FloatArray
    length: float

    @property
    def inward(self) -> FloatArray:
        return np.array([-self.along[1], self.along[0]])

    def distances(self, points: FloatArray) -> FloatArray:
        """Distances (N,) of points (N, 2) from the wall's line."""
        return np.asarray((points - self.start) @ self.inward)


def _walls(scene: Scene) -> list[_Wall]:
    """Walls of the room and of built-in boxes."""
    built_in = [box for box in scene.boxes if not box.piece and box.size[2] >= _FULL_HEIGHT * scene.room.size[2]]
    walls = []
    for box, way in [(scene.room, 1), *((box, -1) for box in built_in)]:
        (left, front), (right, back) = _outline(box.corners)
        corners = np.array([[left, front], [right, front], [right, back], [left, back]])[::way]
        for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            length = float(np.linalg.norm(end - start))
            walls.append(_Wall(start, (end - start) / length, length))
    return walls


def _placed_elsewhere(scene: Scene, piece: str, rng: np.random.Generator, free: FloatArray) -> Scene | None:
    own = [box for box in scene.boxes if box.piece == piece]
    others = [box for box in scene.boxes if box.piece != piece]
    corners = np.concatenate([box.corners for box in own])[:, :2]
    walls = _walls(scene)
    behind = min(walls, key=lambda wall: _gap(wall, corners))
    gap = _gap(behind, corners)
    reach = corners @ behind.along
    width, middle = float(np.ptp(reach)), corners.mean(axis=0)
    anchor = behind.start + behind.along * (reach.min() - behind.start @ behind.along) + behind.inward * gap
    for _ in range(_TRIES):
        wall = walls[rng.integers(len(walls))]
        if wall.length < width:
            continue
        target = wall.start + wall.along * rng.uniform(0, wall.length - width) + wall.inward * gap
        turn = math.atan2(wall.along[1], wall.along[0]) - math.atan2(behind.along[1], behind.along[0])
        turn = round(turn / _QUARTER_RAD) * _QUARTER_RAD
        placed = [_turned(box, anchor, target, turn) for box in own]
        at = np.concatenate([box.corners for box in placed])[:, :2].mean(axis=0)
        if np.linalg.norm(at - middle) >= _MIN_MOVED_M and _fits(scene.room, placed, others, free):
            return replace(scene, boxes=(*others, *placed))
    return None


def _gap(wall: _Wall, corners: FloatArray) -> float:
    """Distance of a piece with corners (N, 2) from the wall along which it stands; infinite if along none."""
    reach = (corners - wall.start) @ wall.along
    distance = float(wall.distances(corners).min())
    return distance if distance > -_APART_M and reach.min() < wall.length and reach.max() > 0 else math.inf


def _turned(box: Box, anchor: FloatArray, target: FloatArray, turn: float) -> Box:
    c, s = math.cos(turn), math.sin(turn)
    x, y = box.centre[:2] - anchor
    centre = np.array([target[0] + c * x - s * y, target[1] + s * x + c * y, box.centre[2]])
    return replace(box, centre=centre, yaw=box.yaw + turn)


def _fits(room: Box, placed: list[Box], others: list[Box], free: FloatArray) -> bool:
    low, high = _outline(np.concatenate([box.corners for box in placed]))
    room_low, room_high = _outline(room.corners)
    if (low < room_low - 1e-6).any() or (high > room_high + 1e-6).any():
        return False
    nearest = np.clip(free[:, :2], low, high)
    if (np.linalg.norm(free[:, :2] - nearest, axis=1) < _CLEAR_M).any():
        return False
    spans = np.array([_outline(box.corners) for box in others])
    apart = (spans[:, 1] <= low + _slack(spans[:, 1], low)) | (spans[:, 0] >= high - _slack(spans[:, 0], high))
    return bool(apart.any(axis=1).all())


def _slack(edge: FloatArray, other: FloatArray) -> FloatArray:
    """What stands against the same wall may touch; else pieces stay apart."""
    return np.where(np.abs(edge - other) < 1e-6, 1e-6, -_APART_M)


def _outline(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Minimum and maximum x and y."""
    return corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
