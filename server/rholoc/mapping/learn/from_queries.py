"""Learn from users: from confidently answered queries, without their pictures."""

import hashlib
from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np

from rholoc.errors import Conflict, MappingFailed
from rholoc.features import FeatureSet, Metric
from rholoc.features.matching import LIMITS, descriptor_distances
from rholoc.geometry import BoolArray, Camera, FloatArray, IntArray, evenly, pose_distances, ranges
from rholoc.localization import Dof, Localizer, Query
from rholoc.mapping.build.assembly import assemble
from rholoc.mapping.build.density_fitting import ray_form
from rholoc.mapping.build.landmarks import Landmarks
from rholoc.mapping.build.stored_observations import keep_features
from rholoc.mapping.build.tracks import Views
from rholoc.mapping.build.view_covariance import storable_covariances
from rholoc.mapping.edit.cutting import keep_views
from rholoc.mapping.edit.sources import join, with_sources_once
from rholoc.mapping.edit.versions import as_learned
from rholoc.mapping.learn.answered_query import AnsweredQuery
from rholoc.mapping.learn.expected_sightings import Looked, Sights, agreeing, vanished
from rholoc.mapping.learn.merging import remembered_frames
from rholoc.mapping.learn.recognition import recognize, seen_landmarks
from rholoc.mapping.learn.registration import LEARNING_RECOGNIZED
from rholoc.maps import Map, MapInfo, Source, check_memory
from rholoc.progress import ProgressListener, Stage, silent
from rholoc.reports import LearningReport, QueriesReport

MIN_QUERIES = 30
QUERY_POSES = "queries"  # where the poses of a source came from: from localizing queries

_HELD_BACK_EVERY = 5
_ROUNDS = 2  # of placing queries by what was learned from them, and learning again
_MAX_SIGMA_RATIO = 5.0  # of a pose that counts as evidence, against the median of all
_MAX_VIEW_SIGMA_RATIO = 3.0  # of a pose that becomes a view: its error is passed on to new landmarks
_OCCASION_S = 600.0  # an asker's queries closer in time are of one occasion
_MIN_OCCASIONS = 2
_MAX_CAMERAS = 4
_MIN_VIEWS, _MAX_VIEWS_SHARE = 30, 0.35  # of queries; against the views of recordings
_MAX_LANDMARKS_RATIO = 1.15  # against those that recordings brought
_MAX_KNOWN_PER_VIEW = 120  # landmarks that a view of a query keeps, beside the new ones
_METRES_PER_RADIAN = 1.0
_RIGHT_M, _RIGHT_RAD = 0.05, np.deg2rad(5.0)
_WRONG_M, _WRONG_RAD = 0.25, np.deg2rad(10.0)
_MAX_REMEMBERED = 40
_RIGHT_PER_WRONG = 3  # more answers that are right outweigh one more that is wrong
_WORSE_M = 0.01  # tolerated growth of the median error: the reference poses come from the map before


@dataclass(frozen=True, eq=False)
class _Placed:
    """A query and its pose in the present map."""

    query: AnsweredQuery
    T_map_camera: FloatArray
    covariance: FloatArray
    occasion: int


