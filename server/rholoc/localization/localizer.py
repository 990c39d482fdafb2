"""Frame → pose: the localizer of one map."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from itertools import islice

import numpy as np

from rholoc.density import Evidence
from rholoc.errors import InvalidDescriptors
from rholoc.features import Extractor, FeatureSet, get_extractor
from rholoc.geometry import UP, FloatArray, IntArray, Lens, Pose, angles_between, pose_distances
from rholoc.localization.belief.acceptance import gated
from rholoc.localization.belief.confidence import MIN_RECOGNIZED, belief_of
from rholoc.localization.belief.map_uncertainty import with_map_error
from rholoc.localization.diagnosis import (
    INEXACT_MAP,
    TOO_LITTLE_TIME,
    Agreement,
    Cause,
    Diagnosis,
    diagnose_picture,
    wrong_camera,
)
from rholoc.localization.index.map_index import MapIndex
from rholoc.localization.index.matches import Matches
from rholoc.localization.pose.ascent import Optimum, ascend, upright
from rholoc.localization.pose.focal import FocalEstimate, check_focal, focal_seed, verify_with_focal
from rholoc.localization.pose.modes import is_seen_from_afar, poses_on_arcs
from rholoc.localization.pose.ransac import credible_pose
from rholoc.localization.pose.rematching import SEARCH_RADII_PX, Verified, evidence_of, polished, verify
from rholoc.localization.pose.rivals import rival_seeds
from rholoc.localization.pose.seeds import Place, minimal_samples, place_of_prior, places_by_votes, view_votes
from rholoc.localization.search import Found, Search, SearchOptions, Stopwatch
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
_ROUNDS = 2  # of matching again around a pose that is not known exactly
_DIAGNOSTIC_MATCHES, _DIAGNOSTIC_SAMPLES = 100, 100  # the likeliest; a cause is only named where many agree
_TRACKING_RADIUS_PX = 14.0  # around a prior: as far as a tracker's are off. Pairs, and time, grow with the square


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
        """Extractor of the map's features. Raises NotInstalled, or InvalidInput if it is unknown."""
        return get_extractor(self.map.info.features)

    def localize(self, query: Query) -> Localization:
        """Localize one frame by equation (1). A refusal is an answer, with its reason and likeliest cause.

        Extracts more features by ``query.more_features`` if the first ones are inconclusive, or the pose is not exact
        enough.

        Raises:
            InvalidDescriptors: the features are not of the map's kind.
        """
        watch = Stopwatch(query.deadline_s)
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
        """Answer from the features at hand; never extracts more, and does not check their kind.

        Returns None if the search is inconclusive, or if its pose is refused.
        """
        search = self._search(self.adapted(query), Stopwatch(query.deadline_s))
        answer = self._answer(search) if self._is_sure(search) else None
        return answer if answer is not None and answer.localized else None

    def view_votes(self, features: FeatureSet) -> FloatArray:
        """Votes (K,) of a picture's features for each view of the map, without a pose; see :func:`view_votes`."""
        return view_votes(self.index, self.index.match_everywhere(features))

    def candidate(self, query: Query) -> tuple[Verified, Belief] | None:
        """Best pose found, however doubtful, and the belief with which it would be answered. None if there is none. The
        kind of features is not checked.
        """
        search = self._thorough_search(query, Stopwatch(query.deadline_s))
        found = self._outcome(search)
        return None if found is None else (found.verified, self._described(found, search).belief)

    def check(self, query: Query) -> None:
        """Check that features are of the map's kind.

        Raises:
            InvalidDescriptors: they are not.
        """
        check_kind(query.features, self.extractor)

    def adapted(self, query: Query) -> Query:
        """The query without gravity if the map's z axis is not known to be up, and with free roll instead of AUTO if
        the map's own views were not taken upright.
        """
        if not self.map.info.upright:
            query = replace(query, gravity=None)
        if query.dof is Dof.AUTO and not self.index.seen_upright:
            query = replace(query, dof=Dof.FREE)
        return query

    def _thorough_search(self, query: Query, watch: Stopwatch) -> Search:
        """Quick search with the first features, followed by a close one with all if the quick one is inconclusive. The
        quick one is left out if the query has no more features to extract, or an unknown focal length.
        """
        quick: Search | None = None
        if query.more_features is not None and query.intrinsics is Intrinsics.GIVEN:
            quick = self._search(self.adapted(query), watch)
            if self._is_sure(quick):
                return quick
        return self._search(self.adapted(_with_more_features(query, watch)), watch, quick)

    def _is_sure(self, search: Search) -> bool:
        """Whether a search is conclusive: settled, and its outcome recognized with a probability of at least
        ``options.conclusive``.
        """
        if not search.is_settled(self.options.settled_sigma_m):
            return False
        found = search.outcome(self.options.conclusive)
        return found is not None and found.recognized >= self.options.conclusive

    def _search(self, query: Query, watch: Stopwatch, quick: Search | None = None) -> Search:
        """Search for candidates, then for their rivals; no close look if more features can be extracted.

        With fewer than eight features nothing is searched; the reason is then NO_FEATURES.

        Args:
            query: the frame.
            watch: its time budget.
            quick: an inconclusive search with fewer features, whose best pose is the first candidate.
        """
        search = Search(query, watch, seeds=0 if quick is None else quick.seeds)
        if len(query.features) < _MIN_FEATURES:
            search.reason = Reason.NO_FEATURES
            return search
        rays = query.camera.rays(query.features.pixels)
        if quick is not None and quick.likeliest is not None:
            search.add(self._candidate_at(quick.likeliest.verified.optimum.T_map_camera, query, rays, search))
        self._look_around(search, rays)
        self._match_again(search, rays)
        self._look_along_arcs(search, rays)
        if query.more_features is None or search.is_settled(self.options.settled_sigma_m):
            self._look_for_rivals(search, rays)
        return search

    def _look_around(self, search: Search, rays: FloatArray) -> None:
        """Search one place after the other, beginning at the prior, until a candidate is conclusive or hope is lost.
        Adds candidates to ``search`` and sets its place, and its reason at the deadline. ``rays`` (N, 3) are those of
        all features.
        """
        watch, options = search.watch, self.options
        for place in self._places(search):
            if watch.late:
                search.reason = Reason.DEADLINE
                return
            search.place = search.place or place
            for found in self._look(place, search, rays):
                search.add(found)
                max_sigma_m = options.settled_sigma_m if search.is_sampled else math.inf
                if search.is_over(options.conclusive, max_sigma_m) or search.is_hopeless(options):
                    return
            if search.is_as_expected(options.expected):
                return

    def _match_again(self, search: Search, rays: FloatArray) -> None:
        """Match all features again around the likeliest candidate, at most twice, while its position is not settled;
        the result becomes a candidate of ``search``. Does nothing for a doubtful candidate, an unknown focal length or
        features still to be extracted.
        """
        query, watch = search.query, search.watch
        if query.intrinsics is Intrinsics.UNKNOWN or query.more_features is not None:
            return
        for _ in range(_ROUNDS):
            best = search.likeliest
            if best is None or best.if_focal_right.recognized < MIN_RECOGNIZED:
                return
            if search.is_settled(self.options.settled_sigma_m) or watch.late:
                return
            T = best.verified.optimum.T_map_camera
            wide, _ = self.index.match_near(query.features, query.camera, T, SEARCH_RADII_PX[0])
            search.add(self._checked(verify(self.index, query, rays, T, wide=wide), query, search))
            watch.lap("verify")
            if search.likeliest is best:
                return

    def _look_along_arcs(self, search: Search, rays: FloatArray) -> None:
        """Add candidates for other modes of the best candidate's place to ``search``, if it is seen from afar. Does
        nothing for a doubtful candidate, an unknown focal length or features still to be extracted.
        """
        query, best = search.query, search.likeliest
        if best is None or best.if_focal_right.recognized < MIN_RECOGNIZED or query.more_features is not None:
            return
        if query.intrinsics is Intrinsics.UNKNOWN or not is_seen_from_afar(best.verified):
            return
        for T_map_camera in poses_on_arcs(self.index, best.verified):
            if search.watch.late:
                return
            search.add(self._candidate_at(T_map_camera, query, rays, search))

    def _look_for_rivals(self, search: Search, rays: FloatArray) -> None:
        """Add rivals of the best candidate to ``search``. Does nothing if no place was searched by votes (a prior
        sufficed), after the deadline, or for a candidate that is refused anyway.
        """
        query, watch, best = search.query, search.watch, search.likeliest
        if search.nearest is None or best is None or watch.late:
            return
        if best.recognized < min(self.min_recognized, MIN_RECOGNIZED):
            return
        if query.intrinsics is Intrinsics.UNKNOWN:
            query = replace(query, camera=best.camera)
            rays = best.camera.rays(query.features.pixels)
        for seed in rival_seeds(self.index, search.nearest, query, best.verified):
            watch.lap("seed")
            search.add(self._candidate_at(seed, query, rays, search))
        watch.lap("seed")

    def _look(self, place: Place, search: Search, rays: FloatArray) -> Iterator[Found | None]:
        """Iterate over candidates from one place, cheapest search first; None for a search without a credible pose."""
        query, watch = search.query, search.watch
        if query.intrinsics is Intrinsics.UNKNOWN:
            matches = self.index.match_within(query.features, place.landmarks)
            watch.lap("match")
            yield from self._look_with_any_focal(matches, query, self.options.ransac_samples[0], watch)
            return
        glance: Found | None = None
        if search.everywhere is not None:
            glance = self._glance(search.everywhere.among(place.landmarks), search, rays)
            yield glance
        else:
            near = self.index.match_within(query.features, place.landmarks, some=query.features.sample)
            search.near = near
            watch.lap("match")
            yield self._glance(near, search, rays)
            if query.prior is not None:
                yield self._track(query.prior, search, rays)
        if query.more_features is None and (glance is None or not search.is_sampled):
            yield from self._look_closely(place, search, rays)

    def _glance(self, matches: Matches, search: Search, rays: FloatArray) -> Found | None:
        """Candidate from one LO-RANSAC over ``matches``, enough for most frames. None without a credible pose."""
        seed = self._ransac_seed(matches, search)
        return None if seed is None else self._candidate_at(seed, search.query, rays, search, matches)

    def _track(self, prior: Prior, search: Search, rays: FloatArray) -> Found | None:
        """Candidate from one LO-RANSAC over matches within 14 px around a prior, which suffices if few features are
        left. An ascent from the prior itself may end on a lower peak beside the right one. None if no credible pose is
        found.
        """
        query, T_map_camera = search.query, prior.pose.T_map_camera
        some = query.features.sample
        near, _ = self.index.match_near(query.features, query.camera, T_map_camera, _TRACKING_RADIUS_PX, some)
        search.watch.lap("match")
        return self._glance(near, search, rays)

    def _places(self, search: Search) -> Iterator[Place]:
        """Iterate over places to search: around the prior, then by votes of matches with the whole map. First the best
        place by a sample of the features, then at most ``options.places`` by all of them; only the former if more
        features can be extracted. Writes the matches and the reason into ``search``.
        """
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

    def _voted_places(self, search: Search, features: IntArray) -> Iterator[Place]:
        """Iterate over places by votes, after matching the rows ``features`` of the query's features with the whole map
        too. Adds the matches to ``search``. Fewer than eight matches yield no place and the reason NO_MATCHES.
        """
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

    def _look_closely(self, place: Place, search: Search, rays: FloatArray) -> Iterator[Found | None]:
        """Iterate over candidates from matches within one place: LO-RANSAC, then minimal samples ranked by density. A
        sample's candidate is only yielded if its optimum has a higher likelihood. Yields a single None if LO-RANSAC
        finds no credible pose.
        """
        query, watch = search.query, search.watch
        matches = self.index.match_within(query.features, place.landmarks)
        watch.lap("match")
        seed = self._ransac_seed(matches, search)
        if seed is None:
            yield None
            return
        evidence = evidence_of(self.index, matches, rays, query.camera)
        optimum = self._climb(matches, evidence, [seed], query, watch) if _plausible(seed, query) else None
        if optimum is not None:
            yield self._candidate_at(optimum.T_map_camera, query, rays, search, matches)
        samples = minimal_samples(
            evidence, matches.chances, matches.detections, self.options.samples, 4 * self.options.seeds
        )
        seeds = [T for T in samples if _plausible(T, query)][: self.options.seeds]
        watch.lap("seed")
        other = self._climb(matches, evidence, seeds, query, watch)
        if other is not None and (optimum is None or other.value > optimum.value):
            yield self._candidate_at(other.T_map_camera, query, rays, search, matches)

    def _ransac_seed(self, matches: Matches, search: Search) -> FloatArray | None:
        """Credible pose (4, 4) by LO-RANSAC over matches, counted in ``search.seeds``. None if there is none."""
        options = self.options
        found = credible_pose(self.index, search.query, matches, options.ransac_tolerance_px, options.ransac_samples)
        search.watch.lap("seed")
        search.seeds += found is not None
        return None if found is None else found[0]

    def _climb(
        self, matches: Matches, evidence: Evidence, seeds: list[FloatArray], query: Query, watch: Stopwatch
    ) -> Optimum | None:
        """Best optimum of the ascents from seed poses (4, 4); None without seeds."""
        tolerances_px = self.options.seed_tolerances_px
        optima = [ascend(self.map.densities, evidence, T, tolerances_px, query.dof) for T in seeds]
        watch.lap("ascend")
        return max(optima, key=lambda optimum: optimum.value, default=None)

    def _candidate_at(
        self, T_map_camera: FloatArray, query: Query, rays: FloatArray, search: Search, matches: Matches | None = None
    ) -> Found | None:
        """Candidate around a pose (4, 4); None if it breaks the query's constraints or too few matches are found.

        Args:
            matches: those that check the camera's focal length; by default those that ``search`` made without a pose.
        """
        if not _plausible(T_map_camera, query):
            return None
        found = self._checked(verify(self.index, query, rays, T_map_camera), query, search, matches)
        search.watch.lap("verify")
        return found

    def _look_with_any_focal(self, matches: Matches, query: Query, samples: int, watch: Stopwatch) -> Iterator[Found]:
        """Yield the candidate of an unknown focal length, estimated along with the pose; nothing if none is found.
        ``samples`` bounds the LO-RANSAC samples per focal length that is tried.
        """
        seed = focal_seed(self.index, matches, query, samples)
        watch.lap("seed")
        if seed is None:
            return
        T_map_camera, camera = seed
        found = verify_with_focal(self.index, replace(query, camera=camera), T_map_camera, matches)
        watch.lap("verify")
        if found is not None:
            verified, focal, refined = found
            if true_to_gravity(verified.optimum.T_map_camera, query.gravity):
                yield self._candidate(verified, refined, lambda: focal, belief_of(verified))

    def _checked(
        self, verified: Verified | None, query: Query, search: Search, matches: Matches | None = None
    ) -> Found | None:
        """Candidate from a verified pose. None if there is none, or if it contradicts the query's gravity.

        ``matches`` check the focal length, unless the pose is less probable than ``options.hopeless``; by default those
        that ``search`` made without a pose.
        """
        if verified is None or not true_to_gravity(verified.optimum.T_map_camera, query.gravity):
            return None
        belief = belief_of(verified)
        if belief.recognized < self.options.hopeless:
            return self._candidate(verified, query, partial(FocalEstimate.unchecked, query.camera), belief)

        def check() -> FocalEstimate:
            some = matches or search.unposed or verified.wide
            return check_focal(self.index, query, verified, some)

        return self._candidate(verified, query, check, belief)

    def _candidate(self, verified: Verified, query: Query, check: Callable[[], FocalEstimate], belief: Belief) -> Found:
        """Candidate from a verified pose; ``check`` checks the focal length when the result is first asked for."""
        near_prior = _near_prior(verified.optimum.T_map_camera, query.prior)
        return Found(verified, query.camera, cache(check), belief, near_prior)

    def _outcome(self, search: Search) -> Found | None:
        """Candidate to answer with; None if there is none.

        Refined by matches from farther around if its position is not settled, the focal length is known, and all
        features have been extracted.
        """
        found, query = search.outcome(self.options.conclusive), search.query
        if found is None or query.intrinsics is Intrinsics.UNKNOWN or query.more_features is not None:
            return found
        if search.is_settled(self.options.settled_sigma_m):
            return found
        found = replace(found, verified=polished(self.index, query, found.verified))
        search.watch.lap("verify")
        return found

    def _answer(self, search: Search) -> Localization:
        """A search's answer: its pose if probable and exact enough, else a refusal with its reason."""
        found = self._outcome(search)
        if found is None:
            return Localization.refused(search.reason, search.matches, search.watch.timings_ms)
        return gated(self._described(found, search), self.min_recognized, search.query)

    def _described(self, found: Found, search: Search) -> Localization:
        """A search's outcome as an answer with a pose, however doubtful or inexact."""
        query, verified = search.query, found.verified
        estimated = query.intrinsics is Intrinsics.UNKNOWN
        answer = Localization(
            localized=True,
            reason=None,
            pose=_pose(verified, query.dof),
            covariance=verified.covariance,
            belief=found.belief,
            matches=max(search.matches, len(verified.wide), len(verified.matches)),
            inliers=verified.inliers,
            inlier_pixels=verified.inlier_pixels,
            inlier_features=verified.inlier_landmarks,
            timings_ms=search.watch.timings_ms,
            near_prior=None if query.prior is None else found.near_prior,
            camera=found.camera if estimated else None,
            focal_sigma_px=found.focal.sigma_px if estimated else None,
            alternatives=tuple(
                _alternative(weight, rival.verified, query.dof)
                for weight, rival in found.rivals[:MAX_ALTERNATIVES]
                if weight >= MIN_WEIGHT
            ),
        )
        return with_map_error(self.index, answer, found.spread)

    def _diagnose(self, search: Search, answer: Localization) -> Diagnosis:
        """Likeliest cause of a refusal, searched in this order: the deadline, the map, upright or gravity constraints,
        the focal length, the picture. Takes up to two further searches.
        """
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
        if search.place is not None and search.everywhere is not None:
            matches = search.everywhere.among(search.place.landmarks).likeliest_first(_DIAGNOSTIC_MATCHES)
            for refocused in self._look_with_any_focal(matches, freed, _DIAGNOSTIC_SAMPLES, watch):
                if refocused.belief.confidence >= self.options.conclusive:
                    return wrong_camera(query.camera.focal, refocused.focal.focal_px)
        return self._diagnose_picture(query, answer)

    def _diagnose_picture(self, query: Query, answer: Localization) -> Diagnosis:
        """Likeliest cause of a refusal by the picture and its agreement, see :func:`diagnose_picture`."""
        agreement = Agreement(answer.inliers, answer.matches, answer.recognized)
        return diagnose_picture(query.image, self.map, len(query.features), _FEW_FEATURES, agreement)


