"""Check a given focal length against the matches, or estimate an unknown one.

A wrong focal length moves the pose along the optical axis, by the depth times the relative error, until most matches
agree again, so the residuals hardly show it. But near and far landmarks then disagree on the distance. If the focal
length is freed, it moves to where they agree. With few informative matches it can also drift; therefore only a camera
that explains the picture better counts as evidence against the given one. Those that explain it as well leave the
distance open: the spread of their poses is part of the answer's covariance.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from rholoc.density import RayDensities
from rholoc.geometry import Camera, FloatArray, Lens
from rholoc.localization.index.map_error import PLACE_M, worst_sigma
from rholoc.localization.index.map_index import MapIndex
from rholoc.localization.index.matches import Matches
from rholoc.localization.pose.ascent import (
    SYSTEMATIC,
    ascend_with_focal,
    focal_sigma,
    freed_focal,
    information_at,
    optimum_at,
)
from rholoc.localization.pose.modes import Spread
from rholoc.localization.pose.ransac import credible_pose
from rholoc.localization.pose.rematching import ENOUGH_MATCHES, Verified, evidence_of, verify
from rholoc.localization.types import Query

_WIDE_RADIUS_PX = 14.0
_TOLERANCES_PX = (14.0, 7.0, 4.0)
_LAST_TOLERANCES_PX = (5.0, 4.0)
_FIRST_TOLERANCES_PX = (40.0, 15.0, 5.0)
_ROUNDS = 3
_SETTLED = 0.02  # of the focal length's logarithm: rounds that change less end
_ALIKE = 0.003  # of the focal length's logarithm: nothing is gained by another round
_SIGMAS = 3.0  # measured on real recordings: the estimate's error against its curvature's
_OWN_SIGMA = 0.015  # what maps and calibrations differ by, as a share of the focal length
_HARMLESS_M = 0.05  # a pose that a free focal length would move by less is right either way
# Doubt by how many estimated sigmas a focal length is off. Past 1.2 are 3 of 352 right poses by a right camera, and 172
# of 213 wrong ones by one that is a tenth off; of cameras, few are.
_OFF_SIGMAS, _DOUBT = (0.8, 1.2, 4.0), (0.0, 0.8, 1.0)
_FITTING_M, _FITTING_NATS = 0.015, 0.5  # what a free focal length changes at most where the one in use is right
_GUESSES = tuple(0.5 * 1.17**step for step in range(10))  # focal lengths to try, as shares of the longer side
_GUESS_TOLERANCE_SHARE = 0.02  # of the longer side: a guess may be off by half a step
_MIN_MATCHES, _MIN_SAMPLES = 8, 50
_ZOOMS = (0.9, 0.8, 0.63, 0.5), (1.1, 1.25, 1.6, 2.0)  # factors on a focal length that matches leave open
_CLEAR, _CLEAR_NATS = 0.2, 20.0  # of the nats that a pose explains, at least: a clear difference from another's
_VAGUE = 0.05  # of the focal length: with 3 σ as large it is left open
_RIGHT, _WRONG_SIGMA = 0.8, 0.2  # probability that a given focal length is right; its logarithm's sigma if it is not …
_ZOOM_STEP = 0.12  # … and about how far apart those are that are tried
_SAMPLES = 300  # for each guess, where the given focal length is checked
_SQUARE = 0.02  # of the logarithm of fx / fy: pixels of nearly all cameras are square


@dataclass(frozen=True, eq=False)
class FocalEstimate:
    """Estimate of the focal length from the matches of a pose.

    Attributes:
        focal_px: best-fitting focal length.
        sigma_px: its standard deviation.
        belief: factor 0 to 1 on the probability of the right place: probability that an error of the focal length in
            use does not displace the pose. If the focal length was estimated, probability that the pose is within
            50 cm.
        exact: factor 0 to 1 on the probability that the pose is within 10 cm and 5°, given the right place. 1 if the
            focal length was estimated, because the pose's covariance includes its uncertainty.
        of_others: (6, 6) second moment of the poses with other focal lengths about the checked pose; None without a
            check.
    """

    focal_px: float
    sigma_px: float
    belief: float
    exact: float = 1.0
    of_others: FloatArray | None = None

    @classmethod
    def unchecked(cls, camera: Camera) -> FocalEstimate:
        """The camera's own focal length with ``belief`` 1 and a standard deviation as large as itself, for a pose not
        worth a check.
        """
        return cls(camera.focal, camera.focal, 1.0)


Refocused = tuple[float, Verified]
"""A factor on a query's focal length, and a verified pose by it."""


