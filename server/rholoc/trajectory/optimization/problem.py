"""Measurements of a walk, and the unknowns that they are adjusted by."""

from dataclasses import dataclass

import numpy as np

from rholoc.geometry import Camera, FloatArray, PosedCameras
from rholoc.recordings import Imu
from rholoc.trajectory.inertial.gyroscope import GyroCalibration
from rholoc.trajectory.visual.tracks import Observations

GAUGE_SIGMA = 1e-4  # of what no measurement fixes, and an adjustment holds [m, rad]
_PIXEL_SIGMA_PX = 0.7  # of a sighting
_LEVEL_SIGMA_RAD = np.radians(0.5)  # of the waypoints' z axis


@dataclass(frozen=True)
class CameraSigmas:
    """Prior standard deviations of the intrinsics. The principal point is held: pictures of a room hardly fix it.

    Attributes:
        focal: of the focal length, relative.
        distortion: of k1 and k2.
    """

    focal: float
    distortion: float


GUESSED = CameraSigmas(0.05, 0.15)
ANY = CameraSigmas(0.15, 0.15)  # around a first guess, wherever an adjustment begins
GIVEN = CameraSigmas(5e-4, 0.01)  # most calibrations leave some distortion uncertain


@dataclass(frozen=True)
class Fix:
    """A measured camera position.

    Attributes:
        keyframe: number of the keyframe.
        position: in the map frame [m].
        sigma_m: standard deviation of each coordinate.
    """

    keyframe: int
    position: tuple[float, float, float]
    sigma_m: float


@dataclass(frozen=True, eq=False)
class Step:
    """A relative pose of two keyframes, measured by a tracker (ARKit), by wheels, or by how a rig is built.

    Attributes:
        first, second: keyframe numbers.
        T_first_second: (4, 4).
        sigma_m: of each coordinate.
        sigma_rad: of the rotation about each axis.
        is_mounting: whether both are of one moment, by cameras of a rig.
    """

    first: int
    second: int
    T_first_second: FloatArray
    sigma_m: float
    sigma_rad: float
    is_mounting: bool = False


@dataclass(frozen=True, eq=False)
class InertialState:
    """State of the IMU at K keyframes.

    Attributes:
        velocities: (K, 3) m/s in the map frame.
        biases: (K, 6) of the accelerometer, m/s², and the gyroscope, rad/s.
        T_imu_camera: (4, 4) mounting of the camera.
        clock_s: correction to add to the calibrated time offset.
        gravity: (3,) m/s² in the map frame, downwards, as long as the accelerometer reads it.
    """

    velocities: FloatArray
    biases: FloatArray
    T_imu_camera: FloatArray
    clock_s: float
    gravity: FloatArray


@dataclass(frozen=True, eq=False)
class State(PosedCameras):
    """The unknowns.

    Attributes:
        T_map_camera: (K, 4, 4).
        points: (M, 3) in the map frame.
        camera: the intrinsics.
        inertial: None without an IMU.
    """

    T_map_camera: FloatArray
    points: FloatArray
    camera: Camera
    inertial: InertialState | None = None

    @property
    def R_map_camera(self) -> FloatArray:
        """Rotations (K, 3, 3) of the cameras."""
        return self.T_map_camera[:, :3, :3]


@dataclass(frozen=True, eq=False)
class Problem:
    """Measurements to adjust.

    Attributes:
        times: (K,) of the keyframes [s].
        observations: sightings of points by keyframes.
        imu: None without one.
        gyro: calibration of the gyroscope to the camera; given if there is an IMU.
        fixes: waypoints.
        steps: relative poses of keyframes; they fix the scale.
        depth_sigma: relative, of the observations' depths, which fix the scale. None to ignore depths.
        level_sigma_rad: of the fixes' z axis against gravity; None if it need not be vertical.
        camera_sigmas: of the intrinsics; None to hold them.
        camera_mean: of the intrinsics' prior; None for those of the state that an adjustment begins with.
        pixel_sigma_px: of a sighting's coordinates.
        imu_noise: of the IMU, as a multiple of the usual.
    """

    times: FloatArray
    observations: Observations
    imu: Imu | None = None
    gyro: GyroCalibration | None = None
    fixes: tuple[Fix, ...] = ()
    steps: tuple[Step, ...] = ()
    depth_sigma: float | None = None
    level_sigma_rad: float | None = _LEVEL_SIGMA_RAD
    camera_sigmas: CameraSigmas | None = None
    camera_mean: Camera | None = None
    pixel_sigma_px: float = _PIXEL_SIGMA_PX
    imu_noise: float = 1.0
