"""Frame → pose: the localizer of one map."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache, partial
from itertools import islice

import numpy as np

from rholoc import telemetry
from rholoc.density import Evidence
from rholoc.errors import InvalidDescriptors
from rholoc.features import Extractor, FeatureSet, get_extractor
from rholoc.geometry import UP, Camera, FloatArray, IntArray, Lens, Pose, angles_between, pose_distances
from rholoc.localization.belief.confidence import MIN_RECOGNIZED, belief_of
from rholoc.localization.belief.map_uncertainty import gated, with_map_error
from rholoc.localization.diagnosis import (
    INEXACT_MAP,
    TOO_LITTLE_TIME,
    Agreement,
    Cause,
    Diagnosis,
    diagnose_picture,
    wrong_camera,
)
from rholoc.localization.index.map_error import worst_sigma
from rholoc.localization.index.map_index import MapIndex
from rholoc.localization.index.matches import Matches, NearestLandmarks
from rholoc.localization.pose.ascent import Optimum, ascend, upright
from rholoc.localization.pose.focal import FocalEstimate, check_focal, focal_seed, verify_with_focal
from rholoc.localization.pose.modes import are_distinct, is_seen_from_afar, poses_on_arcs, spread_of_modes
from rholoc.localization.pose.ransac import exceeds_chance, lo_ransac
from rholoc.localization.pose.rematching import SEARCH_RADII_PX, Verified, evidence_of, verify
from rholoc.localization.pose.rivals import are_rivals, rival_seeds, shares
from rholoc.localization.pose.seeds import Place, minimal_samples, place_of_prior, places_by_votes, view_votes
from rholoc.localization.types import (
    MAX_ALTERNATIVES,
    MIN_WEIGHT,
    Alternative,
    Belief,
    Dof,
    Intrinsics,
    Localization,
    Prior,
    Query,
    Reason,
)
from rholoc.maps import Map

_MIN_FEATURES = 8
_FEW_FEATURES = 40
_MAX_GRAVITY_ERROR_RAD = np.deg2rad(10.0)
_MAX_UPRIGHT_ROLL_RAD = np.deg2rad(15.0)
_MAX_MISSING = 0.25  # of the nats for a pose: what may speak against it where the search ends with it
_ROUNDS = 2  # of matching again around a pose that is not known exactly
_DIAGNOSTIC_SAMPLES = 300  # of each focal length: a cause is only named where many matches agree
_TRACKING_RADIUS_PX = 14.0  # around a prior: as far as a tracker's are off. Pairs, and time, grow with the square


@dataclass(frozen=True)
class SearchOptions:
    """Effort of the search.

    Attributes:
        places: maximum number of places to search for a seed.
        views_each: number of views with shared landmarks that make up a place.
        ransac_samples: maximum and minimum number of LO-RANSAC samples per place.
        ransac_tolerance_px: maximum reprojection error of an inlier of LO-RANSAC.
        samples: number of minimal samples ranked by density in a place where LO-RANSAC is inconclusive.
        seeds: number of best samples from which to ascend.
        seed_tolerances_px: decreasing tolerances of that ascent.
        conclusive: probability of the right place above which no further place is searched.
        settled_sigma_m: a conclusive pose is final if its position's largest standard deviation is below this;
            otherwise all features are matched again around it.
        hopeless: probability of the right place below which a verified pose counts as hopeless.
        hopeless_looks: number of hopeless poses, or of looks that found none, after which the search ends, because the
            picture shows another place.
        expected: probability of the right place above which the search ends after a close look at the prior's place.
    """

    places: int = 8
    views_each: int = 10
    ransac_samples: tuple[int, int] = (1000, 30)
    ransac_tolerance_px: float = 12.0
    samples: int = 150
    seeds: int = 2
    seed_tolerances_px: tuple[float, ...] = (24.0, 12.0, 6.0)
    conclusive: float = 0.9
    settled_sigma_m: float = 0.04
    hopeless: float = 0.02
    hopeless_looks: int = 5
    expected: float = MIN_RECOGNIZED


@dataclass
class _Stopwatch:
    """Milliseconds per stage, and the deadline."""

    deadline_s: float | None
    started: float = field(default_factory=time.perf_counter)
    timings_ms: dict[str, float] = field(default_factory=dict)
    _last: float = field(default_factory=time.perf_counter)

    def lap(self, stage: str) -> None:
        now = time.perf_counter()
        self.timings_ms[stage] = self.timings_ms.get(stage, 0.0) + 1e3 * (now - self._last)
        telemetry.note(stage, now - self._last)
        self._last = now

    @property
    def late(self) -> bool:
        return self.deadline_s is not None and time.perf_counter() - self.started > self.deadline_s


@dataclass(frozen=True, eq=False)
class _Found:
    """A candidate pose.

    Attributes:
        verified: the pose and its evidence.
        camera: camera it was found with.
        check_focal: returns what the matches say about that camera's focal length; the first call takes as long as a
            search of a place.
        if_focal_right: belief in the pose, given that the focal length is right.
        near_prior: whether the pose agrees with the prior.
        share: factor 0 to 1 that rivals leave of the probability of the right place.
        rivals: mutually exclusive poses, each with its probability of the right place, likeliest first.
        of_modes: (6, 6) second moment of the modes in the pose's place; None if it is the only one.
    """

    verified: Verified
    camera: Camera
    check_focal: Callable[[], FocalEstimate]
    if_focal_right: Belief
    near_prior: bool
    share: float = 1.0
    rivals: tuple[tuple[float, _Found], ...] = ()
    of_modes: FloatArray | None = None

    @property
    def focal(self) -> FocalEstimate:
        """What the matches say about the camera's focal length."""
        return self.check_focal()

    @property
    def belief(self) -> Belief:
        """Belief in the pose."""
        recognized = self.if_focal_right.recognized * self.focal.belief * self.share
        return Belief(recognized, self.if_focal_right.exact * self.focal.exact)

    @property
    def recognized(self) -> float:
        """Probability 0 to 1 that the pose is of the right place."""
        return self.belief.recognized

    @property
    def sigma_m(self) -> float:
        """Standard deviation of the position along its worst axis."""
        return worst_sigma(self.verified.covariance[:3, :3])


