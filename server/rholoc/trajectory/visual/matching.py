"""Features of keyframes → verified matches between pairs of them."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.features import FeatureSet
from rholoc.geometry import FloatArray, IntArray, rotation_angles
from rholoc.geometry.graphs import components
from rholoc.progress import ProgressListener, Stage, silent
from rholoc.trajectory.inertial.gyroscope import allowed_apart
from rholoc.trajectory.visual.loop_candidates import (
    Pair,
    loop_candidates,
    picture_pairs,
    sequential_pairs,
)
from rholoc.trajectory.visual.two_view import (
    PairRotation,
    inliers_of_rotation,
    ratio_matches,
    relative_pose,
    unit_descriptors,
)

_THREADS = 2
_REMEMBERED = 64  # keyframes with cached float descriptors
_TOLERANCE_PX = 2.5
_MIN_SEQUENTIAL = 15
_MIN_LOOP = 30
_STRONG_LOOP = 80  # inliers, from which a loop needs no support
_BESIDE = 2  # keyframes, within which another loop supports one
_LOOPS_EACH = 3
_FAIR_SHARE = 0.33  # of the matches of its pictures' best pairs, above which a pair is clear
_BEST = 2  # the second best pair counts, because a picture may have a duplicate
_EXPLAINED = 0.8  # minimum share of the image rotation's inliers that the gyroscope's rotation explains
_BESIDE_WALK = (1, 2, 4)  # offsets of keyframes to match with if corners were tracked …
_BESIDE_JUMPS = (1, 2, 3, 4, 5, 6, 8, 12)  # … and if pictures are too far apart for tracking


@dataclass(frozen=True, eq=False)
class VerifiedPair:
    """Two keyframes with the inlier matches of their relative pose.

    Attributes:
        first, second: keyframe numbers.
        matches: (M, 2) feature numbers.
        R_second_first: (3, 3).
    """

    first: int
    second: int
    matches: IntArray
    R_second_first: FloatArray

    @property
    def rotation(self) -> PairRotation:
        """The pair's relative rotation."""
        return PairRotation(self.first, self.second, self.R_second_first, len(self.matches))


def match_keyframes(
    features: Sequence[FeatureSet],
    rays: Sequence[FloatArray],
    focal_px: float,
    times: FloatArray,
    by_gyroscope: Rotation | None,
    followed: bool,
    progress: ProgressListener = silent,
) -> tuple[list[VerifiedPair], list[VerifiedPair]]:
    """Match neighbouring keyframes (15 inliers needed), and loop candidates (30). Returns both lists of verified pairs.

    Args:
        features: of K keyframes, in the order of time.
        rays: of these features in the camera frame, (N, 3) each.
        focal_px: of the camera.
        times: (K,) seconds.
        by_gyroscope: R_start_camera of the keyframes by the gyroscope, or None. Pairs that contradict it are left out.
        followed: whether corners are tracked between keyframes, so that fewer pairs need matching.
        progress: listener for :data:`Stage.POSES`, up to the fraction 0.4.
    """
    distances = _BESIDE_WALK if followed else _BESIDE_JUMPS
    neighbours = sequential_pairs(len(features), distances)
    again = loop_candidates(features, 2 * max(distances) + 1, _LOOPS_EACH) if len(features) > 3 else []
    total, done = len(neighbours) + len(again), 0
    descriptors = lru_cache(_REMEMBERED)(lambda keyframe: unit_descriptors(features[keyframe]))
    beside = set(neighbours)

    def verified(pair: Pair) -> VerifiedPair | None:
        fewest = _MIN_SEQUENTIAL if pair in beside else _MIN_LOOP
        return _verify(pair, descriptors, rays, _TOLERANCE_PX / focal_px, times, by_gyroscope, fewest)

    found: list[VerifiedPair] = []
    with ThreadPoolExecutor(_THREADS) as pool:
        for one in pool.map(verified, [*neighbours, *again]):
            done += 1
            progress(Stage.POSES, 0.4 * done / total, f"{done} of {total} pairs of keyframes matched")
            if one is not None:
                found.append(one)
    sequential = [pair for pair in found if (pair.first, pair.second) in beside]
    return sequential, supported_loops([pair for pair in found if (pair.first, pair.second) not in beside])


