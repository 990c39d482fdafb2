"""Pose graph that closes a walk's loops and meets its waypoints, as the start of the joint adjustment.

After metres of drift, loop sightings have too large residuals for the joint adjustment to converge. A pose graph has
one relative pose for each loop and few unknowns.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C

from rholoc.geometry import FloatArray
from rholoc.trajectory.optimization.descent import optimized
from rholoc.trajectory.optimization.factors import robust
from rholoc.trajectory.optimization.problem import Fix, State

_TILT_SIGMA_RAD = np.radians(0.02)  # of a step between keyframes: gravity fixes it …
_HEADING_SIGMA_RAD = np.radians(0.1)  # … but not the heading
_STEP_SIGMA, _MIN_STEP_SIGMA_M = 0.02, 1e-3  # of its length, relative, and at least
_LEVEL_SIGMA_RAD = np.radians(0.2)  # of each keyframe's tilt
_LOOP_SIGMA_RAD, _LOOP_SIGMA_M = np.radians(0.5), 0.05
_FIX_SIGMA_M = 0.05
_CAUCHY = 3.0  # sigmas, of loops and fixes
_HELD_SIGMA = 1e-4  # rad and m
_ITERATIONS = 30


@dataclass(frozen=True, eq=False)
class RelativePose:
    """Relative pose of two keyframes at one place.

    Attributes:
        first, second: their numbers.
        T_first_second: (4, 4) metres.
    """

    first: int
    second: int
    T_first_second: FloatArray


def bend(state: State, loops: Sequence[RelativePose], fixes: Sequence[Fix] = ()) -> State:
    """Spread a walk's drift over its length, so that loops close and fixes are met; tilts are kept.

    Without fixes the first camera's pose is kept.

    Args:
        state: of a walk with an IMU, in metres, z up.
        loops: may contain outliers.
        fixes: may contain outliers.
    """
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    T = state.T_map_camera
    for k, pose in enumerate(T):
        values.insert(C(k), gtsam.Pose3(pose))
    if not fixes:
        graph.add(gtsam.PriorFactorPose3(C(0), gtsam.Pose3(T[0]), gtsam.noiseModel.Isotropic.Sigma(6, _HELD_SIGMA)))
    level = gtsam.noiseModel.Isotropic.Sigma(2, _LEVEL_SIGMA_RAD)
    up = gtsam.Unit3(np.array([0.0, 0.0, 1.0]))
    for k in range(len(T)):
        graph.add(gtsam.AttitudeFactorPose3(C(k), up, level, gtsam.Unit3(T[k, 2, :3])))
    for k in range(1, len(T)):
        step = np.linalg.inv(T[k - 1]) @ T[k]
        graph.add(gtsam.BetweenFactorPose3(C(k - 1), C(k), gtsam.Pose3(step), _step_noise(T[k], step)))
    meeting = robust(_CAUCHY, gtsam.noiseModel.Diagonal.Sigmas(np.repeat([_LOOP_SIGMA_RAD, _LOOP_SIGMA_M], 3)))
    for loop in loops:
        graph.add(gtsam.BetweenFactorPose3(C(loop.first), C(loop.second), gtsam.Pose3(loop.T_first_second), meeting))
    met = robust(_CAUCHY, gtsam.noiseModel.Isotropic.Sigma(3, _FIX_SIGMA_M))
    for fix in fixes:
        graph.add(gtsam.PoseTranslationPrior3D(C(fix.keyframe), np.array(fix.position), met))
    solved = optimized(graph, values, _ITERATIONS)
    return _bent(state, np.array([solved.atPose3(C(k)).matrix() for k in range(len(T))]))


def _step_noise(T_map_camera: FloatArray, step: FloatArray) -> gtsam.noiseModel.Base:
    """Noise of a step between neighbours: rotation with a small tilt and a large heading, position by its length."""
    vertical = T_map_camera[2, :3]  # the map's z axis in the camera's axes
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = _TILT_SIGMA_RAD**2 * np.eye(3) + _HEADING_SIGMA_RAD**2 * np.outer(vertical, vertical)
    sigma_m = _MIN_STEP_SIGMA_M + _STEP_SIGMA * float(np.linalg.norm(step[:3, 3]))
    covariance[3:, 3:] = sigma_m**2 * np.eye(3)
    return gtsam.noiseModel.Gaussian.Covariance(covariance)


def _bent(state: State, T: FloatArray) -> State:
    """The state with poses T (K, 4, 4), and velocities turned like the cameras."""
    inertial = state.inertial
    if inertial is not None:
        turned = T[:, :3, :3] @ np.swapaxes(state.R_map_camera, 1, 2)
        inertial = replace(inertial, velocities=np.einsum("kij,kj->ki", turned, inertial.velocities))
    return replace(state, T_map_camera=T, inertial=inertial)
