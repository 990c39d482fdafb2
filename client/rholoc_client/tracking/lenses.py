"""Where pixels are measured: on the image plane of a pinhole; of other lenses on a plane across each ray."""

import cv2
import numpy as np

from rholoc_client.models import Camera
from rholoc_client.tracking.rigid import FloatArray

_STEPS = 12  # of Newton, from a fisheye's radius to the angle
_MIN_SLOPE = 0.1


def image_planes(camera: Camera, pixels: FloatArray) -> tuple[FloatArray, FloatArray]:
    """R_plane_camera (N, 3, 3) of the plane of each pixel (N, 2), and where on it at z = 1 the pixel is (N, 2)."""
    if camera.lens == "pinhole":
        K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
        plane = cv2.undistortPoints(pixels[:, None], K, np.array(camera.distortion, dtype=np.float64))[:, 0]
        return np.broadcast_to(np.eye(3), (len(plane), 3, 3)), np.asarray(plane)
    ahead = _rays(camera, pixels)
    beside = np.where(np.abs(ahead[:, :1]) < 0.7, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    down = np.cross(ahead, beside)
    down /= np.linalg.norm(down, axis=1, keepdims=True)
    return np.stack([np.cross(down, ahead), down, ahead], axis=1), np.zeros((len(pixels), 2))


def _rays(camera: Camera, pixels: FloatArray) -> FloatArray:
    """Unit rays (N, 3) of pixels (N, 2): OpenCV's fisheye model, or longitude and latitude."""
    x, y = ((pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy)).T
    if camera.lens == "equirectangular":
        return np.column_stack([np.cos(y) * np.sin(x), np.sin(y), np.cos(y) * np.cos(x)])
    k1, k2, k3, k4 = camera.distortion or (0.0, 0.0, 0.0, 0.0)
    radius = np.hypot(x, y)
    angle = np.minimum(radius, np.pi)
    for _ in range(_STEPS):
        s = angle**2
        off = angle * (1 + s * (k1 + s * (k2 + s * (k3 + s * k4)))) - radius
        slope = 1 + s * (3 * k1 + s * (5 * k2 + s * (7 * k3 + s * 9 * k4)))
        angle = np.clip(angle - off / np.maximum(slope, _MIN_SLOPE), 0.0, np.pi)
    across = np.where(radius > 0, np.sin(angle) / np.where(radius > 0, radius, 1.0), 1.0)
    return np.column_stack([x * across, y * across, np.cos(angle)])
