"""Depth of a map's views: recorded with the frames, or by semi-global matching (Hirschmüller, PAMI 2008) of rectified
pairs of frames.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np

from rholoc.geometry import BoolArray, ByteArray, Camera, FloatArray, IntArray, evenly
from rholoc.maps import Map
from rholoc.recordings import Recording
from rholoc.recordings.frames.depth import DepthImages

SIDE = 385  # pixels of a rectified picture, which is square
_COARSE = 8  # pixels between those whose place in the frame is computed; between them it is interpolated
_MAX_SLOPE = 1.2  # from the axis of a rectified picture; a wide lens shows more
_RIM = 9  # pixels of each edge of a picture that say where it lies
_SHARP = 0.8  # rectified pixels per pixel, from which nothing is lost
_PARALLAX = (0.03, 0.4)  # of a pair: distance of its cameras, as a share of the distance to what both see
_BEST_PARALLAX = 0.1
_MIN_ALIGNMENT = 0.7  # cosine between a pair's optical axes
_MAX_ALONG = 0.85  # cosine between a pair's baseline and an optical axis: forward motion gives no depth
_MIN_SHARED = 15  # landmarks seen by both
_PARTNERS = 2  # pairs of a view
_NEAREST = 0.6  # of the nearest landmarks' distance, for the largest disparity
_MAX_DISPARITY = 128
_SMALLEST_DISPARITY = 2.0  # pixels; less is too far away to measure
_AGREEMENT = 0.03  # of a depth: how far another view's may differ
_JUDGES = 5  # other depth views that a point is compared with
_BLOCK = 5  # pixels
_MIN_CONTRAST = 0.8  # grey levels, standard deviation within a block
_MIN_RATIOS = 20  # of recorded depths to landmarks', for a scale


@dataclass(frozen=True, eq=False)
class DepthView:
    """Depth picture of a pinhole camera with square pixels.

    Attributes:
        T_map_camera: (4, 4).
        focal: in pixels.
        centre: (2,) pixel of the optical axis, u and v; it may lie outside the picture.
        depth: (S, S) float32 along the optical axis in the map's unit, NaN where unknown.
        colours: (S, S, 3) uint8, red, green and blue; black where the frame shows nothing.
        pair: numbers of the views that the depth comes from.
    """

    T_map_camera: FloatArray
    focal: float
    centre: FloatArray
    depth: FloatArray
    colours: ByteArray
    pair: frozenset[int]

    def points(self, step: int = 1) -> tuple[FloatArray, FloatArray]:
        """Points (P, 3) in the map frame of every ``step``-th pixel of known depth, and its v and u (P, 2)."""
        v, u = (grid.ravel() for grid in np.mgrid[0 : len(self.depth) : step, 0 : len(self.depth) : step])
        known = np.isfinite(self.depth[v, u])
        v, u = v[known], u[known]
        z = self.depth[v, u].astype(np.float64)
        local = np.column_stack([(np.column_stack([u, v]) - self.centre) / self.focal * z[:, None], z])
        return local @ self.T_map_camera[:3, :3].T + self.T_map_camera[:3, 3], np.column_stack([v, u])

    def look_at(self, points: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray, ByteArray]:
        """Project points (P, 3) of the map frame into a view, to the nearest pixel.

        Returns:
            Their depths (P,); the measured depths (P,) there, NaN where unknown; the mask (P,) of those in front of the
                camera on a pixel that the frame shows; and the picture's colours (P, 3) there, arbitrary outside.
        """
        local = (points - self.T_map_camera[:3, 3]) @ self.T_map_camera[:3, :3]
        z = local[:, 2]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            pixels = np.rint(local[:, :2] * (self.focal / z)[:, None] + self.centre)
        inside = (z > 0) & np.all((pixels >= 0) & (pixels < len(self.depth)), axis=1)
        u, v = np.where(inside[:, None], pixels, 0).astype(np.int64).T
        colours = self.colours[v, u]
        return z, np.where(inside, self.depth[v, u], np.nan), inside & colours.any(axis=1), colours


class _Pair(NamedTuple):
    first: int
    second: int


def depth_views(map_: Map, recording: Recording, source: int, most: int) -> list[DepthView]:
    """Depth views of a recording: recorded depths if enough fit the map, else those that two pairs of frames agree on.

    Args:
        map_: a map.
        recording: one of its recordings.
        source: row of the recording in the map's sources.
        most: maximum number of depth views; of pairs of frames, approximately.

    Raises:
        InvalidRecording: a frame cannot be decoded. No frames with a view give an empty list.
    """
    rows = _frames_of_views(map_, recording, source)
    if not rows:
        return []
    camera = map_.info.sources[source].camera or map_.info.camera
    if recording.depth is not None:
        recorded = _recorded(map_, camera, recording, recording.depth, rows, most)
        if recorded:
            return recorded
    pairs = _pairs(map_, list(rows), most)
    images = _images(recording, rows, {view for pair in pairs for view in pair})
    seen = [_stereo(map_, camera, images, pair) for pair in pairs]
    return _agreeing([view for view in seen if np.isfinite(view.depth).any()])


def _frames_of_views(map_: Map, recording: Recording, source: int) -> dict[int, int]:
    """Views of a map → rows of the recording's frames at their times, within half a frame interval. {} with fewer than
    two frames. Only views of ``source`` are looked at, or all if the map does not know their sources.
    """
    times, sources = recording.frames.times, map_.views.sources
    if len(times) < 2:
        return {}
    tolerance = 0.5 * float(np.median(np.diff(times)))
    views = np.arange(len(map_.views)) if sources is None else np.flatnonzero(sources == source)
    rows = np.abs(times[None] - map_.views.times[views][:, None]).argmin(axis=1)
    near = np.abs(times[rows] - map_.views.times[views]) < tolerance
    return dict(zip(views[near].tolist(), rows[near].tolist(), strict=True))


def _images(recording: Recording, rows: Mapping[int, int], views: set[int]) -> dict[int, ByteArray]:
    """Pictures of ``views``, by view; ``rows`` gives each view's row in the recording's frames."""
    by_row: dict[int, list[int]] = {}
    for view in views:
        by_row.setdefault(rows[view], []).append(view)
    wanted = sorted(by_row)
    images: Iterator[ByteArray] = recording.frames.images(wanted)
    return {view: image for row, image in zip(wanted, images, strict=True) for view in by_row[row]}


def _pairs(map_: Map, views: Sequence[int], most: int) -> list[_Pair]:
    """The pairs of views whose depth is worth computing: two at most for each of ``most`` / 2 views evenly over the
    walk. Their parallax is 0.03 to 0.4, best 0.1, they look the same way, not along the baseline, and share 15
    landmarks.
    """
    seen = [map_.observations.features[map_.view_offsets[k] : map_.view_offsets[k + 1]] for k in views]
    centres, axes = map_.views.positions[views].astype(np.float64), map_.views.headings[views].astype(np.float64)
    chosen = evenly(len(views), max(1, most // _PARTNERS))
    found: list[_Pair] = []
    for i in chosen.tolist():
        if len(seen[i]) < _MIN_SHARED:
            continue
        distance = float(np.median(_distances(map_, views[i], seen[i])))
        baselines = centres - centres[i]
        apart = np.linalg.norm(baselines, axis=1)
        along = np.abs(baselines @ axes[i]) / np.maximum(apart, 1e-9)
        parallax = apart / distance
        fits = (parallax > _PARALLAX[0]) & (parallax < _PARALLAX[1]) & (along < _MAX_ALONG)
        fits &= axes @ axes[i] > _MIN_ALIGNMENT
        cost = np.abs(np.log(np.maximum(parallax, 1e-9) / _BEST_PARALLAX)) + along
        candidates = [j for j in np.argsort(cost).tolist() if fits[j]]
        shared = (j for j in candidates if len(np.intersect1d(seen[i], seen[j])) >= _MIN_SHARED)
        found += [_Pair(views[i], views[j]) for j, _ in zip(shared, range(_PARTNERS), strict=False)]
    return found


def _distances(map_: Map, view: int, features: IntArray) -> FloatArray:
    """Distances (N,) of landmarks from a view."""
    return np.asarray(np.linalg.norm(map_.landmarks.positions[features] - map_.views.positions[view], axis=1))


def _stereo(map_: Map, camera: Camera, images: Mapping[int, ByteArray], pair: _Pair) -> DepthView:
    """Depth of the first view of a pair, in rectified axes whose x points to the second view."""
    T_a, T_b = (map_.views.T_map_camera[view] for view in pair)
    baseline = T_b[:3, 3] - T_a[:3, 3]
    length = float(np.linalg.norm(baseline))
    x = baseline / length
    z = T_a[:3, 2] + T_b[:3, 2]
    z = z - x * (x @ z)
    z /= np.linalg.norm(z)
    R_map_pair = np.column_stack([x, np.cross(z, x), z])
    focal, centre = _window(camera, T_a[:3, :3].T @ R_map_pair)
    (left, shown), (right, _) = (
        _rectified(images[view], camera, T[:3, :3].T @ R_map_pair, focal, centre)
        for view, T in zip(pair, (T_a, T_b), strict=True)
    )
    view = pair.first
    features = map_.observations.features[map_.view_offsets[view] : map_.view_offsets[view + 1]]
    nearest = _NEAREST * float(np.quantile(_distances(map_, view, features), 0.05))
    disparities = int(np.clip(16 * np.ceil(focal * length / nearest / 16), 16, _MAX_DISPARITY))
    disparity = _disparity(left, right, disparities)
    disparity[~shown | (disparity < _SMALLEST_DISPARITY)] = np.nan
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R_map_pair, T_a[:3, 3]
    depth = (focal * length / disparity).astype(np.float32)
    return DepthView(T, focal, centre, depth, left[..., ::-1], frozenset(pair))


def _window(camera: Camera, R_camera_pair: FloatArray) -> tuple[float, FloatArray]:
    """Focal length and centre (2,) [px] of a square picture in a pair's axes that shows what the camera sees, up to a
    slope of 1.2.
    """
    u, v = (np.linspace(0, size - 1, _RIM) for size in (camera.width, camera.height))
    rim = np.concatenate([np.column_stack([u, np.full(_RIM, at)]) for at in (v[0], v[-1])])
    rim = np.concatenate([rim, *(np.column_stack([np.full(_RIM, at), v]) for at in (u[0], u[-1]))])
    rays = camera.rays(rim) @ R_camera_pair
    slopes = np.clip(rays[:, :2] / np.maximum(rays[:, 2:], 0.1), -_MAX_SLOPE, _MAX_SLOPE)
    low, high = slopes.min(axis=0), slopes.max(axis=0)
    focal = (SIDE - 1) / float((high - low).max())
    return focal, (SIDE - 1) / 2 - focal * (low + high) / 2


def _rectified(
    image: ByteArray, camera: Camera, R_camera_pair: FloatArray, focal: float, centre: FloatArray
) -> tuple[ByteArray, BoolArray]:
    """A frame in a pair's axes (S, S, 3) BGR, by ``focal`` and ``centre`` [px]; the mask (S, S) of what it shows."""
    camera = camera.fitted(*image.shape[1::-1])
    pixels = camera.project(_rays(focal, centre, _COARSE) @ R_camera_pair.T).reshape(len(_FINER[0]), -1, 2)
    at_u, at_v = (_FINER @ np.nan_to_num(pixels[..., k], nan=-1e4) @ _FINER.T for k in range(2))
    shown = (at_u >= 0) & (at_v >= 0) & (at_u <= camera.width - 1) & (at_v <= camera.height - 1)
    u, v = (np.where(shown, at, -1).astype(np.float32) for at in (at_u, at_v))
    return np.asarray(cv2.remap(_smoothed(image, focal / camera.focal), u, v, cv2.INTER_LINEAR)), shown


