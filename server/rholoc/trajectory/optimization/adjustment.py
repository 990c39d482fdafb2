"""Joint least-squares adjustment of a walk's pictures, gyroscope, accelerometer and waypoints.

Unknowns: keyframe poses and points; with an IMU its pose, velocity and biases at every keyframe, gravity, its mounting
on the camera and its clock offset; the intrinsics if they were not given. IMU readings between keyframes are
preintegrated (Forster et al., 2017). Solved by gtsam; sightings and waypoints have Cauchy's loss.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, C, D, E, G, L, S, V, X
from scipy.linalg import cho_factor, cho_solve

from rholoc.errors import InvalidCamera, MappingFailed
from rholoc.geometry import (
    BoolArray,
    Camera,
    FloatArray,
    IntArray,
    PosedCameras,
    angles_between,
    cross,
    on_plane,
    pose_matrix,
)
from rholoc.lazy import lazy
from rholoc.recordings import GRAVITY, Imu
from rholoc.trajectory.inertial.gyroscope import GyroCalibration, longest_interval_s
from rholoc.trajectory.visual.tracks import Observations

_PIXEL_SIGMA_PX = 0.7  # of a sighting
_CAUCHY_PIXELS = 2.0  # sigmas
_CAUCHY_WAYPOINTS = 3.0
_CAUCHY_STEPS = 3.0
_MIN_PARALLAX_DEG = 1.5  # between the rays to a usable point
_ACCELEROMETER_NOISE = 0.01  # m/s² / √Hz: a phone's, and hand motion between its readings
_GYROSCOPE_NOISE = 5e-4  # rad/s / √Hz
_INTEGRATION_NOISE = 1e-4  # m / √s
_ACCELEROMETER_WALK = 2e-3  # m/s² / √s
_GYROSCOPE_WALK = 2e-4  # rad/s / √s
_ACCELEROMETER_BIAS_SIGMA = 0.3  # m/s²
_GYROSCOPE_BIAS_SIGMA = 0.02  # rad/s
_MOUNTING_SIGMA_RAD = 0.02
_LEVER_SIGMA_M = 0.03  # between camera and IMU: the size of a phone
_CLOCK_SIGMA_S = 3e-3  # of the calibrated time offset
_IMU_COORDINATES = 9  # of a preintegrated interval: rotation, displacement, velocity change
_GRAVITY_SIGMA = 0.05  # m/s², of its length as accelerometers read it
_LEVEL_SIGMA_RAD = np.radians(0.5)  # of the waypoints' z axis
_GAUGE_SIGMA = 1e-4
_TIE_SIGMA_RAD, _TIE_SIGMA_M = 2e-4, 5e-4
_FIXED = 1e-9
_CAUCHY_DEPTHS = 2.0  # sigmas
_DEPTH_SIGMA_M = 0.01  # of a depth picture's pixel, in addition to a share of the depth
_DEPTHS_PER_KEYFRAME = 40
_COARSE, _FINE = 1e-3, 2e-4  # minimum relative cost decrease of a step before another one
_MIN_SEEN = 4  # sightings that fix a keyframe without other measurements
_UNSEEN_SIGMA_RAD = 1.0  # of a keyframe that no measurement fixes
_FIRST_DAMPING = 10.0
_SETTLING_STEPS = 6
_SHARES = (1.0, 0.5, 0.25)  # of a failed step, to retry with every point re-optimized
_POINTS = (ord("l"),)
_ELIMINATED = tuple(map(ord, "lxvb"))  # points and inertial states: what is left of the unknowns is small and dense
_MAX_DENSE = 4000  # unknowns left, up to which their information is inverted as a dense matrix
_HOLDS = (1e-2, 0.3, 10.0)  # increasing strengths of the points' prior, each used if a step fails with the one before


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
        gravity: (3,) m/s² in the map frame, as the accelerometer measures it.
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


@dataclass(frozen=True, eq=False)
class Adjusted:
    """A solution.

    Attributes:
        state: the unknowns.
        used: (N,) mask of the sightings used.
        cost: half the robust sum of squares.
    """

    state: State
    used: BoolArray
    cost: float
    _graph: gtsam.NonlinearFactorGraph = field(repr=False)
    _values: gtsam.Values = field(repr=False)
    _ordering: gtsam.Ordering = field(repr=False)
    _held: Callable[[float], gtsam.GaussianFactorGraph] = field(repr=False)

    def covariances(self, keyframes: Sequence[int]) -> FloatArray:
        """Pose covariances (N, 6, 6) of some keyframes: x, y, z [m], then the rotation about the map's axes [rad].

        NaN if the measurements do not fix a pose.
        """
        to_map = np.zeros((len(keyframes), 6, 6))
        to_map[:, :3, 3:] = to_map[:, 3:, :3] = self.state.R_map_camera[list(keyframes)]
        found = np.array(self._marginals([C(k) for k in keyframes], 6)).reshape(-1, 6, 6)
        return np.asarray(to_map @ found @ to_map.transpose(0, 2, 1))

    def camera_sigmas(self) -> FloatArray:
        """Standard deviations (9,) of estimated fx, fy, skew, cx, cy, k1, k2, p1, p2; NaN if not fixed."""
        return np.asarray(np.sqrt(np.diag(self._marginals([D(0)], 9)[0])))

    def imu_misfit(self) -> float:
        """RMS of the IMU residuals in units of the assumed noise; 0 without an IMU."""
        factors = (self._graph.at(i) for i in range(self._graph.size()))
        squares = [
            2 * factor.error(self._values)
            for factor in factors
            if isinstance(factor, gtsam.CombinedImuFactorWithGravityVector)
        ]
        return float(np.sqrt(np.mean(squares) / _IMU_COORDINATES)) if squares else 0.0

    def _marginals(self, keys: Sequence[int], size: int) -> list[FloatArray]:
        """Covariances (size, size) of some unknowns, not points, with the weakest prior on the points that makes the
        system regular; NaN where it leaves them open, or if it is singular with every prior.
        """
        for system in _with_points_held(self._graph.linearize(self._values), self._held):
            with contextlib.suppress(RuntimeError, np.linalg.LinAlgError):  # RuntimeError: gtsam's word for singular
                return self._marginals_of(system, keys, size)
        return [np.full((size, size), np.nan) for _ in keys]

    def _marginals_of(self, system: gtsam.GaussianFactorGraph, keys: Sequence[int], size: int) -> list[FloatArray]:
        """The same by one linear system: from the dense information of all but the points and the inertial states, or
        by a tree if that would be too large. Raises RuntimeError or LinAlgError if the system is singular.
        """
        gone, rest = _split(self._ordering, _ELIMINATED)
        sizes = self._values.zeroVectors()
        *starts, total = itertools.accumulate((len(sizes.at(key)) for key in rest), initial=0)
        if total > _MAX_DENSE:
            tree = system.eliminateMultifrontal(self._ordering)
            return [_marginal(tree, key, size) for key in keys]
        _, reduced = system.eliminatePartialMultifrontal(_ordered(gone))
        factor = cho_factor(reduced.hessian(_ordered(rest))[0])
        own = np.zeros((total, len(keys), size))
        for k, key in enumerate(keys):
            start = starts[rest.index(key)]
            own[start : start + size, k] = np.eye(size)
        found = cho_solve(factor, own.reshape(total, -1)).reshape(own.shape)
        return [own[:, k].T @ found[:, k] for k in range(len(keys))]


def adjust(
    problem: Problem,
    state: State,
    iterations: int,
    progress: Callable[[float], None] = lambda fraction: None,
    coarsely: bool = False,
) -> Adjusted:
    """Optimize from a nearby state, mostly by Gauss–Newton steps.

    Points are triangulated from the state's poses. Points with at most 1.5° of parallax and outlier sightings are
    ignored in this call only.

    Args:
        iterations: maximum number.
        progress: called with the fraction of iterations done.
        coarsely: stop at a relative decrease of the cost below 1e-3 instead of 2e-4.

    Raises:
        MappingFailed: the measurements do not fix the shape of the walk, or the focal length becomes impossible.
    """
    points, used = _usable_points(problem.observations, state, problem.pixel_sigma_px)
    state = replace(state, points=points)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, T in enumerate(state.T_map_camera):
        values.insert(C(k), gtsam.Pose3(T))
    _add_sightings(graph, values, problem, state, used)
    if problem.imu is not None and state.inertial is not None:
        _add_imu(graph, values, problem, problem.imu, state, state.inertial)
    _hold_unseen(graph, values, problem.observations.keyframes[used], state)
    _add_fixes(graph, problem.fixes)
    _add_steps(graph, problem.steps)
    has_depths = _add_depths(graph, problem, state, used)
    if (problem.steps or has_depths) and state.inertial is None and not problem.fixes:
        first = gtsam.noiseModel.Isotropic.Sigma(6, _GAUGE_SIGMA)
        graph.add(gtsam.PriorFactorPose3(C(0), values.atPose3(C(0)), first))
    elif not problem.fixes:
        _fix_gauge(graph, values, state, metric=state.inertial is not None)
    ordering = _ordering(values, problem.observations, used)
    held = functools.cache(lambda firmness: _held_points(problem.observations, state, used, firmness))
    descent = _Descent(graph, ordering, held, lambda values: _with_points_settled(values, problem, state, used))
    values, cost = descent.solve(values, iterations, _COARSE if coarsely else _FINE, progress)
    return Adjusted(_state_of(values, problem, state, used), used, cost, graph, values, ordering, held)


def triangulate(observations: Observations, state: State) -> tuple[FloatArray, FloatArray]:
    """Points (M, 3) nearest to the rays of their sightings, and twice the largest angle (M,) of a ray to their mean
    [deg].
    """
    rays = np.einsum("nij,nj->ni", state.R_map_camera[observations.keyframes], state.camera.rays(observations.pixels))
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    seen_from = np.einsum("nij,nj->ni", across, state.positions[observations.keyframes])
    count = observations.points
    information, target, middle = np.zeros((count, 3, 3)), np.zeros((count, 3)), np.zeros((count, 3))
    np.add.at(information, observations.tracks, across)
    np.add.at(target, observations.tracks, seen_from)
    np.add.at(middle, observations.tracks, rays)
    points = np.linalg.solve(information + 1e-9 * np.eye(3), target[..., None])[..., 0]
    middle /= np.maximum(np.linalg.norm(middle, axis=1, keepdims=True), 1e-12)
    off = angles_between(rays, middle[observations.tracks])
    widest = np.zeros(count)
    np.maximum.at(widest, observations.tracks, off)
    return points, 2 * np.degrees(widest)


def residuals_px(observations: Observations, state: State, points: FloatArray | None = None) -> FloatArray:
    """Reprojection errors (N,) of the sightings [px] with ``points`` (M, 3) or the state's; infinite behind the
    camera.
    """
    points = state.points if points is None else points
    R_map_plane, measured = _image_planes(observations, state)
    seen = np.einsum("nji,nj->ni", R_map_plane, points[observations.tracks] - state.positions[observations.keyframes])
    ahead = seen[:, 2] > 1e-6
    off = np.full(len(observations), np.inf)
    off[ahead] = np.linalg.norm(on_plane(seen[ahead]) - measured[ahead], axis=1) * state.camera.focal
    return off


def _image_planes(observations: Observations, state: State) -> tuple[FloatArray, FloatArray]:
    """R_map_plane (N, 3, 3) of each sighting's image plane, and its coordinates (N, 2) on this plane."""
    R_plane_camera, measured = state.camera.planes(observations.pixels)
    return state.R_map_camera[observations.keyframes] @ np.swapaxes(R_plane_camera, 1, 2), measured


