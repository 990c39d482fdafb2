"""Localization in a large map: retrieve places first, then search for a pose among their landmarks alone.

Features are looked up in an inverted file over all landmarks, and the results vote for views. The views with the most
votes, and those that share most features with them, are cut out as a map of their own and searched like any map. Time
per frame grows with the square root of the map's size at most; memory grows linearly.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from scipy.sparse import csr_array

from rholoc.features import Extractor, FeatureSet, get_extractor
from rholoc.features.matching import DescriptorIndex
from rholoc.geometry import FloatArray, IntArray, ranges
from rholoc.localization.belief.confidence import MIN_RECOGNIZED
from rholoc.localization.index.map_index import MapIndex, chance_of_likeness
from rholoc.localization.index.matches import Matches, NearestLandmarks
from rholoc.localization.localizer import Localizer, check_kind
from rholoc.localization.pose.seeds import VIEWS_OF_LITTLE, groups_by_votes, views_by_prior
from rholoc.localization.search import SearchOptions
from rholoc.localization.types import Localization, Prior, Query
from rholoc.maps import DensityKind, Map, MapPart, part_of

LARGE_MAP = 30_000
"""Landmarks: in a map of more, finding the place first is quicker than matching with all of them."""

_CANDIDATES = 4
_VIEWS_EACH = 10


@dataclass(frozen=True)
class _Size:
    """Size of the part that is cut out for a frame.

    Attributes:
        places: maximum number of places that matches vote for.
        rivals: maximum number of places that features resemble at all.
        landmarks: maximum number of landmarks in all views together; a room has about 6000.
        views: maximum number of views.
    """

    places: int
    rivals: int
    landmarks: int
    views: int


_AT_FIRST = _Size(places=2, rivals=2, landmarks=3000, views=48)
_CLOSELY = _Size(places=8, rivals=4, landmarks=6000, views=128)


class PlaceIndex:
    """Inverted file over all landmarks of a map, and the views that saw each."""

    def __init__(self, map_: Map) -> None:
        self.map = map_
        self.metric = get_extractor(map_.info.features).metric
        first = np.searchsorted(map_.descriptors.features, np.arange(len(map_)))
        self._descriptors = DescriptorIndex(
            map_.descriptors.values[first], map_.landmarks.channels, self.metric, inverted=True
        )
        ones = np.ones(len(map_.observations), dtype=np.int8)
        shape = (len(map_.views), len(map_))
        seen_by = csr_array((ones, map_.observations.features, map_.view_offsets), shape=shape).tocsc()
        self._first_view, self._views = seen_by.indptr, seen_by.indices.astype(np.int32)

    def nearest(self, features: FeatureSet, some: IntArray | None = None) -> NearestLandmarks:
        """Approximately the four nearest landmarks of the whole map for each of a picture's features, or for the rows
        ``some`` (N,).

        Compares with the first descriptor of each landmark only.
        """
        detections = np.arange(len(features)) if some is None else some
        distances, landmarks = self._descriptors.nearest(features.take(detections), _CANDIDATES)
        return NearestLandmarks(detections, landmarks, distances, self.metric)

    def votes(self, matches: Matches) -> FloatArray:
        """Votes (K,) of the matches for each view: the sum of their probabilities (at most 1 per landmark) over the
        view's landmarks, divided by the square root of the view's size, as in
        :func:`rholoc.localization.pose.seeds.view_votes`.
        """
        landmarks, own = np.unique(matches.landmarks, return_inverse=True)
        belief = np.minimum(np.bincount(own, weights=matches.chances, minlength=len(landmarks)), 1.0)
        votes = self._sums(landmarks, belief)
        return np.asarray(votes / np.sqrt(np.maximum(np.diff(self.map.view_offsets), VIEWS_OF_LITTLE)))

    def shared_with(self, view: int) -> FloatArray:
        """(K,) number of features that each view shares with view ``view``."""
        first, last = self.map.view_offsets[view : view + 2]
        features = self.map.observations.features[first:last]
        return self._sums(features, np.ones(len(features)))

    def _sums(self, landmarks: IntArray, weights: FloatArray) -> FloatArray:
        """(K,) sum of the weights of the landmarks (M,) that each view saw."""
        first, last = self._first_view[landmarks], self._first_view[landmarks + 1]
        views, each = self._views[ranges(first, last)], np.repeat(weights, last - first)
        return np.bincount(views, each, len(self.map.views)).astype(np.float64)


@dataclass(frozen=True, eq=False)
class _NearestInPart(NearestLandmarks):
    """Nearest landmarks in the whole map, restricted to a part of it.

    A feature that resembles a landmark elsewhere most has no match in the part, and a similar landmark elsewhere is
    still a rival.

    Attributes:
        part: the part.
    """

    part: MapPart

    def joined(self, others: NearestLandmarks) -> NearestLandmarks:
        """As :meth:`NearestLandmarks.joined`, restricted to this one's part."""
        return _in_part(super().joined(others), self.part)

    def matches(self, mutual: bool = False) -> Matches:
        """The matches by the whole map that are in the part, landmarks numbered as in the part."""
        return self._within(super().matches(mutual))

    def pairs(self) -> Matches:
        """The pairs by the whole map that are in the part, landmarks numbered as in the part."""
        return self._within(super().pairs())

    def _within(self, found: Matches) -> Matches:
        """The matches inside the part, landmarks numbered as in the part."""
        features = self.part.features
        row = np.minimum(np.searchsorted(features, found.landmarks), len(features) - 1)
        inside = features[row] == found.landmarks
        return Matches(found.detections[inside], row[inside], found.chances[inside])


