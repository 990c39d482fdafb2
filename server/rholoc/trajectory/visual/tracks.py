"""Sightings of points by keyframes, from tracked corners and matched features."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.spatial.transform import Rotation

from rholoc.geometry import BoolArray, Camera, FloatArray, IntArray, rotation_angles
from rholoc.geometry.graphs import components
from rholoc.trajectory.inertial.gyroscope import allowed_apart
from rholoc.trajectory.visual.flow import Flow
from rholoc.trajectory.visual.matching import VerifiedPair
from rholoc.trajectory.visual.rolling_shutter import RollingShutter
from rholoc.trajectory.visual.two_view import PairRotation, inliers_of_rotation, relative_pose

_TOLERANCE_PX = 2.0
_MIN_SHARED = 12  # corners, for a relative pose
_MIN_FOR_ROTATION = 30
MIN_SIGHTINGS = 3
_MAX_GYROSCOPE_APART_RAD = np.radians(1.0)  # from the image's rotation of neighbours to use the gyroscope's
_MIN_TOGETHER = 10  # common points that connect two keyframes
_MIN_PIECE = 3  # keyframes of a connected component that counts
_FEWEST_MATCHED = 2  # sightings of a point that two pictures show
_MIN_OF_THINNED = 50  # matches of a pair: it may be the only one that connects two parts
_FURTHER = 4  # keyframes: a longer interval over which corners measure rotation more accurately


@dataclass(frozen=True, eq=False)
class Observations:
    """N sightings of points by keyframes.

    Attributes:
        keyframes: (N,) keyframe numbers.
        tracks: (N,) point numbers, 0..M-1.
        pixels: (N, 2) of the full image.
        depths: (N,) along the camera's axis by depth pictures [m], NaN where unknown; None without depth pictures.
        fewest: minimum sightings of a point to be of use.
    """

    keyframes: IntArray
    tracks: IntArray
    pixels: FloatArray
    depths: FloatArray | None = None
    fewest: int = MIN_SIGHTINGS

    @classmethod
    def none(cls) -> Self:
        """No sightings."""
        return cls(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)))

    def __len__(self) -> int:
        return len(self.keyframes)

    @property
    def points(self) -> int:
        """Number of points."""
        return int(self.tracks.max(initial=-1)) + 1

    def at(self, rows: IntArray | BoolArray) -> Observations:
        """The sightings ``rows``; points keep their numbers."""
        depths = None if self.depths is None else self.depths[rows]
        return Observations(self.keyframes[rows], self.tracks[rows], self.pixels[rows], depths, self.fewest)

    def scaled(self, factor: float) -> Observations:
        """The same with depths multiplied by a factor; unchanged without depths."""
        return self if self.depths is None else replace(self, depths=factor * self.depths)

    def take(self, kept: BoolArray) -> Observations:
        """The sightings ``kept`` (N,) of points with at least ``fewest`` of them; points are renumbered."""
        tracks = self.tracks[kept]
        often = np.bincount(tracks, minlength=self.points)[tracks] >= self.fewest
        rows = np.flatnonzero(kept)[often]
        _, numbers = np.unique(self.tracks[rows], return_inverse=True)
        return replace(self.at(rows), tracks=numbers)

    def joined(self, others: Observations) -> Observations:
        """These and ``others``, whose points are numbered after these; without depths."""
        return Observations(
            np.concatenate([self.keyframes, others.keyframes]),
            np.concatenate([self.tracks, others.tracks + self.points]),
            np.concatenate([self.pixels, others.pixels]),
            fewest=min(self.fewest, others.fewest),
        )

    def thinned(self, per_keyframe: int) -> Observations:
        """The sightings of some points, renumbered: those with most sightings first, each only if one of its keyframes
        has fewer than ``per_keyframe`` sightings so far.
        """
        lengths = np.bincount(self.tracks, minlength=self.points)
        by_track = np.argsort(self.tracks, kind="stable")
        starts = np.concatenate([[0], np.cumsum(lengths)])
        taken = np.zeros(int(self.keyframes.max(initial=-1)) + 1, dtype=np.int64)
        chosen = np.zeros(self.points, dtype=np.bool_)
        for track in np.argsort(-lengths, kind="stable").tolist():
            seen_from = self.keyframes[by_track[starts[track] : starts[track + 1]]]
            if taken[seen_from].min(initial=per_keyframe) < per_keyframe:
                chosen[track] = True
                taken[seen_from] += 1
        return self.take(chosen[self.tracks])


def followed_corners(
    flow: Flow, rows: IntArray, camera: Camera, by_gyroscope: Rotation | None, shutter: RollingShutter | None
) -> tuple[Observations, list[PairRotation]]:
    """Sightings of tracked corners by keyframes, and relative rotations of the keyframes (with 30 inliers or more).

    A track is split where its corner is an outlier of the neighbours' relative pose (an occlusion, a moving object),
    and dropped with fewer than three sightings.

    Args:
        rows: (K,) the keyframes' rows.
        camera: known, or guessed.
        by_gyroscope: R_start_camera of the keyframes by the gyroscope, or None.
        shutter: rolling-shutter correction of the keyframes, or None.
    """
    tolerance = _TOLERANCE_PX / camera.focal
    rotations: list[PairRotation] = []
    keyframes: list[IntArray] = []
    tracks: list[IntArray] = []
    pixels: list[FloatArray] = []
    numbers: dict[int, int] = {}  # corner number in the flow → track number
    next_track = 0
    for k, row in enumerate(rows.tolist()):
        corners, places = flow.of_frame(row)
        carried = set()
        if k > 0:
            shared, agree, rotation = _neighbours(flow, rows, k - 1, k, camera, tolerance, by_gyroscope)
            carried = set(shared[agree].tolist())
            rotations += [rotation] if rotation is not None else []
        if k >= _FURTHER:
            _, _, rotation = _neighbours(flow, rows, k - _FURTHER, k, camera, tolerance, by_gyroscope)
            rotations += [rotation] if rotation is not None else []
        now: dict[int, int] = {}
        for corner in corners.tolist():
            if corner in carried and corner in numbers:
                now[corner] = numbers[corner]
            else:
                now[corner] = next_track
                next_track += 1
        numbers = now
        keyframes.append(np.full(len(corners), k, dtype=np.int64))
        tracks.append(np.array([now[corner] for corner in corners.tolist()], dtype=np.int64))
        pixels.append(places if shutter is None else shutter.pixels_at_once(k, places))
    found = Observations(np.concatenate(keyframes), np.concatenate(tracks), np.concatenate(pixels))
    return found.take(np.ones(len(found), dtype=np.bool_)), rotations


def _neighbours(
    flow: Flow, rows: IntArray, a: int, b: int, camera: Camera, tolerance: float, by_gyroscope: Rotation | None
) -> tuple[IntArray, BoolArray, PairRotation | None]:
    """Corners (C,) shared by keyframes ``a`` and ``b``, a mask (C,) of the relative pose's inliers, and its rotation.
    The rotation is None with fewer than 30 inliers, or if the gyroscope contradicts it.

    ``by_gyroscope`` are all keyframes' orientations by the gyroscope: where it differs by over 1° between successive
    keyframes, the inliers are those of its rotation. ``tolerance`` is on the plane z = 1, for wide lenses in radians.
    """
    shared, in_a, in_b = flow.shared(int(rows[a]), int(rows[b]))
    if len(shared) < _MIN_SHARED:
        return shared, np.zeros(len(shared), dtype=np.bool_), None
    first, second = camera.rays(in_a), camera.rays(in_b)
    view = relative_pose(first, second, tolerance)
    rotation: PairRotation | None = PairRotation(a, b, view.R_second_first, int(view.inliers.sum()))
    inliers = view.inliers
    if by_gyroscope is not None:
        R_by_gyroscope = (by_gyroscope[b].inv() * by_gyroscope[a]).as_matrix()
        apart = rotation_angles(view.R_second_first, R_by_gyroscope)
        if apart > _MAX_GYROSCOPE_APART_RAD and b - a == 1:
            inliers = inliers_of_rotation(first, second, R_by_gyroscope, tolerance)
        if apart > float(allowed_apart(flow.times[rows[b]] - flow.times[rows[a]])):
            rotation = None
    if rotation is not None and rotation.support < _MIN_FOR_ROTATION:
        rotation = None
    return shared, inliers, rotation


def matched_features(
    places: Sequence[FloatArray], pairs: Sequence[VerifiedPair], fewest: int = MIN_SIGHTINGS
) -> Observations:
    """Sightings of matched features. A point is a connected component of matches, with at least ``fewest`` sightings.

    Two sightings of one point by the same keyframe are both left out.

    Args:
        places: coordinates (N, 2) of the features in every keyframe, copied to the sightings' ``pixels``.
        pairs: verified matches.
        fewest: minimum sightings of a point to be of use.
    """
    offsets = np.concatenate([[0], np.cumsum([len(some) for some in places])])
    if not pairs:
        return Observations.none()
    links, label = linked_features(offsets, pairs)
    keyframe = np.repeat(np.arange(len(places)), np.diff(offsets))
    seen = np.unique(links)
    label, keyframe, pixels = label[seen], keyframe[seen], np.concatenate(places)[seen]
    _, label = np.unique(label, return_inverse=True)
    order = np.lexsort((keyframe, label))
    label, keyframe, pixels = label[order], keyframe[order], pixels[order]
    same = (label[1:] == label[:-1]) & (keyframe[1:] == keyframe[:-1])
    twice = np.concatenate([same, [False]]) | np.concatenate([[False], same])
    found = Observations(keyframe, label, pixels, fewest=fewest)
    return found.take(~twice)


def thinned_matches(pairs: Sequence[VerifiedPair], features: Sequence[int], per_keyframe: int) -> list[VerifiedPair]:
    """The pairs with the matches of about ``per_keyframe`` features of each keyframe, of points with most sightings.

    A pair that would keep fewer than 50 matches keeps all of them.

    Args:
        pairs: verified matches.
        features: number of features of each keyframe.
        per_keyframe: features to keep of each.
    """
    offsets = np.concatenate([[0], np.cumsum(features)])
    numbers = [np.repeat(np.arange(count, dtype=np.float64)[:, None], 2, axis=1) for count in features]
    sightings = matched_features(numbers, pairs, _FEWEST_MATCHED).thinned(per_keyframe)
    is_kept = np.zeros(offsets[-1], dtype=np.bool_)
    is_kept[offsets[sightings.keyframes] + sightings.pixels[:, 0].astype(np.int64)] = True
    found = []
    for pair in pairs:
        kept = is_kept[pair.matches + offsets[[pair.first, pair.second]]].all(axis=1)
        found.append(replace(pair, matches=pair.matches[kept]) if kept.sum() >= _MIN_OF_THINNED else pair)
    return found


def linked_features(first_feature: IntArray, pairs: Sequence[VerifiedPair]) -> tuple[IntArray, IntArray]:
    """Matches (M, 2) with features numbered across all keyframes, and the point number (F,) of each feature.

    Args:
        first_feature: (K + 1,) number of every keyframe's first feature, then the total.
        pairs: verified matches.
    """
    links = np.concatenate(
        [np.zeros((0, 2), np.int64), *(pair.matches + first_feature[[pair.first, pair.second]] for pair in pairs)]
    )
    return links, components(int(first_feature[-1]), links)


def shared_points(count: int, observations: Observations) -> csr_matrix:
    """Number (K, K) of points that each two of ``count`` keyframes both see; on the diagonal, that each sees."""
    seen = coo_matrix(
        (np.ones(len(observations), np.float32), (observations.keyframes, observations.tracks)),
        shape=(count, max(observations.points, 1)),
    ).tocsr()
    return (seen @ seen.T).tocsr()


def pieces_of(count: int, observations: Observations) -> IntArray:
    """Connected component (K,) of each of ``count`` keyframes, numbered from the largest.

    Edges need ten common points. Components of fewer than three keyframes get -1.
    """
    shared = shared_points(count, observations).tocoo()
    strong = shared.data >= _MIN_TOGETHER
    label = components(count, np.column_stack([shared.row[strong], shared.col[strong]]))
    sizes = np.bincount(label)
    order = np.argsort(-sizes, kind="stable")
    large = order[sizes[order] >= _MIN_PIECE]
    number = np.full(len(sizes), -1)
    number[large] = np.arange(len(large))
    return np.asarray(number[label])
