"""Check a recording's own poses against its pictures, and find their axis convention."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from rholoc.geometry import Camera, FloatArray, IntArray, evenly, rotation_angles
from rholoc.geometry.resection import is_narrow
from rholoc.recordings import Recording
from rholoc.trajectory.visual.keyframe_features import KeyframeFeatures
from rholoc.trajectory.visual.two_view import ratio_matches, relative_pose, unit_descriptors

_ANCHORS = 10  # frames spread over the recording; each is compared with …
_APART = (1, 4)  # … the frames this many rows later, and …
_NEAREST = 2  # … this many of the nearest frames with the same heading
_SAME_WAY_RAD = np.radians(25)
_MIN_MATCHES = 30
_MIN_PAIRS = 3
_TOLERANCE = 2.5e-3  # maximum distance of a match from its epipolar line, as a share of the focal length
_MAX_EXACT = 2.0e-3  # epipolar error of exact poses, as a share of the focal length
_MAX_USABLE = 12e-3  # … and of poses good enough to start an adjustment
_CLEARLY = 0.5  # other axes must reduce the error of the documented ones by this factor


class PoseAxes(StrEnum):
    """Axis convention of a recording's poses."""

    AS_DOCUMENTED = "as documented"  # T_map_camera, camera x right, y down, z forward
    LOOKING_BACK = "of a camera that looks along −z with y up (OpenGL, ARKit)"
    INVERTED = "of the world in the camera"
    INVERTED_LOOKING_BACK = "of the world in a camera that looks along −z with y up (OpenGL, ARKit)"


_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
_READ: dict[PoseAxes, Callable[[FloatArray], FloatArray]] = {
    PoseAxes.AS_DOCUMENTED: lambda T: T,
    PoseAxes.LOOKING_BACK: lambda T: T @ _FLIP,
    PoseAxes.INVERTED: np.linalg.inv,
    PoseAxes.INVERTED_LOOKING_BACK: lambda T: np.linalg.inv(T) @ _FLIP,
}


@dataclass(frozen=True)
class PoseCheck:
    """Agreement of a recording's poses with its pictures.

    Attributes:
        axes: convention with the least error.
        error: median epipolar error of correct matches, as a share of the focal length; NaN if nothing could be
            compared.
        pairs: number of frame pairs compared.
    """

    axes: PoseAxes
    error: float
    pairs: int

    @property
    def exact(self) -> bool:
        """Whether the error is at most that of feature detection, 0.2 % of the focal length; False for NaN."""
        return self.error <= _MAX_EXACT

    @property
    def usable(self) -> bool:
        """Whether an adjustment can start from the poses: error up to 1.2 % of the focal length; False for NaN."""
        return self.error <= _MAX_USABLE

    def read(self, T: FloatArray) -> FloatArray:
        """Convert poses (N, 4, 4) in ``axes`` to T_map_camera with OpenCV's camera axes."""
        return np.asarray(_READ[self.axes](T))


@dataclass(frozen=True, eq=False)
class _Matched:
    """Inlier matches of two frames: rays (M, 3) in each camera's frame."""

    first: int
    second: int
    a: FloatArray
    b: FloatArray


def check_given_poses(recording: Recording, camera: Camera) -> PoseCheck:
    """Measure the epipolar error of a recording's poses over pairs of its frames, in each axis convention.

    Outliers of the pictures' own relative pose are removed first, so that false matches do not count against the poses.
    The documented convention stands unless another one halves the error. NaN if fewer than three pairs match. Raises
    InvalidRecording if a frame cannot be decoded. The recording must have poses.
    """
    assert recording.poses is not None
    rows = np.flatnonzero(recording.poses.known)
    T = recording.poses.T_map_camera
    matched = _matched(recording, camera, _pairs(rows, T))
    if len(matched) < _MIN_PAIRS:
        return PoseCheck(PoseAxes.AS_DOCUMENTED, np.nan, len(matched))
    errors = {axes: _error(matched, read, T) for axes, read in _READ.items()}
    best = min(errors, key=lambda axes: errors[axes])
    if errors[best] > _CLEARLY * errors[PoseAxes.AS_DOCUMENTED]:
        best = PoseAxes.AS_DOCUMENTED
    return PoseCheck(best, errors[best], len(matched))