def check_focal(index: MapIndex, query: Query, verified: Verified, matches: Matches) -> FocalEstimate:
    """Check the camera's focal length, and whether its pixels are square, against the matches of a verified pose.

    Returns :meth:`FocalEstimate.unchecked` if the lens is not a pinhole, or if pixels are square and freeing the focal
    length moves the pose by less than 15 mm (:func:`_fits`). Otherwise an ascent from the pose frees it
    (:func:`_followed`). If it fails, or confirms the focal length but with 3 σ of 5 % or more, other focal lengths are
    tried (:func:`_zoomed`); if it fails or confirms pixels that are not square, square ones are (:func:`_sought`).

    Args:
        index: index of the map.
        query: the frame.
        verified: its verified pose.
        matches: matches made without a pose; matches around a pose would exclude evidence against its focal length.
    """
    is_square = abs(math.log(query.camera.fx / query.camera.fy)) < _SQUARE
    if query.camera.lens is not Lens.PINHOLE or (is_square and _fits(index, query, verified, matches)):
        return FocalEstimate.unchecked(query.camera)
    others: list[Refocused] = []
    estimate = _followed(index, query, verified, matches, others)
    is_determined = is_square and estimate is not None and estimate.sigma_px < _VAGUE * estimate.focal_px
    if estimate is None or (estimate.belief == 1 and not is_determined):
        others += _zoomed(index, query, verified) if is_square else _sought(index, query, matches)
        scale, best = _explaining_most(verified, others)
        focal_px = scale * query.camera.focal
        sigma = focal_sigma(information_at(best.evidence, best.optimum, focal_free=True))
        estimate = FocalEstimate(focal_px, _spread(sigma) * focal_px, belief_beside(verified, others))
    return _beside(estimate, verified, others, is_square)


def _beside(estimate: FocalEstimate, verified: Verified, others: list[Refocused], is_square: bool) -> FocalEstimate:
    """The estimate with ``exact`` and ``of_others`` from ``verified`` and the poses by ``others``, other focal lengths.

    A pose's weight is its likelihood, tempered by ``SYSTEMATIC``², times :func:`_prior`. If pixels are not square and
    there are fewer than ``ENOUGH_MATCHES`` inliers, ``exact`` is at most 0.5.
    """
    scales, modes = zip((1.0, verified), *others, strict=True)
    nats = np.array([mode.optimum.value for mode in modes]) / SYSTEMATIC**2
    weights = _prior(np.log(scales)) * np.exp(nats - nats.max())
    weights /= weights.sum()
    spread = Spread.of(verified, modes, weights)
    at_most = 1.0 if is_square or verified.inliers >= ENOUGH_MATCHES else 0.5
    return replace(estimate, exact=min(spread.right, at_most), of_others=spread.moment)


def _prior(logs: FloatArray) -> FloatArray:
    """Prior probabilities (M,) of focal lengths by their logarithms (M,) relative to the first, which was given: it is
    right with probability 0.8, otherwise the logarithm is normal about it.
    """
    prior = (
        (1 - _RIGHT) * _ZOOM_STEP * np.exp(-((logs / _WRONG_SIGMA) ** 2) / 2) / (math.sqrt(2 * math.pi) * _WRONG_SIGMA)
    )
    prior[0] += _RIGHT
    return prior


