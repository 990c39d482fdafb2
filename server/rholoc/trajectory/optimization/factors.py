"""Factor graph of a problem: sightings and waypoints with Cauchy's loss, steps, depths, and the gauge."""

from collections.abc import Sequence

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C, D, L, X

from rholoc.geometry import BoolArray, Camera, IntArray
from rholoc.trajectory.optimization.imu_factors import add_imu
from rholoc.trajectory.optimization.points import CAUCHY_PIXELS
from rholoc.trajectory.optimization.problem import GAUGE_SIGMA, CameraSigmas, Fix, Problem, State, Step

_CAUCHY_WAYPOINTS = 3.0
_CAUCHY_STEPS = 3.0
_CAUCHY_DEPTHS = 2.0  # sigmas
_FIXED = 1e-9
_DEPTH_SIGMA_M = 0.01  # of a depth picture's pixel, in addition to a share of the depth
_DEPTHS_PER_KEYFRAME = 40
_MIN_SEEN = 4  # sightings that fix a keyframe without other measurements
_UNSEEN_SIGMA_RAD = 1.0  # of a keyframe that no measurement fixes


def graph_of(problem: Problem, state: State, used: BoolArray) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Factors of the measurements, of the sightings those in ``used`` (N,), and the values of ``state``."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, T in enumerate(state.T_map_camera):
        values.insert(C(k), gtsam.Pose3(T))
    _add_sightings(graph, values, problem, state, used)
    if problem.imu is not None and state.inertial is not None:
        add_imu(graph, values, problem, problem.imu, state, state.inertial)
    _hold_unseen(graph, values, problem.observations.keyframes[used], state)
    _add_fixes(graph, problem.fixes)
    _add_steps(graph, problem.steps)
    has_depths = _add_depths(graph, problem, state, used)
    if not problem.fixes:
        is_inertial = state.inertial is not None
        has_scale = is_inertial or has_depths or bool(problem.steps)
        _fix_gauge(graph, values, state, has_gravity=is_inertial, has_scale=has_scale)
    return graph, values


def robust(sigmas: float, noise: gtsam.noiseModel.Base) -> gtsam.noiseModel.Base:
    """The noise model ``noise`` with Cauchy's loss of width ``sigmas`` standard deviations."""
    return gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Cauchy.Create(sigmas), noise)


def _add_sightings(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, problem: Problem, state: State, used: BoolArray
) -> None:
    """Add the sightings in ``used`` (N,) to ``graph``, and their points and any estimated intrinsics to ``values``."""
    observations, camera = problem.observations, state.camera
    noise = robust(CAUCHY_PIXELS, gtsam.noiseModel.Isotropic.Sigma(2, problem.pixel_sigma_px))
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


def _to_gtsam(camera: Camera) -> gtsam.Cal3DS2:
    """A pinhole camera with its first four coefficients of distortion."""
    k1, k2, p1, p2 = (*camera.distortion, 0.0, 0.0, 0.0, 0.0)[:4]
    return gtsam.Cal3DS2(camera.fx, camera.fy, 0.0, camera.cx, camera.cy, k1, k2, p1, p2)


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
    """Add measured camera positions to ``graph``, with Cauchy's loss."""
    for fix in fixes:
        noise = robust(_CAUCHY_WAYPOINTS, gtsam.noiseModel.Isotropic.Sigma(3, fix.sigma_m))
        graph.add(gtsam.PoseTranslationPrior3D(C(fix.keyframe), np.array(fix.position), noise))


def _add_steps(graph: gtsam.NonlinearFactorGraph, steps: Sequence[Step]) -> None:
    """Add relative poses of keyframes to ``graph``, with Cauchy's loss."""
    for step in steps:
        sigmas = np.repeat([step.sigma_rad, step.sigma_m], 3)
        noise = robust(_CAUCHY_STEPS, gtsam.noiseModel.Diagonal.Sigmas(sigmas))
        pose = gtsam.Pose3(step.T_first_second)
        graph.add(gtsam.BetweenFactorPose3(C(step.first), C(step.second), pose, noise))


def _add_depths(graph: gtsam.NonlinearFactorGraph, problem: Problem, state: State, used: BoolArray) -> bool:
    """Add measured distances from keyframes to points to ``graph``, about 40 per keyframe. Returns whether any."""
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


def _fix_gauge(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, state: State, has_gravity: bool, has_scale: bool
) -> None:
    """Add priors to ``graph`` on what no measurement fixes: the first camera's position and heading; without gravity
    its tilt, too; without a measured scale its distance to the farthest camera.
    """
    noise: gtsam.noiseModel.Base = gtsam.noiseModel.Isotropic.Sigma(6, GAUGE_SIGMA)
    if has_gravity:
        vertical = state.R_map_camera[0].T @ np.array([0.0, 0.0, 1.0])
        information = np.zeros((6, 6))
        information[:3, :3] = np.outer(vertical, vertical) + 1e-9 * np.eye(3)
        information[3:, 3:] = np.eye(3)
        noise = gtsam.noiseModel.Gaussian.Information(information / GAUGE_SIGMA**2)
    graph.add(gtsam.PriorFactorPose3(C(0), values.atPose3(C(0)), noise))
    if has_scale:
        return
    away = np.linalg.norm(state.positions - state.positions[0], axis=1)
    far = int(np.argmax(away))
    range_noise = gtsam.noiseModel.Isotropic.Sigma(1, GAUGE_SIGMA * max(float(away[far]), 1e-9))
    graph.add(gtsam.RangeFactorPose3(C(0), C(far), float(away[far]), range_noise))
