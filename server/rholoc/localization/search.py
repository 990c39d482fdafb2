"""State of a search: its effort, its time, its candidates, and which of them is the answer."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from rholoc import telemetry
from rholoc.geometry import Camera, FloatArray
from rholoc.localization.belief.confidence import MIN_RECOGNIZED
from rholoc.localization.index.map_error import worst_sigma
from rholoc.localization.index.matches import Matches, NearestLandmarks
from rholoc.localization.pose.focal import FocalEstimate
from rholoc.localization.pose.modes import Spread, are_distinct, is_seen_from_afar
from rholoc.localization.pose.rematching import Verified
from rholoc.localization.pose.rivals import are_rivals, shares
from rholoc.localization.pose.seeds import Place
from rholoc.localization.types import Belief, Query, Reason

_MAX_MISSING = 0.25  # maximum ratio of the nats against a pose to those for it, for the search to end with it


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
        fruitless_looks: number of looks that found none after which it ends if LO-RANSAC never found a credible pose.
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
    fruitless_looks: int = 2
    expected: float = MIN_RECOGNIZED


@dataclass
class Stopwatch:
    """Milliseconds per stage, and the deadline [s after the start]; None if there is none."""

    deadline_s: float | None
    started: float = field(default_factory=time.perf_counter)
    timings_ms: dict[str, float] = field(default_factory=dict)
    _last: float = field(default_factory=time.perf_counter)

    def lap(self, stage: str) -> None:
        """Add the time since the last lap to a stage of ``timings_ms``, and note it for the telemetry."""
        now = time.perf_counter()
        self.timings_ms[stage] = self.timings_ms.get(stage, 0.0) + 1e3 * (now - self._last)
        telemetry.note(stage, now - self._last)
        self._last = now

    @property
    def late(self) -> bool:
        """Whether the deadline has passed; False without one."""
        return self.deadline_s is not None and time.perf_counter() - self.started > self.deadline_s


@dataclass(frozen=True, eq=False)
class Found:
    """A candidate pose.

    Attributes:
        verified: the pose and its evidence.
        camera: camera it was found with.
        check_focal: returns the check of that camera's focal length against the matches; the first call takes as long
            as a search of a place.
        if_focal_right: belief in the pose, given that the focal length is right.
        near_prior: whether the pose agrees with the prior.
        share: factor 0 to 1 that rivals leave of the probability of the right place.
        rivals: mutually exclusive poses, each with its probability of the right place, likeliest first.
        modes: spread of the modes in the pose's place; None if it is the only one.
    """

    verified: Verified
    camera: Camera
    check_focal: Callable[[], FocalEstimate]
    if_focal_right: Belief
    near_prior: bool
    share: float = 1.0
    rivals: tuple[tuple[float, Found], ...] = ()
    modes: Spread | None = None

    @property
    def focal(self) -> FocalEstimate:
        """Result of the focal length's check; the first access computes it."""
        return self.check_focal()

    @property
    def belief(self) -> Belief:
        """Belief in the pose: ``if_focal_right`` times the belief in the focal length, and what rivals and other modes
        leave.
        """
        recognized = self.if_focal_right.recognized * self.focal.belief * self.share
        of_modes = 1.0 if self.modes is None else self.modes.right
        return Belief(recognized, self.if_focal_right.exact * self.focal.exact * of_modes)

    @property
    def spread(self) -> FloatArray:
        """Second moment (6, 6) of the other poses, by other focal lengths and of other modes, about this one."""
        of_focal, of_modes = self.focal.of_others, None if self.modes is None else self.modes.moment
        return sum((one for one in (of_focal, of_modes) if one is not None), start=np.zeros((6, 6)))

    @property
    def recognized(self) -> float:
        """Probability 0 to 1 that the pose is of the right place."""
        return self.belief.recognized

    @property
    def sigma_m(self) -> float:
        """Standard deviation of the position along its worst axis [m]."""
        return worst_sigma(self.verified.covariance[:3, :3])