def learn_from_queries(map_: Map, queries: Sequence[AnsweredQuery], progress: ProgressListener = silent) -> Map:
    """The next version of a map: with views and landmarks of what was seen often, without what is no longer seen.

    Every query is first localized anew, without a prior. Only confident queries are used, and only if other cameras
    see the same landmarks (:func:`rholoc.mapping.learn.expected_sightings.agreeing`). A landmark is added once it was
    seen from several places on several occasions. It is forgotten once many queries should have seen it and did not
    (:func:`rholoc.mapping.learn.expected_sightings.vanished`). Then all queries are localized in the new map, the
    doubtful ones too, and learned again. A fifth of the queries is held back for a test: these queries, whole and by
    halves, and the views that the map remembers must be localized as well as before. The numbers of views and of
    landmarks from queries are bounded by those from recordings; a view of a query gives way to newer ones near it.

    Raises:
        InvalidInput: the map does not remember its observations.
        Conflict: fewer than ``MIN_QUERIES`` queries are given.
        MappingFailed: fewer than ``MIN_QUERIES`` are believed, there is nothing to learn, or the map would be worse;
            says by how much.
        Cancelled: ``progress`` asked to stop.
    """
    check_memory(map_, "The map")
    if len(queries) < MIN_QUERIES:
        raise too_few_queries(len(queries))
    known = ray_form(map_)
    localizer = Localizer(known, min_recognized=LEARNING_RECOGNIZED)
    queries = sorted(queries, key=lambda query: query.time_s)
    placed = _placed(localizer, queries, progress)
    believed = _believed(localizer, placed)
    if len(believed) < MIN_QUERIES:
        raise MappingFailed(
            f"Only {len(believed)} of {len(queries)} queries are sure in the map as it is and agree with the others; "
            f"at least {MIN_QUERIES} are needed.",
            "The map is unchanged.",
        )
    lesson = _lesson(localizer, believed, progress)
    believed_again = believed
    for _ in range(_ROUNDS):  # what was hard to place by the old landmarks alone is easier by the new ones too
        if lesson.is_empty:
            break
        better = Localizer(lesson.map_, min_recognized=LEARNING_RECOGNIZED)
        believed_again = _believed(better, _placed(better, queries, progress))
        lesson = _lesson(localizer, believed_again, progress)
    if lesson.is_empty:
        raise MappingFailed("The queries show nothing new, and miss nothing.", "The map is unchanged.")
    learned = Localizer(lesson.map_, min_recognized=LEARNING_RECOGNIZED)
    held_back = [one for one in _settled(placed, believed, believed_again) if _is_held_back(one.query)]
    questions, remembered = _questions(held_back), _remembered(known, lesson.gone)
    before_answers, after_answers = _answers(localizer, questions), _answers(learned, questions)
    progress(Stage.REPORT, 0.7, f"{len(held_back)} queries held back, asked before and after")
    _check_no_worse(before_answers, after_answers, "queries held back, whole and by halves,")
    _check_no_worse(_answers(localizer, remembered), _answers(learned, remembered), "views of its own")
    report = LearningReport(
        version=map_.info.version + 1,
        views=lesson.views,
        features_seen_again=lesson.seen_again,
        features_new=lesson.new,
        queries=QueriesReport(
            kept=len(queries),
            sure=len(placed),
            askers=len({one.query.asker for one in placed}),
            occasions=len({one.occasion for one in placed}),
            features_forgotten=int(lesson.gone.sum()),
            held_back=len(held_back),
            recall_before=before_answers.recall,
            recall_after=after_answers.recall,
            median_before_m=before_answers.median_m,
            median_after_m=after_answers.median_m,
            contradicted=len(placed) - len(believed),
        ),
    )
    return as_learned(map_, lesson.map_, report, progress)


def _is_held_back(query: AnsweredQuery) -> bool:
    """Whether a query is one of the fifth reserved for testing; by a hash of asker and time: always the same ones."""
    digest = hashlib.blake2b(f"{query.asker} {query.time_s:.3f}".encode(), digest_size=8).digest()
    return int.from_bytes(digest) % _HELD_BACK_EVERY == 0


def too_few_queries(kept: int) -> Conflict:
    """Error for a map with only ``kept`` queries to learn from."""
    return Conflict(
        f"{kept} queries are kept for the map; it learns from {MIN_QUERIES} at least.",
        "Set RHOLOC_LEARN=true to keep queries, and try again when the map has been asked more often.",
    )


def _placed(localizer: Localizer, queries: Sequence[AnsweredQuery], progress: ProgressListener) -> list[_Placed]:
    """Localize the queries without a prior. Returns those found with a position sigma of at most 5 × the median."""
    occasions = _occasions(queries)
    found = []
    for done, (query, occasion) in enumerate(zip(queries, occasions.tolist(), strict=True)):
        answer = localizer.localize(Query(query.features, query.camera, Dof.FREE))
        if answer.pose is not None and answer.covariance is not None:
            found.append(_Placed(query, answer.pose.T_map_camera, answer.covariance, occasion))
        progress(Stage.POSES, (done + 1) / len(queries), f"{done + 1} of {len(queries)} queries localized anew")
    return _exact(found, _MAX_SIGMA_RATIO)


