"""Point cloud of a room from depth pictures, for display; localization does not use it.

Depth is scaled to the landmarks visible in each picture, so it fits the map whatever the units are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rholoc.geometry import ByteArray, FloatArray, IntArray
from rholoc.mapping.build.landmarks import Landmarks
from rholoc.mapping.build.tracks import Views
from rholoc.maps import Cloud
from rholoc.recordings import Recording
from rholoc.recordings.frames.depth import DepthImage, DepthImages

_MAX_VIEWS = 100  # that points are taken from
_MAX_POINTS = 200_000
_APART_M = 0.02  # no two points are within the same cube of this size
_MIN_LANDMARKS = 30  # that give the scale
_MAX_MISFIT = 0.1  # of depths to the landmarks', in the median, as a share


class _Seen(NamedTuple):
    """Points (P, 3) of a depth picture in the camera frame [m], their colours (P, 3), and the ratios (L,) of
    landmark depth in the map to measured depth.
    """

    points: FloatArray
    colours: ByteArray
    ratios: FloatArray


def depth_cloud(
    recording: Recording, rows: IntArray, views: Views, of_views: IntArray, landmarks: Landmarks, source: int
) -> Cloud:
    """Point cloud of the surfaces in a recording's depth pictures, in the map frame.

    Args:
        recording: a recording, some of whose frames may have depth.
        rows: (V,) rows of the frames that are views.
        views: K views, including these.
        of_views: (V,) row of the view for each frame.
        landmarks: landmarks reconstructed from the views.
        source: number of the recording among the map's sources.

    Returns:
        An empty cloud if depth and landmarks contradict each other.

    Raises:
        InvalidRecording: a frame cannot be decoded.
    """
    depth = recording.depth
    if depth is None:
        return Cloud()
    having = np.flatnonzero([depth.paths[row] is not None for row in rows])
    chosen = having[np.unique(np.linspace(0, len(having) - 1, min(_MAX_VIEWS, len(having))).astype(np.int64))]
    budget = _MAX_POINTS // max(1, len(chosen))
    images = recording.frames.images(rows[chosen].tolist())
    seen: dict[int, _Seen] = {}
    for row, view, image in zip(rows[chosen].tolist(), of_views[chosen].tolist(), images, strict=True):
        found = _look(depth, row, image, views, view, landmarks, budget)
        if found is not None:
            seen[view] = found
    scale = _scale([one.ratios for one in seen.values()])
    if scale is None:
        return Cloud()
    positions = np.concatenate([_placed(scale * one.points, views.T_map_camera[view]) for view, one in seen.items()])
    colours = np.concatenate([one.colours for one in seen.values()])
    cubes = np.floor(positions / (_APART_M * scale)).astype(np.int64)
    kept = np.sort(np.unique(cubes, axis=0, return_index=True)[1])
    return Cloud(positions[kept].astype(np.float32), colours[kept], np.full(len(kept), source, dtype=np.int32))


def _look(
    depth: DepthImages, row: int, image: ByteArray, views: Views, view: int, landmarks: Landmarks, budget: int
) -> _Seen | None:
    """About ``budget`` points of one frame. None if its depth picture is unusable."""
    camera = views.cameras[view]
    found = depth.of_frame(row, camera)
    if found is None:
        return None
    metres, smooth = found.metres, found.reliable
    step = max(1, int(np.ceil(np.sqrt(metres.size / max(budget, 1)))))
    v, u = (grid.ravel() for grid in np.mgrid[step // 2 : metres.shape[0] : step, step // 2 : metres.shape[1] : step])
    v, u = v[smooth[v, u]], u[smooth[v, u]]
    rays = found.camera.rays(np.column_stack([u, v]).astype(np.float64))
    ahead = rays[:, 2] > 0  # depths are along the axis, of which a wide lens sees both sides
    v, u, rays = v[ahead], u[ahead], rays[ahead]
    points = rays / rays[:, 2:] * metres[v, u][:, None]
    pixels = camera.project(points)
    inside = camera.contains(pixels)
    at = np.round(pixels[inside]).astype(np.int64)
    return _Seen(points[inside], image[at[:, 1], at[:, 0], ::-1], _ratios(found, views, view, landmarks))


def _ratios(depth: DepthImage, views: Views, view: int, landmarks: Landmarks) -> FloatArray:
    """Ratios (L,) of landmark depth in the map to measured depth, for the landmarks in a view."""
    seen = np.arange(views.offsets[view], views.offsets[view + 1])
    seen = seen[landmarks.labels[seen] >= 0]
    T = views.T_map_camera[view]
    points = (landmarks.positions[landmarks.labels[seen]] - T[:3, 3]) @ T[:3, :3]
    ratios = points[:, 2] / depth.at(points)
    return np.asarray(ratios[np.isfinite(ratios)])


def _scale(ratios: list[FloatArray]) -> float | None:
    """Median of the ratios: map units per metre of measured depth. None if the ratios disagree."""
    together = np.concatenate(ratios) if ratios else np.zeros(0)
    if len(together) < _MIN_LANDMARKS:
        return None
    scale = float(np.median(together))
    return scale if np.median(np.abs(together / scale - 1)) < _MAX_MISFIT else None


def _placed(points: FloatArray, T_map_camera: FloatArray) -> FloatArray:
    return np.asarray(points @ T_map_camera[:3, :3].T + T_map_camera[:3, 3])