def _pairs(rows: IntArray, T: FloatArray) -> list[tuple[int, int]]:
    """Sorted pairs of frames to compare, out of ``rows`` (N,) with poses T (of all frames).

    Ten anchors, spread evenly, are each paired with the rows 1 and 4 places later, and with the two nearest other
    positions whose rotation differs by at most 25°.
    """
    anchors = evenly(len(rows), _ANCHORS).tolist()
    pairs: set[tuple[int, int]] = set()
    for anchor in anchors:
        pairs |= {(anchor, anchor + apart) for apart in _APART if anchor + apart < len(rows)}
        away = np.linalg.norm(T[rows, :3, 3] - T[rows[anchor], :3, 3], axis=1)
        turned = rotation_angles(T[rows, :3, :3], np.broadcast_to(T[rows[anchor], :3, :3], (len(rows), 3, 3)))
        away[(turned > _SAME_WAY_RAD) | (away == 0)] = np.inf
        nearest = np.argsort(away, kind="stable")[:_NEAREST].tolist()
        pairs |= {(min(anchor, other), max(anchor, other)) for other in nearest if np.isfinite(away[other])}
    return sorted((int(rows[a]), int(rows[b])) for a, b in pairs)


def _matched(recording: Recording, camera: Camera, pairs: list[tuple[int, int]]) -> list[_Matched]:
    """Pairs of frames (rows) with at least 30 inlier matches. Raises InvalidRecording if one cannot be decoded."""
    needed = np.unique(list(itertools.chain.from_iterable(pairs))).astype(np.int64)
    with KeyframeFeatures(recording.frames, camera=camera) as extractor:
        features = dict(zip(needed.tolist(), extractor.of(needed), strict=True))
    descriptors = {row: unit_descriptors(found) for row, found in features.items()}
    rays = {row: camera.rays(found.pixels) for row, found in features.items()}
    matched = []
    for first, second in pairs:
        matches = ratio_matches(descriptors[first], descriptors[second])
        if len(matches) < _MIN_MATCHES:
            continue
        a, b = rays[first][matches[:, 0]], rays[second][matches[:, 1]]
        inliers = relative_pose(a, b, _TOLERANCE).inliers
        if inliers.sum() >= _MIN_MATCHES:
            matched.append(_Matched(first, second, a[inliers], b[inliers]))
    return matched


def _error(matched: list[_Matched], read: Callable[[FloatArray], FloatArray], T: FloatArray) -> float:
    """Median over pairs of each pair's median :func:`epipolar_errors`, with poses T converted by ``read``."""
    medians = []
    for one in matched:
        T_first, T_second = read(T[[one.first, one.second]])
        medians.append(float(np.median(epipolar_errors(np.linalg.inv(T_second) @ T_first, one.a, one.b))))
    return float(np.median(medians))


def epipolar_errors(T_second_first: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    """Sampson distances (M,) of matched unit rays ``a`` and ``b`` (M, 3) under a relative pose (4, 4).

    Hartley and Zisserman, Multiple View Geometry, equation 11.9: on the plane z = 1 if all rays meet it, else in
    radians on the unit sphere. Without a baseline, the angle between the rays.
    """
    R, t = T_second_first[:3, :3], T_second_first[:3, 3]
    length = float(np.linalg.norm(t))
    if length < 1e-9:
        return np.asarray(np.linalg.norm(b - a @ R.T, axis=1))
    tx, ty, tz = t / length
    E = np.array([[0, -tz, ty], [tz, 0, -tx], [-ty, tx, 0]]) @ R
    if is_narrow(a) and is_narrow(b):
        a, b = a / a[:, 2:], b / b[:, 2:]
        lines_b, lines_a = a @ E.T, b @ E
        across = lines_b[:, :2], lines_a[:, :2]
    else:
        lines_b, lines_a = a @ E.T, b @ E
        across = np.cross(lines_b, b), np.cross(lines_a, a)
    algebraic = np.sum(b * lines_b, axis=1)
    gradient = np.sqrt(sum(np.sum(one**2, axis=1) for one in across))
    return np.asarray(np.abs(algebraic) / np.maximum(gradient, 1e-12))