def _in_part(found: NearestLandmarks, part: MapPart) -> _NearestInPart:
    """Nearest landmarks in the whole map, restricted to a part."""
    return _NearestInPart(found.detections, found.landmarks, found.distances, found.metric, part)


class _PartIndex(MapIndex):
    """Index of a part of a map, with features compared against the whole map.

    Args:
        part: the part.
        chance: :func:`chance_of_likeness` of the whole map.
        places: inverted file of the whole map.
        looked_up: features that were looked up there before, and the result.
    """

    def __init__(
        self, part: MapPart, chance: float, places: PlaceIndex, looked_up: tuple[FeatureSet, NearestLandmarks]
    ) -> None:
        super().__init__(part.map, chance)
        self._part, self._places, self._looked_up = part, places, looked_up

    def nearest_everywhere(self, features: FeatureSet, some: IntArray | None = None) -> NearestLandmarks:
        """Approximately the nearest landmarks in the whole map, of which only those in the part are matched."""
        known, found = self._looked_up
        if features is not known or some is None or not np.array_equal(found.detections, some):
            found = self._places.nearest(features, some)
        return _in_part(found, self._part)


class LargeMapLocalizer:
    """Localizer for maps of any size with ``ray`` densities. Thread-safe.

    Args:
        map_: the map.
        min_recognized: as :class:`Localizer`.
        options: as :class:`Localizer`.
    """

    def __init__(self, map_: Map, min_recognized: float = MIN_RECOGNIZED, options: SearchOptions | None = None) -> None:
        self.map = map_
        self.min_recognized = min_recognized
        self.options = options
        self.index = PlaceIndex(map_)
        self._chance = chance_of_likeness(map_)

    @property
    def extractor(self) -> Extractor:
        """Extractor of the map's features. Raises NotInstalled, or InvalidInput if it is unknown."""
        return get_extractor(self.map.info.features)

    def localize(self, query: Query) -> Localization:
        """Localize one frame, as :meth:`Localizer.localize`, in the parts of the map that it may show.

        First the part near the prior, if there is one, then that of a sample of the features, then that of all
        features.

        Raises:
            InvalidDescriptors: the features are not of the map's kind.
        """
        check_kind(query.features, self.extractor)
        clock = _Clock(query.deadline_s)
        given = query.features
        query = replace(query, more_features=query.more_features or (lambda: given))  # first a quick look
        if query.prior is not None:
            near = views_by_prior(self.map.views.positions, self.map.views.headings, query.prior)
            if len(near):
                part = part_of(self.map, np.sort(self._first_views(near, _AT_FIRST)))
                answer = self._localizer(part, MapIndex(part.map, self._chance)).attempt(clock.remaining(query))
                if answer is not None:
                    return clock.answered(answer, part)
        part, localizer = self._where(query, query.features.sample, _AT_FIRST)
        answer = localizer.attempt(clock.remaining(query))
        if answer is None:
            assert query.more_features is not None
            query = replace(query, features=query.more_features(), more_features=None)
            part, localizer = self._where(query, np.arange(len(query.features)), _CLOSELY)
            answer = localizer.localize(clock.remaining(query))
        return clock.answered(answer, part)

    def _where(self, query: Query, some: IntArray, size: _Size) -> tuple[MapPart, Localizer]:
        """Cut out the part of the map that the rows ``some`` (N,) of a query's features vote for, at most of ``size``,
        and make its localizer.
        """
        nearest = self.index.nearest(query.features, some)
        part = self._part([nearest], query.prior, size)
        return part, self._localizer(part, _PartIndex(part, self._chance, self.index, (query.features, nearest)))

    def view_votes(self, features: FeatureSet) -> FloatArray:
        """Votes (K,) of a picture's features for each view of the map; see :meth:`PlaceIndex.votes`."""
        return self.index.votes(self.index.nearest(features).matches())

    def around(self, frames: Sequence[FeatureSet]) -> tuple[MapPart, Localizer]:
        """Cut out the part of the map that the frames' features vote for together (view 0 and its landmarks without
        votes), and make its localizer. For frames taken at one place.
        """
        part = self._part([self.index.nearest(features) for features in frames], None, _CLOSELY)
        return part, self._localizer(part, MapIndex(part.map, self._chance))

    def _localizer(self, part: MapPart, index: MapIndex) -> Localizer:
        """Localizer of a part, with this one's options."""
        return Localizer(part.map, self.min_recognized, self.options, index)

    def _part(self, found: Sequence[NearestLandmarks], prior: Prior | None, size: _Size) -> MapPart:
        """Cut out the part of the map that features vote for, with the places that may be confused with it.

        Args:
            found: nearest landmarks of each frame's features, whose votes are added.
            prior: adds the views near it; None for none.
            size: upper bounds of the part.
        """
        surely = np.sum([self.index.votes(nearest.matches()) for nearest in found], axis=0)
        perhaps = np.sum([self.index.votes(nearest.pairs()) for nearest in found], axis=0)
        views = [*self._places(surely, size.places), *self._places(perhaps, size.rivals)]
        if prior is not None:
            views.append(views_by_prior(self.map.views.positions, self.map.views.headings, prior)[:_VIEWS_EACH])
        voted = np.flatnonzero(surely > 0)
        views.append(voted[np.argsort(-surely[voted], kind="stable")[: size.views]])
        views.append(np.zeros(1, dtype=np.int64))  # where nothing is voted for
        return part_of(self.map, np.sort(self._first_views(np.concatenate(views), size)))

    def _places(self, votes: FloatArray, most: int) -> Iterator[IntArray]:
        """Iterate over the ``most`` places with the most votes (K,), each as its views (10 at most)."""
        for _, views in islice(groups_by_votes(votes, self.index.shared_with, _VIEWS_EACH), most):
            yield views

    def _first_views(self, views: IntArray, size: _Size) -> IntArray:
        """The first distinct views among ``views`` (N,), as many as ``size`` allows, at least one."""
        _, first = np.unique(views, return_index=True)
        views = views[np.sort(first)][: size.views]
        start, end = self.map.view_offsets[views], self.map.view_offsets[views + 1]
        _, at = np.unique(self.map.observations.features[ranges(start, end)], return_index=True)
        new = np.bincount(np.searchsorted(np.cumsum(end - start), at, side="right"), minlength=len(views))
        return views[: max(1, int(np.searchsorted(np.cumsum(new), size.landmarks, side="right")))]


