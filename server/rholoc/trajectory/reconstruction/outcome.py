"""Results of a reconstruction."""

from dataclasses import dataclass, field, replace

import numpy as np

from rholoc.geometry import BoolArray, Camera, FloatArray, Similarity
from rholoc.trajectory.checks.agreement import Agreement
from rholoc.trajectory.checks.mistaken_waypoints import LeftOut
from rholoc.trajectory.frame.map_frame import MapFrame
from rholoc.trajectory.inertial.gyroscope import GyroCalibration
from rholoc.trajectory.optimization.adjustment import Adjusted
from rholoc.trajectory.optimization.points import residuals_px
from rholoc.trajectory.optimization.problem import Problem, State
from rholoc.trajectory.optimization.rounds import MIN_PX, OUTLIER
from rholoc.trajectory.reconstruction.figures import median_depth_of, spread_covariances
from rholoc.trajectory.visual.tracks import MIN_SIGHTINGS

WELL_PLACED = 0.9  # minimum share of the keyframes for a trajectory to be trusted
_MIN_PLACED = 0.5  # the share of a walk's keyframes that a map must have …
_MIN_OF_SET, _ENOUGH_OF_SET = 0.25, 8  # … and of a set, which may show several places: a share, or so many pictures
_SEEN, _FIXED = 12, 8  # minimum sightings to fix a keyframe, and minimum of these with a known distance
_CARRIED_SIGMA_M = 0.05  # maximum, for a keyframe fixed by the IMU alone
_SHARED = 0.0012  # of the median depth: sigma of errors that sightings share, which no number of them averages out
_COVARIANCES = 60  # keyframes with a computed covariance; interpolated between them


@dataclass(frozen=True, eq=False)
class InertialFigures:
    """IMU parameters estimated by the adjustment.

    Attributes:
        gyro: calibration of the gyroscope to the camera.
        scale_sigma: relative standard deviation of the walk's scale.
        accelerometer_bias: (3,) in the middle of the walk [m/s²].
        lever_m: (3,) position of the IMU in the camera frame.
        clock_s: correction to add to the calibrated time offset.
        accelerometer_scale: reading for an acceleration of 1 m/s².
        residual: median residual of the accelerations, in units of the expected noise.
        misfit: RMS difference between IMU and pictures over keyframe intervals, in units of the IMU noise.
    """

    gyro: GyroCalibration
    scale_sigma: float
    accelerometer_bias: FloatArray
    lever_m: FloatArray
    clock_s: float
    accelerometer_scale: float
    residual: float
    misfit: float


