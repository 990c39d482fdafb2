"""Whether two reconstructions from different keyframes are the same: without an IMU, a bent one looks perfect."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rholoc.geometry import BoolArray, FloatArray, IntArray, align_poses, posed_alignment, rotation_angles

_FEWEST_COMMON = 0.7  # the share of the second's keyframes that both must have placed
_MAX_LINE_WIDTH = 0.02  # spread across a line, as a share of that along it, of positions that count as on it
_MAX_DISTANCE = 0.02  # of the median depth, between two reconstructions that count as the same …
_MAX_DISTANCE_OF_MOST = 0.04  # … and of nine in ten of their keyframes: a part may be wrong, the rest right
_MAX_ANGLE_DEG = 2.0


@dataclass(frozen=True, eq=False)
class Agreement:
    """How far two reconstructions are apart.

    Attributes:
        distance: between the same keyframes, the median, as a share of the median depth; NaN without a second.
        distance_of_most: likewise, of nine in ten.
        angle_deg: the median angle.
        common: how many keyframes could be compared.
        of: how many there might have been.
    """

    distance: float
    distance_of_most: float
    angle_deg: float
    common: int
    of: int

    @property
    def same(self) -> bool:
        """Whether they count as the same."""
        close = self.distance <= _MAX_DISTANCE and self.distance_of_most <= _MAX_DISTANCE_OF_MOST
        return close and self.angle_deg <= _MAX_ANGLE_DEG

    @property
    def why(self) -> str:
        """One line on it."""
        if not np.isfinite(self.distance):
            return f"Only {self.common} of {self.of} keyframes could be checked by a second reconstruction."
        verb = "agree" if self.same else "disagree"
        return (
            f"Two reconstructions {verb}: {self.distance:.1%} of the median depth and {self.angle_deg:.1f}° apart, "
            f"nine in ten keyframes within {self.distance_of_most:.1%}."
        )


def compare(
    T: FloatArray, placed: BoolArray, some: IntArray, other: FloatArray, other_placed: BoolArray, median_depth: float
) -> Agreement:
    """Hold a reconstruction against one from ``some`` of its keyframes, of any frame and scale.

    Args:
        T: (K, 4, 4), of which ``placed`` (K,) count.
        some: (N,) the keyframes of the other.
        other: (N, 4, 4), of which ``other_placed`` (N,) count.
        median_depth: of the points before the cameras, in the first's unit.
    """
    both = placed[some] & other_placed
    common = int(both.sum())
    if common < max(3, _FEWEST_COMMON * len(some)):
        return Agreement(np.nan, np.nan, np.nan, common, len(some))
    a, b = T[some[both]], other[both]
    on_a_line = _is_line(a[:, :3, 3])
    similarity = posed_alignment(b, a, np.ones(common), fixed_scale=False) if on_a_line else align_poses(b, a)
    aligned = similarity.poses(b)
    apart = np.linalg.norm(aligned[:, :3, 3] - a[:, :3, 3], axis=1) / median_depth
    return Agreement(
        float(np.median(apart)),
        float(np.percentile(apart, 90)),
        float(np.degrees(np.median(rotation_angles(aligned[:, :3, :3], a[:, :3, :3])))),
        common,
        len(some),
    )


def _is_line(positions: FloatArray) -> bool:
    """Whether positions (N, 3) leave the rotation about their line open."""
    along, across, _ = np.linalg.svd(positions - positions.mean(axis=0), compute_uv=False)
    return bool(across < _MAX_LINE_WIDTH * along)