def _usable_points(observations: Observations, state: State, sigma_px: float) -> tuple[FloatArray, BoolArray]:
    """Points (M, 3), triangulated and refined, and a mask (N,) of the usable sightings.

    A usable sighting has a residual below 20 px (or 4 × the median, if larger), and belongs to a point with
    ``observations.fewest`` such sightings and more than 1.5° of parallax.
    """
    points, parallax_deg = triangulate(observations, state)
    off = residuals_px(observations, state, points)
    near = off < max(20.0, 4 * float(np.median(off)))
    often = np.bincount(observations.tracks[near], minlength=observations.points) >= observations.fewest
    good = (parallax_deg > _MIN_PARALLAX_DEG) & often
    used = near & good[observations.tracks]
    return _settled(points, observations.at(used), state, sigma_px), used


def _settled(points: FloatArray, observations: Observations, state: State, sigma_px: float) -> FloatArray:
    """Points (M, 3) of least reprojection error with all else held (Gauss–Newton, Cauchy's weights). Triangulated
    points are not optimal; refining them here saves the joint problem iterations.
    """
    tracks, positions = observations.tracks, state.positions[observations.keyframes]
    R, measured = _image_planes(observations, state)
    scale = _CAUCHY_PIXELS * sigma_px / state.camera.focal
    points = points.copy()
    for _ in range(_SETTLING_STEPS):
        seen = np.einsum("nji,nj->ni", R, points[tracks] - positions)
        depth = np.maximum(seen[:, 2], 1e-6)
        plane = seen[:, :2] / depth[:, None]
        off = measured - plane
        weight = np.where(seen[:, 2] > 1e-6, 1 / (1 + np.sum(off**2, axis=1) / scale**2), 0.0)
        slope = (R[:, :, :2] - R[:, :, 2:] * plane[:, None, :]) / depth[:, None, None]  # (n, 3, 2)
        weighted = weight[:, None, None] * slope
        information, target = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
        np.add.at(information, tracks, weighted @ np.swapaxes(slope, 1, 2))
        np.add.at(target, tracks, np.einsum("nij,nj->ni", weighted, off))
        damping = 1e-3 * np.trace(information, axis1=1, axis2=2) + 1e-12
        points += np.linalg.solve(information + damping[:, None, None] * np.eye(3), target[..., None])[..., 0]
    return points


