"""Parts of a set of pictures → one, by the points that they share or by waypoints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from rholoc.errors import MappingFailed
from rholoc.geometry import BoolArray, FloatArray, IntArray, Similarity, umeyama
from rholoc.recordings import Waypoint
from rholoc.trajectory.frame.map_frame import frame_of_waypoints, up_by_pictures
from rholoc.trajectory.optimization.resection import known_points
from rholoc.trajectory.optimization.rounds import AdjustmentProgress
from rholoc.trajectory.reconstruction.outcome import moved
from rholoc.trajectory.reconstruction.pair_fit import MAX_PAIR_ERROR, pair_error, without_contradicted
from rholoc.trajectory.reconstruction.part import Part, Pictured, Start, adjusted_part, agreement_of, extended
from rholoc.trajectory.reconstruction.waypoints import fixes_of
from rholoc.trajectory.visual.matching import VerifiedPair
from rholoc.trajectory.visual.tracks import Observations

_SAMPLES, _SEED = 300, 1  # of three shared points
_TOLERANCE_PX = 16.0  # error of one part's point in the other's pictures: each part has its own small bends and focal
_USUAL_ERROR = 0.3  # in tolerances, where errors begin to count less
_MIN_POINTS, _MIN_KNOWN_TWICE = 15, 4
_MIN_INLIER_SHARE = 0.4
_MIN_DISTANCES, _MAX_DISTANCE_ERROR = 6, 0.05  # from a common picture; relative
_MIN_NEW_PICTURES = 3  # that a further piece adds

Known = tuple[FloatArray, BoolArray]  # all points as a part knows them, see known_points


def with_pieces_joined(
    part: Part, pieces: Sequence[Start], walk: Pictured, whole: Observations, progress: AdjustmentProgress
) -> Part:
    """Join the ``pieces`` that share points with the part, then those with enough waypoints of known times.

    Each is first adjusted alone. Joins that fail or move the part are discarded, all pieces together.
    """
    others = _adjusted_pieces(pieces, part.members, walk, whole, progress)
    if not others:
        return part
    start, *apart = _groups([part.start, *others], walk, whole)
    part = _adjusted_whole(part, start, (), walk, whole, progress)
    if not apart or len(walk.waypoints) != 1:
        return part
    (waypoints,), times = walk.waypoints, walk.sights.times
    try:
        start, sizes = joined_by_waypoints(part.start, apart, times, waypoints)
    except MappingFailed:
        return part
    found = _adjusted_whole(part, start, waypoints, walk, whole, progress)
    return part if found is part else replace(found, by_waypoints=sizes)


def _groups(pieces: Sequence[Start], walk: Pictured, whole: Observations) -> list[Start]:
    """The pieces, joined where they share points; each group is in the frame of its first piece."""
    found: list[Start] = []
    while pieces:
        group, pieces = joined_by_points(pieces[0], pieces[1:], whole, walk.evidence.sequential, walk.rays())
        found.append(group)
    return found


def _adjusted_whole(
    part: Part,
    start: Start,
    waypoints: tuple[Waypoint, ...],
    walk: Pictured,
    whole: Observations,
    progress: AdjustmentProgress,
) -> Part:
    """The ``start``, of the part and other pieces, with the pictures that it places, adjusted to the ``whole``
    sightings and the waypoints. The ``part`` itself if the start adds nothing, the adjustment fails or moves the part.
    """
    if len(start[1]) == len(part.members):
        return part
    state, members = extended(start, walk, whole)
    fixes = tuple(fixes_of(walk.sights.times[members], waypoints).values())
    try:
        found = adjusted_part(walk, whole, (state, members), progress, (0.85, 0.85), fixes)
    except (MappingFailed, RuntimeError):
        return part
    return found if agreement_of(found, part).same else part


def _adjusted_pieces(
    pieces: Sequence[Start], placed: IntArray, walk: Pictured, whole: Observations, progress: AdjustmentProgress
) -> list[Start]:
    """The pieces, largest first, each adjusted alone to the ``whole`` sightings. Left out are those that fail, or have
    fewer than three pictures that are neither ``placed`` (N,) nor in a piece before.
    """
    found: list[Start] = []
    for piece in sorted(pieces, key=lambda start: -len(start[1])):
        if len(np.setdiff1d(piece[1], placed)) < _MIN_NEW_PICTURES:
            continue
        try:
            found.append(adjusted_part(walk, whole, piece, progress, (0.85, 0.85)).start)
        except (MappingFailed, RuntimeError):
            continue
        placed = np.union1d(placed, piece[1])
    return found


def joined_by_points(
    start: Start,
    others: Sequence[Start],
    observations: Observations,
    pairs: Sequence[VerifiedPair],
    rays: Sequence[FloatArray],
) -> tuple[Start, tuple[Start, ...]]:
    """Join to a start the others that share points with it, or with one joined before.

    By a picture that both have and six points on whose distances from it they agree; else by 15 points that both see,
    and two pairs of pictures, without a common one, that fit. Of the matches that link further pictures to the start,
    at most a third may contradict their poses.

    Args:
        start: its frame remains.
        others: may have pictures in common.
        observations: of all pictures.
        pairs: verified, of all pictures.
        rays: of every picture's features.

    Returns:
        The start, without points, and those of the others that do not join.
    """
    apart = list(others)
    k = 0
    while k < len(apart):
        found = _try_join(start, apart[k], observations, pairs, rays)
        if found is None:
            k += 1
        else:
            start, k = found, 0
            apart = [other for other in apart if not np.isin(other[1], start[1]).all()]
    return start, tuple(apart)


def joined_by_waypoints(
    start: Start, others: Sequence[Start], times: FloatArray, waypoints: tuple[Waypoint, ...]
) -> tuple[Start, tuple[int, ...]]:
    """Join to the start the others whose pictures were taken at three waypoints or more, in the waypoints' frame.

    Args:
        start: likewise at three waypoints.
        others: may have pictures in common.
        times: of all pictures [s].
        waypoints: with times.

    Returns:
        The start in the waypoints' frame, without points; the number of its pictures, and of those that each joined
        piece adds.

    Raises:
        MappingFailed: the start misses the waypoints, or was not taken at enough of them.
    """
    whole = _at_waypoints(start, times, waypoints)
    sizes = [len(start[1])]
    for other in others:
        if np.isin(other[1], whole[1]).all():
            continue
        try:
            joined = _merged(whole, _at_waypoints(other, times, waypoints), Similarity.identity())
        except MappingFailed:
            continue
        sizes.append(len(joined[1]) - len(whole[1]))
        whole = joined
    return whole, tuple(sizes)


def _at_waypoints(start: Start, times: FloatArray, waypoints: tuple[Waypoint, ...]) -> Start:
    """The start in the frame of the waypoints, by the similarity that fits them; ``times`` [s] of all pictures."""
    state, members = start
    up = up_by_pictures(state.R_map_camera)
    frame = frame_of_waypoints(times[members], state.T_map_camera, [waypoints], *up)
    return moved(state, frame.similarity), members


def _merged(one: Start, other: Start, similarity: Similarity) -> Start:
    """The pictures of both in the first one's frame, without points. ``similarity`` leads there from the other's frame;
    pictures of both keep their pose in the first.
    """
    (state, members), new = one, ~np.isin(other[1], one[1])
    numbers = np.concatenate([members, other[1][new]])
    T = np.concatenate([state.T_map_camera, similarity.poses(other[0].T_map_camera[new])])
    order = np.argsort(numbers)
    return replace(state, T_map_camera=T[order], points=np.zeros((0, 3))), numbers[order]


def _try_join(
    one: Start,
    other: Start,
    observations: Observations,
    pairs: Sequence[VerifiedPair],
    rays: Sequence[FloatArray],
) -> Start | None:
    """Both starts in the frame of ``one``; None if they share too little, or pairs of pictures contradict the join."""
    known = [known_points(observations, members, state) for state, members in (one, other)]
    similarity = _by_common_picture(one, other, observations, known)
    has_common = similarity is not None
    if similarity is None:
        similarity = _by_shared_points(one, other, observations, known)
    if similarity is None:
        return None
    found = _merged(one, other, similarity)
    if not (has_common or _several_fit(found, one[1], pairs, rays)):
        return None
    kept = without_contradicted(found, one[1], pairs, rays)
    return found if len(kept[1]) == len(found[1]) else None


def _by_common_picture(
    one: Start, other: Start, observations: Observations, of_each: Sequence[Known]
) -> Similarity | None:
    """Similarity from the other's frame to the one's by the common picture with the most agreeing points: known to
    both, at distances that agree up to one factor. None if fewer than six, or less than half of those known to both,
    agree.
    """
    points, known = zip(*of_each, strict=True)
    best, most = None, 0
    for picture in np.intersect1d(one[1], other[1]).tolist():
        tracks = observations.tracks[observations.keyframes == picture]
        tracks = tracks[known[0][tracks] & known[1][tracks]]
        if len(tracks) < _MIN_DISTANCES:
            continue
        T, T_other = (state.T_map_camera[np.searchsorted(members, picture)] for state, members in (one, other))
        ratios = np.linalg.norm(points[0][tracks] - T[:3, 3], axis=1)
        ratios /= np.linalg.norm(points[1][tracks] - T_other[:3, 3], axis=1)
        scale = float(np.median(ratios))
        agreeing = int((np.abs(ratios / scale - 1) < _MAX_DISTANCE_ERROR).sum())
        if agreeing > most and agreeing >= max(_MIN_DISTANCES, len(tracks) / 2):
            R = T[:3, :3] @ T_other[:3, :3].T
            best, most = Similarity(scale, R, T[:3, 3] - scale * R @ T_other[:3, 3]), agreeing
    return best


@dataclass(frozen=True, eq=False)
class _Shared:
    """M points that two parts see, as one of them knows them.

    Attributes:
        points: (M, 3), NaN where the part does not know the point well.
        centres: (M, 3) positions of a picture of the part that shows each.
        rays: (M, 3) unit, from there to the point as it was seen.
    """

    points: FloatArray
    centres: FloatArray
    rays: FloatArray

    @property
    def known(self) -> BoolArray:
        """Mask (M,) of the points that the part knows."""
        return np.isfinite(self.points[:, 0])

    def moved(self, similarity: Similarity) -> _Shared:
        """The same in the frame that ``similarity`` leads to."""
        points, centres = similarity.points(self.points), similarity.points(self.centres)
        return _Shared(points, centres, self.rays @ similarity.rotation.T)

    def off(self, other: _Shared) -> FloatArray:
        """Difference (M, 3) of the directions to the points as the other part knows them from these rays [rad]; 0 where
        it does not know them.
        """
        away = other.points - self.centres
        away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
        return np.where(other.known[:, None], away - self.rays, 0.0)


def _by_shared_points(
    one: Start, other: Start, observations: Observations, of_each: Sequence[Known]
) -> Similarity | None:
    """Similarity from the other's frame to the one's by the points that both see and one knows; None if too few fit.

    RANSAC: hypotheses by three points that both know.
    """
    a, b = _shared(one, other, observations, of_each)
    both = np.flatnonzero(a.known & b.known)
    if len(both) < _MIN_KNOWN_TWICE or len(a.points) < _MIN_POINTS:
        return None
    tolerance = _TOLERANCE_PX / one[0].camera.focal

    def off(similarity: Similarity) -> FloatArray:
        there = b.moved(similarity)
        return np.hstack([a.off(there), there.off(a)]) / tolerance

    def inliers(similarity: Similarity) -> BoolArray:
        return np.asarray(np.linalg.norm(off(similarity), axis=1) < 1)

    rng = np.random.default_rng(_SEED)
    samples = [rng.choice(both, 3, replace=False) for _ in range(_SAMPLES)]
    best = max((umeyama(b.points[rows], a.points[rows]) for rows in samples), key=lambda some: inliers(some).sum())
    best = _refined(best, off)
    return best if inliers(best).sum() >= max(_MIN_POINTS, _MIN_INLIER_SHARE * len(a.points)) else None


def _refined(similarity: Similarity, off: Callable[[Similarity], FloatArray]) -> Similarity:
    """The similarity near ``similarity`` with the least robust errors ``off``, in tolerances."""

    def near(x: FloatArray) -> Similarity:
        R = Rotation.from_rotvec(x[:3]).as_matrix() @ similarity.rotation
        return Similarity(similarity.scale * float(np.exp(x[6])), R, similarity.translation + x[3:6])

    def errors(x: FloatArray) -> FloatArray:
        return off(near(x)).ravel()

    return near(least_squares(errors, np.zeros(7), loss="cauchy", f_scale=_USUAL_ERROR).x)


def _shared(one: Start, other: Start, observations: Observations, known: Sequence[Known]) -> tuple[_Shared, _Shared]:
    """The points that both parts see and at least one knows, as each of the two does."""
    first = [_first_sightings(observations, members) for _, members in (one, other)]
    tracks = np.intersect1d(first[0].tracks, first[1].tracks)
    tracks = tracks[known[0][1][tracks] | known[1][1][tracks]]
    return _known(one, tracks, first[0], *known[0]), _known(other, tracks, first[1], *known[1])


def _first_sightings(observations: Observations, members: IntArray) -> Observations:
    """The first sighting of each point by the pictures ``members`` (N,), in the points' order."""
    seen = observations.at(np.isin(observations.keyframes, members))
    return seen.at(np.unique(seen.tracks, return_index=True)[1])


