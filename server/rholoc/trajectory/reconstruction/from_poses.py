"""Adjust poses with drift (ARKit) to the pictures: the poses are initial values and measure each step."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_limits

from rholoc.geometry import Camera, FloatArray, Similarity, kabsch
from rholoc.progress import ProgressListener, silent
from rholoc.trajectory.frame.map_frame import MapFrame
from rholoc.trajectory.optimization.problem import Problem, State, Step
from rholoc.trajectory.optimization.rounds import AdjustmentProgress, adjusted_in_rounds, camera_sigmas
from rholoc.trajectory.reconstruction.outcome import Reconstruction, Solved, finished
from rholoc.trajectory.reconstruction.pair_fit import pair_error
from rholoc.trajectory.reconstruction.sights import Sights, gather_evidence
from rholoc.trajectory.trajectory import Scale

_STEP_SIGMA = 0.02  # of a step's length …
_MIN_STEP_SIGMA = 0.02  # … and at least this share of the median step
_STEP_SIGMA_RAD = np.radians(0.3)
_ROUNDS = 3
_MAX_PAIR_ERROR = 30e-3  # median epipolar error of a correct pair under the poses


def reconstruct_from_poses(
    sights: Sights, camera: Camera, T_map_camera: FloatArray, frame: MapFrame, progress: ProgressListener = silent
) -> Reconstruction:
    """Adjust poses with drift to the pictures.

    Pairs that contradict the poses, such as doors that look alike, are left out.

    Args:
        sights: sightings of K keyframes.
        camera: of the frames.
        T_map_camera: (K, 4, 4) the poses.
        frame: of the poses; its similarity is replaced by the alignment of the result with them.
        progress: listener for :data:`Stage.POSES`.

    Raises:
        MappingFailed: no features could be matched.
    """
    with threadpool_limits(1, "blas"):
        return _reconstruct(sights, camera, T_map_camera, frame, progress)


def _reconstruct(
    sights: Sights, camera: Camera, T: FloatArray, frame: MapFrame, progress: ProgressListener
) -> Reconstruction:
    turned = Rotation.from_matrix(T[0, :3, :3].T @ T[:, :3, :3])
    evidence = gather_evidence(sights, camera, turned, progress)
    rays = [camera.rays(found.pixels) for found in sights.features]
    evidence = replace(
        evidence,
        sequential=[pair for pair in evidence.sequential if pair_error(pair, rays, T) <= _MAX_PAIR_ERROR],
        loops=[pair for pair in evidence.loops if pair_error(pair, rays, T) <= _MAX_PAIR_ERROR],
    )
    problem = Problem(
        sights.times,
        evidence.observations(sights),
        camera_sigmas=camera_sigmas(sights.camera),
        steps=_steps(T),
    )
    state = State(T, np.zeros((0, 3)), camera)
    problem, adjusted = adjusted_in_rounds(problem, state, AdjustmentProgress(progress), (0.45, 0.9), _ROUNDS)
    back = kabsch(adjusted.state.positions, T[:, :3, 3]) if _spread(T) > 0 else frame.similarity
    solved = Solved(problem, adjusted, replace(frame, similarity=back))
    return finished(solved, len(evidence.loops), sights.camera is not None, None, "")


def _steps(T: FloatArray) -> tuple[Step, ...]:
    """Relative poses of neighbours in T (K, 4, 4), with sigmas of 2 % of their lengths and of the median length."""
    lengths = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1)
    least = _MIN_STEP_SIGMA * max(float(np.median(lengths)), 1e-6)
    return tuple(
        Step(k, k + 1, np.linalg.inv(T[k]) @ T[k + 1], float(np.hypot(_STEP_SIGMA * length, least)), _STEP_SIGMA_RAD)
        for k, length in enumerate(lengths)
    )


def _spread(T: FloatArray) -> float:
    """Second singular value of the centred positions of T (K, 4, 4): 0 if they lie on a line."""
    return float(np.linalg.svd(T[:, :3, 3] - T[:, :3, 3].mean(axis=0), compute_uv=False)[1])


def unmoved_frame(scale: Scale, upright: bool, why_up: str) -> MapFrame:
    """The poses' own frame as a map frame, with a line on its unit."""
    why = "The poses came in metres." if scale is Scale.METRIC else "The poses' unit of length is not stated."
    return MapFrame(Similarity.identity(), scale, upright, why_up, why)