@dataclass
class _Search:
    """State of a search.

    Attributes:
        query: the frame.
        watch: its time budget.
        matches: number of features that match anywhere, or near the prior.
        best: likeliest candidate that agrees with the prior.
        elsewhere: likeliest candidate that does not.
        reason: reason for a refusal, if no candidate is good enough.
        place: place with the most votes.
        everywhere: matches with the whole map.
        nearest: nearest landmarks of each feature in the whole map.
        is_sampled: whether ``nearest`` covers only a sample of the features.
        found: all candidates.
        fruitless: number of looks that found none.
    """

    query: Query
    watch: _Stopwatch
    matches: int = 0
    best: _Found | None = None
    elsewhere: _Found | None = None
    reason: Reason = Reason.NO_AGREEMENT
    place: Place | None = None
    everywhere: Matches | None = None
    nearest: NearestLandmarks | None = None
    is_sampled: bool = False
    found: list[_Found] = field(default_factory=list)
    fruitless: int = 0

    def add(self, found: _Found | None) -> None:
        """Add a candidate."""
        if found is None:
            self.fruitless += 1
            return
        self.found.append(found)
        if found.near_prior:
            self.best = _likelier(self.best, found)
        else:
            self.elsewhere = _likelier(self.elsewhere, found)

    def is_over(self, conclusive: float, max_sigma_m: float) -> bool:
        """Whether some candidate is probable and exact enough, and nearly uncontested."""
        candidates = [found for found in (self.best, self.elsewhere) if found is not None]
        return any(
            found.if_focal_right.recognized >= conclusive
            and found.verified.support.missing <= _MAX_MISSING * found.verified.support.seen
            and found.sigma_m <= max_sigma_m
            for found in candidates
        )

    def is_settled(self, max_sigma_m: float) -> bool:
        """Whether the position of the likeliest candidate is known exactly enough."""
        likeliest = self.best or self.elsewhere
        return likeliest is not None and likeliest.sigma_m <= max_sigma_m

    def is_hopeless(self, options: SearchOptions) -> bool:
        """Whether enough was looked at without any chance of the right place."""
        likeliest = max((found.if_focal_right.recognized for found in self.found), default=0.0)
        return len(self.found) + self.fruitless >= options.hopeless_looks and likeliest < options.hopeless

    def is_as_expected(self, enough: float) -> bool:
        """Whether some candidate agrees with the prior and is probable enough."""
        if self.query.prior is None or self.best is None:
            return False
        return self.best.if_focal_right.recognized >= enough

    def outcome(self, conclusive: float) -> _Found | None:
        """Candidate to answer with. One that contradicts the prior wins only if it is sure and the other is not."""
        best, elsewhere = self._contested(self.best), self._contested(self.elsewhere)
        surely_elsewhere = elsewhere is not None and elsewhere.recognized >= conclusive
        if best is not None and (best.recognized >= MIN_RECOGNIZED or not surely_elsewhere):
            return best
        return elsewhere if surely_elsewhere else best

    def _contested(self, found: _Found | None) -> _Found | None:
        """A candidate with its rivals and the other modes of its place; those of one near the prior must be near it."""
        if found is None:
            return None
        modes, rivals = [found], [found]
        for other in sorted(self.found, key=lambda one: -one.verified.support.net):
            if not other.near_prior and found.near_prior:
                continue
            if not are_rivals(found.verified, other.verified):
                if all(are_distinct(mode.verified, other.verified) for mode in modes):
                    modes.append(other)
            elif all(are_rivals(rival.verified, other.verified) for rival in rivals):
                rivals.append(other)
        share, places = _shares(rivals), [rival.recognized for rival in rivals]
        others = zip((share * places)[1:].tolist(), rivals[1:], strict=True)
        T = found.verified.optimum.T_map_camera
        of_modes = spread_of_modes(T, [mode.verified for mode in modes], _shares(modes)) if len(modes) > 1 else None
        ordered = sorted(others, key=lambda rival: -rival[0])
        return replace(found, share=float(share[0]), rivals=tuple(ordered), of_modes=of_modes)