def _followed(
    index: MapIndex, query: Query, verified: Verified, matches: Matches, others: list[Refocused]
) -> FocalEstimate | None:
    """Estimate by a joint ascent over pose and focal length from a verified pose.

    None if the likelihood at an ascent's end is lower than at the start. If the focal length in use looks wrong, the
    pose with the estimated one is appended to ``others``.
    """
    camera, T = query.camera, verified.optimum.T_map_camera
    total, sigma, explained = 1.0, np.inf, 0.0
    tolerances_px: tuple[float, ...] = _FIRST_TOLERANCES_PX
    for _ in range(_ROUNDS):
        if len(matches) < _MIN_MATCHES:
            break
        evidence = evidence_of(index, matches, camera.rays(query.features.pixels), camera)
        explained = explained or optimum_at(RayDensities(), evidence, T, tolerances_px[-1]).value
        optimum, scale, sigma = ascend_with_focal(evidence, T, tolerances_px, query.dof)
        if optimum.value < explained:
            return None
        tolerances_px = _TOLERANCES_PX
        total, T = total * scale, optimum.T_map_camera
        if abs(np.log(scale)) < _SETTLED or not _sensible(query.camera, total):
            break
        camera = query.camera.zoomed(total)
        matches, _ = index.match_near(query.features, camera, T, _WIDE_RADIUS_PX)
    moved_m = float(np.linalg.norm(T[:3, 3] - verified.optimum.T_map_camera[:3, 3]))
    focal_px = query.camera.focal * total
    belief = _belief(moved_m, abs(math.log(total)) / math.hypot(_SIGMAS * sigma, _OWN_SIGMA))
    if belief < 1:
        others += _refocused(index, query, total, T)
        belief = belief_beside(verified, others)
    return FocalEstimate(focal_px, _spread(sigma) * focal_px, belief)


def _zoomed(index: MapIndex, query: Query, verified: Verified) -> list[Refocused]:
    """Poses by focal lengths from half to twice the query's, at most eight, and one refined.

    Each starts from the verified pose moved along the optical axis, its distance from the landmarks scaled like the
    focal length. The search in either direction ends :func:`_margin` below the verified likelihood. If a pose has a
    higher likelihood than the verified one, the best is refined, and appended.
    """
    T = verified.optimum.T_map_camera
    depths_m = (index.landmarks[verified.inlier_landmarks] - T[:3, 3]) @ T[:3, 2]
    if len(depths_m) == 0:
        return []
    found: list[Refocused] = []
    for way in _ZOOMS:
        for scale in way:
            farther = T.copy()
            farther[:3, 3] -= (scale - 1) * float(np.median(depths_m)) * T[:3, 2]
            other = _by_focal(index, query, scale, farther)
            if other is None:
                break
            found.append((scale, other))
            if other.optimum.value < verified.optimum.value - _margin(verified):
                break
    scale, best = _explaining_most(verified, found)
    return found if best is verified else [*found, *_refined(index, query, scale, best)]


def _sought(index: MapIndex, query: Query, matches: Matches) -> Iterator[Refocused]:
    """Pose with square pixels and any focal length, from ``matches`` alone; nothing if none is found."""
    camera = query.camera
    square = replace(query, camera=replace(camera, fx=camera.focal, fy=camera.focal))
    seed = focal_seed(index, matches, square, _SAMPLES)
    found = None if seed is None else verify_with_focal(index, replace(query, camera=seed[1]), seed[0], matches)
    if found is not None:
        factors = (found[1].focal_px / given for given in (camera.fx, camera.fy))
        yield max(factors, key=lambda factor: abs(math.log(factor))), found[0]


