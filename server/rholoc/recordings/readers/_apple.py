"""How Apple's axes relate to ours.

CoreMotion's axes belong to the device held upright: x right, y up, z out of the screen. ARKit's camera belongs to the
device on its side, as its images are: x right, y up, looking along −z. ARKit's world has y up.
"""

from __future__ import annotations

import numpy as np

from rholoc.geometry import FloatArray

R_LANDSCAPE_CAMERA_IMU: FloatArray = np.array([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1]])  # images as ARKit has them
R_PORTRAIT_CAMERA_IMU: FloatArray = np.diag([1.0, -1, -1])  # images turned upright

_T_MAP_ARKIT: FloatArray = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
_R_ARKIT_OPENCV: FloatArray = np.diag([1.0, -1, -1, 1])


def z_up(T_arkit_camera: FloatArray) -> FloatArray:
    """Poses (N, 4, 4) in ARKit's world → in one with z up."""
    return np.asarray(_T_MAP_ARKIT @ T_arkit_camera)


def opencv_camera(T_world_camera: FloatArray) -> FloatArray:
    """Poses (N, 4, 4) of a camera that looks along −z with y up → of one that looks along z with y down."""
    return np.asarray(T_world_camera @ _R_ARKIT_OPENCV)