class Localizer:
    """Localizer for one map. The constructor builds the index; methods are thread-safe.

    Args:
        map_: the map.
        min_recognized: minimum probability of the right place; less probable poses are refused with ``localized`` False
            and the reason ``not_recognized``.
        options: effort of the search.
        index: index of the map, if it already exists.
    """

    def __init__(
        self,
        map_: Map,
        min_recognized: float = MIN_RECOGNIZED,
        options: SearchOptions | None = None,
        index: MapIndex | None = None,
    ) -> None:
        self.map = map_
        self.min_recognized = min_recognized
        self.options = options or SearchOptions()
        self.index = index or MapIndex(map_)

    @property
    def extractor(self) -> Extractor:
        """Extractor of the map's features."""
        return get_extractor(self.map.info.features)

    def localize(self, query: Query) -> Localization:
        """Localize one frame by equation (1). A refusal states its likeliest cause.

        Raises:
            InvalidDescriptors: the features are not of the map's kind.
        """
        watch = _Stopwatch(query.deadline_s)
        self.check(query)
        search = self._thorough_search(query, watch)
        answer = self._answer(search)
        if answer.reason is Reason.TOO_INEXACT and search.query.more_features is not None:
            search = self._search(self.adapted(_with_more_features(query, watch)), watch)
            answer = self._answer(search)
        if answer.localized or answer.diagnosis is not None:
            return answer
        diagnosis = self._diagnose(search, answer)
        watch.lap("diagnose")
        return replace(answer, diagnosis=diagnosis)

    def attempt(self, query: Query) -> Localization | None:
        """Answer from the features at hand. Returns None if they are inconclusive; never extracts more."""
        search = self._sure_search(query, _Stopwatch(query.deadline_s))
        answer = None if search is None else self._answer(search)
        return answer if answer is not None and answer.localized else None

    def view_votes(self, features: FeatureSet) -> FloatArray:
        """(K,) votes of a picture's features for each view of the map, without a pose."""
        return view_votes(self.index, self.index.match_everywhere(features))

    def candidate(self, query: Query) -> tuple[Verified, Belief] | None:
        """Best pose found, however doubtful, and the belief in it. None if there is none."""
        search = self._thorough_search(query, _Stopwatch(query.deadline_s))
        found = search.outcome(self.options.conclusive)
        return None if found is None else (found.verified, found.belief)

    def check(self, query: Query) -> None:
        """Check that features are of the map's kind.

        Raises:
            InvalidDescriptors: they are not.
        """
        check_kind(query.features, self.extractor)

    def adapted(self, query: Query) -> Query:
        """The query without constraints that are meaningless in this map."""
        if not self.map.info.upright:
            query = replace(query, gravity=None)
        if query.dof is Dof.AUTO and not self.index.seen_upright:
            query = replace(query, dof=Dof.FREE)
        return query

    def _thorough_search(self, query: Query, watch: _Stopwatch) -> _Search:
        """Quick search, followed by a close one if the quick one is inconclusive."""
        return self._quick_search(query, watch) or self._search(self.adapted(_with_more_features(query, watch)), watch)

    def _quick_search(self, query: Query, watch: _Stopwatch) -> _Search | None:
        """Quick search with the first features. Returns None if it is inconclusive and more features can be
        extracted.
        """
        if query.more_features is None or query.intrinsics is Intrinsics.UNKNOWN:
            return None
        return self._sure_search(query, watch)

    def _sure_search(self, query: Query, watch: _Stopwatch) -> _Search | None:
        """Search with the features at hand. Returns None if it is inconclusive."""
        search = self._search(self.adapted(query), watch)
        if not search.is_settled(self.options.settled_sigma_m):
            return None
        found = search.outcome(self.options.conclusive)
        return None if found is None or found.recognized < self.options.conclusive else search

    def _search(self, query: Query, watch: _Stopwatch) -> _Search:
        """Search for candidates, then for their rivals; no close look if more features can be extracted."""
        search = _Search(query, watch)
        if len(query.features) < _MIN_FEATURES:
            search.reason = Reason.NO_FEATURES
            return search
        rays = query.camera.rays(query.features.pixels)
        self._look_around(search, rays)
        self._match_again(search, rays)
        self._look_along_arcs(search, rays)
        if query.more_features is None or search.is_settled(self.options.settled_sigma_m):
            self._look_for_rivals(search, rays)
        return search

    def _look_around(self, search: _Search, rays: FloatArray) -> None:
        """Search one place after the other, beginning at the prior, until a candidate is conclusive or hope is lost."""
        watch, options = search.watch, self.options
        for place in self._places(search):
            if watch.late:
                search.reason = Reason.DEADLINE
                return
            if not search.is_sampled:
                search.place = search.place or place
            for found in self._look(place, search, rays):
                search.add(found)
                max_sigma_m = options.settled_sigma_m if search.is_sampled else math.inf
                if search.is_over(options.conclusive, max_sigma_m) or search.is_hopeless(options):
                    return
            if search.is_as_expected(options.expected):
                return

    def _match_again(self, search: _Search, rays: FloatArray) -> None:
        """Match all features again around a pose that is not exact enough, and refine it."""
        query, watch = search.query, search.watch
        if query.intrinsics is Intrinsics.UNKNOWN or query.more_features is not None:
            return
        for _ in range(_ROUNDS):
            best = search.best or search.elsewhere
            if best is None or best.if_focal_right.recognized < MIN_RECOGNIZED:
                return
            if best.sigma_m <= self.options.settled_sigma_m or watch.late:
                return
            T = best.verified.optimum.T_map_camera
            wide, _ = self.index.match_near(query.features, query.camera, T, SEARCH_RADII_PX[0])
            search.add(self._checked(verify(self.index, query, rays, T, wide=wide), query, wide))
            watch.lap("verify")
            if (search.best or search.elsewhere) is best:
                return

    def _look_along_arcs(self, search: _Search, rays: FloatArray) -> None:
        """Search for other modes of the best candidate's place, if it is seen from afar."""
        query, best = search.query, search.best or search.elsewhere
        if best is None or best.if_focal_right.recognized < MIN_RECOGNIZED or query.more_features is not None:
            return
        if query.intrinsics is Intrinsics.UNKNOWN or not is_seen_from_afar(best.verified):
            return
        for T_map_camera in poses_on_arcs(self.index, best.verified):
            if search.watch.late:
                return
            verified = verify(self.index, query, rays, T_map_camera) if _plausible(T_map_camera, query) else None
            if verified is not None:
                search.add(self._checked(verified, query, verified.wide))
            search.watch.lap("verify")

    def _look_for_rivals(self, search: _Search, rays: FloatArray) -> None:
        """Search for rivals of the best candidate; not needed if it agrees with a prior."""
        query, watch, best = search.query, search.watch, search.best or search.elsewhere
        if search.nearest is None or best is None or watch.late:
            return
        if best.recognized < min(self.min_recognized, MIN_RECOGNIZED):
            return
        if query.intrinsics is Intrinsics.UNKNOWN:
            query = replace(query, camera=best.camera)
            rays = best.camera.rays(query.features.pixels)
        for seed in rival_seeds(self.index, search.nearest, query, rays, best.verified):
            watch.lap("seed")
            verified = verify(self.index, query, rays, seed) if _plausible(seed, query) else None
            search.add(self._checked(verified, query, None if verified is None else verified.wide))
            watch.lap("verify")
        watch.lap("seed")

    def _look(self, place: Place, search: _Search, rays: FloatArray) -> Iterator[_Found | None]:
        """Iterate over candidates from one place, cheapest search first."""
        query, watch = search.query, search.watch
        if query.intrinsics is Intrinsics.UNKNOWN:
            yield from self._look_with_any_focal(place, query, self.options.ransac_samples[0], watch)
            return
        if search.everywhere is not None:
            in_place = np.isin(search.everywhere.landmarks, place.landmarks)
            yield self._glance(search.everywhere.take(np.flatnonzero(in_place)), query, rays, watch)
        else:
            near = self.index.match_within(query.features, place.landmarks, some=query.features.sample)
            watch.lap("match")
            yield self._glance(near, query, rays, watch)
            if query.prior is not None:
                yield self._track(query.prior, query, rays, watch)
        if search.is_sampled or query.more_features is not None:
            return
        yield from self._look_closely(place, query, rays, watch)

    def _glance(self, matches: Matches, query: Query, rays: FloatArray, watch: _Stopwatch) -> _Found | None:
        """Candidate from one LO-RANSAC over all matches, which suffices for most frames."""
        seed = self._ransac_seed(matches, query, rays)
        watch.lap("seed")
        if seed is None or not _plausible(seed, query):
            return None
        found = self._checked(verify(self.index, query, rays, seed), query, matches)
        watch.lap("verify")
        return found

    def _track(self, prior: Prior, query: Query, rays: FloatArray, watch: _Stopwatch) -> _Found | None:
        """Candidate from one LO-RANSAC over matches near a prior, which suffices if few features are left.

        An ascent from the prior itself may end on a lower peak beside the right one.
        """
        some, T_map_camera = query.features.sample, prior.pose.T_map_camera
        near, _ = self.index.match_near(query.features, query.camera, T_map_camera, _TRACKING_RADIUS_PX, some)
        watch.lap("match")
        return self._glance(near, query, rays, watch)

    def _places(self, search: _Search) -> Iterator[Place]:
        """Iterate over places to search: around the prior, then by votes of matches with the whole map."""
        query, options = search.query, self.options
        if query.prior is not None:
            near = place_of_prior(self.index, query.prior, options.views_each)
            if near is not None:
                yield near
        sample = query.features.sample
        others = np.arange(len(query.features))
        if query.more_features is not None:
            yield from islice(self._voted_places(search, sample), 1)
            return
        if len(sample) < len(others) and query.intrinsics is Intrinsics.GIVEN:
            yield from islice(self._voted_places(search, sample), 1)
            others = np.delete(others, sample)
        yield from islice(self._voted_places(search, others), options.places)

    def _voted_places(self, search: _Search, features: IntArray) -> Iterator[Place]:
        """Iterate over places by votes, after matching more of the query's ``features``."""
        query = search.query
        found = self.index.nearest_everywhere(query.features, features)
        search.nearest = found if search.nearest is None else search.nearest.joined(found)
        search.is_sampled = len(search.nearest) < len(query.features)
        search.everywhere = search.nearest.matches()
        search.matches = len(search.everywhere)
        search.watch.lap("match")
        if search.matches < _MIN_FEATURES:
            search.reason = Reason.NO_MATCHES
            return
        search.reason = Reason.NO_AGREEMENT
        yield from places_by_votes(self.index, search.everywhere, self.options.views_each, query.prior)

    def _look_closely(self, place: Place, query: Query, rays: FloatArray, watch: _Stopwatch) -> Iterator[_Found | None]:
        """Iterate over candidates from matches within one place: LO-RANSAC, then minimal samples ranked by density."""
        matches = self.index.match_within(query.features, place.landmarks)
        watch.lap("match")
        seed = self._ransac_seed(matches, query, rays)
        watch.lap("seed")
        if seed is None:
            yield None
            return
        evidence = evidence_of(self.index, matches, rays, query.camera)
        optimum = None
        if _plausible(seed, query):
            optimum = self._climb(matches, evidence, [seed], query, watch)
            yield self._verified(optimum, query, rays, matches, watch)
        samples = minimal_samples(
            evidence, matches.chances, matches.detections, self.options.samples, 4 * self.options.seeds
        )
        seeds = [T for T in samples if _plausible(T, query)][: self.options.seeds]
        watch.lap("seed")
        other = self._climb(matches, evidence, seeds, query, watch)
        if other is not None and (optimum is None or other.value > optimum.value):
            yield self._verified(other, query, rays, matches, watch)

    def _ransac_seed(self, matches: Matches, query: Query, rays: FloatArray) -> FloatArray | None:
        ordered = matches.likeliest_first()
        found = lo_ransac(
            rays[ordered.detections],
            self.index.landmarks[ordered.landmarks],
            query.camera.focal,
            self.options.ransac_tolerance_px,
            *self.options.ransac_samples,
        )
        return found[0] if found is not None and exceeds_chance(found[1], len(ordered)) else None

    def _climb(
        self, matches: Matches, evidence: Evidence, seeds: list[FloatArray], query: Query, watch: _Stopwatch
    ) -> Optimum | None:
        tolerances_px = self.options.seed_tolerances_px
        optima = [ascend(self.map.densities, evidence, T, tolerances_px, query.dof) for T in seeds]
        watch.lap("ascend")
        return max(optima, key=lambda optimum: optimum.value, default=None)

    def _verified(
        self, optimum: Optimum | None, query: Query, rays: FloatArray, matches: Matches, watch: _Stopwatch
    ) -> _Found | None:
        found = None if optimum is None else verify(self.index, query, rays, optimum.T_map_camera)
        checked = self._checked(found, query, matches)
        watch.lap("verify")
        return checked

    def _look_with_any_focal(self, place: Place, query: Query, samples: int, watch: _Stopwatch) -> Iterator[_Found]:
        """As :meth:`_look_closely`, with the focal length estimated along with the pose."""
        matches = self.index.match_within(query.features, place.landmarks)
        watch.lap("match")
        seed = focal_seed(self.index, matches, query, samples)
        watch.lap("seed")
        if seed is None:
            return
        T_map_camera, camera = seed
        found = verify_with_focal(self.index, replace(query, camera=camera), T_map_camera, matches)
        watch.lap("verify")
        if found is not None:
            verified, focal, refined = found
            if _true_to_gravity(verified.optimum.T_map_camera, query.gravity):
                yield self._candidate(verified, refined, lambda: focal, belief_of(verified))

    def _checked(self, verified: Verified | None, query: Query, matches: Matches | None) -> _Found | None:
        """Candidate from a verified pose; its matches check the camera's focal length. None if it is implausible."""
        if verified is None or matches is None or not _true_to_gravity(verified.optimum.T_map_camera, query.gravity):
            return None
        belief = belief_of(verified)
        if belief.recognized < self.options.hopeless:
            return self._candidate(verified, query, partial(FocalEstimate.unchecked, query.camera), belief)
        return self._candidate(verified, query, partial(check_focal, self.index, query, verified, matches), belief)

    def _candidate(
        self, verified: Verified, query: Query, check: Callable[[], FocalEstimate], belief: Belief
    ) -> _Found:
        near_prior = _near_prior(verified.optimum.T_map_camera, query.prior)
        return _Found(verified, query.camera, cache(check), belief, near_prior)

    def _answer(self, search: _Search) -> Localization:
        found = search.outcome(self.options.conclusive)
        if found is None:
            return Localization.refused(search.reason, search.matches, search.watch.timings_ms)
        query, verified = search.query, found.verified
        agreeing = verified.optimum.density > 0
        estimated = query.intrinsics is Intrinsics.UNKNOWN
        answer = Localization(
            localized=True,
            reason=None,
            pose=_pose(verified, query.dof),
            covariance=verified.covariance,
            belief=found.belief,
            matches=max(search.matches, len(verified.wide), len(verified.matches)),
            inliers=verified.inliers,
            inlier_pixels=verified.pixels[agreeing],
            inlier_features=verified.matches.landmarks[agreeing],
            timings_ms=search.watch.timings_ms,
            near_prior=None if query.prior is None else found.near_prior,
            camera=found.camera if estimated else None,
            focal_sigma_px=found.focal.sigma_px if estimated else None,
            alternatives=tuple(
                Alternative(weight, _pose(rival.verified, query.dof), rival.verified.covariance)
                for weight, rival in found.rivals[:MAX_ALTERNATIVES]
                if weight >= MIN_WEIGHT
            ),
        )
        return gated(with_map_error(self.index, answer, found.of_modes), self.min_recognized, query)

    def _diagnose(self, search: _Search, answer: Localization) -> Diagnosis:
        """Likeliest cause of a refusal: the request, the camera, or the picture."""
        query, watch = search.query, search.watch
        if answer.reason is Reason.DEADLINE or watch.late:
            return TOO_LITTLE_TIME
        refused = search.outcome(self.options.conclusive)
        if refused is not None and refused.recognized >= self.min_recognized:
            return INEXACT_MAP
        freed = replace(query, dof=Dof.FREE, gravity=None)
        if query.dof is Dof.UPRIGHT or query.gravity is not None:
            found = self._search(freed, watch).outcome(self.options.conclusive)
            if found is not None and found.belief.confidence >= self.options.conclusive:
                return _contradicted(found, query)
        if query.intrinsics is Intrinsics.UNKNOWN or query.camera.lens is not Lens.PINHOLE:
            return self._diagnose_picture(query, answer)
        if refused is not None and refused.focal.belief < self.min_recognized <= refused.if_focal_right.recognized:
            return wrong_camera(query.camera.focal, refused.focal.focal_px)
        if search.place is not None:
            for refocused in self._look_with_any_focal(search.place, freed, _DIAGNOSTIC_SAMPLES, watch):
                if refocused.belief.confidence >= self.options.conclusive:
                    return wrong_camera(query.camera.focal, refocused.focal.focal_px)
        return self._diagnose_picture(query, answer)

    def _diagnose_picture(self, query: Query, answer: Localization) -> Diagnosis:
        agreement = Agreement(answer.inliers, answer.matches, answer.recognized)
        return diagnose_picture(query.image, self.map, len(query.features), _FEW_FEATURES, agreement)


