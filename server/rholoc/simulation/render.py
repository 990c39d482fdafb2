"""Pictures of a scene: exact projection and occlusion, anti-aliased paint.

A pixel's rectangle is found by painting the scene back to front; on it, texture coordinates are a homography of the
pixel. All faces share one atlas that holds every face at every level of its mipmap, so that a picture is one look-up
per pixel. Sampling is distributed (Cook et al. 1984): one sample per pixel, repeated at other places within the
pixel and other times within the exposure, gives smooth edges and motion blur at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import cv2
import numpy as np

from rholoc.geometry import BoolArray, ByteArray, Camera, FloatArray, IntArray, Pose
from rholoc.simulation.scene import Building, DrawOrder, Face, Scene

_NEAR_M = 0.02
_SMALLEST_EDGE_M2 = 1e-9
_MAX_ROOMS_DEEP = 8
_GUTTER_PX = 2
_MAX_LEVELS = 7
_ATLAS_WIDTH_PX = 8192
_SHARPNESS = -0.35  # mipmap levels finer than the footprint of one sample: several samples share a pixel
SAMPLES = ((-1 / 3, 0.0), (1 / 3, -1 / 3), (0.0, 1 / 3))  # places in the pixel (u, v)
_LEVEL_DITHER = (-1 / 3, 0.0, 1 / 3)


@dataclass(frozen=True, eq=False)
class Atlas:
    """All faces' paint at all levels in one image.

    Attributes:
        image: (H, W, 3) uint8.
        left, top, scale_x, scale_y: (faces, levels) float32: where a level's texel (0, 0) lies and its texels per
            texel of level 0.
    """

    image: ByteArray
    left: FloatArray
    top: FloatArray
    scale_x: FloatArray
    scale_y: FloatArray

    @classmethod
    def of(cls, paints: Sequence[ByteArray]) -> Atlas:
        """Pack the mipmaps of images (H, W, 3), seven levels each, tallest first, in rows of 8192 px."""
        tiles: list[tuple[int, int, ByteArray]] = []
        scale = np.ones((2, len(paints), _MAX_LEVELS), np.float32)
        place = np.zeros((2, len(paints), _MAX_LEVELS), np.float32)
        for f, paint in enumerate(paints):
            image, (height, width) = paint, paint.shape[:2]
            for level in range(_MAX_LEVELS):
                if level:
                    size = max(1, round(width / 2**level)), max(1, round(height / 2**level))
                    image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
                scale[0, f, level], scale[1, f, level] = image.shape[1] / width, image.shape[0] / height
                tiles.append((f, level, image))
        tiles.sort(key=lambda tile: -tile[2].shape[0])
        spots, x, y, row = [], 0, 0, 0
        for _, _, image in tiles:
            height, width = image.shape[0] + 2 * _GUTTER_PX, image.shape[1] + 2 * _GUTTER_PX
            if x + width > _ATLAS_WIDTH_PX:
                x, y, row = 0, y + row, 0
            spots.append((x, y))
            x, row = x + width, max(row, height)
        atlas = np.zeros((y + row, _ATLAS_WIDTH_PX, 3), np.uint8)
        for (f, level, image), (x, y) in zip(tiles, spots, strict=True):
            padded = np.pad(image, ((_GUTTER_PX,) * 2, (_GUTTER_PX,) * 2, (0, 0)), mode="edge")
            atlas[y : y + padded.shape[0], x : x + padded.shape[1]] = padded
            place[:, f, level] = x + _GUTTER_PX, y + _GUTTER_PX
        return cls(atlas, place[0], place[1], scale[0], scale[1])


@dataclass(frozen=True, eq=False)
class Surface:
    """Visible surface at each pixel's centre.

    Attributes:
        face: (H, W) int64, the face's index in ``scene.faces``.
        depth: (H, W) metres along the optical axis.
        points: (H, W, 3) metres, map frame.
    """

    face: IntArray
    depth: FloatArray
    points: FloatArray


@dataclass(frozen=True)
class _Rows:
    """Some rows of a camera's image, which are a pinhole camera's image too."""

    camera: Camera
    top: int
    height: int

    @property
    def width(self) -> int:
        """Width [px]."""
        return self.camera.width

    @property
    def focal_px(self) -> tuple[float, float]:
        """Focal lengths along u and v [px]."""
        return self.camera.fx, self.camera.fy

    @property
    def centre_px(self) -> tuple[float, float]:
        """Principal point, u and v, counted from the first of these rows."""
        return self.camera.cx, self.camera.cy - self.top

    @property
    def inverse_matrix(self) -> FloatArray:
        """Matrix (3, 3) from homogeneous pixels of these rows to rays with z = 1."""
        (fx, fy), (cx, cy) = self.focal_px, self.centre_px
        return np.array([[1 / fx, 0, -cx / fx], [0, 1 / fy, -cy / fy], [0, 0, 1]])


@dataclass(frozen=True, eq=False)
class _Room:
    """Drawing data of one room: indices of its faces, walls first, then box after box."""

    draw_order: DrawOrder
    faces: range
    groups: list[range]

    @classmethod
    def of(cls, scene: Scene, first: int) -> _Room:
        """Drawing data of a room whose first face has the index ``first``."""
        counts = first + np.cumsum([len(scene.room.paints), *(len(box.paints) for box in scene.boxes)])
        groups = [range(first, int(counts[0])), *(range(a, b) for a, b in pairwise(counts.tolist()))]
        return cls(DrawOrder(scene.boxes), range(first, int(counts[-1])), groups)


_PaintOrder = Callable[[int], tuple[list[int], list[int]]]


@dataclass(frozen=True, eq=False)
class _Layer:
    """Faces to paint, back to front, and the planes through the eye (N, 3) between which they are seen, or None."""

    faces: list[int]
    window: FloatArray | None


class Renderer:
    """Draws a scene or a building with ``paints``, one image per face of ``scene.faces``.

    The camera must have no distortion and stand inside a room, outside of the boxes. Of a building only what is seen
    through the openings between the rooms is painted, each room clipped to the opening (Luebke and Georges 1995).
    """

    def __init__(self, scene: Scene | Building, paints: Sequence[ByteArray]) -> None:
        self.scene = scene
        self._building = scene if isinstance(scene, Building) else Building.of(scene)
        self._faces = scene.faces
        self._atlas = Atlas.of(paints)
        self._rooms: list[_Room] = []
        for room in self._building.rooms:
            self._rooms.append(_Room.of(room, self._rooms[-1].faces.stop if self._rooms else 0))
        self._corners = np.array([_corners(face) for face in self._faces])
        self._normals = np.array([face.normal for face in self._faces])
        self._texels = np.array([[paint.shape[1], paint.shape[0]] for paint in paints], dtype=np.float64)
        self._frames = np.array([np.column_stack([f.right, f.down, f.origin]) for f in self._faces])

    def radiance(self, camera: Camera, poses: Sequence[Pose], rows: tuple[int, int] | None = None) -> ByteArray:
        """The picture (H, W, 3) of encoded luminance: the mean of one sample per pixel at each pose.

        ``poses`` are the camera's along the exposure; the samples' places within the pixel cycle through ``SAMPLES``.
        Only ``rows``, from the first to before the last, are drawn, None: all.
        """
        top, bottom = rows or (0, camera.height)
        part = _Rows(camera, top, bottom - top)
        order = self._paint_orders(poses[len(poses) // 2].position)
        total = np.zeros((part.height, part.width, 3), np.uint16)
        for i, pose in enumerate(poses):
            total += self._sample(part, pose, order, SAMPLES[i % len(SAMPLES)], _LEVEL_DITHER[i % len(SAMPLES)])
        half = len(poses) // 2
        return np.asarray(((total + half) // len(poses)).astype(np.uint8))

    def surface(self, camera: Camera, pose: Pose) -> Surface:
        """The visible surface at the pixels' centres from a pose in a room."""
        whole = _Rows(camera, 0, camera.height)
        ids = self._identify(whole, pose, self._paint_orders(pose.position), (0.0, 0.0))[0]
        T = pose.inverse()
        normals = self._normals @ T[:3, :3].T
        offsets = np.einsum("fk,fk->f", normals, self._corners[:, 0] @ T[:3, :3].T + T[:3, 3])
        u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)
        depth = offsets[ids] / np.einsum("hwk,hwk->hw", normals[ids], rays)
        points = (rays * depth[..., None]) @ pose.R_map_camera.T + pose.position
        return Surface(ids.astype(np.int64), depth, points)

    def _paint_orders(self, eye: FloatArray) -> _PaintOrder:
        """Function of a room's index: walls, and boxes' faces, that may be seen from ``eye``, each back to front."""

        @cache
        def order(room: int) -> tuple[list[int], list[int]]:
            painted = self._rooms[room]
            own = slice(painted.faces.start, painted.faces.stop)
            facing = np.einsum("fk,fk->f", self._normals[own], eye - self._corners[own, 0]) > 0
            walls, *boxes = painted.groups
            furniture = [f for box in painted.draw_order(eye) for f in boxes[box]]
            first = painted.faces.start
            return [f for f in walls if facing[f - first]], [f for f in furniture if facing[f - first]]

        return order

    def _layers(self, part: _Rows, T: FloatArray, eye: FloatArray, order: _PaintOrder) -> Iterator[_Layer]:
        """Iterate over layers in painting order: walls, the view through their openings (eight rooms deep), the boxes
        before them.
        """

        def room_seen(room: int, came_from: int | None, window: FloatArray | None, depth: int) -> Iterator[_Layer]:
            walls, boxes = order(room)
            if not self._building.portals[room]:
                yield _Layer(walls + boxes, window)
                return
            yield _Layer(walls, window)
            for portal in self._building.portals[room]:
                if portal.into == came_from or depth == _MAX_ROOMS_DEEP:
                    continue
                opening = _clip(portal.corners @ T[:3, :3].T + T[:3, 3], window)
                if len(opening) >= 3 and _may_be_seen(part, opening[None])[0]:
                    yield from room_seen(portal.into, room, _planes_through(opening), depth + 1)
            yield _Layer(boxes, window)

        return room_seen(self._building.room_at(eye), None, None, 0)

    def _identify(
        self, part: _Rows, pose: Pose, order: _PaintOrder, shift: tuple[float, float]
    ) -> tuple[IntArray, dict[int, tuple[int, int, int, int]]]:
        """The face at each pixel (H, W), sampled ``shift`` (u, v) from the centres, and the painted faces' bounds
        (rows, columns).
        """
        T = pose.inverse()
        ids = np.zeros((part.height, part.width), np.int16)
        bounds: dict[int, tuple[int, int, int, int]] = {}
        for layer in self._layers(part, T, pose.position, order):
            if not layer.faces:
                continue
            corners = self._corners[layer.faces] @ T[:3, :3].T + T[:3, 3]
            seen = _may_be_seen(part, corners)
            if layer.window is not None:
                seen &= ~np.any((corners @ layer.window.T < 0).all(axis=1), axis=1)
            for f, polygon in zip(np.array(layer.faces)[seen].tolist(), corners[seen], strict=True):
                clipped = _clip_near(_clip(polygon, layer.window))
                if len(clipped) < 3:
                    continue
                pixels = clipped[:, :2] / clipped[:, 2:] * part.focal_px + np.subtract(part.centre_px, shift)
                spans = _spans(pixels, part.width, part.height)
                if spans is None:
                    continue
                top, left, right = spans
                x0, x1 = int(left.min()), int(right.max()) + 1
                columns = np.arange(x0, x1, dtype=np.int16)
                inside = (columns >= left[:, None]) & (columns <= right[:, None])
                np.copyto(ids[top : top + len(left), x0:x1], np.int16(f), where=inside)
                found = (top, top + len(left), x0, x1)
                bounds[f] = _hull(bounds[f], found) if f in bounds else found
        return ids, bounds

    def _sample(
        self, part: _Rows, pose: Pose, order: _PaintOrder, shift: tuple[float, float], dither: float
    ) -> ByteArray:
        """One sample per pixel (H, W, 3), ``shift`` from the centres; ``dither`` is added to the mipmap level."""
        ids, bounds = self._identify(part, pose, order, shift)
        map_x = np.zeros(ids.shape, np.float32)
        map_y = np.zeros(ids.shape, np.float32)
        T = pose.inverse()
        visible = np.flatnonzero(np.bincount(ids.ravel(), minlength=len(self._faces)))
        K_inverse = part.inverse_matrix
        for f in visible.tolist():
            if f not in bounds:
                continue
            y0, y1, x0, x1 = bounds[f]
            plane_to_camera = T[:3, :3] @ self._frames[f]
            plane_to_camera[:, 2] += T[:3, 3]
            # pixel → (a, b, 1) up to scale; the scale is 1 / depth
            H = np.linalg.inv(plane_to_camera) @ K_inverse
            H[:2] *= self._texels[f][:, None]
            u = np.arange(x0, x1) + shift[0]
            v = np.arange(y0, y1) + shift[1]
            x, y, w = ((row[0] * u).astype(np.float32) + (row[1] * v + row[2]).astype(np.float32)[:, None] for row in H)
            with np.errstate(divide="ignore"):  # outside the face, where nothing is taken
                np.divide(np.float32(1), w, out=w)
            with np.errstate(invalid="ignore"):
                x *= w
                y *= w
            # The footprint's area in texels is |det H| / w³ for a pixel at homogeneous scale w.
            bias = 0.5 * np.log2(abs(np.linalg.det(H))) + _SHARPNESS + dither + 0.5
            level = np.log2(np.abs(w, out=w), out=w)
            level *= np.float32(1.5)
            level += np.float32(bias)
            np.clip(level, 0, _MAX_LEVELS - 1, out=level)
            mask = ids[y0:y1, x0:x1] == f
            self._to_atlas(f, level, mask, x, y)
            np.copyto(map_x[y0:y1, x0:x1], x, where=mask)
            np.copyto(map_y[y0:y1, x0:x1], y, where=mask)
        return np.asarray(cv2.remap(self._atlas.image, map_x, map_y, cv2.INTER_LINEAR))

    def _to_atlas(self, f: int, level: FloatArray, mask: BoolArray, x: FloatArray, y: FloatArray) -> None:
        """Turn texel-edge coordinates ``x``, ``y`` of level 0 into the atlas's pixels of ``level``, in place."""
        atlas = self._atlas
        chosen = level.astype(np.uint8)
        low, high = int(chosen.min(where=mask, initial=_MAX_LEVELS - 1)), int(chosen.max(where=mask, initial=0))
        for values, scale, start in ((x, atlas.scale_x[f], atlas.left[f]), (y, atlas.scale_y[f], atlas.top[f])):
            if low == high:
                values *= scale[low]
                values += start[low] - np.float32(0.5)
            else:
                values *= scale[chosen]
                values += (start - np.float32(0.5))[chosen]