def _add_sightings(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, problem: Problem, state: State, used: BoolArray
) -> None:
    observations, camera = problem.observations, state.camera
    noise = robust(_CAUCHY_PIXELS, gtsam.noiseModel.Isotropic.Sigma(2, problem.pixel_sigma_px))
    for track in np.unique(observations.tracks[used]).tolist():
        values.insert(L(track), state.points[track])
    keyframes, tracks = observations.keyframes[used].tolist(), observations.tracks[used].tolist()
    if problem.camera_sigmas is None:
        ideal = gtsam.Cal3_S2(camera.focal, camera.focal, 0.0, 0.0, 0.0)
        R_plane_camera, places = camera.planes(observations.pixels[used])
        for keyframe, track, R, place in zip(keyframes, tracks, R_plane_camera, camera.focal * places, strict=True):
            turned = gtsam.Pose3(gtsam.Rot3(R.T), np.zeros(3))
            graph.add(
                gtsam.GenericProjectionFactorCal3_S2(place, noise, C(keyframe), L(track), ideal, False, False, turned)
            )
        return
    mean = problem.camera_mean or camera
    values.insert(D(0), _to_gtsam(camera))
    graph.add(gtsam.PriorFactorCal3DS2(D(0), _to_gtsam(mean), _camera_prior(mean, problem.camera_sigmas)))
    for keyframe, track, place in zip(keyframes, tracks, observations.pixels[used], strict=True):
        graph.add(gtsam.GeneralSFMFactor2Cal3DS2(place, noise, C(keyframe), L(track), D(0)))


