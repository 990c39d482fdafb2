"""Rays in all directions for pycolmap, as pixels of an ideal equirectangular camera."""

import numpy as np
import pycolmap

from rholoc.geometry import BoolArray, Camera, FloatArray

_WIDTH = 4000
_PANORAMA = Camera.panorama(_WIDTH, _WIDTH // 2)
_CENTRE_SHIFT = 0.5  # COLMAP's pixel (0.5, 0.5) is the centre of the top-left one
FOCAL_PX = _PANORAMA.focal


def sphere_camera(camera_id: int) -> pycolmap.Camera:
    """Ideal equirectangular camera with ``FOCAL_PX`` pixels per radian."""
    camera = pycolmap.Camera.create_from_model_name(camera_id, "EQUIRECTANGULAR", FOCAL_PX, _WIDTH, _WIDTH // 2)
    camera.has_prior_focal_length = True
    return camera


def on_sphere(rays: FloatArray) -> FloatArray:
    """Project rays (N, 3) to the ideal camera's pixels (N, 2) in COLMAP's convention."""
    return _PANORAMA.project(rays) + _CENTRE_SHIFT


def relative_pose_on_sphere(
    first: FloatArray, second: FloatArray, tolerance_rad: float, iterations: tuple[int, int], seed: int
) -> tuple[BoolArray, FloatArray]:
    """Relative pose with most inliers (LO-RANSAC, pycolmap).

    Args:
        first, second: (M, 3) rays of the matches, each in its camera's frame.
        tolerance_rad: maximum angle between an inlier's ray and its epipolar plane.
        iterations: minimum and maximum of RANSAC.
        seed: of its samples.

    Returns:
        Mask (M,) of the inliers, all False without a pose, and R_second_first (3, 3).
    """
    options = pycolmap.RANSACOptions()
    options.max_error = tolerance_rad * FOCAL_PX
    options.min_num_trials, options.max_num_trials = iterations
    options.random_seed = seed
    camera = sphere_camera(1)
    found = pycolmap.estimate_essential_matrix(on_sphere(first), on_sphere(second), camera, camera, options)
    if found is None:
        return np.zeros(len(first), dtype=np.bool_), np.eye(3)
    return np.asarray(found["inlier_mask"], dtype=np.bool_), np.asarray(found["cam2_from_cam1"].rotation.matrix())
