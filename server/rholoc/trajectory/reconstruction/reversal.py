"""Depth reversal: a scene turned inside out, which explains pictures nearly as well where perspective is weak.

The ambiguity of Szeliski and Kang, "Shape ambiguities in structure from motion" (1997): under affine projection it is
exact. The camera then seems to turn and move the other way.
"""

from dataclasses import replace

import numpy as np

from rholoc.errors import MappingFailed
from rholoc.geometry import pose_matrix
from rholoc.trajectory.optimization.rounds import AdjustmentProgress
from rholoc.trajectory.reconstruction.part import Part, Pictured, Start, adjusted_part
from rholoc.trajectory.visual.tracks import Observations

_BETTER = 1.01  # minimum ratio of explained sightings, reversed to not: a wrong part explained 2 to 15 % fewer


def unreversed(
    part: Part, walk: Pictured, whole: Observations, progress: AdjustmentProgress, span: tuple[float, float]
) -> Part:
    """The part, or the one adjusted from its reversed depths if this explains over 1 % more sightings.

    A part with a picture that looks 90° or more away from the mean direction is not tried. ``whole`` are the sightings
    of all pictures, ``span`` the fractions of progress.
    """
    axes = part.adjusted.state.R_map_camera[:, :, 2]
    if (axes @ axes.mean(axis=0)).min() <= 0:
        return part
    try:
        found = adjusted_part(walk, whole, reversed_start(part), progress, span)
    except (MappingFailed, RuntimeError):
        return part
    return replace(found, apart=part.apart) if found.inliers > _BETTER * part.inliers else part


def reversed_start(part: Part) -> Start:
    """The part's pictures with the poses from which they would show the points mirrored in depth, without points.

    Mirrored at the plane through the median point, seen along the axis of the picture that looks most like all others.
    """
    state, members = part.start
    seen = np.unique(part.problem.observations.tracks[part.adjusted.used])
    pivot = np.median(part.adjusted.state.points[seen], axis=0)
    R = state.R_map_camera
    axis = R[(R[:, :, 2] @ R[:, :, 2].mean(axis=0)).argmax(), :, 2]
    mirrored = np.eye(3) - 2 * np.outer(axis, axis)
    R_reversed = mirrored @ R @ np.diag([1.0, 1.0, -1.0])
    in_camera = np.einsum("kji,kj->ki", R, pivot - state.positions)  # the pivot stays where each picture shows it
    positions = pivot - np.einsum("kij,kj->ki", R_reversed, in_camera)
    return replace(state, T_map_camera=pose_matrix(R_reversed, positions)), members
