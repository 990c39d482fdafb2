"""Frame → pose in a large map: which places first, then a pose among the landmarks of those places alone.

Features are looked up in an inverted file over all landmarks; what is found votes for the views that saw it; the
likeliest views and those that share most with them are cut out as a map of their own, and searched as any map is.
Nothing that is done for a frame takes time by the map's size, but for lists that lengthen with its square root and a
few sums over its views; nothing that is kept grows with the square of anything.
"""

from __future__ import annotations

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
from rholoc.localization.localizer import Localizer, SearchOptions, check_kind
from rholoc.localization.pose.seeds import VIEWS_OF_LITTLE, groups_by_votes, views_by_prior
from rholoc.localization.types import Localization, Prior, Query
from rholoc.maps import DensityKind, Map, MapPart, part_of

LARGE_MAP = 30_000
"""Landmarks: in a map of more, finding the place first is quicker than matching with all of them."""

_CANDIDATES = 4
_VIEWS_EACH = 10


@dataclass(frozen=True)
class _Size:
    """How much of a map is cut out for a frame.

    Attributes:
        places: the most places that its matches speak for.
        rivals: the most that its features are like at all.
        landmarks: the most that all views may have seen together; a room has about 6000.
        views: the most of them.
    """

    places: int
    rivals: int
    landmarks: int
    views: int


_AT_FIRST = _Size(places=2, rivals=2, landmarks=3000, views=48)
_CLOSELY = _Size(places=8, rivals=4, landmarks=6000, views=128)


class PlaceIndex:
    """All landmarks of a map by their descriptors, and the views that saw each."""

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
        """What in the whole map a picture's features, or ``some`` of them (N,), are most like, nearly always."""
        detections = np.arange(len(features)) if some is None else some
        distances, landmarks = self._descriptors.nearest(features.take(detections), _CANDIDATES)
        return NearestLandmarks(detections, landmarks, distances, self.metric)

    def votes(self, matches: Matches) -> FloatArray:
        """(K,) as :func:`rholoc.localization.pose.seeds.view_votes`."""
        landmarks, own = np.unique(matches.landmarks, return_inverse=True)
        belief = np.minimum(np.bincount(own, weights=matches.chances, minlength=len(landmarks)), 1.0)
        votes = self._sums(landmarks, belief)
        return np.asarray(votes / np.sqrt(np.maximum(np.diff(self.map.view_offsets), VIEWS_OF_LITTLE)))

    def shared_with(self, view: int) -> FloatArray:
        """(K,) how many features each view shares with one of them."""
        first, last = self.map.view_offsets[view : view + 2]
        features = self.map.observations.features[first:last]
        return self._sums(features, np.ones(len(features)))

    def _sums(self, landmarks: IntArray, weights: FloatArray) -> FloatArray:
        """(K,) the weights of those of some landmarks (M,) that each view saw, added up."""
        first, last = self._first_view[landmarks], self._first_view[landmarks + 1]
        views, each = self._views[ranges(first, last)], np.repeat(weights, last - first)
        return np.bincount(views, each, len(self.map.views)).astype(np.float64)


@dataclass(frozen=True, eq=False)
class _NearestInPart(NearestLandmarks):
    """The landmarks of a whole map that features are most like, of which those in a part of it count.

    A feature that is most like something elsewhere is no match in the part; what is alike elsewhere is a rival all the
    same.

    Attributes:
        part: the part.
    """

    part: MapPart

    def joined(self, others: NearestLandmarks) -> NearestLandmarks:
        return _in_part(super().joined(others), self.part)

    def matches(self, mutual: bool = False) -> Matches:
        return self._within(super().matches(mutual))

    def pairs(self) -> Matches:
        return self._within(super().pairs())

    def _within(self, found: Matches) -> Matches:
        features = self.part.features
        row = np.minimum(np.searchsorted(features, found.landmarks), len(features) - 1)
        inside = features[row] == found.landmarks
        return Matches(found.detections[inside], row[inside], found.chances[inside])


def _in_part(found: NearestLandmarks, part: MapPart) -> _NearestInPart:
    return _NearestInPart(found.detections, found.landmarks, found.distances, found.metric, part)


