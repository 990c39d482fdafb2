"""Errors of poses against the truth, and summary figures."""

import math
from dataclasses import asdict, dataclass

import numpy as np

from rholoc.geometry import BoolArray, FloatArray, kabsch, pose_distances, pose_matrix

RECALL_THRESHOLDS = ((0.05, 5.0), (0.10, 5.0), (0.25, 10.0))
"""Metres and degrees within which a frame counts as localized well: 5 cm/5°, 10 cm/5°, 25 cm/10°."""


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """Errors of N poses; a frame without a pose has infinite errors.

    Attributes:
        position_m: (N,) distance between the camera centres.
        rotation_rad: (N,) angle of the rotation between estimate and truth.
    """

    position_m: FloatArray
    rotation_rad: FloatArray

    def __len__(self) -> int:
        return len(self.position_m)

    @property
    def localized(self) -> BoolArray:
        """Mask (N,) of the frames with a pose."""
        return np.isfinite(self.position_m)

    def within(self, position_m: float, rotation_deg: float) -> BoolArray:
        """Mask (N,) of the frames with both errors at most these [m, °]."""
        return (self.position_m <= position_m) & (self.rotation_rad <= math.radians(rotation_deg))


@dataclass(frozen=True)
class Evaluation:
    """A trajectory's figures, all over ``n`` frames.

    A frame without a pose has an infinite error, also in medians and percentiles: leaving it out would reward a
    localizer for answering only easy frames. An infinite figure is None.

    Attributes:
        n: number of frames with known truth.
        localized: number of these with a pose.
        median_cm, median_deg: median errors of position (cm) and rotation (degrees).
        p90_cm, p90_deg: their 90th percentiles.
        recall_5cm_5deg, recall_10cm_5deg, recall_25cm_10deg: fractions 0..1 of ``n`` within both.
    """

    n: int
    localized: int
    median_cm: float | None
    median_deg: float | None
    p90_cm: float | None
    p90_deg: float | None
    recall_5cm_5deg: float
    recall_10cm_5deg: float
    recall_25cm_10deg: float

    def as_dict(self) -> dict[str, float | int | None]:
        """The figures by attribute, JSON-serialisable; None if infinite."""
        return asdict(self)

    def rows(self) -> dict[str, str]:
        """The figures for people: texts with units, by name; "–" if infinite."""
        return {
            "frames": str(self.n),
            "localized": f"{self.localized} ({_percent(self.localized / self.n if self.n else 0)})",
            "median error": f"{_number(self.median_cm)} cm, {_number(self.median_deg)}°",
            "90th percentile": f"{_number(self.p90_cm)} cm, {_number(self.p90_deg)}°",
            "within 5 cm and 5°": _percent(self.recall_5cm_5deg),
            "within 10 cm and 5°": _percent(self.recall_10cm_5deg),
            "within 25 cm and 10°": _percent(self.recall_25cm_10deg),
        }


def trajectory_errors(estimated: FloatArray, truth: FloatArray) -> PoseErrors:
    """Errors of ``estimated`` (N, 4, 4) against ``truth`` (N, 4, 4), both T_map_camera in one map frame, metres.

    NaN in an estimated pose means that there is none: its errors are infinite.
    """
    known = np.isfinite(estimated).all(axis=(1, 2))
    position_m = np.full(len(estimated), np.inf)
    rotation_rad = np.full(len(estimated), np.inf)
    if known.any():
        position_m[known], rotation_rad[known] = pose_distances(estimated[known], truth[known])
    return PoseErrors(position_m, rotation_rad)


def evaluate(errors: PoseErrors) -> Evaluation:
    """Medians, 90th percentiles and recalls of a trajectory's errors; None where infinite or without frames."""
    recalls = [_fraction(errors.within(*threshold)) for threshold in RECALL_THRESHOLDS]
    rotation_deg = np.degrees(errors.rotation_rad)
    return Evaluation(
        n=len(errors),
        localized=int(errors.localized.sum()),
        median_cm=quantile(errors.position_m * 100, 0.5),
        median_deg=quantile(rotation_deg, 0.5),
        p90_cm=quantile(errors.position_m * 100, 0.9),
        p90_deg=quantile(rotation_deg, 0.9),
        recall_5cm_5deg=recalls[0],
        recall_10cm_5deg=recalls[1],
        recall_25cm_10deg=recalls[2],
    )


def quantile(values: FloatArray, q: float) -> float | None:
    """The ``q``-quantile (0..1) of values (N,) that may be infinite, interpolated; None where it is not finite."""
    if len(values) == 0:
        return None
    ordered = np.sort(values)
    place = q * (len(ordered) - 1)
    low, high = math.floor(place), math.ceil(place)
    share = place - low
    value = ordered[low] if share == 0 else (1 - share) * ordered[low] + share * ordered[high]
    return float(value) if math.isfinite(value) else None


def rigid_alignment(estimated: FloatArray, truth: FloatArray) -> FloatArray:
    """The T_truth_estimated (4, 4) that brings the camera centres of ``estimated`` (N, 4, 4) nearest to ``truth``'s.

    Rotation and translation, no scale (Kabsch). For trajectories in different map frames; at least three poses that do
    not lie on a line fix it. NaN poses of ``estimated`` are left out.
    """
    known = np.isfinite(estimated).all(axis=(1, 2))
    aligned = kabsch(estimated[known, :3, 3], truth[known, :3, 3])
    return pose_matrix(aligned.rotation, aligned.translation)


def _percent(fraction: float) -> str:
    """A fraction as a percentage with one decimal."""
    return f"{100 * fraction:.1f} %"


def _number(value: float | None) -> str:
    """A number with two decimals; "–" for None."""
    return "–" if value is None else f"{value:.2f}"


def _fraction(flags: BoolArray) -> float:
    """Share of True, 0 to 1; 0 of nothing."""
    return float(flags.mean()) if len(flags) else 0.0
