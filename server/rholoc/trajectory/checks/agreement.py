"""Compare two reconstructions from different keyframes: without an IMU, a bent one has small residuals too."""

from dataclasses import dataclass

import numpy as np

from rholoc.geometry import BoolArray, FloatArray, IntArray, Similarity, align_poses, posed_alignment, rotation_angles

_MIN_COMMON = 0.7  # share of the second reconstruction's keyframes that both must have placed
_MAX_LINE_WIDTH = 0.02  # of collinear positions: spread across the line over spread along it
_MAX_DISTANCE = 0.02  # median distance of equal reconstructions, as a share of the median depth …
MAX_DISTANCE_OF_MOST = 0.04  # … and its 90th percentile: one part may be wrong, the rest right
MAX_ANGLE_DEG = 2.0
_CONTRADICTION = 0.1  # of the median depth, between reconstructions or poses of which at least one must be wrong


@dataclass(frozen=True, eq=False)
class Agreement:
    """Differences between two aligned reconstructions of the same keyframes.

    Attributes:
        distance: median distance over common keyframes, as a share of the median depth; NaN without a second one.
        distance_of_most: 90th percentile of these distances.
        angle_deg: median angle [deg].
        common: number of keyframes placed by both.
        of: number of keyframes of the second reconstruction.
        second_positions: (K, 3) of the first's keyframes in the second, aligned with the first; NaN where only one
            placed them. None without a second reconstruction.
    """

    distance: float
    distance_of_most: float
    angle_deg: float
    common: int
    of: int
    second_positions: FloatArray | None = None

    @property
    def same(self) -> bool:
        """Whether the reconstructions agree; False for NaN.

        The median distance is up to 2 % of the median depth, its 90th percentile 4 %, and the median angle 2°.
        """
        close = self.distance <= _MAX_DISTANCE and self.distance_of_most <= MAX_DISTANCE_OF_MOST
        return close and self.angle_deg <= MAX_ANGLE_DEG

    @property
    def contradicts(self) -> bool:
        """Whether one reconstruction must be wrong: median distance over 10 % of the median depth. False for NaN."""
        return self.distance > _CONTRADICTION

    @property
    def why(self) -> str:
        """One line: whether they agree, with the distances [% of the median depth] and the angle [deg]; or that too few
        keyframes could be compared.
        """
        if not np.isfinite(self.distance):
            return f"Only {self.common} of {self.of} keyframes could be checked by a second reconstruction."
        verb = "agree" if self.same else "disagree"
        return (
            f"Two reconstructions {verb}: {self.distance:.1%} of the median depth and {self.angle_deg:.1f}° apart, "
            f"nine in ten keyframes within {self.distance_of_most:.1%}."
        )


def disputed(T: FloatArray, second_positions: FloatArray, median_depth: float) -> BoolArray:
    """Mask (K,) of the poses T (K, 4, 4) whose position differs from the second one (K, 3) by over 10 % of the median
    depth; false where that is NaN.
    """
    apart = np.linalg.norm(T[:, :3, 3] - second_positions, axis=1)
    return np.asarray(apart > _CONTRADICTION * median_depth)


def compare(
    T: FloatArray, placed: BoolArray, some: IntArray, other: FloatArray, other_placed: BoolArray, median_depth: float
) -> Agreement:
    """Compare a reconstruction with a second one of ``some`` of its keyframes, in any frame and scale.

    Distances and angle are NaN if fewer than 70 % of ``some``, or fewer than three, are placed by both.

    Args:
        T: (K, 4, 4) poses of the first, valid where ``placed`` (K,).
        some: (N,) keyframe numbers of the other.
        other: (N, 4, 4) poses of the other, valid where ``other_placed`` (N,).
        median_depth: median depth of the first's points, in its unit.
    """
    both = placed[some] & other_placed
    common = int(both.sum())
    if common < max(3, _MIN_COMMON * len(some)):
        return Agreement(np.nan, np.nan, np.nan, common, len(some))
    a, b = T[some[both]], other[both]
    aligned = aligning(b, a).poses(b)
    apart = np.linalg.norm(aligned[:, :3, 3] - a[:, :3, 3], axis=1) / median_depth
    second_positions = np.full((len(T), 3), np.nan)
    second_positions[some[both]] = aligned[:, :3, 3]
    return Agreement(
        float(np.median(apart)),
        float(np.percentile(apart, 90)),
        float(np.degrees(np.median(rotation_angles(aligned[:, :3, :3], a[:, :3, :3])))),
        common,
        len(some),
        second_positions,
    )


def aligning(source: FloatArray, target: FloatArray) -> Similarity:
    """Similarity from poses ``source`` (N, 4, 4) to ``target`` (N, 4, 4): by the positions, a minority of wrong ones
    ignored; if they are collinear, by the rotations too.
    """
    if _is_line(target[:, :3, 3]):
        return posed_alignment(source, target, np.ones(len(source)), fixed_scale=False)
    return align_poses(source, target)


def _is_line(positions: FloatArray) -> bool:
    """Whether positions (N, 3) are collinear (spread across up to 2 % of that along): they leave the rotation about
    their line open.
    """
    along, across = np.linalg.svd(positions - positions.mean(axis=0), compute_uv=False)[:2]
    return bool(across <= _MAX_LINE_WIDTH * along)
