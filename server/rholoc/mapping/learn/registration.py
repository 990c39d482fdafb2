"""Register new frames in a map: localize them one by one, or align their own trajectory."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rholoc.errors import MappingFailed
from rholoc.features import FeatureSet
from rholoc.geometry import (
    BoolArray,
    Camera,
    FloatArray,
    IntArray,
    Pose,
    Similarity,
    evenly,
    pose_distances,
    posed_alignment,
)
from rholoc.localization import Dof, Localizer, Prior, Query
from rholoc.progress import ProgressListener, Stage, silent
from rholoc.reports import LearningReport

LEARNING_RECOGNIZED = 0.8
"""Minimum probability of the right place for a frame that a map learns from."""

_PROBES = 12  # frames, spread over all, by which a recording of another place is recognized at once
MIN_FOUND = 5
_MIN_SHARE = 0.1
_MAX_GAP_S = 2.0  # between localized frames; farther apart they do not confirm each other
_JUMP_M, _JUMP_RAD = 0.1, np.deg2rad(5.0)  # of two poses without any motion
_MAX_SPEED_M_PER_S, _MAX_TURN_RAD_PER_S = 2.0, np.deg2rad(180.0)
_ROUNDS = 10
_MAX_MEDIAN_M = 0.1  # of the localized positions against the aligned ones
_MAX_MEDIAN_RAD = np.deg2rad(3.0)
_MAX_SCALE_ERROR = 0.05  # of two maps or trajectories that both claim to be metric
_MIN_SPREAD_M = 0.05  # of the positions, below which they do not show the scale


@dataclass(frozen=True, eq=False)
class Found:
    """K frames, some of them localized.

    Attributes:
        T_map_camera: (K, 4, 4), NaN for a frame that was refused or not tried.
        tried: number of frames tried.
    """

    T_map_camera: FloatArray
    tried: int

    @property
    def rows(self) -> IntArray:
        """Rows (L,) of the localized frames."""
        return np.flatnonzero(np.isfinite(self.T_map_camera[:, 0, 0]))


def find_frames(
    localizer: Localizer,
    frames: Sequence[tuple[Camera, FeatureSet]],
    rows: IntArray,
    what: str,
    progress: ProgressListener = silent,
) -> Found:
    """Localize the frames in rows ``rows`` (ascending) of a recording; ``what`` names it in messages.

    Raises:
        MappingFailed: none of twelve probes, fewer than five frames, or fewer than a tenth of them, are found.
        Cancelled: ``progress`` asked to stop.
    """
    T = np.full((len(frames), 4, 4), np.nan)
    probes = rows[evenly(len(rows), _PROBES)]
    for row in probes:
        _localize(localizer, frames, int(row), T, None)
    if np.isnan(T[probes, 0, 0]).all():
        raise _elsewhere(0, len(probes), what)
    last: int | None = None
    for done, row in enumerate(rows.tolist()):
        if np.isnan(T[row, 0, 0]):
            _localize(localizer, frames, row, T, last)
        last = row if np.isfinite(T[row, 0, 0]) else last
        progress(Stage.POSES, (done + 1) / len(rows), f"{done + 1} of {len(rows)} frames looked for in the map")
    return _enough(Found(T, len(rows)), what)


def without_jumps(found: Found, times: FloatArray, what: str) -> Found:
    """Drop localized frames that a hand-held camera could not have reached from the previous or next one.

    Within 2 s it moves by at most 0.1 m + 2 m/s and turns by 5° + 180°/s; a frame without such a neighbour is dropped.
    Frames of another place that are mistaken for the map lie anywhere in it; those of a walk do not.

    Args:
        found: K frames.
        times: (K,) [s].
        what: name of the recording in messages.

    Raises:
        MappingFailed: fewer than five frames, or fewer than a tenth of those tried, are left.
    """
    rows = found.rows
    T, elapsed_s = found.T_map_camera[rows], np.diff(times[rows])
    moved, turned = pose_distances(T[:-1], T[1:])
    reached = (
        (elapsed_s <= _MAX_GAP_S)
        & (moved <= _JUMP_M + _MAX_SPEED_M_PER_S * elapsed_s)
        & (turned <= _JUMP_RAD + _MAX_TURN_RAD_PER_S * elapsed_s)
    )
    kept = np.append(reached, False) | np.append(False, reached)
    left = np.full_like(found.T_map_camera, np.nan)
    left[rows[kept]] = T[kept]
    return _enough(Found(left, found.tried), what)


@dataclass(frozen=True, eq=False)
class Alignment:
    """Alignment of a trajectory with a map.

    Attributes:
        similarity: takes the trajectory to the map frame.
        agreeing: (L,) mask of the localized frames that agree with it.
        residual_m: median distance between localized and aligned positions.
        residual_rad: median angle between localized and aligned rotations.
    """

    similarity: Similarity
    agreeing: BoolArray
    residual_m: float
    residual_rad: float


def align_to_found(T_own_camera: FloatArray, found: Found, scale_is_known: bool, what: str) -> Alignment:
    """Align a trajectory's poses (K, 4, 4) with those of its frames localized in the map; ``what`` names it in
    messages.

    Robust least squares, rotations first: every frame determines the rotation between the two frames, so walks along a
    line or on the spot can be aligned too. The scale is 1 if ``scale_is_known``; the error then says whether the scales
    differ.

    Raises:
        MappingFailed: the median residual exceeds 10 cm or 3°, or fewer than five frames are within 30 cm and 9°.
    """
    own, target = T_own_camera[found.rows], found.T_map_camera[found.rows]
    similarity, distance, angle = _fit(own, target, fixed_scale=scale_is_known)
    agreeing = (distance < 3 * _MAX_MEDIAN_M) & (angle < 3 * _MAX_MEDIAN_RAD)
    residual_m, residual_rad = float(np.median(distance)), float(np.median(angle))
    if residual_m > _MAX_MEDIAN_M or residual_rad > _MAX_MEDIAN_RAD or agreeing.sum() < MIN_FOUND:
        free, _, _ = _fit(own, target, fixed_scale=False)
        stretched = abs(free.scale - 1) > _MAX_SCALE_ERROR and scale_is_known
        scales = f" Their units of length differ by {abs(free.scale - 1):.0%}." if stretched else ""
        raise MappingFailed(
            f"{what} and the map disagree: {100 * residual_m:.0f} cm and {np.degrees(residual_rad):.1f}° in the median."
            + scales,
            "One of the two is bent or has the wrong scale: record and build it again.",
        )
    return Alignment(similarity, agreeing, residual_m, residual_rad)


def _fit(own: FloatArray, target: FloatArray, fixed_scale: bool) -> tuple[Similarity, FloatArray, FloatArray]:
    """Robust similarity from poses ``own`` (L, 4, 4) to ``target`` (L, 4, 4); residuals (L,) [m] and (L,) [rad]."""
    weights = np.ones(len(own))
    for _ in range(_ROUNDS):
        similarity = posed_alignment(own, target, weights, fixed_scale, _MIN_SPREAD_M)
        aligned = similarity.poses(own)
        distance, angle = pose_distances(aligned, target)
        weights = 1 / (1 + (distance / max(float(np.median(distance)), 1e-6)) ** 2)
        weights *= 1 / (1 + (angle / max(float(np.median(angle)), 1e-6)) ** 2)
    return similarity, distance, angle


def _localize(
    localizer: Localizer, frames: Sequence[tuple[Camera, FeatureSet]], row: int, T: FloatArray, last: int | None
) -> None:
    """Write the pose of frame ``row`` into T (K, 4, 4), if found near frame ``last`` (None: no prior) or anywhere."""
    camera, features = frames[row]
    query = Query(features, camera, Dof.FREE)
    if last is not None:
        answer = localizer.localize(replace(query, prior=Prior(Pose(T[last]))))
        if answer.pose is not None:
            T[row] = answer.pose.T_map_camera
            return
    answer = localizer.localize(query)
    if answer.pose is not None:
        T[row] = answer.pose.T_map_camera


def _enough(found: Found, what: str) -> Found:
    """``found`` itself. Raises MappingFailed if too few of the tried frames were found."""
    if len(found.rows) < max(MIN_FOUND, _MIN_SHARE * found.tried):
        if 2 * len(found.rows) >= found.tried:
            raise MappingFailed(
                f"Only {len(found.rows)} frames of {what} show the place of the map; at least {MIN_FOUND} are needed.",
                "Give a longer recording; the map is unchanged.",
            )
        raise _elsewhere(len(found.rows), found.tried, what)
    return found


def _elsewhere(found: int, tried: int, what: str) -> MappingFailed:
    """Error for a recording or map, ``what``, of which only ``found`` of ``tried`` frames were localized."""
    return MappingFailed(
        f"{what} does not show the place of the map: {found} of {tried} frames were found in it.",
        "Give one of the same place that overlaps with it; the map is unchanged.",
    )


def alignment_report(alignment: Alignment, found: Found) -> LearningReport:
    """Report on an alignment with the number of frames tried and found; its version is 0, to be filled in."""
    return LearningReport(
        version=0,
        frames_tried=found.tried,
        frames_found=len(found.rows),
        residual_median_m=alignment.residual_m,
        residual_median_deg=float(np.degrees(alignment.residual_rad)),
        scale=alignment.similarity.scale,
    )