def _exact(placed: Sequence[_Placed], ratio: float) -> list[_Placed]:
    """Queries with a position sigma of at most ``ratio`` × the median of all."""
    sigmas_m = np.sqrt([np.trace(one.covariance[:3, :3]) for one in placed])
    most_m = ratio * np.median(sigmas_m) if len(placed) else np.inf
    return [one for one, sigma_m in zip(placed, sigmas_m, strict=True) if sigma_m <= most_m]


def _believed(localizer: Localizer, placed: Sequence[_Placed]) -> list[_Placed]:
    """Queries that the others do not contradict. Held-back queries are judged too, but do not judge."""
    teaching = np.array([not _is_held_back(one.query) for one in placed], dtype=bool)
    agree = agreeing(_sights(localizer, placed), teaching)
    return [one for one, agrees in zip(placed, agree.tolist(), strict=True) if agrees]


def _sights(localizer: Localizer, placed: Sequence[_Placed]) -> Sights:
    """Expected sightings of the localizer's map by the queries."""
    looked = [Looked(one.query.camera, one.T_map_camera, one.query.features, one.occasion) for one in placed]
    return Sights.of(localizer.index, looked, _is_recorded(localizer.map))


def _settled(placed: Sequence[_Placed], believed: Sequence[_Placed], again: Sequence[_Placed]) -> list[_Placed]:
    """Queries believed before the map has learned, or after (``again``), with the pose from before if they were
    believed then. Queries whose two poses are more than 25 cm or 10° apart are dropped.
    """
    before, after = ({id(one.query): one for one in some} for some in (believed, again))
    found = []
    for number in (id(one.query) for one in placed):
        one, other = before.get(number), after.get(number)
        if one is not None and other is not None:
            apart_m, turned_rad = pose_distances(one.T_map_camera, other.T_map_camera)
            if apart_m > _WRONG_M or turned_rad > _WRONG_RAD:
                continue
        settled = one or other
        if settled is not None:
            found.append(settled)
    return found


def _occasions(queries: Sequence[AnsweredQuery]) -> IntArray:
    """Number (Q,) of the occasion: equal for a client's queries that follow each other within ten minutes."""
    times = np.array([query.time_s for query in queries])
    _, askers = np.unique([query.asker for query in queries], return_inverse=True)
    order = np.lexsort((times, askers))
    starts = (np.diff(askers[order], prepend=-1) != 0) | (np.diff(times[order], prepend=-np.inf) > _OCCASION_S)
    occasions = np.zeros(len(queries), dtype=np.int64)
    occasions[order] = np.cumsum(starts) - 1
    return occasions


def _is_recorded(map_: Map) -> BoolArray:
    """Mask (K,) of the views from recordings rather than queries."""
    return ~_is_of_queries(map_.info)[check_memory(map_, "The map").view_sources]


def _is_of_queries(info: MapInfo) -> BoolArray:
    """Mask (S,) of the map's sources that are queries."""
    return np.array([source.poses == QUERY_POSES for source in info.sources])


def _chosen_views(known: Map, teaching: Sequence[_Placed]) -> tuple[BoolArray, list[_Placed]]:
    """Mask (K,) of the map's views that stay, and the queries that become views.

    A query may become a view if its position sigma is at most 3 × the median of ``teaching``, no view was learned from
    a query of its time, and its camera is one of the four most common. Views of queries, old and new, are thinned
    together: an old one gives way to newer ones near it, not to those of other places.
    """
    of_queries = np.flatnonzero(~_is_recorded(known))
    T_old, times_old = known.views.T_map_camera[of_queries], known.views.times[of_queries]
    learned = set(times_old.tolist())
    new = [one for one in _exact(teaching, _MAX_VIEW_SIGMA_RATIO) if one.query.time_s not in learned]
    cameras = [one.query.camera for one in new]
    common = sorted(set(cameras), key=lambda camera: (-cameras.count(camera), astuple(camera)))[:_MAX_CAMERAS]
    new = [one for one in new if one.query.camera in common]
    T_new = np.array([one.T_map_camera for one in new]).reshape(-1, 4, 4)
    times = np.append(times_old, [one.query.time_s for one in new])
    chosen = _thinned(np.concatenate([T_old, T_new]), times, _most_views(known))
    stays = np.ones(len(known.views), dtype=bool)
    stays[of_queries] = chosen[: len(of_queries)]
    return stays, [new[row] for row in np.flatnonzero(chosen[len(of_queries) :])]