def _camera_prior(camera: Camera, sigmas: CameraSigmas) -> gtsam.noiseModel.Base:
    """Prior (9,) on the intrinsics of ``camera`` with fx = fy and radial distortion; the rest is held."""
    focal = sigmas.focal * camera.focal
    radial = [sigmas.distortion**2] * 2
    covariance = np.diag([0.0, 0.0, _FIXED, _FIXED, _FIXED, *radial, _FIXED, _FIXED])
    covariance[:2, :2] = focal**2
    covariance[[0, 1], [0, 1]] += (1e-3 * focal) ** 2
    return gtsam.noiseModel.Gaussian.Covariance(covariance)


def _add_imu(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    problem: Problem,
    imu: Imu,
    state: State,
    inertial: InertialState,
) -> None:
    assert problem.gyro is not None
    times = problem.times + problem.gyro.time_offset_s
    covered = np.flatnonzero((times >= imu.times[0]) & (times <= imu.times[-1])).tolist()
    T_imu_camera = gtsam.Pose3(inertial.T_imu_camera)
    values.insert(E(0), T_imu_camera)
    mounting = np.concatenate([np.full(3, _MOUNTING_SIGMA_RAD), np.full(3, _LEVER_SIGMA_M)])
    nominal = gtsam.Pose3(pose_matrix(problem.gyro.R_camera_imu.T, np.zeros(3)))
    graph.add(gtsam.PriorFactorPose3(E(0), nominal, gtsam.noiseModel.Diagonal.Sigmas(mounting)))
    values.insert(S(0), np.array([inertial.clock_s]))
    graph.add(gtsam.PriorFactorVector(S(0), np.zeros(1), gtsam.noiseModel.Isotropic.Sigma(1, _CLOCK_SIGMA_S)))
    values.insert(G(0), inertial.gravity)
    graph.add(gtsam.PriorFactorVector(G(0), np.array([0.0, 0.0, -GRAVITY]), _gravity_prior(problem)))
    tie = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([_TIE_SIGMA_RAD, _TIE_SIGMA_M], 3))
    rates = np.column_stack([np.interp(times, imu.times, axis) for axis in imu.angular_velocity.T])
    parameters, longest_s = imu_noise(problem.imu_noise), longest_interval_s(imu)
    walk = np.repeat([_ACCELEROMETER_WALK, _GYROSCOPE_WALK], 3)
    for k in covered:
        bias = gtsam.imuBias.ConstantBias(inertial.biases[k, :3], inertial.biases[k, 3:])
        values.insert(X(k), gtsam.Pose3(state.T_map_camera[k]).compose(T_imu_camera.inverse()))
        values.insert(V(k), inertial.velocities[k])
        values.insert(B(k), bias)
        graph.add(_tie(k, rates[k] - inertial.biases[k, 3:], tie))
    for before, k in itertools.pairwise(covered):
        bias = gtsam.imuBias.ConstantBias(inertial.biases[k, :3], inertial.biases[k, 3:])
        summed = preintegrated(imu, times[before], times[k], parameters, bias, longest_s)
        if summed is not None:
            graph.add(
                gtsam.CombinedImuFactorWithGravityVector(
                    X(before), V(before), X(k), V(k), B(before), B(k), G(0), summed
                )
            )
        else:
            sigmas = walk * np.sqrt(times[k] - times[before])
            still = gtsam.imuBias.ConstantBias()
            graph.add(gtsam.BetweenFactorConstantBias(B(before), B(k), still, gtsam.noiseModel.Diagonal.Sigmas(sigmas)))
            loose = gtsam.noiseModel.Isotropic.Sigma(3, 10.0)
            for end in (before, k) if before == covered[0] else (k,):  # whose speeds no reading before them measured
                graph.add(gtsam.PriorFactorVector(V(end), np.zeros(3), loose))
    first = covered[0]
    prior = gtsam.imuBias.ConstantBias(np.zeros(3), problem.gyro.bias)
    sigmas = np.repeat([_ACCELEROMETER_BIAS_SIGMA, _GYROSCOPE_BIAS_SIGMA], 3)
    graph.add(gtsam.PriorFactorConstantBias(B(first), prior, gtsam.noiseModel.Diagonal.Sigmas(sigmas)))