def _corners(face: Face) -> FloatArray:
    """Corners (4, 3) [m]: the origin, then those at the ends of ``right``, of both, and of ``down``."""
    a, b = np.array([0.0, 1, 1, 0]), np.array([0.0, 0, 1, 1])
    return face.points(a, b)


def _may_be_seen(part: _Rows, polygons: FloatArray) -> BoolArray:
    """Mask (F,) of polygons (F, N, 3), camera frame, not all beyond one side of the view nor all nearer than 2 cm."""
    x, y, z = np.moveaxis(polygons, 2, 0)
    (fx, fy), (cx, cy) = part.focal_px, part.centre_px
    left, right = -(cx + 1) / fx, (part.width - cx) / fx
    top, bottom = -(cy + 1) / fy, (part.height - cy) / fy
    sides = (z < _NEAR_M, x < left * z, x > right * z, y < top * z, y > bottom * z)
    return np.asarray(~np.any([side.all(axis=1) for side in sides], axis=0))


def _hull(a: tuple[int, int, int, int], b: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
    """The smallest bounds (top, bottom, left, right) around both."""
    return min(a[0], b[0]), max(a[1], b[1]), min(a[2], b[2]), max(a[3], b[3])


def _planes_through(opening: FloatArray) -> FloatArray:
    """The inward unit normals (N, 3) of the planes through the eye and the edges of a polygon (N, 3), camera frame."""
    normals = np.cross(opening, np.roll(opening, -1, axis=0))
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals[lengths > _SMALLEST_EDGE_M2] / lengths[lengths > _SMALLEST_EDGE_M2, None]
    return np.asarray(normals * np.where(normals @ opening.mean(axis=0) < 0, -1.0, 1.0)[:, None])


def _clip(polygon: FloatArray, window: FloatArray | None) -> FloatArray:
    """The part of a polygon (N, 3) on the positive side of planes through the eye, of normals (M, 3); None: all."""
    if window is None:
        return polygon
    for normal in window:
        if len(polygon) < 3:
            break
        polygon = _clip_at(polygon, polygon @ normal)
    return polygon


def _clip_near(polygon: FloatArray) -> FloatArray:
    """The part of a polygon (N, 3) in the camera frame that is at least 2 cm before the camera; maybe empty."""
    return polygon if len(polygon) < 3 else _clip_at(polygon, polygon[:, 2] - _NEAR_M)


def _clip_at(polygon: FloatArray, depth: FloatArray) -> FloatArray:
    """The part of a polygon (N, 3) where ``depth`` (N,), linear over it, is positive (Sutherland and Hodgman)."""
    if (depth > 0).all():
        return polygon
    kept = []
    for i in range(len(polygon)):
        j = (i + 1) % len(polygon)
        if depth[i] > 0:
            kept.append(polygon[i])
        if (depth[i] > 0) != (depth[j] > 0):
            kept.append(polygon[i] + depth[i] / (depth[i] - depth[j]) * (polygon[j] - polygon[i]))
    return np.array(kept).reshape(-1, 3)


def _spans(polygon: FloatArray, width: int, height: int) -> tuple[int, IntArray, IntArray] | None:
    """The pixels whose centres a convex polygon (N, 2) covers: the first row, and each row's first and last column.
    None if it covers none in the picture.
    """
    y = polygon[:, 1]
    top, bottom = max(0, int(np.ceil(y.min()))), min(height - 1, int(np.floor(y.max())))
    if top > bottom or polygon[:, 0].max() < 0 or polygon[:, 0].min() > width - 1:
        return None
    rows = np.arange(top, bottom + 1, dtype=np.float64)
    left, right = np.full(rows.shape, np.inf), np.full(rows.shape, -np.inf)
    for a, b in zip(polygon, (*polygon[1:], polygon[0]), strict=True):
        low, high = (a, b) if a[1] < b[1] else (b, a)
        i0, i1 = max(int(np.ceil(low[1])) - top, 0), min(int(np.floor(high[1])) - top, len(rows) - 1)
        if i0 > i1:
            continue
        crossing = low[0] + (rows[i0 : i1 + 1] - low[1]) * ((high[0] - low[0]) / max(high[1] - low[1], 1e-12))
        np.minimum(left[i0 : i1 + 1], crossing, out=left[i0 : i1 + 1])
        np.maximum(right[i0 : i1 + 1], crossing, out=right[i0 : i1 + 1])
    first = np.ceil(np.clip(left, 0, width)).astype(np.int16)
    last = np.floor(np.clip(right, -1, width - 1)).astype(np.int16)
    keep = np.flatnonzero(first <= last)
    if len(keep) == 0:
        return None
    return top + int(keep[0]), first[keep[0] : keep[-1] + 1], last[keep[0] : keep[-1] + 1]
