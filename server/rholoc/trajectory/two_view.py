"""Matches between two images and their geometric verification."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pycolmap

from rholoc.features import FeatureSet
from rholoc.geometry import FloatArray, IntArray

_RATIO = 0.8  # Lowe's ratio of the nearest to the second nearest distance
_MAX_ERROR_PX = 3.0
_SEED = 1


@dataclass(frozen=True, eq=False)
class VerifiedPair:
    """Two keyframes whose matches agree with one relative pose.

    Attributes:
        first, second: keyframe numbers.
        matches: (M, 2) feature numbers, the inliers.
        candidates: how many matches there were before verification.
        R_second_first: (3, 3), the likeliest: where the matches are of one plane, there are others.
        seen: (2, M, 2) where the two saw the matches, on the image plane at unit distance.
        geometry: COLMAP's own record of it.
    """

    first: int
    second: int
    matches: IntArray
    candidates: int
    R_second_first: FloatArray
    seen: FloatArray
    geometry: Any


def ratio_matches(a: FeatureSet, b: FeatureSet) -> IntArray:
    """Mutual nearest neighbours that pass the ratio test: (M, 2) rows of ``a`` and ``b``."""
    if len(a) < 2 or len(b) < 2:
        return np.zeros((0, 2), np.int64)
    alike = _unit(a) @ _unit(b).T
    rows = np.arange(len(a))
    to_b = alike.argmax(1)
    mutual = alike.argmax(0)[to_b] == rows
    rows, to_b = rows[mutual], to_b[mutual]
    best = alike[rows, to_b]
    others = alike[rows]
    others[np.arange(len(rows)), to_b] = -1
    distinct = 1 - best < _RATIO**2 * (1 - others.max(1))
    return np.column_stack([rows[distinct], to_b[distinct]])


def _unit(features: FeatureSet) -> FloatArray:
    descriptors = features.descriptors.astype(np.float32)
    return np.asarray(descriptors / np.maximum(np.linalg.norm(descriptors, axis=1, keepdims=True), 1e-9))


def verify(
    pair: tuple[int, int],
    a: FeatureSet,
    b: FeatureSet,
    camera: pycolmap.Camera,
    pixels: tuple[FloatArray, FloatArray],
    fewest: int,
) -> VerifiedPair | None:
    """Match two images and keep what one essential matrix (or homography) explains; None below ``fewest`` inliers.

    ``pixels`` are the features' places in COLMAP's convention for ``camera``, (N, 2) each.
    """
    matches = ratio_matches(a, b)
    if len(matches) < fewest:
        return None
    options = pycolmap.TwoViewGeometryOptions()
    options.min_num_inliers = fewest
    options.detect_watermark = False
    options.compute_relative_pose = True
    options.ransac.max_error = _MAX_ERROR_PX
    options.ransac.random_seed = _SEED
    found = pycolmap.estimate_calibrated_two_view_geometry(
        camera, pixels[0], camera, pixels[1], matches.astype(np.uint32), options
    )
    if len(found.inlier_matches) < fewest or found.cam2_from_cam1 is None:
        return None
    R = np.asarray(found.cam2_from_cam1.rotation.matrix())
    inliers = np.asarray(found.inlier_matches).astype(np.int64)
    seen = np.array([camera.cam_from_img(pixels[i][inliers[:, i]]) for i in (0, 1)])
    return VerifiedPair(*pair, inliers, len(matches), R, seen, found)
