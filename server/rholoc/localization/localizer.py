"""Frame → pose: the localizer of one map."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from rholoc.errors import InvalidDescriptors
from rholoc.features import Extractor, get_extractor
from rholoc.geometry import FloatArray, Pose
from rholoc.localization.ascent import upright
from rholoc.localization.confidence import MIN_CONFIDENCE, confidence_of
from rholoc.localization.map_index import MapIndex
from rholoc.localization.map_uncertainty import with_map_error
from rholoc.localization.matches import Matches
from rholoc.localization.seeds import Place, minimal_samples, vote_for_places
from rholoc.localization.types import Dof, Localization, Prior, Query, Reason
from rholoc.localization.verification import (
    Verified,
    better,
    climb,
    distance_between,
    evidence_of,
    verify,
)
from rholoc.maps import Map

_MIN_FEATURES = 8
_MAX_GRAVITY_ERROR_RAD = np.deg2rad(10.0)
_MAX_UPRIGHT_ROLL_RAD = np.deg2rad(15.0)


@dataclass(frozen=True)
class SearchOptions:
    """How hard the localizer looks.

    Attributes:
        places: the most places that are searched for a seed.
        views_each: how many views that see the same landmarks make up a place.
        samples: minimal samples drawn in each place.
        seeds: the best samples of a place that are ascended from.
        seed_tolerances_px: the tolerances of that ascent, narrowing.
        conclusive: the confidence at which the search stops.
    """

    places: int = 8
    views_each: int = 10
    samples: int = 150
    seeds: int = 2
    seed_tolerances_px: tuple[float, ...] = (24.0, 12.0, 6.0)
    conclusive: float = 0.95


@dataclass
class _Stopwatch:
    """Milliseconds by stage, and the deadline."""

    deadline_s: float | None
    started: float = field(default_factory=time.perf_counter)
    timings_ms: dict[str, float] = field(default_factory=dict)
    _last: float = field(default_factory=time.perf_counter)

    def lap(self, stage: str) -> None:
        now = time.perf_counter()
        self.timings_ms[stage] = self.timings_ms.get(stage, 0.0) + 1e3 * (now - self._last)
        self._last = now

    @property
    def late(self) -> bool:
        return self.deadline_s is not None and time.perf_counter() - self.started > self.deadline_s


class Localizer:
    """Localizes frames in one map. Building it makes the index; calls may come from several threads.

    Args:
        map_: the map.
        min_confidence: answers below it are refused (``localized`` False, reason ``low_confidence``).
        options: how hard to look.
    """

    def __init__(self, map_: Map, min_confidence: float = MIN_CONFIDENCE, options: SearchOptions | None = None) -> None:
        self.map = map_
        self.min_confidence = min_confidence
        self.options = options or SearchOptions()
        self.index = MapIndex(map_)

    @property
    def extractor(self) -> Extractor:
        """The extractor whose features the map is made of."""
        return get_extractor(self.map.info.features)

    def localize(self, query: Query) -> Localization:
        """The pose of one frame, by equation (1).

        Raises:
            InvalidDescriptors: the features are not of the map's kind.
        """
        watch = _Stopwatch(query.deadline_s)
        self._check(query)
        if not self.map.info.upright:
            query = replace(query, gravity=None)
        if len(query.features) < _MIN_FEATURES:
            return _refusal(Reason.NO_FEATURES, 0, watch)
        rays = query.camera.rays(query.features.pixels)
        tracked = self._track(query, rays)
        watch.lap("verify")
        if tracked is not None and self._conclusive(tracked):
            return self._answer(tracked, query.dof, len(tracked.matches), watch)
        everywhere = self.index.match_everywhere(query.features)
        watch.lap("match")
        if len(everywhere) < _MIN_FEATURES:
            return self._settle(tracked, query.dof, Reason.NO_MATCHES, len(everywhere), watch)
        best = tracked
        for place in self._places(everywhere, query.prior):
            if watch.late:
                return self._settle(best, query.dof, Reason.DEADLINE, len(everywhere), watch)
            found = self._search(place, query, rays, watch)
            best = better(best, found)
            if best is found and self._conclusive(found):
                break
        return self._settle(best, query.dof, Reason.NO_AGREEMENT, len(everywhere), watch)

    def _check(self, query: Query) -> None:
        wanted = self.extractor
        given = query.features.descriptors.shape[1]
        if given != wanted.descriptor_bytes:
            raise InvalidDescriptors(
                f"The descriptors have {given} bytes; this map's have {wanted.descriptor_bytes}.",
                f"Extract '{wanted.name}' features for this map.",
            )

    def _places(self, matches: Matches, prior: Prior | None) -> Iterator[Place]:
        options = self.options
        yield from vote_for_places(self.index, matches, options.places, options.views_each, prior)

    def _track(self, query: Query, rays: FloatArray) -> Verified | None:
        """The pose near the prior, if there is a prior and it holds."""
        if query.prior is None:
            return None
        distance_m = max(
            float(np.median(np.linalg.norm(self._nearby(query.prior) - query.prior.pose.position, axis=1))), 0.5
        )
        radius_px = query.camera.focal * min(query.prior.radius_m / distance_m + query.prior.radius_rad, 0.12)
        found = verify(self.index, query, rays, query.prior.pose.T_map_camera, radius_px)
        return found if found is not None and _permitted(found, query) else None

    def _nearby(self, prior: Prior) -> FloatArray:
        present = self.index.landmarks[self.index.present(prior.pose.position)]
        return present if len(present) else self.index.landmarks

    def _search(self, place: Place, query: Query, rays: FloatArray, watch: _Stopwatch) -> Verified | None:
        """The best pose that matches within one place lead to."""
        matches = self.index.match_within(query.features, place.landmarks)
        watch.lap("match")
        evidence = evidence_of(self.index, matches, rays, query.camera)
        samples = minimal_samples(
            evidence, matches.chances, matches.detections, self.options.samples, 4 * self.options.seeds
        )
        seeds = [T for T in samples if _plausible(T, query)][: self.options.seeds]
        watch.lap("seed")
        tolerances_px = self.options.seed_tolerances_px
        optima = [climb(self.index, matches, evidence, T, tolerances_px, query.dof) for T in seeds]
        watch.lap("ascend")
        if not optima:
            return None
        best = max(optima, key=lambda optimum: optimum.value)
        found = verify(self.index, query, rays, best.T_map_camera)
        watch.lap("verify")
        return found if found is not None and _permitted(found, query) else None

    def _conclusive(self, verified: Verified | None) -> bool:
        return verified is not None and confidence_of(verified, self.index.metric) >= self.options.conclusive

    def _settle(
        self, best: Verified | None, dof: Dof, otherwise: Reason, matches: int, watch: _Stopwatch
    ) -> Localization:
        return _refusal(otherwise, matches, watch) if best is None else self._answer(best, dof, matches, watch)

    def _answer(self, verified: Verified, dof: Dof, matches: int, watch: _Stopwatch) -> Localization:
        confidence = confidence_of(verified, self.index.metric)
        agreeing = verified.optimum.density > 0
        T_map_camera = upright(verified.optimum.T_map_camera) if dof is Dof.UPRIGHT else verified.optimum.T_map_camera
        localized = confidence >= self.min_confidence
        pixels = verified.pixels[agreeing]
        answer = Localization(
            localized=localized,
            reason=None if localized else Reason.LOW_CONFIDENCE,
            pose=Pose(T_map_camera) if localized else None,
            covariance=verified.covariance if localized else None,
            confidence=confidence,
            matches=matches,
            inliers=verified.inliers,
            inlier_pixels=pixels,
            inlier_features=verified.matches.landmarks[agreeing],
            timings_ms=watch.timings_ms,
        )
        return with_map_error(self.index, answer)


def _plausible(T_map_camera: FloatArray, query: Query) -> bool:
    """Whether a seed may be what is asked for: upright where that is assumed, near the prior, true to gravity."""
    if query.dof is Dof.UPRIGHT:
        _, rolled = distance_between(T_map_camera, upright(T_map_camera))
        if rolled > _MAX_UPRIGHT_ROLL_RAD:
            return False
    return _near_prior(T_map_camera, query.prior) and _true_to_gravity(T_map_camera, query.gravity)


def _permitted(found: Verified, query: Query) -> bool:
    T = found.optimum.T_map_camera
    return _near_prior(T, query.prior) and _true_to_gravity(T, query.gravity)


def _near_prior(T_map_camera: FloatArray, prior: Prior | None) -> bool:
    if prior is None:
        return True
    apart = float(np.linalg.norm(T_map_camera[:3, 3] - prior.pose.position))
    turned = float(np.arccos(np.clip(T_map_camera[:3, 2] @ prior.pose.heading, -1, 1)))
    return apart <= prior.radius_m and turned <= prior.radius_rad


def _true_to_gravity(T_map_camera: FloatArray, gravity: FloatArray | None) -> bool:
    if gravity is None:
        return True
    down = T_map_camera[:3, :3] @ (gravity / np.linalg.norm(gravity))
    return bool(np.arccos(np.clip(-down[2], -1, 1)) <= _MAX_GRAVITY_ERROR_RAD)


def _refusal(reason: Reason, matches: int, watch: _Stopwatch) -> Localization:
    return Localization(
        False, reason, None, None, 0.0, matches, 0, np.zeros((0, 2)), np.zeros(0, dtype=np.int64), watch.timings_ms
    )