def _gravity_prior(problem: Problem) -> gtsam.noiseModel.Base:
    """Prior on gravity (3,). Without fixes it is vertical, which defines the map's z axis. With fixes it is vertical up
    to ``level_sigma_rad``; if that is None, gravity is free.
    """
    if not problem.fixes:
        level = _GAUGE_SIGMA
    elif problem.level_sigma_rad is None:
        level = GRAVITY
    else:
        level = GRAVITY * problem.level_sigma_rad
    length = GRAVITY if problem.fixes and problem.level_sigma_rad is None else _GRAVITY_SIGMA
    return gtsam.noiseModel.Diagonal.Sigmas(np.array([level, level, length]))


def imu_noise(times_usual: float) -> gtsam.PreintegrationCombinedParams:
    """Preintegration parameters of an IMU with ``times_usual`` × the usual noise; its biases wander as usual."""
    parameters = gtsam.PreintegrationCombinedParams.MakeSharedU(GRAVITY)
    parameters.setAccelerometerCovariance(np.eye(3) * (times_usual * _ACCELEROMETER_NOISE) ** 2)
    parameters.setGyroscopeCovariance(np.eye(3) * (times_usual * _GYROSCOPE_NOISE) ** 2)
    parameters.setIntegrationCovariance(np.eye(3) * (times_usual * _INTEGRATION_NOISE) ** 2)
    parameters.setBiasAccCovariance(np.eye(3) * _ACCELEROMETER_WALK**2)
    parameters.setBiasOmegaCovariance(np.eye(3) * _GYROSCOPE_WALK**2)
    return parameters


def preintegrated(
    imu: Imu,
    start_s: float,
    end_s: float,
    parameters: gtsam.PreintegrationCombinedParams,
    bias: gtsam.imuBias.ConstantBias,
    longest_s: float,
) -> gtsam.PreintegratedCombinedMeasurements | None:
    """Preintegrate the readings from ``start_s`` to ``end_s``, IMU clock (trapezoidal rule, linearized at ``bias``);
    None over a gap of more than ``longest_s``.
    """
    first, last = np.searchsorted(imu.times, start_s, side="right"), np.searchsorted(imu.times, end_s, side="left")
    knots = np.concatenate([[start_s], imu.times[first:last], [end_s]])
    around = imu.times[max(first - 1, 0) : last + 1]
    if np.diff(around).max(initial=0.0) > longest_s:
        return None
    acceleration = np.column_stack([np.interp(knots, imu.times, axis) for axis in imu.acceleration.T])
    rate = np.column_stack([np.interp(knots, imu.times, axis) for axis in imu.angular_velocity.T])
    summed = gtsam.PreintegratedCombinedMeasurements(parameters, bias)
    steps = np.diff(knots)
    for a, w, dt in zip(
        0.5 * (acceleration[1:] + acceleration[:-1]), 0.5 * (rate[1:] + rate[:-1]), steps.tolist(), strict=True
    ):
        if dt > 0:
            summed.integrateMeasurement(a, w, dt)
    return summed


def _tie(k: int, rate: FloatArray, noise: gtsam.noiseModel.Base) -> gtsam.CustomFactor:
    """Factor of mounting and clock offset: T_map_camera = T_map_imu Exp((ω, v) clock) T_imu_camera. ``rate`` is the
    IMU's ω (3,) [rad/s] at keyframe ``k``, v its velocity.
    """

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: Any) -> Any:
        T_map_camera, T_map_imu = values.atPose3(C(k)), values.atPose3(X(k))
        velocity, T_imu_camera = values.atVector(V(k)), values.atPose3(E(0))
        clock_s = float(values.atVector(S(0))[0])
        R_imu_map = T_map_imu.rotation().matrix().T
        speed = R_imu_map @ velocity
        twist = np.concatenate([rate, speed])
        moved = gtsam.Pose3.Expmap(twist * clock_s)
        expected = T_map_imu.compose(moved).compose(T_imu_camera)
        if jacobians is not None:
            to_camera = T_imu_camera.inverse().AdjointMap()
            by_velocity, by_rotation = np.zeros((6, 3)), np.zeros((6, 6))
            by_velocity[3:] = R_imu_map * clock_s
            by_rotation[3:, :3] = cross(speed, np.eye(3)).T * clock_s
            jacobians[0] = np.eye(6)
            jacobians[1] = -moved.compose(T_imu_camera).inverse().AdjointMap() - to_camera @ by_rotation
            jacobians[2] = -to_camera @ by_velocity
            jacobians[3] = -np.eye(6)
            jacobians[4] = -(to_camera @ twist)[:, None]
        return np.asarray(gtsam.Pose3.Logmap(expected.between(T_map_camera)))

    return gtsam.CustomFactor(noise, [C(k), X(k), V(k), E(0), S(0)], error)


