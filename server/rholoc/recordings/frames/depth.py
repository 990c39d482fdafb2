"""Depth images that come with a recording's frames."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from rholoc.errors import InvalidImage
from rholoc.geometry import Camera, FloatArray, IntArray
from rholoc.recordings.frames.image import read_grey

MILLIMETRE_M = 1e-3


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

    def select(self, rows: IntArray) -> DepthImages:
        """Those of some rows."""
        return replace(self, paths=tuple(self.paths[row] for row in rows))