def _smoothed(image: ByteArray, scale: float) -> ByteArray:
    """An image blurred to the detail that it has at ``scale`` × its width; unchanged for a scale above 0.8."""
    return image if scale > _SHARP else np.asarray(cv2.GaussianBlur(image, (0, 0), 0.4 / scale))


def _rays(focal: float, centre: FloatArray, step: int = 1) -> FloatArray:
    """Rays (N · N, 3) with z = 1 of every ``step``-th pixel of a rectified picture (SIDE, SIDE), row by row."""
    v, u = np.mgrid[0:SIDE:step, 0:SIDE:step]
    return np.stack([(u - centre[0]) / focal, (v - centre[1]) / focal, np.ones(u.shape)], axis=-1).reshape(-1, 3)


def _interpolation() -> FloatArray:
    """Matrix (S, N) of linear interpolation from every eighth pixel of a row (N) to all its S pixels."""
    at = np.arange(SIDE) / _COARSE
    return np.asarray(np.maximum(0.0, 1 - np.abs(at[:, None] - np.arange(SIDE // _COARSE + 1))))


_FINER = _interpolation()


def _disparity(left: ByteArray, right: ByteArray, disparities: int) -> FloatArray:
    """Disparity (S, S) float32 of ``left`` [px], below ``disparities``; negative or NaN where unknown or blank."""
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=disparities,
        blockSize=_BLOCK,
        P1=8 * _BLOCK**2,
        P2=32 * _BLOCK**2,
        disp12MaxDiff=1,
        uniquenessRatio=8,
        speckleWindowSize=80,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    greys = [cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) for picture in (left, right)]
    padded = [cv2.copyMakeBorder(grey, 0, 0, disparities, 0, cv2.BORDER_REPLICATE) for grey in greys]
    found = matcher.compute(*padded)[:, disparities:].astype(np.float32) / 16
    grey = greys[0].astype(np.float32)
    mean = cv2.blur(grey, (_BLOCK, _BLOCK))
    contrast = cv2.blur(grey * grey, (_BLOCK, _BLOCK)) - mean * mean
    found[contrast < _MIN_CONTRAST**2] = np.nan
    return np.asarray(found)


def _agreeing(views: Sequence[DepthView]) -> list[DepthView]:
    """Depth views without unconfirmed pixels: one of the five nearest views of other pairs must agree within 3 %."""
    centres = np.array([view.T_map_camera[:3, 3] for view in views]).reshape(-1, 3)
    axes = np.array([view.T_map_camera[:3, 2] for view in views]).reshape(-1, 3)
    kept = []
    for number, view in enumerate(views):
        points, pixels = view.points()
        agreed = np.zeros(len(points), dtype=bool)
        near = np.argsort(np.linalg.norm(centres - centres[number], axis=1) - axes @ axes[number])
        others = [other for other in near.tolist() if views[other].pair != view.pair][:_JUDGES]
        for other in others:
            z, measured, _, _ = views[other].look_at(points)
            with np.errstate(invalid="ignore"):
                agreed |= np.abs(measured - z) < _AGREEMENT * z
        depth = np.full_like(view.depth, np.nan)
        v, u = pixels[agreed].T
        depth[v, u] = view.depth[v, u]
        kept.append(replace(view, depth=depth))
    return kept


def _recorded(
    map_: Map, camera: Camera, recording: Recording, depth: DepthImages, rows: Mapping[int, int], most: int
) -> list[DepthView]:
    """Recorded depths of at most ``most`` evenly chosen views, in the map's unit by their median ratio to the
    landmarks'. Empty with fewer than 20 ratios, or if these deviate by more than 10 % in the median.
    """
    having = [view for view, row in rows.items() if depth.paths[row] is not None]
    chosen = [having[i] for i in evenly(len(having), most)]
    images, found, ratios = _images(recording, rows, set(chosen)), [], []
    focal, centre = _window(camera, np.eye(3))
    for view in chosen:
        measured = depth.of_frame(rows[view], camera)
        if measured is None:
            continue
        T = map_.views.T_map_camera[view]
        features = map_.observations.features[map_.view_offsets[view] : map_.view_offsets[view + 1]]
        local = (map_.landmarks.positions[features] - T[:3, 3]) @ T[:3, :3]
        ratios.append(local[:, 2] / measured.at(local))
        colours, shown = _rectified(images[view], camera, np.eye(3), focal, centre)
        metres = measured.at(_rays(focal, centre)).reshape(SIDE, SIDE).astype(np.float32)
        metres[~shown] = np.nan
        found.append(DepthView(T, focal, centre, metres, colours[..., ::-1], frozenset([view])))
    together = np.concatenate(ratios) if ratios else np.zeros(0)
    together = together[np.isfinite(together)]
    if len(together) < _MIN_RATIOS:
        return []
    scale = float(np.median(together))
    if np.median(np.abs(together / scale - 1)) > 0.1:
        return []
    return [replace(view, depth=view.depth * np.float32(scale)) for view in found]
