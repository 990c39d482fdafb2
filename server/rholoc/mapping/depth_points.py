"""Points of a room from depth images: nothing is localized by them, but people see the room.

Depth is brought to the map's scale by the landmarks that it shows, so that it fits them whatever the unit of either is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rholoc.geometry import ByteArray, FloatArray, IntArray
from rholoc.mapping.landmarks import Landmarks
from rholoc.mapping.observations import Views
from rholoc.maps import Cloud
from rholoc.recordings import Recording
from rholoc.recordings.frames.depth import DepthImage, DepthImages

_MOST_VIEWS = 100  # that points are taken from
_MOST_POINTS = 200_000
_APART_M = 0.02  # no two points are within the same cube of this size
_FEWEST_LANDMARKS = 30  # that give the scale
_LARGEST_MISFIT = 0.1  # of depths to the landmarks', in the median, as a share


class _Seen(NamedTuple):
    """What a depth image shows: points (P, 3) of the camera frame in metres, their colours (P, 3), and the ratios (L,)
    of landmarks' depths in the map to their depths in the image."""

    points: FloatArray
    colours: ByteArray
    ratios: FloatArray


def depth_cloud(
    recording: Recording, rows: IntArray, views: Views, of_views: IntArray, landmarks: Landmarks, source: int
) -> Cloud:
    """The surfaces that a recording's depth images show, in the map frame; none where they contradict the landmarks.

    Args:
        recording: some of its frames may have depth images.
        rows: (V,) those of its frames that are views.
        views: K views, these among them.
        of_views: (V,) which of the K views each is.
        landmarks: what was reconstructed of the views.
        source: the number that the recording has among the map's sources.

    Raises:
        InvalidRecording: a frame cannot be decoded.
    """
    depth = recording.depth
    if depth is None:
        return Cloud()
    having = np.flatnonzero([depth.paths[row] is not None for row in rows])
    chosen = having[np.unique(np.linspace(0, len(having) - 1, min(_MOST_VIEWS, len(having))).astype(np.int64))]
    budget = _MOST_POINTS // max(1, len(chosen))
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
    """At most about ``budget`` points of one frame; None where its depth image cannot be used."""
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
    """The ratios (L,) of the depths of the landmarks that a view shows to those in its depth image."""
    seen = np.arange(views.offsets[view], views.offsets[view + 1])
    seen = seen[landmarks.labels[seen] >= 0]
    T = views.T_map_camera[view]
    points = (landmarks.positions[landmarks.labels[seen]] - T[:3, 3]) @ T[:3, :3]
    ratios = points[:, 2] / depth.at(points)
    return np.asarray(ratios[np.isfinite(ratios)])


def _scale(ratios: list[FloatArray]) -> float | None:
    """The map's unit of length in the depth images' metres; None where they do not agree on one."""
    together = np.concatenate(ratios) if ratios else np.zeros(0)
    if len(together) < _FEWEST_LANDMARKS:
        return None
    scale = float(np.median(together))
    return scale if np.median(np.abs(together / scale - 1)) < _LARGEST_MISFIT else None


def _placed(points: FloatArray, T_map_camera: FloatArray) -> FloatArray:
    return np.asarray(points @ T_map_camera[:3, :3].T + T_map_camera[:3, 3])
