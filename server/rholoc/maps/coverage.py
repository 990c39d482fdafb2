"""A map's coverage: how many landmarks a camera would see, by position and heading.

Positions lie on a grid around the views, at the height of the camera; at each, a camera like the map's looks in twelve
directions. A landmark counts if it is expected from there (presence π_f, :mod:`rholoc.density.presence`) and in the
field of view. Occlusions between the views are unknown.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from rholoc.density.presence import Presence
from rholoc.geometry import FloatArray, IntArray
from rholoc.maps.map import Map
from rholoc.reports import CoverageReport

HEADINGS = 12
SUFFICIENT = 60  # landmarks in view, for localization to be expected

_STEP_M = 0.25
_REACH_M = 0.75  # from a view
_MAX_CELLS = 250
_GROWTH = 1.15  # factor for the step while there are too many cells
_MAX_COUNT = 9999
_MIN_UPRIGHT = np.cos(np.deg2rad(45.0))
_DEPTH_OF_A_ROOM_M = 2.5  # the assumed distance of landmarks in a map of arbitrary scale


@dataclass(frozen=True, eq=False)
class Coverage:
    """C positions on a plane's grid, H headings in it.

    Attributes:
        origin: (3,) the position of cell (0, 0), map frame, metres.
        axes: (2, 3) unit vectors of a cell's first and second index.
        up: (3,) unit vector across the plane.
        step_m: between cells.
        pitch_deg: of the camera above the plane.
        cells: (C, 2) indices of the cells.
        headings_deg: (H,) from the first axis towards the second.
        counts: (C, H) landmarks in view, at most 9999.
    """

    origin: FloatArray
    axes: FloatArray
    up: FloatArray
    step_m: float
    pitch_deg: float
    cells: IntArray
    headings_deg: FloatArray
    counts: IntArray

    @property
    def positions(self) -> FloatArray:
        """Positions (C, 3) of the cells [m], map frame."""
        return np.asarray(self.origin + self.step_m * self.cells @ self.axes)

    @property
    def share_sufficient(self) -> float:
        """Share 0 to 1 of positions and headings with at least ``SUFFICIENT`` landmarks in view; 0 without any."""
        return float((self.counts >= SUFFICIENT).mean()) if self.counts.size else 0.0

    def report(self) -> CoverageReport:
        """The coverage rounded for a map's report; less than 20 kB as JSON."""
        sufficient = self.counts >= SUFFICIENT
        some = self.counts.size > 0
        return CoverageReport(
            share_sufficient=round(self.share_sufficient, 4),
            positions_sufficient=round(float(sufficient.any(axis=1).mean()), 4) if some else 0.0,
            median=float(np.median(self.counts)) if some else 0.0,
            sufficient=SUFFICIENT,
            origin=tuple(np.round(self.origin, 4).tolist()),
            axes=_rows(np.round(self.axes, 6)),
            step=round(self.step_m, 6),
            pitch_deg=round(self.pitch_deg, 1),
            headings_deg=tuple(self.headings_deg.tolist()),
            cells=_rows(self.cells),
            counts=_rows(self.counts),
        )


def coverage_of(map_: Map) -> Coverage:
    """Coverage of a map within 0.75 m of its views.

    The plane is horizontal if the map is upright, else perpendicular to the views' mean up. The step is 0.25 m, or more
    to have at most 250 positions; in maps of arbitrary scale the landmarks' distance defines a metre.
    """
    positions, rotations = map_.views.positions, map_.views.T_map_camera[:, :3, :3]
    up, axes = _plane(rotations, map_.info.upright)
    height, pitch = _height_and_pitch(positions, rotations, up)
    origin, step_m, cells = _grid(positions @ axes.T, _metre(map_, positions))
    headings_deg = np.arange(HEADINGS) * (360.0 / HEADINGS)
    coverage = Coverage(
        origin=origin @ axes + height * up,
        axes=axes,
        up=up,
        step_m=step_m,
        pitch_deg=float(np.degrees(pitch)),
        cells=cells,
        headings_deg=headings_deg,
        counts=np.zeros((len(cells), HEADINGS), dtype=np.int64),
    )
    if len(map_):
        _count(map_, coverage)
    return coverage


