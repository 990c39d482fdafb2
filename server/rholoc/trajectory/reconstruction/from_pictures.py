"""Pictures alone → the walk, up to its size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rholoc.errors import MappingFailed
from rholoc.geometry import Camera, FloatArray, IntArray, pose_matrix
from rholoc.recordings import Waypoint
from rholoc.trajectory.frame.map_frame import up_by_pictures
from rholoc.trajectory.initialization.global_positioning import global_positions
from rholoc.trajectory.initialization.rotation_averaging import average_rotations
from rholoc.trajectory.optimization.adjustment import Problem, State
from rholoc.trajectory.reconstruction.outcome import Reconstruction, finished
from rholoc.trajectory.reconstruction.rounds import AdjustmentProgress, adjusted_in_rounds, camera_sigmas
from rholoc.trajectory.reconstruction.sights import ADVICE, Evidence, Sights
from rholoc.trajectory.reconstruction.waypoints import in_map_frame
from rholoc.trajectory.visual.tracks import Observations, pieces_of
from rholoc.trajectory.visual.two_view import PairRotation

_ROUNDS_OF_PICTURES = 3  # … without an IMU, from a start that is less near


def solve_from_pictures(
    sights: Sights,
    camera: Camera,
    evidence: Evidence,
    waypoints: Sequence[tuple[Waypoint, ...]],
    reason: str,
    progress: AdjustmentProgress,
) -> Reconstruction:
    """The largest piece of the walk whose pictures hang together.

    Args:
        reason: one line on why the IMU was not used, or empty.
    """
    whole = evidence.observations(sights)
    state, members = _start_from_pictures(sights, camera, evidence.rotations, whole)
    number = np.full(len(sights.rows), -1)
    number[members] = np.arange(len(members))
    numbered = Observations(number[whole.keyframes], whole.tracks, whole.pixels)
    observations = numbered.take(numbered.keyframes >= 0)
    problem = Problem(sights.times[members], observations, camera_sigmas=camera_sigmas(sights.camera))
    problem, adjusted = adjusted_in_rounds(problem, state, progress, (0.45, 0.75), _ROUNDS_OF_PICTURES)
    up = up_by_pictures(adjusted.state.R_map_camera)
    solved = in_map_frame(problem, adjusted, waypoints, up, None, (), progress)
    part = finished(solved, len(evidence.loops), sights.camera is not None, None, reason)
    return _of_all(part, members, len(sights.rows))


def _of_all(part: Reconstruction, members: IntArray, count: int) -> Reconstruction:
    """The reconstruction of some keyframes as one of ``count``, of which no others are placed."""
    placed = np.zeros(count, dtype=np.bool_)
    placed[members] = part.placed
    T = np.tile(np.eye(4), (count, 1, 1))
    T[members] = part.T_map_camera
    covariances = np.zeros((count, 6, 6))
    covariances[members] = part.covariances
    return replace(part, placed=placed, T_map_camera=T, covariances=covariances)


def _start_from_pictures(
    sights: Sights, camera: Camera, rotations: Sequence[PairRotation], observations: Observations
) -> tuple[State, IntArray]:
    """The largest piece of the walk: its state in a frame of its own, and its keyframes."""
    count = len(sights.rows)
    R, component = average_rotations(count, rotations, sights.times, None)
    piece = pieces_of(count, observations)
    both = component * (count + 1) + piece
    both[piece < 0] = -1
    kinds, sizes = np.unique(both[both >= 0], return_counts=True)
    if len(kinds) == 0:
        raise MappingFailed("No two pictures overlap enough.", ADVICE)
    members = np.flatnonzero(both == kinds[sizes.argmax()])
    positions = _positions_of(members, R, observations, camera.undistort(observations.pixels))
    return State(pose_matrix(R[members], positions), np.zeros((0, 3)), camera), members


def _positions_of(members: IntArray, R: FloatArray, observations: Observations, plane: FloatArray) -> FloatArray:
    """The positions (N, 3) of some keyframes from what they see together."""
    number = np.full(len(R), -1)
    number[members] = np.arange(len(members))
    within = number[observations.keyframes] >= 0
    tracks = observations.tracks[within]
    often = np.bincount(tracks, minlength=observations.points)[tracks] >= 2
    rows = np.flatnonzero(within)[often]
    _, tracks = np.unique(observations.tracks[rows], return_inverse=True)
    return global_positions(R[members], number[observations.keyframes[rows]], tracks, plane[rows])
