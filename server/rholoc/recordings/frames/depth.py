"""Depth images that come with a recording's frames."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from rholoc.errors import InvalidCamera, InvalidImage
from rholoc.geometry import BoolArray, Camera, FloatArray, IntArray
from rholoc.recordings.frames.image_decoding import read_grey

MILLIMETRE_M = 1e-3
_MAX_DEPTH_M = 10.0  # larger depths are unreliable
_MAX_STEP = 0.05  # between neighbouring pixels on one surface, as a share of the depth


@dataclass(frozen=True, eq=False)
class DepthImage:
    """The depths of one frame.

    Attributes:
        metres: (H, W) along the optical axis, NaN where unknown.
        reliable: (H, W) where the depth is known and its neighbours lie on the same surface.
        camera: intrinsics for its own size.
    """

    metres: FloatArray
    reliable: BoolArray
    camera: Camera

    def at(self, points: FloatArray) -> FloatArray:
        """Depths (N,) [m] at the nearest pixels to the projections of points (N, 3) in the camera frame; NaN outside or
        if unreliable.
        """
        pixels = self.camera.project(points)
        inside = (points[:, 2] > 0) & self.camera.contains(pixels)
        u, v = np.round(pixels[inside]).astype(np.int64).T
        found = np.full(len(points), np.nan)
        found[inside] = np.where(self.reliable[v, u], self.metres[v, u], np.nan)
        return found


@dataclass(frozen=True, eq=False)
class DepthImages:
    """Depth images of frames, along the optical axis.

    Attributes:
        paths: N single-channel files of up to 16 bits, which need not exist; None for a frame without one.
        unit_m: metres per unit.
        unknown: pixel values that stand for an unknown depth.
        camera: their intrinsics; None if they are the frames', scaled to the depth images' size.
    """

    paths: tuple[Path | None, ...]
    unit_m: float = MILLIMETRE_M
    unknown: tuple[int, ...] = (0,)
    camera: Camera | None = None

    def read(self, row: int) -> FloatArray | None:
        """Depths (H, W) [m], NaN where unknown; None if the frame has no readable depth image."""
        path = self.paths[row]
        if path is None:
            return None
        try:
            values = read_grey(path)
        except InvalidImage:
            return None
        return np.where(np.isin(values, self.unknown), np.nan, values * self.unit_m)

    def of_frame(self, row: int, camera: Camera) -> DepthImage | None:
        """Depth image of frame ``row``, taken by ``camera``; None if unreadable, or of another aspect ratio."""
        metres = self.read(row)
        if metres is None:
            return None
        try:
            own = (self.camera or camera).fitted(metres.shape[1], metres.shape[0])
        except InvalidCamera:
            return None
        return DepthImage(metres, _on_surfaces(metres), own)

    def select(self, rows: IntArray) -> DepthImages:
        """The depth images of the frames in rows ``rows`` (M,)."""
        return replace(self, paths=tuple(self.paths[row] for row in rows))


def _on_surfaces(metres: FloatArray) -> BoolArray:
    """Mask (H, W) of depths on a surface: known, below 10 m and differing by under 5 % in the 3 × 3 pixels around."""
    known = np.nan_to_num(metres, nan=0.0).astype(np.float32)
    around = np.ones((3, 3), np.uint8)
    least, most = cv2.erode(known, around), cv2.dilate(known, around)
    return np.asarray((least > 0) & (most < _MAX_DEPTH_M) & (most - least < _MAX_STEP * known))