def match_pictures(
    features: Sequence[FeatureSet],
    rays: Sequence[FloatArray],
    focal_px: float,
    progress: ProgressListener = silent,
) -> tuple[list[VerifiedPair], list[VerifiedPair]]:
    """Match unordered pictures; returns the verified pairs that are clear, and the others, see :func:`clear_pairs`.

    Args:
        features: of K pictures.
        rays: of these features in the camera frame, (N, 3) each.
        focal_px: of the camera.
        progress: listener for :data:`Stage.POSES`, up to the fraction 0.4.
    """
    descriptors = [unit_descriptors(found) for found in features]
    nowhen, found = np.zeros(len(features)), list[VerifiedPair]()

    def verified(pair: Pair) -> VerifiedPair | None:
        tolerance = _TOLERANCE_PX / focal_px
        return _verify(pair, descriptors.__getitem__, rays, tolerance, nowhen, None, _MIN_SEQUENTIAL)

    pairs = picture_pairs(features)
    with ThreadPoolExecutor(_THREADS) as pool:
        for done, one in enumerate(pool.map(verified, pairs), 1):
            progress(Stage.POSES, 0.4 * done / len(pairs), f"{done} of {len(pairs)} pairs of pictures matched")
            if one is not None:
                found.append(one)
    return clear_pairs(found, len(features))


def with_poses_anew(pairs: Sequence[VerifiedPair], rays: Sequence[FloatArray], focal_px: float) -> list[VerifiedPair]:
    """Pairs with relative poses by other rays, as of a better focal length, and their inliers; none with under 15."""

    def anew(pair: VerifiedPair) -> VerifiedPair | None:
        first, second = rays[pair.first][pair.matches[:, 0]], rays[pair.second][pair.matches[:, 1]]
        view = relative_pose(first, second, _TOLERANCE_PX / focal_px, _MIN_SEQUENTIAL)
        if view.inliers.sum() < _MIN_SEQUENTIAL:
            return None
        return VerifiedPair(pair.first, pair.second, pair.matches[view.inliers], view.R_second_first)

    with ThreadPoolExecutor(_THREADS) as pool:
        return [pair for pair in pool.map(anew, pairs) if pair is not None]


def clear_pairs(pairs: Sequence[VerifiedPair], count: int) -> tuple[list[VerifiedPair], list[VerifiedPair]]:
    """Split verified pairs into clear ones and others, which may show different places that look alike.

    A pair is clear if it has at least 0.33 × the matches of the second best pair of either of its pictures. Pairs that
    connect different components of the view graph of clear pairs count as clear too.

    Args:
        pairs: verified pairs.
        count: number of pictures.
    """
    ends = np.array([(pair.first, pair.second) for pair in pairs], dtype=np.int64).reshape(-1, 2)
    matches = np.array([len(pair.matches) for pair in pairs])
    best = np.zeros(count)
    for k in range(count):
        own = np.sort(matches[(ends == k).any(axis=1)])
        best[k] = own[-min(_BEST, len(own))] if len(own) else 0
    clear = matches >= _FAIR_SHARE * best[ends].min(axis=1)
    part = components(count, ends[clear])
    kept = clear | (part[ends[:, 0]] != part[ends[:, 1]])
    places = np.flatnonzero(kept).tolist(), np.flatnonzero(~kept).tolist()
    return [pairs[k] for k in places[0]], [pairs[k] for k in places[1]]


def supported_loops(pairs: Sequence[VerifiedPair]) -> list[VerifiedPair]:
    """Loop pairs with at least 80 inliers, or with another loop pair within two keyframes at both ends."""
    places = np.array([(pair.first, pair.second) for pair in pairs]).reshape(-1, 2)
    kept = []
    for pair, place in zip(pairs, places, strict=True):
        beside = np.abs(places - place).max(axis=1) <= _BESIDE
        if len(pair.matches) >= _STRONG_LOOP or beside.sum() > 1:
            kept.append(pair)
    return kept


def _verify(
    pair: Pair,
    descriptors: Callable[[int], FloatArray],
    rays: Sequence[FloatArray],
    tolerance: float,
    times: FloatArray,
    by_gyroscope: Rotation | None,
    fewest: int,
) -> VerifiedPair | None:
    """Inlier matches of one relative pose, with a ``tolerance`` as of :func:`relative_pose`; None with fewer than
    ``fewest``. Where the gyroscope contradicts the rotation, its own is taken if that explains 80 % of the inliers;
    otherwise the result is None, too.
    """
    i, j = pair
    matches = ratio_matches(descriptors(i), descriptors(j))
    if len(matches) < fewest:
        return None
    first, second = rays[i][matches[:, 0]], rays[j][matches[:, 1]]
    view = relative_pose(first, second, tolerance, fewest)
    inliers, R = view.inliers, view.R_second_first
    if by_gyroscope is not None and inliers.any():
        R_by_gyroscope = (by_gyroscope[j].inv() * by_gyroscope[i]).as_matrix()
        if rotation_angles(R, R_by_gyroscope) > allowed_apart(times[j] - times[i]):
            agreeing = inliers_of_rotation(first, second, R_by_gyroscope, 2 * tolerance)
            if agreeing.sum() < _EXPLAINED * inliers.sum():
                return None
            inliers, R = inliers & agreeing, R_by_gyroscope
    if inliers.sum() < fewest:
        return None
    return VerifiedPair(i, j, matches[inliers], R)
