"""Patches: the orientation and size in space of what a descriptor describes.

A detector measures in the image the orientation and the diameter of the patch that it describes (Lowe 2004). With the
landmark's position that makes a vector in the map frame: across the camera's ray, along the orientation, and as long as
the patch's diameter. From any other pose it predicts the orientation and size of the detected patch.
"""

import numpy as np

from rholoc.geometry.arrays import FloatArray, IntArray
from rholoc.geometry.camera import Camera


def patch_vectors(
    camera: Camera, T_map_camera: FloatArray, landmarks: FloatArray, angles: FloatArray, sizes_px: FloatArray
) -> FloatArray:
    """Patch vectors of landmarks from their detections.

    Args:
        camera: that saw them; a pinhole's distortion is left out.
        T_map_camera: (4, 4) its pose.
        landmarks: (N, 3) metres, map frame, where the detections are.
        angles: (N,) radians, of the patches in the image, clockwise from +u; NaN where unknown.
        sizes_px: (N,) the patches' diameters in the image; 0 where unknown.

    Returns:
        (N, 3) metres, map frame: perpendicular to the landmark's ray, projected along the angle, and as long as the
        patch's diameter. NaN where either is not known, and where the camera does not see it.
    """
    R, points = T_map_camera[:3, :3], _in_camera(T_map_camera, landmarks)
    depth = camera.depths(points)
    slopes = camera.slopes(points)
    known = (depth > 0) & (sizes_px > 0) & np.isfinite(angles) & np.isfinite(slopes).all(axis=(1, 2))
    along = np.full_like(points, np.nan)
    across = np.column_stack([np.cos(angles), np.sin(angles)])[known]
    along[known] = np.einsum("nij,nj->ni", np.linalg.pinv(slopes[known]), across)  # across the ray: it has no slope
    diameters_m = np.where(known, sizes_px * depth / camera.focal, np.nan)
    return np.asarray(along * (diameters_m / np.linalg.norm(along, axis=1))[:, None] @ R.T)


def patch_appearance(
    camera: Camera, T_map_camera: FloatArray, landmarks: FloatArray, patches: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Appearance of the ``patches`` (N, 3) of ``landmarks`` (N, 3), both in the map frame, in a camera at a pose.

    Returns:
        Their angles (N,) in the image, radians, clockwise from +u, and their diameters (N,), pixels; a pinhole's
        distortion is left out. NaN where a patch is not known, and where the camera does not see it.
    """
    points, along = _in_camera(T_map_camera, landmarks), patches @ T_map_camera[:3, :3]
    du, dv = np.einsum("nij,nj->in", camera.slopes(points), along)
    depths = np.where(np.isnan(du), np.nan, camera.depths(points))
    return np.arctan2(dv, du), np.asarray(np.linalg.norm(along, axis=1) * camera.focal / depths)


def mean_patches(vectors: FloatArray, features: IntArray, count: int) -> FloatArray:
    """Mean patch vector (count, 3) of each feature, from the ``vectors`` (V, 3) of its observations.

    ``features`` (V,) are the observations' features. The direction is the mean direction, the length the geometric mean
    of the lengths. NaN vectors are ignored; a feature without any other gets NaN.
    """
    lengths = np.linalg.norm(vectors, axis=1)
    known = np.isfinite(lengths) & (lengths > 0)
    lengths, owners = lengths[known], features[known]
    units = vectors[known] / lengths[:, None]
    sums = np.column_stack([np.bincount(owners, units[:, axis], count) for axis in range(3)])
    with np.errstate(invalid="ignore", divide="ignore"):
        mean_log = np.bincount(owners, np.log(lengths), count) / np.bincount(owners, minlength=count)
        return np.asarray(sums * (np.exp(mean_log) / np.linalg.norm(sums, axis=1))[:, None])


def _in_camera(T_map_camera: FloatArray, landmarks: FloatArray) -> FloatArray:
    """Landmarks (N, 3) of the map frame in the camera frame."""
    return (landmarks.astype(np.float64) - T_map_camera[:3, 3]) @ T_map_camera[:3, :3]