def _by_focal(index: MapIndex, query: Query, scale: float, T_map_camera: FloatArray) -> Verified | None:
    """Verified pose near a pose (4, 4) by ``scale`` × the query's focal length. None if there is none, or the field of
    view is implausible.
    """
    if not _sensible(query.camera, scale):
        return None
    camera = query.camera.zoomed(scale)
    asked = replace(query, camera=camera)
    return verify(index, asked, camera.rays(query.features.pixels), T_map_camera, focal_free=True)


def _refocused(index: MapIndex, query: Query, scale: float, T_map_camera: FloatArray) -> list[Refocused]:
    """Pose near a pose (4, 4) by ``scale`` × the query's focal length, refined; nothing if none is verified."""
    found = _by_focal(index, query, scale, T_map_camera)
    return [] if found is None else _refined(index, query, scale, found)


def _refined(index: MapIndex, query: Query, scale: float, verified: Verified) -> list[Refocused]:
    """The likeliest of ``verified`` (at ``scale``) and at most two poses by ascents of its focal length, as a list."""
    found = [(scale, verified)]
    for _ in range(_ROUNDS - 1):
        scale, last = found[-1]
        optimum, change, _ = ascend_with_focal(last.evidence, last.optimum.T_map_camera, _LAST_TOLERANCES_PX, query.dof)
        if abs(np.log(change)) < _ALIKE:
            break
        nearer = _by_focal(index, query, scale * change, optimum.T_map_camera)
        if nearer is None:
            break
        found.append((scale * change, nearer))
    return [max(found, key=lambda one: one[1].optimum.value)]


def belief_beside(verified: Verified, others: Iterable[Refocused]) -> float:
    """Probability 0 to 1 that a verified pose's focal length is harmless, given poses by others.

    A few matches at the edge of their density can produce a sharp but wrong peak, and in front of a wall any focal
    length fits from some distance. Therefore another pose only counts if its likelihood exceeds that of the verified
    one by :func:`_margin`.
    """
    _, best = _explaining_most(verified, others)
    gain = best.optimum.value - verified.optimum.value - _margin(verified)
    return _belief(_apart_m(best, verified), math.sqrt(2 * gain) / SYSTEMATIC) if gain > 0 else 1.0


def _margin(verified: Verified) -> float:
    """Difference in log-likelihood [nats] from which another pose counts as clearly better, or worse, than a verified
    one: a fifth of that one's log-likelihood, at least 20.
    """
    return max(_CLEAR * verified.optimum.value, _CLEAR_NATS)


def _explaining_most(verified: Verified, others: Iterable[Refocused]) -> Refocused:
    """The one of ``others`` with the highest likelihood; the verified pose at scale 1 if there are none."""
    return max(others, key=lambda other: other[1].optimum.value, default=(1.0, verified))


def _apart_m(a: Verified, b: Verified) -> float:
    """Distance [m] between the positions of two poses."""
    return float(np.linalg.norm(a.optimum.T_map_camera[:3, 3] - b.optimum.T_map_camera[:3, 3]))


def _belief(moved_m: float, off_sigmas: float) -> float:
    """Probability 0 to 1 that a focal length is harmless: 1 if the pose moves by 5 cm or less, or the focal length is
    off by at most 0.8 σ.

    Args:
        moved_m: displacement of the pose when the focal length is freed.
        off_sigmas: standard deviations by which the focal length in use is off.
    """
    harm = min(max(moved_m / _HARMLESS_M - 1, 0.0), 1.0)
    return 1 - harm * float(np.interp(off_sigmas, _OFF_SIGMAS, _DOUBT))


def _spread(sigma: float) -> float:
    """Relative standard deviation of a focal length: 3 × that of its logarithm by the curvature alone, at most 1."""
    return min(_SIGMAS * sigma, 1.0)


