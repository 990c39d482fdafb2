"""Peaks of densities as surfaces for ParaView.

Around its landmark a ``ray`` density seen from the feature's views is constant on ellipsoids: those of the landmark's
covariance Λ⁻¹ (:mod:`rholoc.density.ray`). The surface drawn is three standard deviations wide.
"""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import ConvexHull

from rholoc.errors import InvalidInput
from rholoc.geometry import FloatArray, IntArray
from rholoc.maps.formats.ply_and_vtp import Cells, Owner, data_array, landmark_sigmas, piece, polydata
from rholoc.maps.map import Map
from rholoc.maps.walks import consecutive

SIGMAS = 3.0
_POINTS = 162  # of a surface
MAX_SURFACES = 5000
_PATH = -1  # feature number of the path's cell


def map_surfaces_vtp(map_: Map, features: Sequence[int]) -> bytes:
    """The peaks of the densities of chosen features, and the path, as a VTK XML PolyData file with two pieces.

    Triangles of ellipsoids in the map frame, metres, and lines from each view to the next of its walk. Cell data:
    ``feature`` (-1 for the path), ``channel`` (255) and ``sigma_m`` (0), as in :func:`rholoc.maps.map_to_vtp`.

    Raises:
        InvalidInput: no feature, more than ``MAX_SURFACES``, or one that the map does not have.
    """
    chosen = _checked(map_, features)
    ball, triangles = _ball()
    points = map_.landmarks.positions[chosen].astype(np.float64)[:, None] + SIGMAS * ball @ _roots(map_, chosen)
    faces = triangles + _POINTS * np.arange(len(chosen))[:, None, None]
    owners = np.repeat(chosen, len(triangles))
    surfaces = _piece(
        points.reshape(-1, 3),
        faces.reshape(-1, 3),
        Cells.TRIANGLES,
        owners,
        map_.landmarks.channels[owners],
        landmark_sigmas(map_)[owners],
    )
    line = consecutive(map_.views.walks)
    of_path = np.full(len(line), _PATH)
    path = _piece(map_.views.positions, line, Cells.LINES, of_path, np.full(len(line), 255), np.zeros(len(line)))
    return polydata(surfaces, path)


def _checked(map_: Map, features: Sequence[int]) -> IntArray:
    """The features, sorted and unique. Raises InvalidInput for none, too many or unknown ones."""
    chosen = np.unique(np.asarray(features, dtype=np.int64))
    if len(chosen) == 0:
        raise InvalidInput("No feature was chosen.", "Give the numbers of some.")
    if len(chosen) > MAX_SURFACES:
        raise InvalidInput(f"{len(chosen)} surfaces are too many.", f"Choose {MAX_SURFACES} features at most.")
    unknown = chosen[(chosen < 0) | (chosen >= len(map_))]
    if len(unknown):
        raise InvalidInput(f"The map has no feature {unknown[0]}.", f"Its features are 0 to {len(map_) - 1}.")
    return chosen


def _ball() -> tuple[FloatArray, IntArray]:
    """Points (162, 3) spread evenly over the unit sphere (a Fibonacci spiral), and triangles (T, 3) facing outwards."""
    number = np.arange(_POINTS) + 0.5
    height, angle = 1 - 2 * number / _POINTS, np.pi * (1 + np.sqrt(5)) * number
    width = np.sqrt(1 - height**2)
    points = np.column_stack([width * np.cos(angle), width * np.sin(angle), height])
    triangles = ConvexHull(points).simplices.astype(np.int64)
    inwards = np.linalg.det(points[triangles]) < 0
    triangles[inwards] = triangles[inwards][:, ::-1]
    return points, triangles


def _roots(map_: Map, features: IntArray) -> FloatArray:
    """(N, 3, 3) symmetric square roots of the landmarks' covariances, metres."""
    variances, directions = np.linalg.eigh(map_.landmarks.covariances[features].astype(np.float64))
    deviations = np.sqrt(np.maximum(variances, 0))
    return np.asarray((directions * deviations[:, None]) @ directions.transpose(0, 2, 1))


def _piece(
    points: FloatArray, cells: IntArray, kind: Cells, features: IntArray, channels: IntArray, sigmas: FloatArray
) -> str:
    """A piece of PolyData of points (N, 3), with the feature, channel and sigma [m] of each cell (C, L)."""
    data = [
        data_array("feature", "Int32", features, "%d"),
        data_array("channel", "UInt8", channels, "%d"),
        data_array("sigma_m", "Float32", sigmas, "%.5f"),
    ]
    return piece(points, cells, kind, Owner.CELLS, 'Scalars="feature"', data, form="%.6f")