class _PartIndex(MapIndex):
    """The index of a part of a map, whose features are held against the whole map's.

    Args:
        part: the part.
        chance: the whole map's :func:`chance_of_likeness`.
        places: the whole map's landmarks.
        looked_up: what has been looked up there already, of which features.
    """

    def __init__(
        self, part: MapPart, chance: float, places: PlaceIndex, looked_up: tuple[FeatureSet, NearestLandmarks]
    ) -> None:
        super().__init__(part.map, chance)
        self._part, self._places, self._looked_up = part, places, looked_up

    def nearest_everywhere(self, features: FeatureSet, some: IntArray | None = None) -> NearestLandmarks:
        known, found = self._looked_up
        if features is not known or some is None or not np.array_equal(found.detections, some):
            found = self._places.nearest(features, some)
        return _in_part(found, self._part)


class LargeMapLocalizer:
    """Localizes frames in a map of any size, whose densities are ``ray``; calls may come from several threads.

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
        """The extractor whose features the map is made of."""
        return get_extractor(self.map.info.features)

    def localize(self, query: Query) -> Localization:
        """As :meth:`Localizer.localize`.

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
        """The part of the map that some of a query's features (N,) speak for, and its localizer."""
        nearest = self.index.nearest(query.features, some)
        part = self._part([nearest], query.prior, size)
        return part, self._localizer(part, _PartIndex(part, self._chance, self.index, (query.features, nearest)))

    def view_votes(self, features: FeatureSet) -> FloatArray:
        """(K,) as :meth:`Localizer.view_votes`."""
        return self.index.votes(self.index.nearest(features).matches())

    def around(self, frames: Sequence[FeatureSet]) -> tuple[MapPart, Localizer]:
        """The part of the map where frames of one place may be, and its localizer."""
        part = self._part([self.index.nearest(features) for features in frames], None, _CLOSELY)
        return part, self._localizer(part, MapIndex(part.map, self._chance))

    def _localizer(self, part: MapPart, index: MapIndex) -> Localizer:
        return Localizer(part.map, self.min_recognized, self.options, index)

    def _part(self, found: Sequence[NearestLandmarks], prior: Prior | None, size: _Size) -> MapPart:
        """The part of the map that frames' features speak for, with the places that may be taken for it."""
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
        """The views of the places that most votes are for."""
        for _, views in islice(groups_by_votes(votes, self.index.shared_with, _VIEWS_EACH), most):
            yield views

    def _first_views(self, views: IntArray, size: _Size) -> IntArray:
        """The first different ones of some views (N,), as many as ``size`` allows; at least one."""
        _, first = np.unique(views, return_index=True)
        views = views[np.sort(first)][: size.views]
        start, end = self.map.view_offsets[views], self.map.view_offsets[views + 1]
        _, at = np.unique(self.map.observations.features[ranges(start, end)], return_index=True)
        new = np.bincount(np.searchsorted(np.cumsum(end - start), at, side="right"), minlength=len(views))
        return views[: max(1, int(np.searchsorted(np.cumsum(new), size.landmarks, side="right")))]


class _Clock:
    """The time of one frame: what is left of it, and what it was spent on."""

    def __init__(self, deadline_s: float | None) -> None:
        self._deadline_s = deadline_s
        self._started = time.perf_counter()

    def remaining(self, query: Query) -> Query:
        """The query with the time that is left."""
        if self._deadline_s is None:
            return query
        return replace(query, deadline_s=max(self._deadline_s - (time.perf_counter() - self._started), 0.0))

    def answered(self, answer: Localization, part: MapPart) -> Localization:
        """A part's answer as one of the whole map; what its own stages did not take, finding the part did."""
        spent_ms = 1e3 * (time.perf_counter() - self._started) - sum(answer.timings_ms.values())
        timings_ms = {"place": spent_ms, **answer.timings_ms}
        return replace(answer, timings_ms=timings_ms, inlier_features=part.features[answer.inlier_features])


AnyLocalizer = Localizer | LargeMapLocalizer


def localizer_of(map_: Map, min_recognized: float = MIN_RECOGNIZED) -> AnyLocalizer:
    """The localizer that suits a map's size."""
    if len(map_) > LARGE_MAP and map_.info.density is DensityKind.RAY:
        return LargeMapLocalizer(map_, min_recognized)
    return Localizer(map_, min_recognized)
