"""Report on a trajectory."""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class CalibrationReport:
    """Intrinsics that were estimated from the walk itself.

    Attributes:
        focal_px: the focal length.
        focal_sigma_px: its standard deviation; None where the adjustment failed.
        centre_sigma_px: that of the principal point; None where it was not observable.
        observable: whether the walk fixes the focal length.
        why: one line on how well the intrinsics are known.
    """

    focal_px: float
    focal_sigma_px: float | None
    centre_sigma_px: float | None
    observable: bool
    why: str


@dataclass(frozen=True)
class ImuReport:
    """Calibration of the IMU to the camera, and figures of its accelerometer.

    Attributes:
        not_observable: what could not be estimated, and why.
        time_offset_s: what to add to a frame's time to get the IMU's.
        time_offset_sigma_s: its standard deviation.
        gyro_bias_rad_per_s: (3,).
        gyro_bias_sigma_rad_per_s: its standard deviation.
        R_camera_imu: (3, 3) the mounting.
        R_camera_imu_contradicts_recording: whether the recording stated another mounting.
        mounting_sigma_deg: the mounting's standard deviation.
        rotation_residual_deg: the median angle between camera's and gyroscope's rotation from keyframe to keyframe.
        scale_sigma: the relative standard deviation of the scale.
        accelerometer_bias_m_s2: (3,).
        lever_m: (3,) the IMU's position in the camera's axes.
        accelerometer_scale: what the accelerometer reads for one m/s², by gravity's length.
    """

    not_observable: dict[str, str] = field(default_factory=dict)
    time_offset_s: float | None = None
    time_offset_sigma_s: float | None = None
    gyro_bias_rad_per_s: tuple[float, ...] | None = None
    gyro_bias_sigma_rad_per_s: float | None = None
    R_camera_imu: tuple[tuple[float, ...], ...] | None = None
    R_camera_imu_contradicts_recording: bool | None = None
    mounting_sigma_deg: float | None = None
    rotation_residual_deg: float | None = None
    scale_sigma: float | None = None
    accelerometer_bias_m_s2: tuple[float, ...] | None = None
    lever_m: tuple[float, ...] | None = None
    accelerometer_scale: float | None = None


@dataclass(frozen=True)
class InertialComparison:
    """Difference between the IMU's motion, integrated between waypoints, and the trajectory.

    Attributes:
        why: one line on why there is no comparison, where there is none.
        frames: how many were compared.
        rms_m: the root mean square distance.
        worst_m: the greatest distance.
        worst_time_s: when that was.
    """

    why: str | None = None
    frames: int | None = None
    rms_m: float | None = None
    worst_m: float | None = None
    worst_time_s: float | None = None


@dataclass(frozen=True)
class MissingSpan:
    """Part of a recording that could not be placed.

    Attributes:
        start_s, end_s: seconds from the start of the recording; None if its pictures have no times.
        why: what the frames show instead, as it continues a sentence: "shows a blank wall".
        first_number, last_number: numbers of the first and the last frame.
    """

    start_s: float | None
    end_s: float | None
    why: str
    first_number: int = 0
    last_number: int = 0


@dataclass(frozen=True)
class TrajectoryReport:
    """Report on a trajectory. Figures that a method does not produce are None.

    Attributes:
        method: a value of :class:`rholoc.trajectory.PoseMethod`.
        frames: how many frames have a pose.
        trusted: whether every check passed; None where that is not known.
        why: one line: which checks failed, or why the poses are trusted.
        up: one line on what fixes the upward direction.
        scale: one line on what fixes the scale.
        keyframes: how many were chosen.
        landmarks: points of the reconstruction.
        reprojection_error_px: their mean.
        loop_pairs: pairs of keyframes, far apart in time, that show the same place.
        disagreement_of_depth: between two reconstructions, as a share of the median distance of the landmarks.
        disagreement_deg: of the rotations of the same two.
        camera: the intrinsics, where they were estimated.
        imu: the IMU's figures, or one line on why there are none.
        inertial: the comparison with the integrated IMU.
        waypoints_tilt_deg: between the waypoints' z axis and the measured upward direction.
        waypoint_times_s: when the camera was at each waypoint, by name.
        waypoint_residuals_m: how far the trajectory misses each waypoint; None for one that was not used.
        waypoint_mistake: one line on a waypoint that contradicts all others.
        waypoint_sigmas: how far each waypoint is from where everything else has it, in standard deviations of the two.
        expected_error_m: of the positions, by the adjustment's covariance: the median over the frames.
        expected_error_deg: of the rotations, likewise.
        missing: the seconds that could not be placed, and why.
    """

    method: str
    frames: int = 0
    trusted: bool | None = None
    why: str = ""
    up: str | None = None
    scale: str | None = None
    keyframes: int | None = None
    landmarks: int | None = None
    reprojection_error_px: float | None = None
    loop_pairs: int | None = None
    disagreement_of_depth: float | None = None
    disagreement_deg: float | None = None
    camera: CalibrationReport | None = None
    imu: ImuReport | str | None = None
    inertial: InertialComparison | None = None
    waypoints_tilt_deg: float | None = None
    waypoint_times_s: dict[str, float] | None = None
    waypoint_residuals_m: dict[str, float | None] | None = None
    waypoint_mistake: str | None = None
    waypoint_sigmas: dict[str, float | None] | None = None
    expected_error_m: float | None = None
    expected_error_deg: float | None = None
    missing: tuple[MissingSpan, ...] | None = None