def _fits(index: MapIndex, query: Query, verified: Verified, matches: Matches) -> bool:
    """Whether matches around the pose and ``matches``, made without, both agree with the given focal length: freeing it
    would move the pose by less than 15 mm and gain less than 0.5 nats. False with fewer than ``ENOUGH_MATCHES`` of
    either, or inliers. True for most frames. Matches around the pose alone would not suffice: a wrong focal length
    excludes the matches that contradict it.
    """
    if min(len(verified.wide), len(matches), verified.inliers) < ENOUGH_MATCHES:
        return False
    camera, T = query.camera, verified.optimum.T_map_camera
    for some in (verified.wide, matches):
        evidence = evidence_of(index, some, camera.rays(query.features.pixels), camera)
        moved_m, gain = freed_focal(evidence, T, _WIDE_RADIUS_PX, query.dof)
        if moved_m >= _FITTING_M or gain >= _FITTING_NATS:
            return False
    return True


def focal_seed(index: MapIndex, matches: Matches, query: Query, samples: int) -> tuple[FloatArray, Camera] | None:
    """Seed pose (4, 4) and camera for an unknown focal length: LO-RANSAC for each of ten, from 0.5 to 2 × the longer
    side.

    Args:
        index: index of the map.
        matches: matches of the query's features.
        query: the frame; its camera has the right principal point and any focal length.
        samples: maximum number of samples per focal length.

    Returns:
        The pose with the most inliers; None if fewer than eight matches agree with any focal length.
    """
    camera, longer = query.camera, max(query.camera.width, query.camera.height)
    best: tuple[int, FloatArray, Camera] | None = None
    for share in _GUESSES:
        guess = camera.zoomed(share * longer / camera.focal)
        asked = replace(query, camera=guess)
        found = credible_pose(index, asked, matches, _GUESS_TOLERANCE_SHARE * longer, (samples, _MIN_SAMPLES))
        if found is not None and (best is None or found[1] > best[0]):
            best = found[1], found[0], guess
    return None if best is None or best[0] < _MIN_MATCHES else best[1:]


def verify_with_focal(
    index: MapIndex, query: Query, T_map_camera: FloatArray, matches: Matches
) -> tuple[Verified, FocalEstimate, Query] | None:
    """Ascend over pose and focal length, match again and verify, as :func:`verify` does for a known one.

    Args:
        index: index of the map.
        query: the frame, with the guessed camera.
        T_map_camera: (4, 4) start.
        matches: matches to begin with.

    Returns:
        The verified pose, with a covariance that includes the uncertain focal length; the estimate; the query with the
        estimated camera. None if fewer than eight matches are found, or the focal length gives no plausible field of
            view.
    """
    evidence = evidence_of(index, matches, query.camera.rays(query.features.pixels), query.camera)
    optimum, scale, _ = ascend_with_focal(evidence, T_map_camera, (24.0, 12.0, 6.0), query.dof)
    for _ in range(_ROUNDS):
        if not _sensible(query.camera, scale):
            return None
        query = replace(query, camera=query.camera.zoomed(scale))
        near, _ = index.match_near(query.features, query.camera, optimum.T_map_camera, _WIDE_RADIUS_PX)
        if len(near) < _MIN_MATCHES:
            return None
        evidence = evidence_of(index, near, query.camera.rays(query.features.pixels), query.camera)
        optimum, scale, sigma = ascend_with_focal(evidence, optimum.T_map_camera, _TOLERANCES_PX, query.dof)
        if abs(np.log(scale)) < _SETTLED:
            break
    query = replace(query, camera=query.camera.zoomed(scale))
    rays = query.camera.rays(query.features.pixels)
    verified = verify(index, query, rays, optimum.T_map_camera, focal_free=True)
    if verified is None:
        return None
    focal_px = query.camera.focal
    here = math.erf(PLACE_M / (math.sqrt(2) * worst_sigma(verified.covariance[:3, :3])))
    return verified, FocalEstimate(focal_px, _spread(sigma) * focal_px, here), query


def _sensible(camera: Camera, scale: float) -> bool:
    """Whether ``scale`` × the camera's focal length is between 0.3 and 3.5 × its longer side."""
    return 0.3 < camera.focal * scale / max(camera.width, camera.height) < 3.5
