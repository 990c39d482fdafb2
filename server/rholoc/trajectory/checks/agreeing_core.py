"""Where two reconstructions that contradict each other as a whole agree all the same."""

from dataclasses import dataclass

import numpy as np

from rholoc.geometry import BoolArray, FloatArray, IntArray, rotation_angles
from rholoc.geometry.graphs import components
from rholoc.trajectory.checks.agreement import MAX_ANGLE_DEG, MAX_DISTANCE_OF_MOST, aligning

_ROUNDS = 20  # in which a core grows from a pair of keyframes
_MIN_INWARD = 0.75  # share of a keyframe's matches that are with others of the core


@dataclass(frozen=True, eq=False)
class Links:
    """Verified pairs of K keyframes.

    Attributes:
        ends: (M, 2) keyframes of each pair.
        matches: (M,) number of its matches.
    """

    ends: IntArray
    matches: IntArray

    def connected(self, some: BoolArray) -> BoolArray:
        """Mask (K,) of the largest connected component of the keyframes ``some`` (K,)."""
        group = components(len(some), self.ends[some[self.ends].all(axis=1)])
        return np.asarray(group == np.bincount(group[some]).argmax()) if some.any() else some

    def count(self, some: BoolArray) -> FloatArray:
        """Number (K,) of each keyframe's matches with the keyframes ``some`` (K,)."""
        inward = self.matches[:, None] * some[self.ends[:, ::-1]]
        return np.asarray(np.bincount(self.ends.ravel(), inward.ravel(), len(some)), dtype=np.float64)


def agreeing_core(T: FloatArray, other: FloatArray, placed: BoolArray, links: Links, depths: FloatArray) -> BoolArray:
    """Mask (K,) of the largest connected set of keyframes that two reconstructions place alike.

    One similarity aligns all of them: each keyframe to 4 % of its depth and 2°. At least three quarters of each
    keyframe's matches are with others of the set. This excludes places that look alike, which both reconstructions may
    confuse: their keyframes have as many matches with the keyframes around their true place.

    The search starts from the similarity of each linked pair, estimated again from its inliers until these stay the
    same.

    Args:
        T: (K, 4, 4) poses of the first reconstruction.
        other: (K, 4, 4) poses of the second one, in any frame and scale.
        placed: (K,) keyframes that both place; the poses of others are not used.
        links: of all keyframes.
        depths: (K,) median depth of each keyframe's points in the first one, in its unit.
    """
    core = np.zeros(len(T), dtype=np.bool_)
    for pair in links.ends[placed[links.ends].all(axis=1)].tolist():
        if not core[pair].all():
            found = _without_outward(_fitting(pair, T, other, placed, links, depths), links)
            core = found if found.sum() > core.sum() else core
    return core


def _fitting(
    pair: list[int], T: FloatArray, other: FloatArray, placed: BoolArray, links: Links, depths: FloatArray
) -> BoolArray:
    """Mask (K,) of a connected set of keyframes that fit one similarity, searched from that of a linked pair."""
    inside = np.isin(np.arange(len(T)), pair)
    for _ in range(_ROUNDS):
        aligned = aligning(other[inside], T[inside]).poses(other)
        apart = np.linalg.norm(aligned[:, :3, 3] - T[:, :3, 3], axis=1)
        angles = rotation_angles(aligned[:, :3, :3], T[:, :3, :3])
        fits = placed & (apart <= MAX_DISTANCE_OF_MOST * depths) & (angles <= np.radians(MAX_ANGLE_DEG))
        found = links.connected(fits)
        if found.sum() < len(pair) or (found == inside).all():
            return found
        inside = found
    return inside


def _without_outward(core: BoolArray, links: Links) -> BoolArray:
    """Mask (K,) of a connected part of the ``core`` (K,), in which each keyframe has three quarters of its matches."""
    total = links.count(np.ones_like(core))
    while True:
        kept = links.connected(core & (links.count(core) >= _MIN_INWARD * total))
        if (kept == core).all():
            return core
        core = kept
