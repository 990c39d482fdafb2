"""Which keyframes see which points: corners that were followed, and features that were matched."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

from rholoc.geometry import BoolArray, Camera, FloatArray, IntArray, rotation_angles
from rholoc.trajectory.inertial.gyroscope import allowed_apart
from rholoc.trajectory.visual.flow import Flow
from rholoc.trajectory.visual.matching import VerifiedPair
from rholoc.trajectory.visual.rolling_shutter import RollingShutter
from rholoc.trajectory.visual.two_view import PairRotation, inliers_of_rotation, relative_pose

_TOLERANCE_PX = 2.0
_FEWEST_SHARED = 12  # corners, for a relative pose
_FEWEST_FOR_ROTATION = 30
_FEWEST_SIGHTINGS = 3
_MAX_FELT_APART_RAD = np.radians(1.0)  # between neighbours, from which the gyroscope is believed rather than the image
_FEWEST_TOGETHER = 10  # points that two keyframes see, for them to be of one piece
_LEAST_PIECE = 3  # keyframes; fewer have no shape of their own
_FURTHER = 4  # keyframes, over which corners show the rotation better than from one to the next


@dataclass(frozen=True, eq=False)
class Observations:
    """N sightings of points by keyframes.

    Attributes:
        keyframes: (N,) the keyframe.
        tracks: (N,) the point, 0..M-1.
        pixels: (N, 2) where, in pixels of the full image.
        depths: (N,) along the camera's axis by depth pictures [m], NaN where unknown; None without depth pictures.
    """

    keyframes: IntArray
    tracks: IntArray
    pixels: FloatArray
    depths: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.keyframes)

    @property
    def points(self) -> int:
        """How many points there are."""
        return int(self.tracks.max(initial=-1)) + 1

    def at(self, rows: IntArray | BoolArray) -> Observations:
        """Some of the sightings; points keep their numbers."""
        depths = None if self.depths is None else self.depths[rows]
        return Observations(self.keyframes[rows], self.tracks[rows], self.pixels[rows], depths)

    def scaled(self, factor: float) -> Observations:
        """The same with depths multiplied by a factor."""
        return self if self.depths is None else replace(self, depths=factor * self.depths)

    def take(self, kept: BoolArray) -> Observations:
        """Some of the sightings; points are numbered anew, those seen from fewer than three keyframes are left out."""
        tracks = self.tracks[kept]
        often = np.bincount(tracks, minlength=self.points)[tracks] >= _FEWEST_SIGHTINGS
        rows = np.flatnonzero(kept)[often]
        _, numbers = np.unique(self.tracks[rows], return_inverse=True)
        return replace(self.at(rows), tracks=numbers)

    def joined(self, others: Observations) -> Observations:
        """Both, the others' points numbered after these."""
        return Observations(
            np.concatenate([self.keyframes, others.keyframes]),
            np.concatenate([self.tracks, others.tracks + self.points]),
            np.concatenate([self.pixels, others.pixels]),
        )

    def thinned(self, per_keyframe: int) -> Observations:
        """So many a keyframe where there are more, of the points that are seen most often."""
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
    flow: Flow, rows: IntArray, camera: Camera, felt: Rotation | None, shutter: RollingShutter | None
) -> tuple[Observations, list[PairRotation]]:
    """Corners seen from keyframes, and how the camera turned between these.

    Where a corner leaves what the relative pose of neighbours allows (an edge behind another, something that moves),
    its track ends and a new one begins.

    Args:
        rows: (K,) the keyframes' rows.
        camera: known, or guessed.
        felt: R_start_camera of the keyframes by the gyroscope, or None.
        shutter: how the image moves in the keyframes while it is read, or None.
    """
    tolerance = _TOLERANCE_PX / camera.focal
    rotations: list[PairRotation] = []
    keyframes: list[IntArray] = []
    tracks: list[IntArray] = []
    pixels: list[FloatArray] = []
    numbers: dict[int, int] = {}  # the corner's number in the flow → the track's
    next_track = 0
    for k, row in enumerate(rows.tolist()):
        corners, places = flow.of_frame(row)
        carried = set()
        if k > 0:
            shared, agree, turned = _neighbours(flow, rows, k - 1, k, camera, tolerance, felt)
            carried = set(shared[agree].tolist())
            rotations += [turned] if turned is not None else []
        if k >= _FURTHER:
            _, _, turned = _neighbours(flow, rows, k - _FURTHER, k, camera, tolerance, felt)
            rotations += [turned] if turned is not None else []
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
    flow: Flow, rows: IntArray, a: int, b: int, camera: Camera, tolerance: float, felt: Rotation | None
) -> tuple[IntArray, BoolArray, PairRotation | None]:
    """The corners that keyframes share, which of them agree with one relative pose, and its rotation."""
    shared, in_a, in_b = flow.shared(int(rows[a]), int(rows[b]))
    if len(shared) < _FEWEST_SHARED:
        return shared, np.zeros(len(shared), dtype=np.bool_), None
    first, second = camera.rays(in_a), camera.rays(in_b)
    view = relative_pose(first, second, tolerance)
    turned: PairRotation | None = PairRotation(a, b, view.R_second_first, int(view.inliers.sum()))
    inliers = view.inliers
    if felt is not None:
        R_felt = (felt[b].inv() * felt[a]).as_matrix()
        apart = rotation_angles(view.R_second_first, R_felt)
        if apart > _MAX_FELT_APART_RAD and b - a == 1:
            inliers = inliers_of_rotation(first, second, R_felt, tolerance)
        if apart > float(allowed_apart(flow.times[rows[b]] - flow.times[rows[a]])):
            turned = None
    if turned is not None and turned.support < _FEWEST_FOR_ROTATION:
        turned = None
    return shared, inliers, turned


