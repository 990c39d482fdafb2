"""The geometric baselines: absolute pose from 2D–3D matches by the RANSACs of OpenCV and poselib.

Settings are those that did best on real hard queries among 1000–10 000 iterations and thresholds of 8 and 12 px:
for both, 8 px and many iterations. poselib draws its samples from the likeliest matches first (PROSAC), which was
worth more than any other setting. OpenCV's USAC with a MAGSAC score was tried too, and was no better than its P3P
RANSAC followed by Levenberg–Marquardt.
"""

from dataclasses import dataclass
from enum import StrEnum

import cv2
import numpy as np

from rholoc.geometry import Camera, FloatArray, on_plane, pose_matrix
from rholoc.geometry.resection import is_narrow
from rholoc.localization import Query
from rholoc.localization.index.map_index import MapIndex
from rholoc.localization.index.matches import Matches
from rholoc.localization.pose.ascent import ascend
from rholoc.localization.pose.ransac import lo_ransac
from rholoc.localization.pose.rematching import FINAL_TOLERANCE_PX, evidence_of, settle

_MIN_MATCHES = 4
_DISTINCT_CHANCE = 0.3
_ASCENT_PX = (4 * FINAL_TOLERANCE_PX, 2 * FINAL_TOLERANCE_PX, FINAL_TOLERANCE_PX)


class Solver(StrEnum):
    """A solver for a pose from matches, without any density."""

    CV2 = "cv2"  # P3P RANSAC, then Levenberg–Marquardt over the inliers
    POSELIB = "poselib"  # LO-RANSAC with progressive sampling, then its own non-linear refinement


class MatchSet(StrEnum):
    """Input matches of a solver."""

    EVERYWHERE = "everywhere"  # each query feature with its nearest neighbour in the whole map
    DISTINCT = "distinct"  # those that pass the ratio test
    PLACE = "place"  # mutual matches within the place with most votes: half of our seeding


@dataclass(frozen=True)
class RansacOptions:
    """Settings of a RANSAC.

    Attributes:
        iterations: maximum number of samples.
        threshold_px: maximum reprojection error of an inlier.
        confidence: at which sampling stops early.
    """

    iterations: int = 10_000
    threshold_px: float = 8.0
    confidence: float = 0.9999


def solve(
    solver: Solver, pixels: FloatArray, points: FloatArray, camera: Camera, options: RansacOptions | None = None
) -> FloatArray | None:
    """T_map_camera (4, 4) from pixels (M, 2) and map points (M, 3), the most likely match first; None without a pose.

    OpenCV's solver returns None for lenses other than pinholes.
    """
    if len(pixels) < _MIN_MATCHES:
        return None
    run = _solve_cv2 if solver is Solver.CV2 else _solve_poselib
    T = run(camera.rays(pixels), np.asarray(points, dtype=np.float64), camera, options or RansacOptions())
    return T if T is not None and np.isfinite(T).all() else None


def distinct(matches: Matches) -> Matches:
    """The matches that pass the ratio test."""
    return matches.take(np.flatnonzero(matches.chances >= _DISTINCT_CHANCE))


def refine_by_density(
    index: MapIndex, query: Query, rays: FloatArray, matches: Matches, T_map_camera: FloatArray
) -> FloatArray:
    """The density's optimum (4, 4) near a pose, over all matches, with none rejected.

    Args:
        rays: (N, 3) of all the query's features, camera frame.
    """
    evidence = evidence_of(index, matches, rays, query.camera)
    optimum = ascend(index.map.densities, evidence, T_map_camera, _ASCENT_PX, query.dof)
    return settle(index, matches, evidence, optimum, query.dof).T_map_camera


def _solve_cv2(rays: FloatArray, points: FloatArray, camera: Camera, options: RansacOptions) -> FloatArray | None:
    if not is_narrow(rays):
        return None
    pixels = on_plane(rays) * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    try:
        found, rotation, translation, inliers = cv2.solvePnPRansac(
            points,
            pixels,
            camera.matrix,
            None,
            iterationsCount=options.iterations,
            reprojectionError=options.threshold_px,
            confidence=options.confidence,
            flags=cv2.SOLVEPNP_P3P,
        )
        if not found or inliers is None or len(inliers) < _MIN_MATCHES:
            return None
        chosen = inliers[:, 0]
        rotation, translation = cv2.solvePnPRefineLM(
            points[chosen], pixels[chosen], camera.matrix, None, rotation, translation
        )
    except cv2.error:  # degenerate samples
        return None
    return _inverted(
        np.asarray(cv2.Rodrigues(rotation)[0], dtype=np.float64), np.asarray(translation, dtype=np.float64).ravel()
    )


def _solve_poselib(rays: FloatArray, points: FloatArray, camera: Camera, options: RansacOptions) -> FloatArray | None:
    found = lo_ransac(rays, points, camera.focal, options.threshold_px, options.iterations, success=options.confidence)
    return None if found is None else found[0]


def _inverted(R_camera_map: FloatArray, t: FloatArray) -> FloatArray:
    return pose_matrix(R_camera_map.T, -R_camera_map.T @ t)