def _most_views(map_: Map) -> int:
    """Maximum number of views from queries: 0.35 × the recorded ones, at least 30."""
    return max(_MIN_VIEWS, int(_MAX_VIEWS_SHARE * _is_recorded(map_).sum()))


def _thinned(T_map_camera: FloatArray, times: FloatArray, most: int) -> BoolArray:
    """Mask (N,) of at most ``most`` poses (N, 4, 4), spread over the map.

    While there are more, the older of the two closest ones (metres plus radians) is dropped; ``times`` (N,) say which.
    """
    newest_first = np.argsort(-times, kind="stable")
    T = T_map_camera[newest_first]
    to_newer = np.full((len(T), len(T)), np.inf)
    for row in range(len(T)):
        apart_m, turned_rad = pose_distances(T[row], T[:row])
        to_newer[row, :row] = apart_m + _METRES_PER_RADIAN * turned_rad
    kept = np.ones(len(T), dtype=bool)
    for _ in range(len(T) - most):
        older = int(to_newer.argmin()) // len(T)
        to_newer[older] = to_newer[:, older] = np.inf
        kept[newest_first[older]] = False
    return kept


@dataclass(frozen=True, eq=False)
class _Lesson:
    """Result of learning from queries.

    Attributes:
        map_: the map after learning.
        gone: (F,) mask of the previous map's landmarks that are gone.
        views: number of new views.
        seen_again: number of known landmarks in the new views.
        new: number of new landmarks.
    """

    map_: Map
    gone: BoolArray
    views: int
    seen_again: int
    new: int

    @property
    def is_empty(self) -> bool:
        """Whether no landmark was added or removed."""
        return not self.new and not self.gone.any()


def _lesson(localizer: Localizer, placed: Sequence[_Placed], progress: ProgressListener) -> _Lesson:
    """The localizer's map without vanished landmarks, with queries (except held-back ones) as views instead of older
    ones near them. ``placed`` are the believed queries with their poses.
    """
    known = localizer.map
    teaching = [one for one in placed if not _is_held_back(one.query)]
    gone = vanished(_sights(localizer, teaching))
    progress(Stage.OBSERVATIONS, 0.0, f"{int(gone.sum())} landmarks are no longer seen")
    stays, fresh = _chosen_views(known, teaching)
    left = keep_features(known, ~gone)
    if not fresh:
        return _Lesson(keep_views(left, stays), gone, 0, 0, 0)
    map_, seen_again, new = _joined(left, fresh, _most_landmarks(known), progress)
    bounded = keep_views(map_, np.append(stays, np.ones(len(fresh), dtype=bool)))
    return _Lesson(bounded, gone, len(fresh), seen_again, new)


def _joined(left: Map, fresh: Sequence[_Placed], most: int, progress: ProgressListener) -> tuple[Map, int, int]:
    """A map extended by the views of queries, with at most ``most`` landmarks; how many of its landmarks they see
    again; how many are new.
    """
    localizer = Localizer(left, min_recognized=LEARNING_RECOGNIZED)
    cameras = [one.query.camera for one in fresh]
    T = np.array([one.T_map_camera for one in fresh])
    times = np.array([one.query.time_s for one in fresh])
    views = Views.from_features(cameras, T, times, [one.query.features for one in fresh])
    labels, new, _ = recognize(localizer, views, progress)
    new = new.keep(_seen_repeatedly(views, new, np.array([one.occasion for one in fresh])))
    new = new.keep(_needed_most(views, new, labels, most - len(left)))
    seen, landmarks = seen_landmarks(left, _some_of_each_view(views, labels), new)
    sources = [_source(left, camera) for camera in dict.fromkeys(cameras)]
    rows = {source.camera: row for row, source in enumerate(sources)}
    info = replace(left.info, sources=tuple(sources), waypoints=())
    view_sources = np.array([rows[camera] for camera in cameras], dtype=np.int64)
    learned = assemble(info, views, landmarks, view_sources, localizer.extractor.metric)
    if left.views.covariances is not None:
        covariances = storable_covariances(np.array([one.covariance for one in fresh]))
        learned = replace(learned, views=replace(learned.views, covariances=covariances))
    joined = _without_like_descriptors(with_sources_once(join(left, learned, seen)), localizer.extractor.metric)
    return joined, int((seen >= 0).sum()), int((seen < 0).sum())