def _with_more_features(query: Query, watch: Stopwatch) -> Query:
    """The query with all features that can be extracted, and none left to extract; unchanged if it has all."""
    if query.more_features is None:
        return query
    query = replace(query, features=query.more_features(), more_features=None)
    watch.lap("extract")
    return query


def check_kind(features: FeatureSet, wanted: Extractor) -> None:
    """Refuse features that a map's extractor cannot have made.

    Raises:
        InvalidDescriptors: their descriptors have another length than the extractor's.
    """
    given = features.descriptors.shape[1]
    if given != wanted.descriptor_bytes:
        raise InvalidDescriptors(
            f"The descriptors have {given} bytes; this map's have {wanted.descriptor_bytes}.",
            f"Extract '{wanted.name}' features for this map.",
        )


def _contradicted(found: Found, query: Query) -> Diagnosis:
    """Diagnosis of the constraint that a sure pose breaks: WRONG_GRAVITY if that is the gravity sent, else ROLLED."""
    T = found.verified.optimum.T_map_camera
    if not true_to_gravity(T, query.gravity):
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


def _alternative(weight: float, verified: Verified, dof: Dof) -> Alternative:
    """A rival as an alternative of probability ``weight``."""
    return Alternative(weight, _pose(verified, dof), verified.covariance, verified.inlier_landmarks)


