"""Evidence from patches: whether matched features have the orientation and size that the pose predicts.

Descriptors are invariant to orientation and size. Once a pose is given, the landmark's patch in the map predicts both.
Eight of ten true matches have the predicted orientation and size; of false matches one in ten has the orientation, one
in three the size (the weak geometric consistency of Jégou, Douze and Schmid, ECCV 2008, made exact by the pose).
"""

import numpy as np

from rholoc.features import FeatureSet
from rholoc.geometry import Camera, FloatArray, IntArray, patch_appearance
from rholoc.maps import Map

_TURN_RAD = np.deg2rad(8.0)  # median deviation of true matches from the predicted orientation
_SIZE_OCTAVES, _CHANCE_OCTAVES = 0.2, 0.8  # likewise of sizes; the mean deviation of false matches
_MAX_OCTAVES = 2.5  # larger deviations are clipped
_TRUE_SHARE = 0.9  # of true matches: the others are as if by chance
_FEWEST = 3.0  # pseudo-matches with a ratio of 0


def patch_log_odds(
    map_: Map, features: FeatureSet, camera: Camera, T_map_camera: FloatArray, detections: IntArray, landmarks: IntArray
) -> FloatArray:
    """Log-likelihood ratio [nats] of matches by orientation and size under a pose.

    Args:
        map_: the map.
        features: the query's features.
        camera: its camera.
        T_map_camera: (4, 4) the pose.
        detections: (M,) rows of the features.
        landmarks: (M,) rows of the map's landmarks.

    Returns:
        (M,); NaN if the landmark's patch or the detection's orientation is unknown, all NaN if the map has no patches.
    """
    if map_.landmarks.patches is None:
        return np.full(len(detections), np.nan)
    angles, sizes_px = patch_appearance(
        camera, T_map_camera, map_.landmarks.positions[landmarks], map_.landmarks.patches[landmarks]
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        grown_octaves = np.log2(features.sizes[detections] / sizes_px)
    return turn_log_odds(features.angles[detections] - angles) + size_log_odds(grown_octaves)


def turn_log_odds(turned_rad: FloatArray) -> FloatArray:
    """Log-likelihood ratio (M,) [nats] of deviations [rad] from the predicted orientation; NaN for NaN.

    True matches follow a Cauchy distribution of half-width 8°, false ones a uniform one.
    """
    sharp = 2 / (_TURN_RAD * (1 + (_wrapped(turned_rad) / _TURN_RAD) ** 2))
    return np.asarray(np.log(_TRUE_SHARE * sharp + 1 - _TRUE_SHARE))


def size_log_odds(grown_octaves: FloatArray) -> FloatArray:
    """Log-likelihood ratio (M,) [nats] of deviations from the predicted size [octaves: log₂ of the ratio]; 0 if not
    finite.

    True matches follow a Cauchy distribution, false ones a Laplace distribution. Deviations beyond 2.5 octaves count as
    2.5.
    """
    known = np.isfinite(grown_octaves)
    grown = np.clip(np.where(known, grown_octaves, 0.0), -_MAX_OCTAVES, _MAX_OCTAVES)
    true = 1 / (np.pi * _SIZE_OCTAVES * (1 + (grown / _SIZE_OCTAVES) ** 2))
    false = np.exp(-np.abs(grown) / _CHANCE_OCTAVES) / (2 * _CHANCE_OCTAVES)
    return np.where(known, np.log(_TRUE_SHARE * true / false + 1 - _TRUE_SHARE), 0.0)


def patch_agreement(log_odds: FloatArray) -> float:
    """Mean of the finite log-likelihood ratios (M,) [nats per match] of a pose's inliers, shrunk towards 0 by three
    further matches of ratio 0.

    About 2 for a right pose, -1 for a wrong one. NaN if no ratio is known.
    """
    known = log_odds[np.isfinite(log_odds)]
    return float(known.sum() / (len(known) + _FEWEST)) if len(known) else np.nan


def _wrapped(angles_rad: FloatArray) -> FloatArray:
    """Angles wrapped to -π to π."""
    return np.asarray((angles_rad + np.pi) % (2 * np.pi) - np.pi)