def _some_of_each_view(views: Views, labels: IntArray) -> IntArray:
    """Labels (N,) of known landmarks, or -1; of each view at most 120, evenly chosen, as many as recognition needs."""
    kept = np.full_like(labels, -1)
    for k in range(len(views)):
        known = np.flatnonzero(labels[views.offsets[k] : views.offsets[k + 1]] >= 0) + views.offsets[k]
        known = known[evenly(len(known), _MAX_KNOWN_PER_VIEW)]
        kept[known] = labels[known]
    return kept


def _without_like_descriptors(map_: Map, metric: Metric) -> Map:
    """Drop each query's descriptor that is closer than half the strict limit to a recording's of the same feature."""
    kept = check_memory(map_, "The map")
    of_queries = _is_of_queries(map_.info)[kept.descriptor_sources]
    features = map_.descriptors.features
    first = np.searchsorted(features, features)
    last = np.searchsorted(features, features, side="right")
    ours = np.flatnonzero(of_queries)
    others = ranges(first[ours], last[ours])
    owner = np.repeat(ours, last[ours] - first[ours])
    distances = descriptor_distances(map_.descriptors.values[owner], map_.descriptors.values[others], metric)
    like = ~of_queries[others] & (distances <= 0.5 * LIMITS[metric].strict)
    stays = np.ones(len(features), dtype=bool)
    stays[owner[like]] = False
    return replace(map_, descriptors=map_.descriptors.take(stays))


def _source(map_: Map, camera: Camera) -> Source:
    """A source for all queries of one camera; its id is a hash of the map's and the intrinsics."""
    digest = hashlib.blake2b(repr((map_.info.id, astuple(camera))).encode(), digest_size=8)
    return Source(name=QUERY_POSES, id=digest.hexdigest(), camera=camera, poses=QUERY_POSES)


def _seen_repeatedly(views: Views, landmarks: Landmarks, occasions: IntArray) -> BoolArray:
    """Mask (F,) of landmarks seen on at least two of the views' occasions (K,)."""
    rows = landmarks.observed_rows
    seen = np.unique(np.column_stack([landmarks.labels[rows], occasions[views.view_of[rows]]]), axis=0)
    return np.bincount(seen[:, 0], minlength=len(landmarks)) >= _MIN_OCCASIONS


def _needed_most(views: Views, landmarks: Landmarks, known: IntArray, most: int) -> BoolArray:
    """Mask (F,) of at most ``most`` new landmarks that views need most. A view needs the landmarks that most views see,
    and more of them the fewer of its detections (N,) are ``known`` (not -1).
    """
    rows = landmarks.observed_rows
    labels, view = landmarks.labels[rows], views.view_of[rows]
    order = np.lexsort((labels, -landmarks.view_counts[labels], view))
    labels, view = labels[order], view[order]
    rank = np.arange(len(order)) - np.searchsorted(view, view)
    known_in_view = np.bincount(views.view_of[known >= 0], minlength=len(views))
    need = np.full(len(landmarks), np.inf)
    np.minimum.at(need, labels, (known_in_view[view] + rank).astype(np.float64))
    chosen = np.zeros(len(landmarks), dtype=bool)
    chosen[np.argsort(need, kind="stable")[:most]] = True
    return chosen


