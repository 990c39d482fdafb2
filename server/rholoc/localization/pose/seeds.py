"""Seeds: places that the matches vote for, and minimal samples within them, scored by the density."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np
import poselib

from rholoc.density import Evidence
from rholoc.geometry import FloatArray, IntArray, angles_between, pose_matrix
from rholoc.localization.index.map_index import MapIndex
from rholoc.localization.index.matches import Matches
from rholoc.localization.pose.ascent import gains
from rholoc.localization.types import Prior

_SEED = 20250  # samples are drawn from a generator with this seed: the same query gives the same answer
_SCORE_TOLERANCE_PX = 12.0
VIEWS_OF_LITTLE = 50  # features: views that saw fewer are held against as many
_BESIDE_M, _ASIDE_RAD = 1.0, np.deg2rad(30.0)  # how far from a pose a view still shows much the same


@dataclass(frozen=True, eq=False)
class Place:
    """A part of the map that is seen together.

    Attributes:
        view: the view it is seen from.
        landmarks: (P,) rows of the map's features seen from there and thereabouts.
        votes: how strongly the matches speak for it.
    """

    view: int
    landmarks: IntArray
    votes: float


def vote_for_places(index: MapIndex, matches: Matches, most: int, views_each: int, prior: Prior | None) -> list[Place]:
    """The places that most matches speak for, no two of them the same.

    Each match votes with its chance for the views that its landmark was seen in (presence); a place is a view with
    those that share most features with it.
    """
    return list(islice(places_by_votes(index, matches, views_each, prior), most))


def places_by_votes(index: MapIndex, matches: Matches, views_each: int, prior: Prior | None = None) -> Iterator[Place]:
    """As :func:`vote_for_places`, one after the other: mostly the first one is enough."""
    votes = view_votes(index, matches)
    if prior is not None:
        near = np.linalg.norm(index.view_positions - prior.pose.position, axis=1) < prior.radius_m + 1.0
        votes = np.where(near, votes, votes * 0.1)
    for view, companions in groups_by_votes(votes, index.shared_with, views_each):
        yield Place(view, index.seen_from(companions), float(votes[view]))


def groups_by_votes(
    votes: FloatArray, shared_with: Callable[[int], FloatArray], views_each: int
) -> Iterator[tuple[int, IntArray]]:
    """Views by their votes (K,), each with those, itself among them, that share most features with it."""
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
    """How strongly matches speak for each view (K,): the sum of their chances, held against how much the view saw."""
    belief = np.bincount(matches.landmarks, weights=matches.chances, minlength=len(index.map))
    votes = np.asarray(index.visibility @ np.minimum(belief, 1.0), dtype=np.float64)
    return np.asarray(votes / np.sqrt(np.maximum(np.diff(index.map.view_offsets), VIEWS_OF_LITTLE)))


def place_of_prior(index: MapIndex, prior: Prior, views_each: int) -> Place | None:
    """The part of the map that is seen from about a prior: by the views that stand and look most like it."""
    chosen = views_by_prior(index.view_positions, index.view_headings, prior)[:views_each]
    if len(chosen) == 0:
        return None
    return Place(int(chosen[0]), index.seen_from(chosen), np.inf)


def views_by_prior(positions: FloatArray, headings: FloatArray, prior: Prior) -> IntArray:
    """Those of the views at ``positions`` (K, 3), with ``headings`` (K, 3), that stand and look about as a prior says;
    the most like it first."""
    apart_m = np.linalg.norm(positions - prior.pose.position, axis=1)
    turned = angles_between(headings, prior.pose.heading)
    within = (apart_m < prior.radius_m + _BESIDE_M) & (turned < prior.radius_rad + _ASIDE_RAD)
    nearest = np.argsort(apart_m + turned, kind="stable")
    return np.asarray(nearest[within[nearest]])


def minimal_samples(
    evidence: Evidence, chances: FloatArray, detections: IntArray, samples: int, keep: int
) -> FloatArray:
    """Poses (S, 4, 4), S ≤ ``keep``, from samples of three matches, the best by density first.

    Matches are drawn by their chances; the three-point solver is poselib's.
    """
    if len(chances) < 4:
        return np.zeros((0, 4, 4))
    rng = np.random.default_rng(_SEED)
    draws = _draw_triples(rng, chances, detections, samples)
    poses = [pose for triple in draws for pose in poselib.p3p(evidence.rays[triple], evidence.landmarks[triple])]
    if not poses:
        return np.zeros((0, 4, 4))
    R_camera_map = np.array([p.R for p in poses])
    t = np.array([p.t for p in poses])
    R = R_camera_map.transpose(0, 2, 1)
    T = pose_matrix(R, -np.einsum("hij,hj->hi", R, t))
    T = T[np.isfinite(T).all(axis=(1, 2))]
    value = gains(evidence, T, _SCORE_TOLERANCE_PX)
    best = np.argsort(-value, kind="stable")[:keep]
    return np.asarray(T[best])


def _draw_triples(rng: np.random.Generator, chances: FloatArray, detections: IntArray, samples: int) -> IntArray:
    """Triples (S, 3) of different detections, drawn by chance."""
    cumulative = np.cumsum(chances)
    draws = np.searchsorted(cumulative, rng.random((samples, 3)) * cumulative[-1])
    a, b, c = (detections[draws[:, i]] for i in range(3))
    return np.asarray(draws[(a != b) & (b != c) & (a != c)])