def _rows(array: FloatArray | IntArray) -> tuple[tuple[Any, ...], ...]:
    """A two-dimensional array as tuples of numbers, one for each row."""
    return tuple(map(tuple, array.tolist()))


def _plane(rotations: FloatArray, upright: bool) -> tuple[FloatArray, FloatArray]:
    """Up (3,), and two axes (2, 3) of the plane across it, right-handed. Up is z, and the axes x and y, if the map is
    upright or the cameras' mean up (of rotations (K, 3, 3)) is within 45° of z.
    """
    z = np.array([0.0, 0.0, 1.0])
    mean = -rotations[:, :, 1].mean(axis=0) if len(rotations) else z
    length = np.linalg.norm(mean)
    if upright or length < 1e-6 or mean[2] / length > _MIN_UPRIGHT:
        return z, np.eye(3)[:2]
    up = mean / length
    first = np.eye(3)[np.argmin(np.abs(up))]
    first = first - (first @ up) * up
    first /= np.linalg.norm(first)
    return up, np.stack([first, np.cross(up, first)])


def _height_and_pitch(positions: FloatArray, rotations: FloatArray, up: FloatArray) -> tuple[float, float]:
    """Median height along ``up`` (3,), and pitch [rad] above its plane, of positions (K, 3) and rotations (K, 3, 3)."""
    if len(positions) == 0:
        return 0.0, 0.0
    return float(np.median(positions @ up)), float(np.median(np.arcsin(np.clip(rotations[:, :, 2] @ up, -1, 1))))


def _metre(map_: Map, positions: FloatArray) -> float:
    """Length of a metre in the map's unit: 1 if metric or without observations, else the median distance of its
    landmarks from the views (at ``positions``, (K, 3)) that see them, over 2.5.
    """
    if map_.info.metric or len(map_.observations) == 0:
        return 1.0
    seen_from = positions[map_.observations.views]
    distances = np.linalg.norm(map_.landmarks.positions[map_.observations.features] - seen_from, axis=1)
    return max(float(np.median(distances)) / _DEPTH_OF_A_ROOM_M, 1e-9)


def _grid(places: FloatArray, metre: float) -> tuple[FloatArray, float, IntArray]:
    """Origin (2,), step and cells (C, 2) of the grid within 0.75 ``metre`` of ``places`` (K, 2), at most 250 cells."""
    step = _STEP_M * metre
    if len(places) == 0:
        return np.zeros(2), step, np.zeros((0, 2), dtype=np.int64)
    tree, reach = cKDTree(places), _REACH_M * metre
    low, high = places.min(axis=0) - reach, places.max(axis=0) + reach
    step = max(step, float((high - low).max()) / 1000)
    while True:
        first, last = np.ceil(low / step).astype(int), np.floor(high / step).astype(int)
        i, j = np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(first, last, strict=True)), indexing="ij")
        numbers = np.column_stack([i.ravel(), j.ravel()])
        near = np.asarray(tree.query(numbers * step, distance_upper_bound=reach)[0] <= reach)
        if near.sum() <= _MAX_CELLS:
            return first * step, step, numbers[near] - first
        step *= _GROWTH


def _count(map_: Map, coverage: Coverage) -> None:
    """Write the number of landmarks in view of each cell and heading into ``coverage.counts``."""
    landmarks = map_.landmarks.positions.astype(np.float64)
    presence = Presence.of(landmarks, map_.views.positions[map_.observations.views], map_.observations.features)
    R_camera_map = _upright_cameras(coverage)
    for cell, position in enumerate(coverage.positions):
        present = landmarks[presence.allows(landmarks, position)] - position
        in_view = map_.info.camera.shows(present @ R_camera_map.transpose(0, 2, 1))
        coverage.counts[cell] = np.minimum(in_view.sum(axis=1), _MAX_COUNT)


def _upright_cameras(coverage: Coverage) -> FloatArray:
    """R_camera_map (H, 3, 3) of cameras that do not roll, one for each heading."""
    angles, pitch = np.deg2rad(coverage.headings_deg), np.deg2rad(coverage.pitch_deg)
    level = np.column_stack([np.cos(angles), np.sin(angles)]) @ coverage.axes
    forward = np.cos(pitch) * level + np.sin(pitch) * coverage.up
    right = np.cross(level, coverage.up)
    return np.stack([right, np.cross(forward, right), forward], axis=1)
