"""A cloud of points and cameras about it."""

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.features import Channel, FeatureSet
from rholoc.geometry import Camera, FloatArray, Lens, pose_matrix
from rholoc.geometry.lenses import rays_of

CAMERA = Camera(640, 480, 500.0, 500.0, 319.5, 239.5, (-0.1, 0.02, 0.0, 0.0))


def arc(count: int, radians: float = 1.0) -> FloatArray:
    """Cameras (N, 4, 4) on an arc of 4 m about the origin that look at it."""
    angles = np.linspace(-radians / 2, radians / 2, count)
    centres = np.column_stack([4 * np.sin(angles), 0.3 * np.sin(7 * angles), -4 * np.cos(angles)])
    return pose_matrix(Rotation.from_rotvec(np.outer(-angles, [0.0, 1.0, 0.0])).as_matrix(), centres)


def cloud(count: int, seed: int = 0) -> FloatArray:
    """Points (N, 3) that all cameras of :func:`arc` see."""
    return np.random.default_rng(seed).uniform(-1.1, 1.1, (count, 3))


def on_plane(points: FloatArray, T_world_camera: FloatArray) -> FloatArray:
    """Points (N, 3) on the plane z = 1 of a camera (4, 4), (N, 2)."""
    inside = (points - T_world_camera[:3, 3]) @ T_world_camera[:3, :3]
    return np.asarray(inside[:, :2] / inside[:, 2:])


def rays(plane: FloatArray) -> FloatArray:
    """Points (N, 2) on the plane z = 1 → unit rays (N, 3)."""
    return rays_of(Lens.PINHOLE, plane, ())


def in_pixels(points: FloatArray, T_world_camera: FloatArray) -> FloatArray:
    """Points (N, 3) in a camera's (4, 4) image, (N, 2)."""
    return CAMERA.project((points - T_world_camera[:3, 3]) @ T_world_camera[:3, :3])


def sift_like(pixels: FloatArray, descriptors: FloatArray) -> FeatureSet:
    """Features at pixels (N, 2) with descriptors (N, 128)."""
    zeros = np.zeros(len(pixels), np.float32)
    channels = np.full(len(pixels), Channel.SIFT, np.uint8)
    return FeatureSet(pixels.astype(np.float32), channels, descriptors.astype(np.uint8), zeros, zeros)


def descriptors_of(count: int, seed: int = 3) -> FloatArray:
    """Descriptors (N, 128) that are told apart easily."""
    return np.random.default_rng(seed).integers(0, 200, (count, 128)).astype(np.float64)
