"""Similarities that align a map with what people say about its frame: origin, direction, up, length, floor plan."""

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidInput
from rholoc.geometry import UP, FloatArray, Similarity, angles_between
from rholoc.maps import Map

_SHORTEST = 1e-6  # of a direction or a distance, in the map's unit
_MIN_LEVEL = 0.05  # of a direction, as a share of its length: the sine of the least angle against the vertical
_LOOKED_AROUND = 0.05  # the second spread of the views' horizontal axes, of 1 in all: some 25 degrees to either side
_LANDMARKS_LOOKED_AT = 2000
_WALL_STEP_DEG = 1.0
_WALL_BINS = 60
_SCALES = (1e-4, 1e4)  # what a map may be stretched by at once


def origin_at(point: FloatArray) -> Similarity:
    """Translation that moves ``point`` (3,) to (0, 0, 0)."""
    return Similarity(1.0, np.eye(3), -point)


def level_direction(direction: FloatArray, becomes_deg: float) -> Similarity:
    """Rotation about z that turns ``direction`` (3,), seen from above, to the angle ``becomes_deg`` from x towards y.

    Raises:
        InvalidInput: the direction is too short, or within 3° of the vertical.
    """
    length, level = float(np.linalg.norm(direction)), float(np.linalg.norm(direction[:2]))
    if length < _SHORTEST or level < _MIN_LEVEL * length:
        raise InvalidInput("The direction points nowhere, or straight up or down.", "Give a level direction.")
    turn = np.deg2rad(becomes_deg) - np.arctan2(direction[1], direction[0])
    return Similarity(1.0, Rotation.from_euler("z", turn).as_matrix(), np.zeros(3))


def upward(direction: FloatArray) -> Similarity:
    """Smallest rotation that turns ``direction`` (3,), of any length, to z.

    Raises:
        InvalidInput: the direction is shorter than 1e-6.
    """
    length = float(np.linalg.norm(direction))
    if length < _SHORTEST:
        raise InvalidInput("The upward direction points nowhere.", "Give a longer one.")
    up = direction / length
    axis = np.cross(up, UP)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        axis, sine = np.array([1.0, 0.0, 0.0]), 1.0
    turn = Rotation.from_rotvec(axis / sine * angles_between(up, UP))
    return Similarity(1.0, turn.as_matrix(), np.zeros(3))


def estimated_up(map_: Map) -> FloatArray:
    """Up direction (3,), unit length, estimated from the views, because people hold cameras upright.

    If the views look around, the direction perpendicular to their horizontal axes, regardless of pitch (Szeliski, Image
    alignment and stitching, 2006, section 5.1); otherwise the mean of their up axes.

    Raises:
        InvalidInput: the mean of their up axes is shorter than a half: the views do not agree.
    """
    ups, across = -map_.views.T_map_camera[:, :3, 1], map_.views.T_map_camera[:, :3, 0]
    mean = ups.mean(axis=0) if len(ups) else np.zeros(3)
    length = float(np.linalg.norm(mean))
    if length < 0.5:
        raise InvalidInput("The views do not show which direction is up.", "Give the direction.")
    spread, axes = np.linalg.eigh(across.T @ across / len(across))
    if spread[1] < _LOOKED_AROUND:
        return np.asarray(mean / length)
    return np.asarray(axes[:, 0] * np.sign(axes[:, 0] @ mean))


def levelled(map_: Map) -> FloatArray | None:
    """Rotation (3, 3) for displaying a map that is not upright: up becomes z, walls become parallel to x and y.

    Up is estimated from the views; walls from the angle at which the landmarks, seen from above, concentrate most in x
    and y (least entropy of the histograms). None if the map is upright or empty, or the views do not agree on up.
    """
    if map_.info.upright or not len(map_):
        return None
    try:
        upright = upward(estimated_up(map_)).rotation
    except InvalidInput:
        return None
    landmarks = map_.landmarks.positions[:: max(1, len(map_) // _LANDMARKS_LOOKED_AT)].astype(np.float64)
    plane = landmarks @ upright[:2].T
    turns = np.deg2rad(np.arange(0.0, 90.0, _WALL_STEP_DEG))
    turn = turns[np.argmin([_entropy(plane, turn) for turn in turns])]
    return np.asarray(Rotation.from_euler("z", -turn).as_matrix() @ upright)


def _entropy(plane: FloatArray, turn: float) -> float:
    """Sum of the entropies [nats] of the histograms of points (N, 2) along both axes rotated by ``turn`` [rad]."""
    cosine, sine = np.cos(turn), np.sin(turn)
    total = 0.0
    for along in (plane @ [cosine, sine], plane @ [-sine, cosine]):
        low, high = np.quantile(along, [0.02, 0.98])
        counts, _ = np.histogram(along, _WALL_BINS, (low, max(high, low + _SHORTEST)))
        share = counts[counts > 0] / max(counts.sum(), 1)
        total -= float(share @ np.log(share))
    return total


def measured(start: FloatArray, end: FloatArray, length_m: float) -> Similarity:
    """Scaling that makes points ``start`` (3,) and ``end`` (3,) ``length_m`` apart; the origin stays.

    Raises:
        InvalidInput: the points coincide, or the scale is not within 1e-4 to 1e4.
    """
    distance = float(np.linalg.norm(end - start))
    if distance < _SHORTEST:
        raise InvalidInput("The two points are the same.", "Choose points that lie further apart.")
    return Similarity(_sensible(length_m / distance), np.eye(3), np.zeros(3))


def laid_over(points: FloatArray, plan: FloatArray, scaled: bool) -> tuple[Similarity, float]:
    """Least-squares similarity that aligns points (N, 3) of the map with points (N, 2) of a plan by a rotation about z.

    In complex numbers, with a and b the centred points, rotation and scale are Σ b ā / Σ |a|².

    Args:
        points: two or more, not all above each other.
        plan: the corresponding points [m].
        scaled: whether the map takes the plan's scale, heights included.

    Returns:
        The similarity, and the root mean square residual [m].

    Raises:
        InvalidInput: the points coincide when seen from above, or the scale is not within 1e-4 to 1e4.
    """
    a, b = (xy[:, 0] + 1j * xy[:, 1] for xy in (points, plan))
    from_middle, to_middle = a - a.mean(), b - b.mean()
    spread = float((np.abs(from_middle) ** 2).sum())
    turn = (to_middle * from_middle.conj()).sum()
    if spread < _SHORTEST**2 or abs(turn) < _SHORTEST**2:
        raise InvalidInput("The two points lie on one vertical line.", "Choose points that lie further apart.")
    scale = _sensible(float(abs(turn)) / spread) if scaled else 1.0
    spin = scale * turn / abs(turn)
    shift = b.mean() - spin * a.mean()
    missed_m = float(np.sqrt(np.mean(np.abs(spin * a + shift - b) ** 2)))
    R = Rotation.from_euler("z", float(np.angle(spin))).as_matrix()
    return Similarity(scale, R, np.array([shift.real, shift.imag, 0.0])), missed_m


def _sensible(scale: float) -> float:
    """The scale itself. Raises InvalidInput if it is implausible."""
    if not _SCALES[0] <= scale <= _SCALES[1]:
        raise InvalidInput(f"The map would be stretched by {scale:g}.", "Check the length, which is in metres.")
    return scale