class _Clock:
    """Time budget of one frame."""

    def __init__(self, deadline_s: float | None) -> None:
        self._deadline_s = deadline_s
        self._started = time.perf_counter()

    def remaining(self, query: Query) -> Query:
        """The query with its deadline reduced by the time spent, at least to 0; unchanged without a deadline."""
        if self._deadline_s is None:
            return query
        return replace(query, deadline_s=max(self._deadline_s - (time.perf_counter() - self._started), 0.0))

    def answered(self, answer: Localization, part: MapPart) -> Localization:
        """Translate a part's answer to the whole map: its ``inlier_features``, and the time spent on finding the part
        as ``place`` [ms].
        """
        spent_ms = 1e3 * (time.perf_counter() - self._started) - sum(answer.timings_ms.values())
        return in_whole_map(answer, part, spent_ms)


def in_whole_map(answer: Localization, part: MapPart, place_ms: float) -> Localization:
    """A part's answer with ``inlier_features`` as rows of the whole map, and ``place_ms``, the time [ms] that finding
    the part took, as the stage ``place``.
    """
    return replace(
        answer,
        timings_ms={"place": place_ms, **answer.timings_ms},
        inlier_features=part.features[answer.inlier_features],
        alternatives=tuple(
            replace(one, inlier_features=part.features[one.inlier_features]) for one in answer.alternatives
        ),
    )


AnyLocalizer = Localizer | LargeMapLocalizer


def localizer_of(map_: Map, min_recognized: float = MIN_RECOGNIZED) -> AnyLocalizer:
    """Localizer for a map of its size: for large maps above ``LARGE_MAP`` landmarks and ``ray`` densities."""
    if len(map_) > LARGE_MAP and map_.info.density is DensityKind.RAY:
        return LargeMapLocalizer(map_, min_recognized)
    return Localizer(map_, min_recognized)