def _known(part: Start, tracks: IntArray, first: Observations, points: FloatArray, known: BoolArray) -> _Shared:
    """The points ``tracks`` (M,) as a part knows them: ``points`` (P, 3) if ``known`` (P,), and ``first`` sightings."""
    state, members = part
    seen = first.at(np.searchsorted(first.tracks, tracks))
    k = np.searchsorted(members, seen.keyframes)
    rays = np.einsum("nij,nj->ni", state.R_map_camera[k], state.camera.rays(seen.pixels))
    return _Shared(np.where(known[tracks, None], points[tracks], np.nan), state.positions[k], rays)


def _several_fit(whole: Start, members: IntArray, pairs: Sequence[VerifiedPair], rays: Sequence[FloatArray]) -> bool:
    """Whether two pairs without a common picture, each of a member and another picture of the ``whole``, fit its
    poses.
    """
    T = np.full((len(rays), 4, 4), np.nan)
    T[whole[1]] = whole[0].T_map_camera
    placed, inside = np.isfinite(T[:, 0, 0]), np.isin(np.arange(len(rays)), members)
    fitting = [
        {pair.first, pair.second}
        for pair in pairs
        if placed[[pair.first, pair.second]].all()
        and inside[pair.first] != inside[pair.second]
        and pair_error(pair, rays, T) <= MAX_PAIR_ERROR
    ]
    return any(a.isdisjoint(b) for a in fitting for b in fitting)
