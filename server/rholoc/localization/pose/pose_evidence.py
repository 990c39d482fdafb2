"""Evidence for and against a pose, accumulated over cells of the picture.

Adjacent matches are correlated: a hundred matches on one poster show that the poster is there, but not which of two
identical posters. The picture is therefore divided into cells with a bounded contribution each. Expected landmarks
whose cells show something else count against the pose: two rooms may have the same door or the same desk, but not the
same surroundings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np

from rholoc.density import Evidence
from rholoc.geometry import Camera, FloatArray, IntArray
from rholoc.localization.index.map_index import MapIndex
from rholoc.localization.index.matches import Matches
from rholoc.localization.pose.ascent import Optimum
from rholoc.localization.pose.colour_evidence import colour_agreement
from rholoc.localization.pose.patch_evidence import patch_agreement, patch_log_odds
from rholoc.localization.types import Query

_CELLS_ACROSS = 8
_CELL_NATS = 10.0  # maximum evidence of a cell
_CHANCE_NATS = 1.5  # approximate evidence of a match by chance
_VIEWS_ALIKE = 10
_MIN_EXPECTED, _MIN_DETECTED = 2, 3  # landmarks, features of a cell that can contradict
_HIGHEST_RATE = 0.9
_CLOSE_PX, _AROUND_PX = 4.0, 14.0  # of where landmarks should be
_LIKENESSES = np.array([0.95, 0.9, 0.8, 0.65, 0.5, 0.35, 0.2, 0.0])  # lower bounds of classes of match probability
_MIN_BY_CHANCE = 0.15  # lower bound on the expected number of false matches


@dataclass(frozen=True)
class Support:
    """Evidence for and against a pose.

    Attributes:
        seen: nats in favour of the pose from matches, summed over cells.
        missing: nats against the pose from cells that show something other than the expected landmarks.
        found: number of landmarks found where nearby views saw them.
        expected: number of landmarks that should be found, limited by what those views saw and by the query's features.
        beyond_chance: log-likelihood ratio [nats] of the clustering of a wider search's matches at their landmarks,
            against chance.
        colours: agreement of colours, 0 by chance, 1 at best; NaN if unknown. See
            :func:`rholoc.localization.pose.colour_evidence.colour_agreement`.
        patches: agreement of orientation and size [nats per match], about -1 by chance, 2 at best; NaN if unknown. See
            :func:`rholoc.localization.pose.patch_evidence.patch_agreement`.
    """

    seen: float
    missing: float
    found: float = 0.0
    expected: float = 0.0
    beyond_chance: float = 0.0
    colours: float = np.nan
    patches: float = np.nan

    @property
    def net(self) -> float:
        """Nats for the pose minus nats against it, by which hypotheses are compared."""
        return self.seen - self.missing

    @classmethod
    def mean(cls, supports: Sequence[Support]) -> Support:
        """Mean of each figure over several frames; NaN if it is NaN in one. They show much the same scene, so evidence
        is not added up.
        """
        return cls(*np.mean([astuple(one) for one in supports], axis=0).tolist())


def support_of(
    index: MapIndex,
    query: Query,
    found: Matches,
    evidence: Evidence,
    optimum: Optimum,
    by_chance: FloatArray,
    wide: Matches,
) -> Support:
    """Evidence for and against an optimum, over about eight square cells across the picture; all 0 if no match agrees.

    Args:
        index: index of the map.
        query: the frame, with N features.
        found: matches that the optimum is based on.
        evidence: their evidence.
        optimum: the pose.
        by_chance: (N,) probability that each feature matches something near it by chance.
        wide: matches of a wider search.
    """
    pixels, camera = query.features.pixels, query.camera
    agreeing = np.flatnonzero(optimum.density > 0)
    if len(agreeing) == 0:
        return Support(0.0, 0.0)
    detections, landmarks = found.detections[agreeing], found.landmarks[agreeing]
    grid = _Grid.of(camera)
    gains = np.log1p(optimum.density[agreeing] / evidence.epsilon[agreeing])
    said = grid.sums(pixels[detections], gains) - _CHANCE_NATS * grid.sums(pixels, by_chance)
    shown, should_be = _expected(index, landmarks, camera, optimum.T_map_camera)
    expected = grid.sums(should_be)
    is_found = np.isin(shown, landmarks)
    seen = grid.sums(should_be[is_found])
    empty = (seen == 0) & (expected >= _MIN_EXPECTED) & (grid.sums(pixels) >= _MIN_DETECTED)
    rate = min(float(seen.sum()) / max(float(expected[seen > 0].sum()), 1.0), _HIGHEST_RATE)
    against = -np.log(1 - rate) * expected[empty]
    return Support(
        float(np.clip(said, 0, _CELL_NATS).sum()),
        float(np.minimum(against, _CELL_NATS).sum()),
        float(is_found.sum()),
        float(min(len(shown), len(pixels))),
        _beyond_chance(index, pixels, camera, wide, optimum.T_map_camera),
        _colour_agreement(index, query, detections, landmarks),
        patch_agreement(patch_log_odds(index.map, query.features, camera, optimum.T_map_camera, detections, landmarks)),
    )


def _beyond_chance(
    index: MapIndex, pixels: FloatArray, camera: Camera, wide: Matches, T_map_camera: FloatArray
) -> float:
    """Nats by which matches concentrate within 4 px of their projected landmarks, beyond what chance predicts from a
    ring of 4 to 14 px. ``pixels`` (N, 2) are those of the query's features. Chernoff bound on the tail of the Poisson
    distribution, maximized over thresholds on descriptor distance: chance matches are less similar than true ones, but
    the similarity of true matches depends on light and viewing distance. 0 if there are no more than by chance.
    """
    T = T_map_camera
    shown = camera.project((index.landmarks[wide.landmarks] - T[:3, 3]) @ T[:3, :3])
    off_px = np.linalg.norm(shown - pixels[wide.detections], axis=1)
    alike = wide.chances >= _LIKENESSES[:, None]
    close, around = (off_px < _CLOSE_PX), (off_px < _AROUND_PX)
    by_chance = _MIN_BY_CHANCE + (alike & around & ~close).sum(axis=1) * _CLOSE_PX**2 / (_AROUND_PX**2 - _CLOSE_PX**2)
    count = np.maximum((alike & close).sum(axis=1), by_chance)
    return float((count * np.log(count / by_chance) - (count - by_chance)).max())


def _colour_agreement(index: MapIndex, query: Query, detections: IntArray, landmarks: IntArray) -> float:
    """Agreement of the colours of detections (M,) with those of their landmarks (M,), a coefficient of determination: 0
    by chance, 1 at best. NaN if the query or the map has no colours, or fewer than four.
    """
    shown, known = query.colours, index.map.landmarks.colours
    if shown is None or known is None:
        return np.nan
    return colour_agreement(shown[detections], known[landmarks])


def _expected(
    index: MapIndex, agreeing: IntArray, camera: Camera, T_map_camera: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Rows (E,) of the landmarks that this frame should show, and their pixels (E, 2). They were seen by the ten views
    that saw most of the landmarks ``agreeing`` (M,), may be visible from the pose, and project into the picture.
    """
    seen = np.flatnonzero(index.seen_alike(agreeing, _VIEWS_ALIKE))
    rows = seen[index.present(T_map_camera[:3, 3], seen)]
    pixels = camera.project((index.landmarks[rows] - T_map_camera[:3, 3]) @ T_map_camera[:3, :3])
    inside = camera.contains(pixels)
    return rows[inside], pixels[inside]


@dataclass(frozen=True)
class _Grid:
    """Square cells over a picture."""

    size_px: float
    columns: int
    rows: int

    @classmethod
    def of(cls, camera: Camera) -> _Grid:
        """Eight cells across the longer side of an ordinary picture, more across a wide lens's."""
        across = round(_CELLS_ACROSS * camera.breadth)
        size_px = max(camera.width, camera.height) / across
        return cls(size_px, across, int(np.ceil(camera.height / size_px)))

    def sums(self, pixels: FloatArray, weights: FloatArray | None = None) -> FloatArray:
        """Sum of ``weights`` (N,), or number of ``pixels`` (N, 2), per cell (C,), row by row. Pixels outside count to
        the border's cells.
        """
        column, row = np.clip((pixels // self.size_px).astype(np.int64), 0, (self.columns - 1, self.rows - 1)).T
        cells = row * self.columns + column
        return np.bincount(cells, weights, minlength=self.rows * self.columns).astype(np.float64)
