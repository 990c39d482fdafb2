"""Two-view geometry: inlier matches and relative pose."""

from dataclasses import dataclass

import numpy as np
import poselib

from rholoc.features import FeatureSet
from rholoc.geometry import BoolArray, FloatArray, IntArray, on_plane
from rholoc.geometry.resection import is_narrow, resected
from rholoc.trajectory.visual.sphere import relative_pose_on_sphere

_RATIO = 0.8  # Lowe's ratio of the nearest to the second nearest distance
_ROUNDING = 1e-6  # of a dot product of equal unit descriptors
_ITERATIONS = (30, 1000)  # of RANSAC, minimum and maximum
_SAMPLE_SIZE, _MISS_PROBABILITY = 5, 1e-6  # of minimal samples; that none of them consists of inliers only
UNIT_CAMERA = {"model": "PINHOLE", "width": 2, "height": 2, "params": [1.0, 1.0, 0.0, 0.0]}
_HYPOTHESES = 300  # of the translation, with known rotation
_MIN_PARALLAX = 0.05  # radians, for a ray to constrain the translation
_SEED = 1


@dataclass(frozen=True, eq=False)
class TwoView:
    """The epipolar geometry of matches.

    Attributes:
        inliers: (M,) bool.
        R_second_first: (3, 3) of the best solution; ambiguous if all points lie on one plane.
    """

    inliers: BoolArray
    R_second_first: FloatArray


@dataclass(frozen=True, eq=False)
class PairRotation:
    """Relative rotation of two keyframes.

    Attributes:
        first, second: keyframe numbers.
        R_second_first: (3, 3).
        support: number of inlier matches.
    """

    first: int
    second: int
    R_second_first: FloatArray
    support: int


def relative_pose(first: FloatArray, second: FloatArray, tolerance: float, min_inliers: int = 0) -> TwoView:
    """Relative pose with most inliers (LO-RANSAC; by poselib, for wide lenses by pycolmap); no inliers if none is
    found.

    Args:
        first, second: (M, 3) rays of the matches, each in its camera's frame, M ≥ 5.
        tolerance: maximum epipolar distance of an inlier on the plane z = 1; for wide lenses in radians.
        min_inliers: number of inliers below which the pose is useless; the iterations are bounded accordingly.
    """
    iterations = _ITERATIONS[0], _max_iterations(len(first), min_inliers)
    if not (is_narrow(first) and is_narrow(second)):
        inliers, R = relative_pose_on_sphere(first, second, tolerance, iterations, _SEED)
        return TwoView(inliers, R)
    options = {
        "max_epipolar_error": tolerance,
        "min_iterations": iterations[0],
        "max_iterations": iterations[1],
        "seed": _SEED,
    }
    pose, info = poselib.estimate_relative_pose(
        on_plane(first), on_plane(second), UNIT_CAMERA, UNIT_CAMERA, options, {}
    )
    inliers = np.array(info["inliers"], dtype=np.bool_)
    return TwoView(inliers if len(inliers) == len(first) else np.zeros(len(first), np.bool_), np.asarray(pose.R))


def _max_iterations(matches: int, min_inliers: int) -> int:
    """Iterations after which RANSAC has found ``min_inliers`` inliers with probability 1 − 1e-6 (Fischler and Bolles,
    1981), within ``_ITERATIONS``.
    """
    share = min(min_inliers / max(matches, 1), 1.0) ** _SAMPLE_SIZE
    with np.errstate(divide="ignore"):
        needed = np.log(_MISS_PROBABILITY) / np.log1p(-share)
    return int(np.clip(needed, *_ITERATIONS))


def absolute_pose(rays: FloatArray, points: FloatArray, tolerance: float) -> tuple[FloatArray, int]:
    """Camera pose T_map_camera (4, 4) with most inliers (LO-RANSAC, poselib), arbitrary if none is found, and their
    number.

    Args:
        rays: (M, 3) of detections, in the camera frame.
        points: (M, 3) their landmarks in the map frame.
        tolerance: maximum reprojection error of an inlier on the plane z = 1; for wide lenses on the face of a cube.
    """
    options = {
        "max_reproj_error": tolerance,
        "min_iterations": _ITERATIONS[0],
        "max_iterations": _ITERATIONS[1],
        "seed": _SEED,
    }
    return resected([rays], [points], np.eye(4)[None], 1.0, options)


def inliers_of_rotation(
    first: FloatArray, second: FloatArray, R_second_first: FloatArray, tolerance: float
) -> BoolArray:
    """Mask (M,) of the inliers of a known rotation and the best translation, sampled from two matches each. Matches
    that the rotation alone explains are always inliers.

    Args:
        first, second: (M, 3) unit rays of the matches, each in its camera's frame.
        R_second_first: (3, 3).
        tolerance: maximum angle [rad] between an inlier's ray and its epipolar plane.
    """
    turned, seen = first @ R_second_first.T, second
    normals = np.cross(turned, seen)
    still = np.linalg.norm(normals, axis=1) < tolerance
    if len(first) < 2:
        return np.asarray(still)
    i, j = np.random.default_rng(_SEED).integers(0, len(first), (2, _HYPOTHESES))
    ways = np.cross(normals[i], normals[j])
    lengths = np.linalg.norm(ways, axis=1)
    ways = ways[lengths > 0] / lengths[lengths > 0, None]
    if len(ways) == 0:
        return np.asarray(still)
    parallax = np.sqrt(np.maximum(1 - (ways @ turned.T) ** 2, _MIN_PARALLAX**2))
    agree = np.abs(ways @ normals.T) < tolerance * parallax
    return np.asarray(agree[agree.sum(axis=1).argmax()] | still)


def ratio_matches(a: FloatArray, b: FloatArray) -> IntArray:
    """Rows (M, 2) of mutual nearest neighbours in unit descriptors ``a`` and ``b`` (N, D) that pass Lowe's ratio test
    (0.8).
    """
    if len(a) < 2 or len(b) < 2:
        return np.zeros((0, 2), np.int64)
    alike = a @ b.T
    rows = np.arange(len(a))
    to_b = alike.argmax(1)
    best, best_of_b = alike[rows, to_b], alike.max(0)  # along columns, argmax takes ten times as long as max
    alike[rows, to_b] = -1
    distinct = (best == best_of_b[to_b]) & (1 - best + _ROUNDING < _RATIO**2 * (1 - alike.max(1)))
    first = np.unique(to_b[distinct], return_index=True)[1]  # of rows that are equally near
    rows = rows[distinct][np.sort(first)]
    return np.column_stack([rows, to_b[rows]])


def unit_descriptors(features: FeatureSet) -> FloatArray:
    """Descriptors (N, D) normalized to unit length, float32."""
    descriptors = features.descriptors.astype(np.float32)
    return np.asarray(descriptors / np.maximum(np.linalg.norm(descriptors, axis=1, keepdims=True), 1e-9))
