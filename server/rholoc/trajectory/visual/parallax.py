"""Parallax: image shifts between two pictures that no rotation explains."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize

from rholoc.errors import InvalidCamera
from rholoc.geometry import Camera, FloatArray, Lens, aligning_rotation, evenly
from rholoc.trajectory.visual.matching import VerifiedPair

_MIN_SHIFT_RAD = 0.0025  # of a walk; twice the detector's noise
_MIN_SHARE = 0.95  # of the pairs
_FITS = 3  # of the rotation, each to the best half of the matches
_SAMPLE = 12  # pairs that a camera is fitted to
_MAX_FACTOR, _MAX_FACTOR_OF_GIVEN = 1.6, 1.1  # of its focal length to a guessed one, and to a given one
_RADIAL = -0.4, 0.1  # range of its first distortion coefficient
_FIRST_STEPS = 0.2, 0.1  # of the fit: share of the focal length's range, change of the coefficient
_PRECISION, _EVALUATIONS = 2e-3, 60  # of the fit


def only_turned(pairs: Sequence[VerifiedPair], pixels: Sequence[FloatArray], camera: Camera, is_given: bool) -> bool:
    """Whether the camera only rotated, so that depths are unobservable: 95 % of the pairs shift by less than 2.5 mrad.

    By a wrong focal length or distortion, a rotation looks like a motion, so those that explain the pairs of a pinhole
    camera best by rotations are tried too. They also explain a motion along a flat wall. Hence the focal length of a
    given camera is varied by up to 10 % only, and one that is given with distortion is not varied.

    Args:
        pairs: of keyframes close in time; without any the answer is False.
        pixels: for each keyframe the places (N, 2) of its features.
        camera: assumed intrinsics.
        is_given: whether these are the recording's, not a guess.
    """
    if not pairs:
        return False

    def most_px(by: Camera) -> float:
        return by.focal * float(np.quantile(shifts(pairs, pixels, by), _MIN_SHARE))

    allowed_px = camera.focal * _MIN_SHIFT_RAD
    if most_px(camera) < allowed_px:
        return True
    if camera.lens is not Lens.PINHOLE or (is_given and any(camera.distortion)):
        return False
    sample = [pairs[k] for k in evenly(len(pairs), _SAMPLE).tolist()]
    max_factor = _MAX_FACTOR_OF_GIVEN if is_given else _MAX_FACTOR
    return most_px(_turning_camera(sample, pixels, camera, max_factor)) < allowed_px


def shifts(pairs: Sequence[VerifiedPair], pixels: Sequence[FloatArray], camera: Camera) -> FloatArray:
    """For each pair of keyframes (P,), the median residual of its matches under their best rotation [rad].

    Detector noise if the camera only turns, parallax if it moves. ``pixels`` are the places (N, 2) of each keyframe's
    features.
    """
    return np.array([_shift(*_matched_rays(pair, pixels, camera)) for pair in pairs])


def _matched_rays(pair: VerifiedPair, pixels: Sequence[FloatArray], camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Rays (M, 3) of a pair's matches in either picture."""
    first, second = pixels[pair.first][pair.matches[:, 0]], pixels[pair.second][pair.matches[:, 1]]
    return camera.rays(first), camera.rays(second)


def _shift(first: FloatArray, second: FloatArray) -> float:
    """Median residual [rad] of matched rays (M, 3) under their best rotation, fitted to the better half."""
    fitted = np.ones(len(first), dtype=np.bool_)
    for _ in range(_FITS):
        R_second_first = aligning_rotation(first[fitted], second[fitted])
        off = np.linalg.norm(second - first @ R_second_first.T, axis=1)
        fitted = off <= np.median(off)
    return float(np.median(off))


def _turning_camera(
    pairs: Sequence[VerifiedPair], pixels: Sequence[FloatArray], camera: Camera, max_factor: float
) -> Camera:
    """Camera of another focal length, up to ``max_factor`` times as long or short, and another first distortion
    coefficient, by which the mean shift [px] of the pairs is smallest.
    """
    radial, *others = camera.distortion or (0.0, 0.0, 0.0, 0.0)

    def changed(change: FloatArray) -> Camera:
        factor = float(np.exp(change[0]))
        return replace(camera, fx=factor * camera.fx, fy=factor * camera.fy, distortion=(float(change[1]), *others))

    def shift_px(change: FloatArray) -> float:
        try:
            other = changed(change)
        except InvalidCamera:  # of an impossible field of view
            return np.inf
        return other.focal * float(np.mean(shifts(pairs, pixels, other)))

    widest, (least, most) = float(np.log(max_factor)), _RADIAL
    longer, rounder = _FIRST_STEPS[0] * widest, -_FIRST_STEPS[1]
    start = np.array([0.0, np.clip(radial, least - rounder, most)])  # from where a step is within the range
    simplex = start + np.array([[0.0, 0.0], [longer, 0.0], [0.0, rounder]])
    found = minimize(
        shift_px,
        start,
        method="Nelder-Mead",
        bounds=((-widest, widest), _RADIAL),
        options={"initial_simplex": simplex, "xatol": _PRECISION, "maxfev": _EVALUATIONS},
    )
    return changed(found.x)
