"""Depth images that come with a recording's frames."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from rholoc.errors import InvalidCamera, InvalidImage
from rholoc.geometry import BoolArray, Camera, FloatArray, IntArray
from rholoc.recordings.frames.image import read_grey

MILLIMETRE_M = 1e-3
_MAX_DEPTH_M = 10.0  # beyond, depth cameras say little
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
        """Depths (N,) [m] where points (N, 3) of the camera frame appear; NaN outside and where not reliable."""
        pixels = self.camera.project(points)
        inside = (points[:, 2] > 0) & self.camera.contains(pixels)
        u, v = np.round(pixels[inside]).astype(np.int64).T
        found = np.full(len(points), np.nan)
        found[inside] = np.where(self.reliable[v, u], self.metres[v, u], np.nan)
        return found


@dataclass(frozen=True, eq=False)
class DepthImages:
    """One image of depths along the optical axis for each of some frames.

    Attributes:
        paths: N files of one channel, up to 16 bits a pixel, or None for a frame that has none. They need not exist.
        unit_m: metres of one unit.
        unknown: the values that are no depths.
        camera: their intrinsics; None where they show what the frames show, in their own size.
    """

    paths: tuple[Path | None, ...]
    unit_m: float = MILLIMETRE_M
    unknown: tuple[int, ...] = (0,)
    camera: Camera | None = None

    def read(self, row: int) -> FloatArray | None:
        """(H, W) metres, NaN where unknown; None where the frame has no depth image that can be read."""
        path = self.paths[row]
        if path is None:
            return None
        try:
            values = read_grey(path)
        except InvalidImage:
            return None
        return np.where(np.isin(values, self.unknown), np.nan, values * self.unit_m)

    def of_frame(self, row: int, camera: Camera) -> DepthImage | None:
        """The depth image of the frame in this row, which ``camera`` took; None where there is none to read."""
        metres = self.read(row)
        if metres is None:
            return None
        try:
            own = (self.camera or camera).fitted(metres.shape[1], metres.shape[0])
        except InvalidCamera:
            return None
        return DepthImage(metres, _on_surfaces(metres), own)

    def select(self, rows: IntArray) -> DepthImages:
        """Those of some rows."""
        return replace(self, paths=tuple(self.paths[row] for row in rows))


def _on_surfaces(metres: FloatArray) -> BoolArray:
    """(H, W) where depth is known and about the same next to it: at edges it is of neither side."""
    known = np.nan_to_num(metres, nan=0.0).astype(np.float32)
    around = np.ones((3, 3), np.uint8)
    least, most = cv2.erode(known, around), cv2.dilate(known, around)
    return np.asarray((least > 0) & (most < _MAX_DEPTH_M) & (most - least < _MAX_STEP * known))