def _hold_unseen(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, seeing: IntArray, state: State) -> None:
    """Add to ``graph`` a weak prior on each keyframe that has no IMU state and fewer than four sightings.

    ``seeing`` (N,) are the keyframes of the used sightings.
    """
    extent = float(np.linalg.norm(np.ptp(state.positions, axis=0)))
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([_UNSEEN_SIGMA_RAD, max(extent, 1e-9)], 3))
    sightings = np.bincount(seeing, minlength=len(state.T_map_camera))
    for k in np.flatnonzero(sightings < _MIN_SEEN).tolist():
        if not values.exists(X(k)):
            graph.add(gtsam.PriorFactorPose3(C(k), values.atPose3(C(k)), noise))


def _add_fixes(graph: gtsam.NonlinearFactorGraph, fixes: Sequence[Fix]) -> None:
    for fix in fixes:
        noise = robust(_CAUCHY_WAYPOINTS, gtsam.noiseModel.Isotropic.Sigma(3, fix.sigma_m))
        graph.add(gtsam.PoseTranslationPrior3D(C(fix.keyframe), np.array(fix.position), noise))


def _add_steps(graph: gtsam.NonlinearFactorGraph, steps: Sequence[Step]) -> None:
    for step in steps:
        sigmas = np.repeat([step.sigma_rad, step.sigma_m], 3)
        noise = robust(_CAUCHY_STEPS, gtsam.noiseModel.Diagonal.Sigmas(sigmas))
        pose = gtsam.Pose3(step.T_first_second)
        graph.add(gtsam.BetweenFactorPose3(C(step.first), C(step.second), pose, noise))