@dataclass(frozen=True, eq=False)
class Solved:
    """An adjusted walk and the map's frame.

    Attributes:
        problem: the measurements.
        adjusted: the solution.
        frame: alignment with the map frame.
        in_frame: whether waypoints in the adjustment already hold the walk in the map frame.
        left_out: name of each waypoint → comparison with the walk without it.
        mistaken: names of the waypoints left out.
    """

    problem: Problem
    adjusted: Adjusted
    frame: MapFrame
    in_frame: bool = False
    left_out: dict[str, LeftOut] = field(default_factory=dict)
    mistaken: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Poses of K keyframes in the map frame, with statistics.

    Attributes:
        placed: (K,) bool, keyframes with a pose.
        T_map_camera: (K, 4, 4); meaningless where ``placed`` is false.
        covariances: (K, 6, 6), see :class:`rholoc.trajectory.Trajectory`.
        camera: the intrinsics.
        focal_sigma_px: standard deviation of an estimated focal length, else None.
        frame: alignment with the map frame.
        imu: None if the IMU was not used.
        imu_reason: one line on why the IMU was not used, or empty.
        left_out: name of each waypoint → comparison with the walk without it.
        mistaken: names of the waypoints left out.
        residual_px: median over the sightings.
        landmarks: number of points used.
        loops: number of loop closures.
        median_depth: of the points in the cameras that see them, in the map's unit.
        agreement: with a second reconstruction, if there is no IMU to check the pictures.
        zooms: (K,) of each picture relative to the camera, where autofocus or another lens changed it; or None.
        note: one line on a fallback that was used, or empty.
        disputed: (K,) bool, keyframes left out because no second reconstruction confirms them; None if not checked.
    """

    placed: BoolArray
    T_map_camera: FloatArray
    covariances: FloatArray
    camera: Camera
    focal_sigma_px: float | None
    frame: MapFrame
    imu: InertialFigures | None
    imu_reason: str
    left_out: dict[str, LeftOut]
    mistaken: tuple[str, ...]
    residual_px: float
    landmarks: int
    loops: int
    median_depth: float
    agreement: Agreement | None = None
    zooms: FloatArray | None = None
    note: str = ""
    disputed: BoolArray | None = None


def finished(
    solved: Solved, loops: int, focal_is_known: bool, imu: InertialFigures | None, imu_reason: str
) -> Reconstruction:
    """Build the reconstruction: move it to the map frame unless it is there, compute covariances and ``placed``.

    Args:
        solved: the adjusted walk and its map frame.
        loops: number of loop closures.
        focal_is_known: whether the focal length was given; its sigma is then None.
        imu: figures of the IMU; None if it was not used.
        imu_reason: why it was not used.
    """
    adjusted, frame, observations = solved.adjusted, solved.frame, solved.problem.observations
    keyframes = len(solved.problem.times)
    covariances = spread_covariances(adjusted, keyframes, _COVARIANCES)
    state, scale = adjusted.state, 1.0
    if not solved.in_frame:
        state, scale = moved(state, frame.similarity), frame.similarity.scale
        covariances = frame.similarity.covariances(covariances)
        away = frame.scale_sigma * state.positions
        covariances[:, :3, :3] += away[:, :, None] * away[:, None, :]
    off_px = residuals_px(observations, adjusted.state)
    right = right_sightings(solved.problem, adjusted)
    placed = held_keyframes(solved.problem, adjusted)
    if imu is not None or solved.problem.steps:
        sigma_m = np.sqrt(np.trace(covariances[:, :3, :3], axis1=1, axis2=2))
        usual_m = float(np.median(sigma_m[placed])) if placed.any() else 0.0
        placed |= sigma_m <= max(_CARRIED_SIGMA_M, 2 * usual_m)
    median_depth = scale * median_depth_of(observations, adjusted)
    covariances[:, :3, :3] += (_SHARED * median_depth) ** 2 * np.eye(3)
    return Reconstruction(
        placed,
        state.T_map_camera,
        covariances,
        state.camera,
        None if focal_is_known else float(adjusted.camera_sigmas()[0]),
        frame,
        imu,
        imu_reason,
        solved.left_out,
        solved.mistaken,
        float(np.median(off_px[adjusted.used])),
        len(np.unique(observations.tracks[right])),
        loops,
        median_depth,
    )


def fewest_placed(count: int, is_film: bool) -> float:
    """Minimum number of ``count`` keyframes that a map must have: of a film half; of a set of pictures a quarter, at
    most eight.
    """
    return _MIN_PLACED * count if is_film else min(_MIN_OF_SET * count, _ENOUGH_OF_SET)


def right_sightings(problem: Problem, adjusted: Adjusted) -> BoolArray:
    """Mask (N,) of the used sightings within five median residuals of the solution (at least 2.5 px)."""
    off_px = residuals_px(problem.observations, adjusted.state)
    return np.asarray(adjusted.used & (off_px <= max(MIN_PX, OUTLIER * float(np.median(off_px)))))


def held_keyframes(problem: Problem, adjusted: Adjusted) -> BoolArray:
    """Mask (K,) of the keyframes whose sightings alone fix their pose.

    They have at least twelve inlier sightings, eight of them with a measured depth or of points that at least two other
    keyframes see. Points that only one other keyframe sees do not fix the distance to it.
    """
    found, count = problem.observations, len(problem.times)
    right = right_sightings(problem, adjusted)
    fixed = np.bincount(found.tracks[right], minlength=found.points)[found.tracks] >= MIN_SIGHTINGS
    if found.depths is not None:
        fixed |= np.isfinite(found.depths)
    seen, near = (np.bincount(found.keyframes[some], minlength=count) for some in (right, right & fixed))
    return np.asarray((seen >= _SEEN) & (near >= _FIXED))


def moved(state: State, similarity: Similarity) -> State:
    """The state in the frame that ``similarity`` leads to; the IMU's velocities and gravity are moved too."""
    inertial = state.inertial
    if inertial is not None:
        R, scale = similarity.rotation, similarity.scale
        inertial = replace(inertial, velocities=scale * inertial.velocities @ R.T, gravity=R @ inertial.gravity)
    T = similarity.poses(state.T_map_camera)
    return State(T, similarity.points(state.points), state.camera, inertial)