def _pose(verified: Verified, dof: Dof) -> Pose:
    """Pose to answer with: with its roll removed if an upright camera was asked for."""
    T_map_camera = verified.optimum.T_map_camera
    return Pose(upright(T_map_camera) if dof is Dof.UPRIGHT else T_map_camera)


def _plausible(T_map_camera: FloatArray, query: Query) -> bool:
    """Whether a pose (4, 4) meets the query's constraints: at most 15° of roll if UPRIGHT, 10° off its gravity."""
    if query.dof is Dof.UPRIGHT:
        _, rolled = pose_distances(T_map_camera, upright(T_map_camera))
        if rolled > _MAX_UPRIGHT_ROLL_RAD:
            return False
    return true_to_gravity(T_map_camera, query.gravity)


def _near_prior(T_map_camera: FloatArray, prior: Prior | None) -> bool:
    """Whether a pose (4, 4) is within the prior's radii; True without a prior."""
    if prior is None:
        return True
    apart = float(np.linalg.norm(T_map_camera[:3, 3] - prior.pose.position))
    turned = float(angles_between(T_map_camera[:3, 2], prior.pose.heading))
    return apart <= prior.radius_m and turned <= prior.radius_rad


def true_to_gravity(T_map_camera: FloatArray, gravity: FloatArray | None) -> bool:
    """Whether ``gravity`` (3,) in the camera frame is within 10° of down by a pose (4, 4); True if it is unknown."""
    if gravity is None:
        return True
    down = T_map_camera[:3, :3] @ (gravity / np.linalg.norm(gravity))
    return bool(angles_between(-down, UP) <= _MAX_GRAVITY_ERROR_RAD)