def _most_landmarks(known: Map) -> int:
    """Maximum number of landmarks in the next version: as many as now, or 1.15 × those that recordings contributed."""
    recorded = np.unique(known.observations.features[_is_recorded(known)[known.observations.views]])
    return max(len(known), int(_MAX_LANDMARKS_RATIO * len(recorded)))


@dataclass(frozen=True)
class _Answers:
    """A map's answers to test queries.

    Attributes:
        asked: number of queries.
        right: number of answers within 5 cm and 5°.
        wrong: number of answers off by more than 25 cm or 10°.
        median_m: median error of the answers; None if there are none.
    """

    asked: int
    right: int
    wrong: int
    median_m: float | None

    @property
    def recall(self) -> float:
        """Share of the queries with a right answer; 0 without queries."""
        return self.right / max(self.asked, 1)


def _answers(localizer: Localizer, frames: Sequence[tuple[Camera, FloatArray, FeatureSet]]) -> _Answers:
    """Localize frames, each a camera, its true T_map_camera (4, 4) and its features, and compare the poses found."""
    errors = []
    for camera, T, features in frames:
        pose = localizer.localize(Query(features, camera, Dof.FREE)).pose
        if pose is not None:
            errors.append(pose_distances(pose.T_map_camera, T))
    distances, angles = np.array(errors).reshape(-1, 2).T
    right = int(((distances < _RIGHT_M) & (angles < _RIGHT_RAD)).sum())
    median_m = float(np.median(distances)) if len(errors) else None
    wrong = int(((distances > _WRONG_M) | (angles > _WRONG_RAD)).sum())
    return _Answers(len(frames), right, wrong, median_m)


def _questions(held_back: Sequence[_Placed]) -> list[tuple[Camera, FloatArray, FeatureSet]]:
    """Held-back queries as frames, three each: whole, left half, right half. Half a picture is harder to localize."""
    found = []
    for one in held_back:
        features, camera = one.query.features, one.query.camera
        on_the_left = features.pixels[:, 0] < 0.5 * camera.width
        for rows in (np.ones(len(features), dtype=bool), on_the_left, ~on_the_left):
            found.append((camera, one.T_map_camera, features.take(np.flatnonzero(rows))))
    return found


def _remembered(map_: Map, gone: BoolArray) -> list[tuple[Camera, FloatArray, FeatureSet]]:
    """At most 40 of the recordings' views, evenly spread, as frames: camera, T_map_camera (4, 4), and the view's
    features without those of landmarks in the mask ``gone`` (F,).
    """
    recorded = np.flatnonzero(_is_recorded(map_))
    chosen = recorded[evenly(len(recorded), _MAX_REMEMBERED)]
    frames = remembered_frames(map_)
    found = []
    for view in chosen.tolist():
        camera, features = frames[view]
        seen = map_.observations.features[map_.view_offsets[view] : map_.view_offsets[view + 1]]
        found.append((camera, map_.views.T_map_camera[view], features.take(np.flatnonzero(~gone[seen]))))
    return found


def _check_no_worse(before: _Answers, after: _Answers, of: str) -> None:
    """Check that answers after learning are no worse than before. ``of`` names the test queries in messages.

    Raises:
        MappingFailed: fewer answers are right, fewer than three more are right for each further wrong one, none is
            found any more, or the median error grew by more than a centimetre.
    """
    gained = after.right - before.right
    if gained < 0 or _RIGHT_PER_WRONG * (after.wrong - before.wrong) > gained:
        raise MappingFailed(
            f"The map would be worse: of {before.asked} {of} it would place {after.right} rightly and {after.wrong} "
            f"wrongly, and places {before.right} and {before.wrong}.",
            "The map is unchanged.",
        )
    if before.median_m is None:
        return
    if after.median_m is None:
        raise MappingFailed(f"The map would find none of {before.asked} {of} any more.", "The map is unchanged.")
    if after.median_m > before.median_m + _WORSE_M:
        raise MappingFailed(
            f"The map would be less exact: it would place {of} to {1000 * after.median_m:.0f} mm in the median, and "
            f"places them to {1000 * before.median_m:.0f} mm.",
            "The map is unchanged.",
        )
