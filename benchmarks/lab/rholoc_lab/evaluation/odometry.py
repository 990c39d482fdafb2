"""Drift of odometry from the truth."""

from dataclasses import dataclass

import numpy as np

from rholoc.geometry import (
    UP,
    FloatArray,
    IntArray,
    angles_between,
    pose_distances,
    posed_alignment,
    umeyama,
    upright_umeyama,
)

_SEGMENTS = (0.1, 0.2, 0.4)  # of the way, over which drift is measured
_FEWEST = 4  # poses
_MAX_TILT_RAD = np.deg2rad(10.0)  # of odometry against a truth that is upright


@dataclass(frozen=True, eq=False)
class OdometryErrors:
    """Errors of N odometry poses after their best alignment with the truth.

    Attributes:
        aligned: (N, 4, 4) the poses in the truth's frame and scale.
        scale: of the alignment: true over odometry length.
        path_m: length of the true path.
        rms_m: RMS of the remaining position errors.
        median_deg: median of the remaining rotation errors.
        drift: error of the position relative to an earlier pose over the path length between; mean over segments of 10
            to 40 % of the path.
    """

    aligned: FloatArray
    scale: float
    path_m: float
    rms_m: float
    median_deg: float
    drift: float

    def figures(self) -> dict[str, float]:
        """All figures, JSON-serialisable."""
        return {
            "true_size": round(self.scale, 4),
            "path_m": round(self.path_m, 2),
            "rms_m": round(self.rms_m, 4),
            "median_deg": round(self.median_deg, 3),
            "drift_percent": round(100 * self.drift, 2),
        }


def measure_odometry(T_odom_camera: FloatArray, truth: FloatArray, upright: bool) -> OdometryErrors | None:
    """The errors of poses (N, 4, 4) against the true ones (N, 4, 4), each in its own frame.

    With ``upright`` z points up in the odometry's frame; if it does so in the truth's too, the alignment only turns
    about z. None if fewer than four poses are known, or the camera did not move.
    """
    steps_m = np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1)
    way_m = np.concatenate([[0.0], np.cumsum(steps_m)])
    if len(truth) < _FEWEST or way_m[-1] < 1e-6:
        return None
    align = upright_umeyama if upright and _same_up(T_odom_camera, truth) else umeyama
    similarity = align(T_odom_camera[:, :3, 3], truth[:, :3, 3])
    aligned = similarity.poses(T_odom_camera)
    moved_m, turned_rad = pose_distances(aligned, truth)
    return OdometryErrors(
        aligned,
        similarity.scale,
        float(way_m[-1]),
        float(np.sqrt(np.mean(moved_m**2))),
        float(np.degrees(np.median(turned_rad))),
        _drift(aligned, truth, way_m),
    )


def _same_up(T_odom_camera: FloatArray, truth: FloatArray) -> bool:
    """Whether the cameras' rotations say that z is the same direction in both frames, to ``_MAX_TILT_RAD``."""
    turn = posed_alignment(T_odom_camera, truth, np.ones(len(truth)), fixed_scale=True)
    return bool(angles_between(turn.rotation[:, 2], UP) <= _MAX_TILT_RAD)


def _drift(estimated: FloatArray, truth: FloatArray, way_m: FloatArray) -> float:
    """Mean error of positions relative to an earlier pose, over the path length between."""
    errors: list[float] = []
    for share in _SEGMENTS:
        length_m = share * way_m[-1]
        ends = np.searchsorted(way_m, way_m + length_m)
        starts = np.flatnonzero(ends < len(way_m))
        if len(starts):
            a, b = _seen_from(estimated, starts, ends[starts]), _seen_from(truth, starts, ends[starts])
            errors += (np.linalg.norm(a - b, axis=1) / length_m).tolist()
    return float(np.mean(errors))


def _seen_from(T: FloatArray, starts: IntArray, ends: IntArray) -> FloatArray:
    """The positions (M, 3) of the cameras at ``ends`` (M,) in the frames of those at ``starts`` (M,)."""
    away = T[ends, :3, 3] - T[starts, :3, 3]
    return np.asarray(np.einsum("mji,mj->mi", T[starts, :3, :3], away))
