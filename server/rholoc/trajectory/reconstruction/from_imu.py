"""Pictures and IMU → the walk, metric and upright."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.geometry import Camera, FloatArray, pose_matrix
from rholoc.recordings import GRAVITY, Imu, Waypoint
from rholoc.trajectory.frame.map_frame import ScaleMeasurement, ScaleSource, up_by_gravity
from rholoc.trajectory.frame.upright import rotation_to_upright
from rholoc.trajectory.inertial.gyroscope import GyroCalibration, calibrate_gyro
from rholoc.trajectory.initialization.inertial_start import InertialStart, inertial_start
from rholoc.trajectory.initialization.rotation_averaging import average_rotations
from rholoc.trajectory.optimization.adjustment import Adjusted, adjust
from rholoc.trajectory.optimization.problem import InertialState, Problem, State
from rholoc.trajectory.optimization.rounds import (
    ITERATIONS,
    LAST_ITERATIONS,
    AdjustmentProgress,
    adjusted_in_rounds,
    camera_sigmas,
)
from rholoc.trajectory.reconstruction.figures import scale_sigma_of
from rholoc.trajectory.reconstruction.loop_closure import with_loops_closed
from rholoc.trajectory.reconstruction.measured_scale import (
    scale_by_depth,
    scale_by_steps,
    scales_by_lengths,
    with_depths,
)
from rholoc.trajectory.reconstruction.outcome import InertialFigures, Reconstruction, finished
from rholoc.trajectory.reconstruction.sights import Evidence, Sights
from rholoc.trajectory.reconstruction.waypoints import in_map_frame
from rholoc.trajectory.visual.directions import PairDirection, direction_between
from rholoc.trajectory.visual.focal_guess import calibrate_by_flow
from rholoc.trajectory.visual.matching import VerifiedPair

_CORNERS_APART = (1, 2, 4, 8)  # keyframes, between which corners show the direction of the way
_FEWEST_CORNERS = 15
_DIRECTION_TOLERANCE_PX = 2.0
_ACCELEROMETER_SCALE = 0.01  # from which it is corrected


def calibrated(
    sights: Sights, camera: Camera, imu: Imu, evidence: Evidence | None = None
) -> tuple[GyroCalibration | None, str]:
    """Calibration of the gyroscope to the pictures, and ""; or None, and one line on why the IMU cannot be used.

    Args:
        evidence: matches of the keyframes, if pictures are too far apart for tracking corners; else None.
    """
    if evidence is None:
        gyro = calibrate_by_flow(sights.flow, camera, imu)
    else:
        R, component = average_rotations(len(sights.rows), evidence.rotations, sights.times, None)
        linked = component == np.bincount(component).argmax()
        gyro = calibrate_gyro(sights.times[linked], R[linked], imu)
    if gyro is None:
        return None, "IMU and video hardly overlap; the poses are from the pictures alone."
    if not gyro.fits:
        return None, (
            f"The gyroscope contradicts the pictures: moment by moment they turn {gyro.residual_deg:.1f}° apart. "
            "The poses are from the pictures alone."
        )
    if not gyro.mounting_is_known:
        return None, (
            "How the IMU is mounted is not known, and the camera hardly turns about two axes, which would show it. "
            "The poses are from the pictures alone."
        )
    if not imu.includes_gravity:
        return None, "The recorder took gravity out of the acceleration. The poses are from the pictures alone."
    return gyro, ""


def start_with_imu(
    sights: Sights, camera: Camera, evidence: Evidence, imu: Imu, gyro: GyroCalibration, by_gyroscope: Rotation
) -> tuple[State, InertialStart] | None:
    """A metric, upright start from rotations, directions between neighbours, and the IMU; None if the IMU covers too
    little.

    ``by_gyroscope`` are the cameras' rotations. Returns the state, without points, and the solution for
    positions, velocities and bias that it comes from.
    """
    count, times = len(sights.rows), sights.times
    R, _ = average_rotations(count, replace(evidence, loops=[]).rotations, times, by_gyroscope)
    along = _directions(sights, camera, R, evidence.sequential)
    start = inertial_start(times, R, along, imu, gyro)
    if start is None:
        return None
    upright = rotation_to_upright(start.up)
    T_imu_camera = pose_matrix(gyro.R_camera_imu.T, np.zeros(3))
    biases = np.tile(np.concatenate([start.accelerometer_bias, gyro.bias]), (count, 1))
    inertial = InertialState(start.velocities @ upright.T, biases, T_imu_camera, 0.0, np.array([0.0, 0.0, -GRAVITY]))
    T = pose_matrix(upright @ R, start.positions @ upright.T)
    return State(T, np.zeros((0, 3)), camera, inertial), start


def _directions(sights: Sights, camera: Camera, R: FloatArray, pairs: Sequence[VerifiedPair]) -> list[PairDirection]:
    """Directions between keyframes 1, 2, 4 and 8 apart that share 15 corners, and between ``pairs``, by matches;
    unclear ones are left out (:func:`direction_between`).
    """
    found: list[PairDirection | None] = []
    rows = sights.rows.tolist()
    for apart in _CORNERS_APART:
        for k in range(len(rows) - apart):
            shared, a, b = sights.flow.shared(rows[k], rows[k + apart])
            if len(shared) >= _FEWEST_CORNERS:
                rays = camera.rays(a), camera.rays(b)
                found.append(direction_between(k, k + apart, R, rays, _DIRECTION_TOLERANCE_PX, camera.focal))
    found += [_direction_of(sights, camera, R, pair) for pair in pairs]
    return [one for one in found if one is not None]


def _direction_of(sights: Sights, camera: Camera, R: FloatArray, pair: VerifiedPair) -> PairDirection | None:
    a, b = (
        camera.rays(sights.features[keyframe].pixels[pair.matches[:, side]])
        for side, keyframe in enumerate((pair.first, pair.second))
    )
    return direction_between(pair.first, pair.second, R, (a, b), _DIRECTION_TOLERANCE_PX, camera.focal)


def solve_with_imu(
    sights: Sights,
    imu: Imu,
    gyro: GyroCalibration,
    evidence: Evidence,
    start: tuple[State, InertialStart],
    waypoints: Sequence[tuple[Waypoint, ...]],
    progress: AdjustmentProgress,
) -> Reconstruction:
    """Adjust all measurements together: first without loop closures, at last with the waypoints.

    Raises MappingFailed if the measurements do not determine the shape, or the waypoints contradict them.
    """
    state, began = start
    observations = replace(evidence, loops=[]).observations(sights)
    problem = Problem(sights.times, observations, imu, gyro, camera_sigmas=camera_sigmas(sights.camera))
    problem, adjusted = adjusted_in_rounds(problem, state, progress, (0.45, 0.6))
    misfit = adjusted.imu_misfit()
    if misfit > 1:
        problem = replace(problem, imu_noise=misfit)
        adjusted = adjust(problem, adjusted.state, ITERATIONS, progress)
    evidence, problem, adjusted = with_loops_closed(sights, evidence, problem, adjusted, progress)
    problem, adjusted, accelerometer_scale = _accelerometer_corrected(problem, adjusted, progress)
    of_accelerometer = ScaleMeasurement(ScaleSource.ACCELEROMETER, 1.0, scale_sigma_of(adjusted), is_adjusted=True)
    driven = scale_by_steps(sights.steps, adjusted)
    contradicted = driven is not None and of_accelerometer.contradicts(driven.ratio, driven.sigma)
    if driven is not None and contradicted:  # a wrong unit is likelier than a wrong gravity: the first of equals counts
        driven = replace(driven, sigma=max(driven.sigma, of_accelerometer.sigma))
    scales = [of_accelerometer, *([] if driven is None else [driven])]
    if driven is not None and driven.usable and not contradicted:
        problem = replace(problem, steps=sights.steps)
        adjusted = adjust(problem, adjusted.state, LAST_ITERATIONS, progress)
        best = min(scales, key=lambda one: one.sigma).source
        scales = [ScaleMeasurement(best, 1.0, scale_sigma_of(adjusted), is_adjusted=True)]
    seen = with_depths(problem.observations, sights.depth, adjusted.state.camera)
    depth = scale_by_depth(replace(problem, observations=seen), adjusted)
    scales += [*scales_by_lengths(sights.lengths, adjusted), *([] if depth is None else [depth])]
    solved = in_map_frame(problem, adjusted, waypoints, up_by_gravity(), scales, evidence.loops, progress)
    inertial = solved.adjusted.state.inertial
    assert inertial is not None
    figures = InertialFigures(
        gyro,
        scales[0].sigma,
        inertial.biases[len(inertial.biases) // 2, :3],
        -inertial.T_imu_camera[:3, :3].T @ inertial.T_imu_camera[:3, 3],
        inertial.clock_s,
        accelerometer_scale,
        began.residual,
        misfit,
    )
    return finished(solved, len(evidence.loops), sights.camera is not None, figures, "")


def _accelerometer_corrected(
    problem: Problem, adjusted: Adjusted, progress: AdjustmentProgress
) -> tuple[Problem, Adjusted, float]:
    """Problem and solution after the accelerometer's scale is corrected, and that scale: its reading for 1 m/s². A
    scale within 1 % is left as it is; 1.0 is then returned. Raises MappingFailed.
    """
    assert adjusted.state.inertial is not None
    assert problem.imu is not None
    read = float(np.linalg.norm(adjusted.state.inertial.gravity)) / GRAVITY
    if abs(read - 1) <= _ACCELEROMETER_SCALE:
        return problem, adjusted, 1.0
    problem = replace(problem, imu=replace(problem.imu, acceleration=problem.imu.acceleration / read))
    return problem, adjust(problem, _of_corrected_scale(adjusted.state, read), LAST_ITERATIONS, progress), read


def _of_corrected_scale(state: State, read: float) -> State:
    """The state with all lengths, velocities and gravity divided by ``read``, the accelerometer's former scale."""
    assert state.inertial is not None
    T = state.T_map_camera.copy()
    T[:, :3, 3] /= read
    inertial = replace(
        state.inertial, velocities=state.inertial.velocities / read, gravity=state.inertial.gravity / read
    )
    return replace(state, T_map_camera=T, points=state.points / read, inertial=inertial)