def _with_more_features(query: Query, watch: _Stopwatch) -> Query:
    """The query with all features that can be extracted."""
    if query.more_features is None:
        return query
    query = replace(query, features=query.more_features(), more_features=None)
    watch.lap("extract")
    return query


def check_kind(features: FeatureSet, wanted: Extractor) -> None:
    """Refuse features that a map's extractor cannot have made.

    Raises:
        InvalidDescriptors: by their length.
    """
    given = features.descriptors.shape[1]
    if given != wanted.descriptor_bytes:
        raise InvalidDescriptors(
            f"The descriptors have {given} bytes; this map's have {wanted.descriptor_bytes}.",
            f"Extract '{wanted.name}' features for this map.",
        )


def _likelier(a: _Found | None, b: _Found) -> _Found:
    """The likelier of two candidates: in one place by the product of densities, of two places by what supports each."""
    if a is None:
        return b
    are_two = are_rivals(a.verified, b.verified)
    of_a, of_b = (one.verified.support.net if are_two else one.verified.optimum.value for one in (a, b))
    likely_a, likely_b = (one.if_focal_right.recognized >= MIN_RECOGNIZED for one in (a, b))
    return a if (likely_a, of_a) >= (likely_b, of_b) else b


def _shares(candidates: list[_Found]) -> FloatArray:
    """Share (M,) of each of M poses that exclude one another."""
    return shares(
        np.array([one.recognized for one in candidates]), np.array([one.verified.support.net for one in candidates])
    )