def _add_depths(graph: gtsam.NonlinearFactorGraph, problem: Problem, state: State, used: BoolArray) -> bool:
    """Add measured distances from keyframes to points to ``graph``, about 40 per keyframe. Returns whether there are
    any.
    """
    seen = problem.observations
    if problem.depth_sigma is None or seen.depths is None:
        return False
    rows = np.flatnonzero(used & np.isfinite(seen.depths))
    rows = rows[np.argsort(seen.keyframes[rows], kind="stable")]
    by_keyframe = np.split(rows, np.flatnonzero(np.diff(seen.keyframes[rows])) + 1)
    rows = np.concatenate([some[:: len(some) // _DEPTHS_PER_KEYFRAME + 1] for some in by_keyframe])
    depths = seen.depths[rows]
    lengths = 1 / state.camera.rays(seen.pixels[rows])[:, 2]  # depths are along the optical axis
    ranges = zip(
        seen.keyframes[rows].tolist(),
        seen.tracks[rows].tolist(),
        (lengths * depths).tolist(),
        (lengths * (problem.depth_sigma * depths + _DEPTH_SIGMA_M)).tolist(),
        strict=True,
    )
    for keyframe, track, range_m, sigma_m in ranges:
        noise = robust(_CAUCHY_DEPTHS, gtsam.noiseModel.Isotropic.Sigma(1, sigma_m))
        graph.add(gtsam.RangeFactor3D(C(keyframe), L(track), range_m, noise))
    return len(rows) > 0


def _fix_gauge(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, state: State, metric: bool) -> None:
    """Add priors to ``graph`` on what no measurement fixes: the first camera's position and heading. Unless ``metric``,
    also its tilt, and the scale by its distance to the farthest camera.
    """
    first = values.atPose3(C(0))
    if metric:
        vertical = state.R_map_camera[0].T @ np.array([0.0, 0.0, 1.0])
        information = np.zeros((6, 6))
        information[:3, :3] = np.outer(vertical, vertical) + 1e-9 * np.eye(3)
        information[3:, 3:] = np.eye(3)
        noise = gtsam.noiseModel.Gaussian.Information(information / _GAUGE_SIGMA**2)
        graph.add(gtsam.PriorFactorPose3(C(0), first, noise))
        return
    graph.add(gtsam.PriorFactorPose3(C(0), first, gtsam.noiseModel.Isotropic.Sigma(6, _GAUGE_SIGMA)))
    away = np.linalg.norm(state.positions - state.positions[0], axis=1)
    far = int(np.argmax(away))
    noise = gtsam.noiseModel.Isotropic.Sigma(1, _GAUGE_SIGMA * max(float(away[far]), 1e-9))
    graph.add(gtsam.RangeFactorPose3(C(0), C(far), float(away[far]), noise))


@dataclass(frozen=True, eq=False)
class _Descent:
    """Optimizer of one problem.

    Attributes:
        graph: its factors.
        ordering: elimination order of its unknowns.
        held: strength → prior that keeps the points near their present positions.
        settled: values → values with every point re-optimized alone.
    """

    graph: gtsam.NonlinearFactorGraph
    ordering: gtsam.Ordering
    held: Callable[[float], gtsam.GaussianFactorGraph]
    settled: Callable[[gtsam.Values], gtsam.Values]

    def solve(
        self, values: gtsam.Values, iterations: int, tolerance: float, progress: Callable[[float], None]
    ) -> tuple[gtsam.Values, float]:
        """Minimize the cost in at most ``iterations`` steps; returns values and cost.

        Stops at a relative decrease of at most ``tolerance``. Raises MappingFailed if the system is singular.
        """
        cost, weakest = self.graph.error(values), 0
        for done in range(iterations):
            before = cost
            values, cost, used = self._stepped(values, cost, weakest)
            weakest = max(used - 1, 0)
            progress((done + 1) / iterations)
            if before - cost <= tolerance * before:
                break
        return values, cost

    def _stepped(self, values: gtsam.Values, cost: float, weakest: int) -> tuple[gtsam.Values, float, int]:
        """Gauss–Newton step; if none lowers the cost, a Levenberg–Marquardt step, which takes three times as long. A
        long step mostly fails because the points lag behind: it is retried, whole and in part, with every point
        re-optimized. The points' prior has the strength ``weakest`` of ``_HOLDS`` or more. Returns values, cost and the
        strength used. Raises MappingFailed if the system is singular.
        """
        systems = _with_points_held(self.graph.linearize(values), self.held, weakest)
        for firmness, system in enumerate(systems, weakest):
            try:
                step = self._solved(system)
            except RuntimeError:  # gtsam's word for a singular system
                continue
            for there in self._along(values, step):
                lower = self.graph.error(there)
                if lower < cost:
                    return there, lower, firmness
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setlambdaInitial(_FIRST_DAMPING)
        parameters.setOrdering(self.ordering)
        optimizer = gtsam.LevenbergMarquardtOptimizer(self.graph, values, parameters)
        try:
            optimizer.iterate()
        except RuntimeError:
            raise MappingFailed(
                "What was measured leaves the shape of the walk open.", "Walk further, and in loops."
            ) from None
        return optimizer.values(), optimizer.error(), weakest

    def _solved(self, system: gtsam.GaussianFactorGraph) -> gtsam.VectorValues:
        """Solution of a linear system. Points are eliminated one by one: a tree of them takes up to twice as long.
        Raises RuntimeError if the system is singular.
        """
        points, rest = self._points_and_rest
        eliminated, reduced = system.eliminatePartialSequential(points)
        return eliminated.optimize(reduced.optimize(rest))

    @lazy
    def _points_and_rest(self) -> tuple[gtsam.Ordering, gtsam.Ordering]:
        points, rest = _split(self.ordering, _POINTS)
        return _ordered(points), _ordered(rest)

    def _along(self, values: gtsam.Values, step: gtsam.VectorValues) -> Iterator[gtsam.Values]:
        yield values.retract(step)
        for share in _SHARES:
            with contextlib.suppress(MappingFailed):  # impossible intrinsics
                yield self.settled(values.retract(step.scale(share)))


def _with_points_settled(values: gtsam.Values, problem: Problem, state: State, used: BoolArray) -> gtsam.Values:
    moved = _state_of(values, problem, state, used)
    sightings = problem.observations.at(used)
    points = _settled(triangulate(sightings, moved)[0], sightings, moved, problem.pixel_sigma_px)
    there = gtsam.Values(values)
    for track in np.unique(sightings.tracks).tolist():
        there.update(L(track), points[track])
    return there


def _marginal(tree: gtsam.GaussianBayesTree, key: int, size: int) -> FloatArray:
    """Covariance (size, size) of one variable; NaN if it is unbounded."""
    with contextlib.suppress(RuntimeError):  # gtsam's word for a singular system
        return np.asarray(tree.marginalCovariance(key))
    return np.full((size, size), np.nan)


def _ordered(keys: Sequence[int]) -> gtsam.Ordering:
    ordering = gtsam.Ordering()
    for key in keys:
        ordering.push_back(key)
    return ordering


def _split(ordering: gtsam.Ordering, kinds: Sequence[int]) -> tuple[list[int], list[int]]:
    """Keys of the unknowns of some ``kinds`` (the characters of their symbols) in their order, and of all others."""
    keys = [ordering.at(i) for i in range(ordering.size())]
    some = [key for key in keys if gtsam.symbolChr(key) in kinds]
    return some, [key for key in keys if gtsam.symbolChr(key) not in kinds]


def _with_points_held(
    linear: gtsam.GaussianFactorGraph, held: Callable[[float], gtsam.GaussianFactorGraph], weakest: int = 0
) -> Iterator[gtsam.GaussianFactorGraph]:
    """Iterate over copies of the linear system with increasingly strong priors on its points."""
    for firmness in _HOLDS[weakest:]:
        system = gtsam.GaussianFactorGraph()
        system.push_back(linear)
        system.push_back(held(firmness))
        yield system


def _held_points(
    observations: Observations, state: State, used: BoolArray, firmness: float
) -> gtsam.GaussianFactorGraph:
    """Prior that keeps each point near its position relative to its distance: weak points would jump behind cameras.

    It is on the points of the observations ``used`` (O,); the distance is the largest to their cameras. ``firmness``
    should be small, because the prior also holds the walk's scale.
    """
    tracks, count = observations.tracks[used], observations.points
    away = np.zeros(count)
    np.maximum.at(
        away, tracks, np.linalg.norm(state.points[tracks] - state.positions[observations.keyframes[used]], axis=1)
    )
    held = gtsam.GaussianFactorGraph()
    noise, nowhere = gtsam.noiseModel.Unit.Create(3), np.zeros(3)
    for track in np.unique(tracks).tolist():
        held.push_back(gtsam.JacobianFactor(L(track), firmness / max(away[track], 1e-9) * np.eye(3), nowhere, noise))
    return held


def _ordering(values: gtsam.Values, observations: Observations, used: BoolArray) -> gtsam.Ordering:
    """Elimination order: points, keyframes by nested dissection, shared unknowns. Ordering the whole graph would take
    longer than the step, because nearly every factor contains the intrinsics.
    """
    by_track = np.lexsort((observations.keyframes[used], observations.tracks[used]))
    tracks, keyframes = observations.tracks[used][by_track], observations.keyframes[used][by_track]
    points, starts = np.unique(tracks, return_index=True)
    together = {tuple(some.tolist()) for some in np.split(keyframes, starts[1:])}
    inertial = [k for k in range(int(keyframes.max(initial=-1)) + 1) if values.exists(X(k))]
    joined = [[C(k) for k in some] for some in sorted(together)]
    joined += [[C(k), X(k), V(k), B(k)] for k in inertial]
    joined += [[X(a), V(a), B(a), X(b), V(b), B(b)] for a, b in itertools.pairwise(inertial)]
    graph = gtsam.SymbolicFactorGraph()
    for keys in joined:
        graph.push_back(gtsam.SymbolicFactor.FromKeys(keys))
    dissected = gtsam.Ordering.MetisSymbolicFactorGraph(graph)
    keys = [L(point) for point in points.tolist()]
    keys += [dissected.at(i) for i in range(dissected.size())]
    rest = set(values.keys()) - set(keys)
    shared = [key for key in (G(0), S(0), E(0), D(0)) if key in rest]
    return _ordered([*keys, *sorted(rest - set(shared)), *shared])


def _state_of(values: gtsam.Values, problem: Problem, state: State, used: BoolArray) -> State:
    T = np.array([values.atPose3(C(k)).matrix() for k in range(len(state.T_map_camera))])
    points = state.points.copy()
    for track in np.unique(problem.observations.tracks[used]).tolist():
        points[track] = values.atPoint3(L(track))
    camera = state.camera if problem.camera_sigmas is None else _from_gtsam(values.atCal3DS2(D(0)), state.camera)
    inertial = state.inertial
    if inertial is not None:
        velocities, biases = inertial.velocities.copy(), inertial.biases.copy()
        for k in range(len(T)):
            if values.exists(V(k)):
                bias = values.atConstantBias(B(k))
                velocities[k] = values.atVector(V(k))
                biases[k] = np.concatenate([bias.accelerometer(), bias.gyroscope()])
        clock_s = float(values.atVector(S(0))[0])
        inertial = InertialState(velocities, biases, values.atPose3(E(0)).matrix(), clock_s, values.atVector(G(0)))
    return State(T, points, camera, inertial)


def _to_gtsam(camera: Camera) -> gtsam.Cal3DS2:
    k1, k2, p1, p2 = (*camera.distortion, 0.0, 0.0, 0.0, 0.0)[:4]
    return gtsam.Cal3DS2(camera.fx, camera.fy, 0.0, camera.cx, camera.cy, k1, k2, p1, p2)


def _from_gtsam(model: gtsam.Cal3DS2, camera: Camera) -> Camera:
    fx, fy, _, cx, cy, k1, k2, p1, p2 = (float(value) for value in model.vector())
    try:
        return replace(camera, fx=fx, fy=fy, cx=cx, cy=cy, distortion=(k1, k2, p1, p2))
    except InvalidCamera as error:
        raise MappingFailed(
            "The pictures do not show what the camera's focal length is.",
            "Calibrate the camera (rholoc camera calibrate), or take pictures from places further apart.",
        ) from error


def robust(sigmas: float, noise: gtsam.noiseModel.Base) -> gtsam.noiseModel.Base:
    """The noise model ``noise`` with Cauchy's loss of width ``sigmas`` standard deviations."""
    return gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Cauchy.Create(sigmas), noise)


def optimized(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, iterations: int) -> gtsam.Values:
    """Values of least cost from ``values``, by at most so many steps of Levenberg–Marquardt. Raises RuntimeError if the
    system is singular.
    """
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(iterations)
    return gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
