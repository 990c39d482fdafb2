"""Rays in all directions as pycolmap takes them: pixels of an ideal equirectangular camera."""

from __future__ import annotations

import numpy as np
import pycolmap

from rholoc.geometry import BoolArray, Camera, FloatArray

_WIDTH = 4000
_PANORAMA = Camera.panorama(_WIDTH, _WIDTH // 2)
_CENTRE_SHIFT = 0.5  # COLMAP's pixel (0.5, 0.5) is the centre of the top-left one
FOCAL_PX = _PANORAMA.focal


def sphere_camera(camera_id: int) -> pycolmap.Camera:
    """The ideal camera, of ``FOCAL_PX`` pixels a radian."""
    camera = pycolmap.Camera.create_from_model_name(camera_id, "EQUIRECTANGULAR", FOCAL_PX, _WIDTH, _WIDTH // 2)
    camera.has_prior_focal_length = True
    return camera


def on_sphere(rays: FloatArray) -> FloatArray:
    """Rays (N, 3) → the ideal camera's pixels (N, 2), as COLMAP counts them."""
    return _PANORAMA.project(rays) + _CENTRE_SHIFT


def relative_pose_on_sphere(
    first: FloatArray, second: FloatArray, tolerance_rad: float, iterations: tuple[int, int], seed: int
) -> tuple[BoolArray, FloatArray]:
    """The relative pose that most matches agree with (LO-RANSAC, pycolmap).

    Args:
        first, second: (M, 3) rays of the matches in either camera's frame.
        tolerance_rad: between a ray and its epipolar plane.
        iterations: of RANSAC, at least and at most.
        seed: of its samples.

    Returns:
        Which matches (M,) agree, none where there is no such pose, and R_second_first (3, 3).
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