def _contradicted(found: _Found, query: Query) -> Diagnosis:
    """Which of the request's constraints a sure pose breaks."""
    T = found.verified.optimum.T_map_camera
    if not _true_to_gravity(T, query.gravity):
        return Diagnosis(
            Cause.WRONG_GRAVITY,
            "The picture fits the map, but not with the gravity that was sent.",
            "Send the direction of gravity (down) in the camera frame: x right, y down, z forward.",
        )
    rolled_deg = abs(np.degrees(Pose(T).roll))
    return Diagnosis(
        Cause.ROLLED,
        f"The picture fits the map, with the camera rolled by {rolled_deg:.0f}°; an upright camera was asked for.",
        "Ask with dof auto.",
    )


def _pose(verified: Verified, dof: Dof) -> Pose:
    """The pose as it is given out: without the roll where an upright camera was asked for."""
    T_map_camera = verified.optimum.T_map_camera
    return Pose(upright(T_map_camera) if dof is Dof.UPRIGHT else T_map_camera)


def _plausible(T_map_camera: FloatArray, query: Query) -> bool:
    """Whether a seed may be what is asked for: upright where that is demanded, true to gravity."""
    if query.dof is Dof.UPRIGHT:
        _, rolled = pose_distances(T_map_camera, upright(T_map_camera))
        if rolled > _MAX_UPRIGHT_ROLL_RAD:
            return False
    return _true_to_gravity(T_map_camera, query.gravity)


def _near_prior(T_map_camera: FloatArray, prior: Prior | None) -> bool:
    if prior is None:
        return True
    apart = float(np.linalg.norm(T_map_camera[:3, 3] - prior.pose.position))
    turned = float(angles_between(T_map_camera[:3, 2], prior.pose.heading))
    return apart <= prior.radius_m and turned <= prior.radius_rad


def _true_to_gravity(T_map_camera: FloatArray, gravity: FloatArray | None) -> bool:
    if gravity is None:
        return True
    down = T_map_camera[:3, :3] @ (gravity / np.linalg.norm(gravity))
    return bool(angles_between(-down, UP) <= _MAX_GRAVITY_ERROR_RAD)