@dataclass
class Search:
    """State of a search.

    Attributes:
        query: the frame.
        watch: its time budget.
        matches: number of features that match anywhere, or near the prior.
        best: likeliest candidate that agrees with the prior.
        elsewhere: likeliest candidate that does not.
        reason: reason for a refusal, if no candidate is good enough.
        place: first place that was searched: the prior's, else the one with the most votes.
        everywhere: matches with the whole map.
        nearest: nearest landmarks of each feature in the whole map.
        is_sampled: whether ``nearest`` covers only a sample of the features.
        near: matches of a sample of the features with the prior's place.
        found: all candidates.
        fruitless: number of searches of voted places without a candidate.
        seeds: number of credible poses by LO-RANSAC, before verification.
    """

    query: Query
    watch: Stopwatch
    matches: int = 0
    best: Found | None = None
    elsewhere: Found | None = None
    reason: Reason = Reason.NO_AGREEMENT
    place: Place | None = None
    everywhere: Matches | None = None
    nearest: NearestLandmarks | None = None
    near: Matches | None = None
    is_sampled: bool = False
    found: list[Found] = field(default_factory=list)
    fruitless: int = 0
    seeds: int = 0

    @property
    def likeliest(self) -> Found | None:
        """Likeliest candidate that agrees with the prior; if there is none, the likeliest of the others. None without
        candidates.
        """
        return self.best or self.elsewhere

    @property
    def unposed(self) -> Matches | None:
        """Matches made without a pose, with the whole map or else with the prior's place; None before there are any."""
        return self.near if self.everywhere is None else self.everywhere

    def add(self, found: Found | None) -> None:
        """Add a candidate, and note it if it is the likeliest that agrees with the prior, or of the others. None
        counts as fruitless if the whole map was searched.
        """
        if found is None:
            self.fruitless += self.everywhere is not None
            return
        self.found.append(found)
        if found.near_prior:
            self.best = _likelier(self.best, found)
        else:
            self.elsewhere = _likelier(self.elsewhere, found)

    def is_over(self, conclusive: float, max_sigma_m: float) -> bool:
        """Whether some candidate ends the search: recognized, if its focal length is right, with a probability of at
        least ``conclusive``, a position sigma of at most ``max_sigma_m``, and nats against it of at most a quarter of
        those for it.
        """
        candidates = [found for found in (self.best, self.elsewhere) if found is not None]
        return any(
            found.if_focal_right.recognized >= conclusive
            and found.verified.support.missing <= _MAX_MISSING * found.verified.support.seen
            and found.sigma_m <= max_sigma_m
            for found in candidates
        )

    def is_settled(self, max_sigma_m: float) -> bool:
        """Whether the likeliest candidate's position sigma is at most ``max_sigma_m``, and it is not seen from afar
        (other modes are improbable).
        """
        best = self.likeliest
        return best is not None and best.sigma_m <= max_sigma_m and not is_seen_from_afar(best.verified)

    def is_hopeless(self, options: SearchOptions) -> bool:
        """Whether the search can be given up.

        Without any credible pose: after ``options.fruitless_looks``. Otherwise: after ``options.hopeless_looks`` if no
        candidate's probability of the right place reaches ``options.hopeless``.
        """
        if not self.seeds:
            return self.fruitless >= options.fruitless_looks
        likeliest = max((found.if_focal_right.recognized for found in self.found), default=0.0)
        return len(self.found) + self.fruitless >= options.hopeless_looks and likeliest < options.hopeless

    def is_as_expected(self, enough: float) -> bool:
        """Whether some candidate agrees with the prior and has at least the probability ``enough`` of the right place.
        False without a prior.
        """
        if self.query.prior is None or self.best is None:
            return False
        return self.best.if_focal_right.recognized >= enough

    def outcome(self, conclusive: float) -> Found | None:
        """Candidate to answer with: the likeliest that agrees with the prior, or None.

        One that contradicts the prior is taken if its probability reaches ``conclusive``, and no agreeing one's reaches
        ``MIN_RECOGNIZED``.
        """
        best, elsewhere = self._contested(self.best), self._contested(self.elsewhere)
        surely_elsewhere = elsewhere is not None and elsewhere.recognized >= conclusive
        if best is not None and (best.recognized >= MIN_RECOGNIZED or not surely_elsewhere):
            return best
        return elsewhere if surely_elsewhere else best

    def _contested(self, found: Found | None) -> Found | None:
        """A candidate with its rivals and the other modes of its place; those of one near the prior must be near it.
        None for None.
        """
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
        places = [rival.if_focal_right.recognized for rival in rivals]
        share = _shares(rivals, places)
        others = zip((found.focal.belief * share * places)[1:].tolist(), rivals[1:], strict=True)
        ordered = sorted(others, key=lambda rival: -rival[0])
        return replace(found, share=float(share[0]), rivals=tuple(ordered), modes=_spread(modes))


def _likelier(a: Found | None, b: Found) -> Found:
    """The likelier of two candidates: within one place by the likelihood at the optimum, of two places by their net
    evidence. One with at least ``MIN_RECOGNIZED`` comes before one with less.
    """
    if a is None:
        return b
    are_two = are_rivals(a.verified, b.verified)
    of_a, of_b = (one.verified.support.net if are_two else one.verified.optimum.value for one in (a, b))
    likely_a, likely_b = (one.if_focal_right.recognized >= MIN_RECOGNIZED for one in (a, b))
    return a if (likely_a, of_a) >= (likely_b, of_b) else b


def _shares(candidates: list[Found], places: list[float]) -> FloatArray:
    """Shares (M,), see :func:`shares`, of M poses that exclude one another, by each one's probability of its place."""
    return shares(np.array(places), np.array([one.verified.support.net for one in candidates]))


def _spread(modes: list[Found]) -> Spread | None:
    """Spread of the modes of one place about the first; None if there is one only. They share a focal length, so that
    nothing is asked of it.
    """
    if len(modes) == 1:
        return None
    weights = _shares(modes, [mode.if_focal_right.recognized for mode in modes])
    return Spread.of(modes[0].verified, [mode.verified for mode in modes], weights)
