"""Seeds: places that matches vote for, and poses from minimal samples within a place, ranked by density."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np

from rholoc.density import Evidence
from rholoc.geometry import FloatArray, IntArray, angles_between
from rholoc.geometry.resection import three_point_poses
from rholoc.localization.index.map_index import MapIndex
from rholoc.localization.index.matches import Matches
from rholoc.localization.pose.ascent import gains
from rholoc.localization.types import Prior

_SEED = 20250  # samples are drawn from a generator with this seed: the same query gives the same answer
_SCORE_TOLERANCE_PX = 12.0
VIEWS_OF_LITTLE = 50  # features: lower bound on the number that a view's votes are divided by
_BESIDE_M, _ASIDE_RAD = 1.0, np.deg2rad(30.0)  # how far from a pose a view still shows much the same


@dataclass(frozen=True, eq=False)
class Place:
    """A part of the map that is visible together.

    Attributes:
        view: row of its central view.
        landmarks: (P,) rows of the features visible from that view and its neighbours.
        votes: sum of the matches' votes.
    """

    view: int
    landmarks: IntArray
    votes: float


def vote_for_places(index: MapIndex, matches: Matches, most: int, views_each: int, prior: Prior | None) -> list[Place]:
    """The places with the most votes, at most ``most``, all different.

    Each match votes with its probability for the views that saw its landmark (presence). A place is a view together
    with the ``views_each`` views that share most features with it, itself among them. Views farther from a prior than
    its radius and 1 m count a tenth.
    """
    return list(islice(places_by_votes(index, matches, views_each, prior), most))


def places_by_votes(index: MapIndex, matches: Matches, views_each: int, prior: Prior | None = None) -> Iterator[Place]:
    """Iterate over the places of :func:`vote_for_places`, most votes first, until no view with votes is left."""
    votes = view_votes(index, matches)
    if prior is not None:
        near = np.linalg.norm(index.view_positions - prior.pose.position, axis=1) < prior.radius_m + 1.0
        votes = np.where(near, votes, votes * 0.1)
    for view, companions in groups_by_votes(votes, index.shared_with, views_each):
        yield Place(view, index.seen_from(companions), float(votes[view]))


def groups_by_votes(
    votes: FloatArray, shared_with: Callable[[int], FloatArray], views_each: int
) -> Iterator[tuple[int, IntArray]]:
    """Iterate over views by descending votes (K,), each with the group of at most ``views_each`` views (itself
    included) that share most features with it.

    The half of a group that shares most is not yielded again. ``shared_with`` returns the number (K,) of features that
    each view shares with a given one.
    """
    open_ = votes > 0
    while open_.any():
        view = int(np.argmax(np.where(open_, votes, -1)))
        shared = shared_with(view)
        sharing = np.flatnonzero(shared > 0)  # few of many: all are not sorted
        companions = sharing[np.argsort(-shared[sharing], kind="stable")[:views_each]]
        yield view, companions
        open_[companions[: max(views_each // 2, 1)]] = False
        open_[view] = False


def view_votes(index: MapIndex, matches: Matches) -> FloatArray:
    """Votes for each view (K,): sum of its landmarks' match probabilities (at most 1 per landmark), divided by the
    square root of the number of features that it saw, of at least ``VIEWS_OF_LITTLE``.
    """
    belief = np.bincount(matches.landmarks, weights=matches.chances, minlength=len(index.map))
    votes = np.asarray(index.visibility @ np.minimum(belief, 1.0), dtype=np.float64)
    return np.asarray(votes / np.sqrt(np.maximum(np.diff(index.map.view_offsets), VIEWS_OF_LITTLE)))


def place_of_prior(index: MapIndex, prior: Prior, views_each: int) -> Place | None:
    """The place around a prior, from its nearest ``views_each`` views by :func:`views_by_prior`; its ``votes`` are
    infinite. None if there are none.
    """
    chosen = views_by_prior(index.view_positions, index.view_headings, prior)[:views_each]
    if len(chosen) == 0:
        return None
    return Place(int(chosen[0]), index.seen_from(chosen), np.inf)


def views_by_prior(positions: FloatArray, headings: FloatArray, prior: Prior) -> IntArray:
    """Rows of the views that agree with a prior, by ascending distance [m] plus angle [rad].

    They are at ``positions`` (K, 3) with ``headings`` (K, 3), and within the prior's radii plus 1 m and 30°.
    """
    apart_m = np.linalg.norm(positions - prior.pose.position, axis=1)
    turned = angles_between(headings, prior.pose.heading)
    within = (apart_m < prior.radius_m + _BESIDE_M) & (turned < prior.radius_rad + _ASIDE_RAD)
    nearest = np.argsort(apart_m + turned, kind="stable")
    return np.asarray(nearest[within[nearest]])


def minimal_samples(
    evidence: Evidence, chances: FloatArray, detections: IntArray, samples: int, keep: int
) -> FloatArray:
    """Poses (S, 4, 4), S ≤ ``keep``, from ``samples`` samples of three matches, highest likelihood first; none for
    fewer than four matches.

    Matches are drawn with their probabilities ``chances`` (M,) from a fixed seed. ``detections`` (M,) are their
    features: a sample never has one twice.
    """
    if len(chances) < 4:
        return np.zeros((0, 4, 4))
    rng = np.random.default_rng(_SEED)
    draws = _draw_triples(rng, chances, detections, samples)
    T = three_point_poses(evidence.rays[draws], evidence.landmarks[draws])
    if not len(T):
        return T
    value = gains(evidence, T, _SCORE_TOLERANCE_PX)
    best = np.argsort(-value, kind="stable")[:keep]
    return np.asarray(T[best])


def _draw_triples(rng: np.random.Generator, chances: FloatArray, detections: IntArray, samples: int) -> IntArray:
    """Random triples (S, 3) of rows of matches with different ``detections`` (M,), drawn in proportion to ``chances``
    (M,); S ≤ ``samples``.
    """
    cumulative = np.cumsum(chances)
    draws = np.searchsorted(cumulative, rng.random((samples, 3)) * cumulative[-1])
    a, b, c = (detections[draws[:, i]] for i in range(3))
    return np.asarray(draws[(a != b) & (b != c) & (a != c)])
