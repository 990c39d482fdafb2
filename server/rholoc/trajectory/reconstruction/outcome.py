"""What comes of a reconstruction."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from rholoc.geometry import BoolArray, Camera, FloatArray, Similarity
from rholoc.trajectory.checks.agreement import Agreement
from rholoc.trajectory.checks.blame import LeftOut
from rholoc.trajectory.frame.map_frame import MapFrame
from rholoc.trajectory.inertial.gyroscope import GyroCalibration
from rholoc.trajectory.optimization.adjustment import Adjusted, Problem, State, residuals_px
from rholoc.trajectory.reconstruction.figures import median_depth_of, spread_covariances
from rholoc.trajectory.reconstruction.rounds import FEWEST_PX, OUTLIER

_SEEN = 12  # sightings that place a keyframe by itself
_CARRIED_SIGMA_M = 0.05  # up to which the IMU alone places a keyframe
_COVARIANCES = 60  # keyframes, spread over the walk, whose covariance is computed; between them it is interpolated


@dataclass(frozen=True, eq=False)
class InertialFigures:
    """What the adjustment found out about the IMU.

    Attributes:
        gyro: how it relates to the camera.
        scale_sigma: of the walk's size, relative.
        accelerometer_bias: (3,) m/s², in the middle of the walk.
        lever_m: (3,) the IMU's place in the camera's axes.
        clock_s: to be added to the calibrated time offset.
        accelerometer_scale: what it reads for one m/s².
        residual: of the accelerations, in units of the noise expected.
        misfit: by how many times its noise the IMU disagrees with what the pictures alone say between keyframes.
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
        problem: what was adjusted.
        adjusted: what came of it.
        frame: how the map's frame came about.
        in_frame: whether the walk lies in that frame already, held there by waypoints.
        left_out: each waypoint, by its name, held against the walk without it.
        mistaken: the names of the waypoints that were left out.
    """

    problem: Problem
    adjusted: Adjusted
    frame: MapFrame
    in_frame: bool = False
    left_out: dict[str, LeftOut] = field(default_factory=dict)
    mistaken: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Poses of K keyframes in the map frame, and what is known of them.

    Attributes:
        placed: (K,) bool, which keyframes have a pose.
        T_map_camera: (K, 4, 4); meaningless where a keyframe has none.
        covariances: (K, 6, 6), see :class:`rholoc.trajectory.Trajectory`.
        camera: the intrinsics.
        focal_sigma_px: of a focal length that was estimated, else None.
        frame: how the map's frame came about.
        imu: None where the IMU was not used.
        imu_reason: one line on why it was not, or empty.
        left_out: each waypoint, by its name, held against the walk without it.
        mistaken: the names of the waypoints that were left out.
        residual_px: the median over the sightings.
        landmarks: points that were used.
        loops: pairs of keyframes that show a place seen again.
        median_depth: of the points before the cameras that see them, in the map's unit.
        agreement: with a second reconstruction, where no IMU checks the pictures.
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


def finished(
    solved: Solved, loops: int, focal_is_known: bool, imu: InertialFigures | None, imu_reason: str
) -> Reconstruction:
    """Covariances, what counts as placed, and the map's frame where waypoints have not given it."""
    adjusted, frame, observations = solved.adjusted, solved.frame, solved.problem.observations
    keyframes = len(solved.problem.times)
    covariances = spread_covariances(adjusted, keyframes, _COVARIANCES)
    state, scale = adjusted.state, 1.0
    if not solved.in_frame:
        state, scale = moved(state, frame.similarity), frame.similarity.scale
        turn = np.zeros((6, 6))
        turn[:3, :3] = scale * frame.similarity.rotation
        turn[3:, 3:] = frame.similarity.rotation
        covariances = turn @ covariances @ turn.T
        away = frame.scale_sigma * state.positions
        covariances[:, :3, :3] += away[:, :, None] * away[:, None, :]
    off_px = residuals_px(observations, adjusted.state)
    right = right_sightings(solved.problem, adjusted)
    placed = held_keyframes(solved.problem, adjusted)
    if imu is not None or solved.problem.steps:
        sigma_m = np.sqrt(np.trace(covariances[:, :3, :3], axis1=1, axis2=2))
        usual_m = float(np.median(sigma_m[placed])) if placed.any() else 0.0
        placed |= sigma_m <= max(_CARRIED_SIGMA_M, 2 * usual_m)
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
        scale * median_depth_of(observations, adjusted),
    )


def right_sightings(problem: Problem, adjusted: Adjusted) -> BoolArray:
    """Which sightings (N,) are used and agree with the solution."""
    off_px = residuals_px(problem.observations, adjusted.state)
    return np.asarray(adjusted.used & (off_px <= max(FEWEST_PX, OUTLIER * float(np.median(off_px)))))


def held_keyframes(problem: Problem, adjusted: Adjusted) -> BoolArray:
    """Which keyframes (K,) enough right sightings place by themselves."""
    right = right_sightings(problem, adjusted)
    return np.asarray(np.bincount(problem.observations.keyframes[right], minlength=len(problem.times)) >= _SEEN)


def moved(state: State, similarity: Similarity) -> State:
    """The state in another frame."""
    inertial = state.inertial
    if inertial is not None:
        R, scale = similarity.rotation, similarity.scale
        inertial = replace(inertial, velocities=scale * inertial.velocities @ R.T, gravity=R @ inertial.gravity)
    T = similarity.poses(state.T_map_camera)
    return State(T, similarity.points(state.points), state.camera, inertial)