def matched_features(places: Sequence[FloatArray], pairs: Sequence[VerifiedPair]) -> Observations:
    """Points from matched features: what is linked by matches is one point; of a keyframe that sees one twice, neither.

    Args:
        places: of the features in every keyframe, (N, 2) each, in whatever the observations are to be.
        pairs: verified matches.
    """
    offsets = np.concatenate([[0], np.cumsum([len(some) for some in places])])
    if not pairs:
        return Observations(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)))
    links, label = linked_features(offsets, pairs)
    keyframe = np.repeat(np.arange(len(places)), np.diff(offsets))
    seen = np.unique(links)
    label, keyframe, pixels = label[seen], keyframe[seen], np.concatenate(places)[seen]
    _, label = np.unique(label, return_inverse=True)
    order = np.lexsort((keyframe, label))
    label, keyframe, pixels = label[order], keyframe[order], pixels[order]
    same = (label[1:] == label[:-1]) & (keyframe[1:] == keyframe[:-1])
    twice = np.concatenate([same, [False]]) | np.concatenate([[False], same])
    found = Observations(keyframe, label, pixels)
    return found.take(~twice)


def linked_features(first_feature: IntArray, pairs: Sequence[VerifiedPair]) -> tuple[IntArray, IntArray]:
    """Matches (M, 2) as features numbered through all keyframes, and the point (F,) that each feature is of.

    Args:
        first_feature: (K + 1,) the number of every keyframe's first feature, then how many there are.
        pairs: verified matches.
    """
    links = np.concatenate(
        [np.zeros((0, 2), np.int64), *(pair.matches + first_feature[[pair.first, pair.second]] for pair in pairs)]
    )
    count = int(first_feature[-1])
    graph = coo_matrix((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(count, count))
    label: IntArray = connected_components(graph, directed=False)[1]
    return links, label


def pieces_of(count: int, observations: Observations) -> IntArray:
    """The piece (K,) of each of ``count`` keyframes: those that see ten points together are of one; -1 without one.

    Pieces are numbered from the largest on.
    """
    seen = coo_matrix(
        (np.ones(len(observations), np.float32), (observations.keyframes, observations.tracks)),
        shape=(count, max(observations.points, 1)),
    ).tocsr()
    shared = (seen @ seen.T).tocoo()
    strong = shared.data >= _FEWEST_TOGETHER
    graph = coo_matrix((shared.data[strong], (shared.row[strong], shared.col[strong])), shape=(count, count))
    label: IntArray = connected_components(graph, directed=False)[1]
    sizes = np.bincount(label)
    order = np.argsort(-sizes, kind="stable")
    large = order[sizes[order] >= _LEAST_PIECE]
    number = np.full(len(sizes), -1)
    number[large] = np.arange(len(large))
    return np.asarray(number[label])
