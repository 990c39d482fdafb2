"""Whether what is matched is turned and as large as a pose foretells: evidence that descriptors leave out.

A descriptor is the same for every orientation and size, so that things are recognized from anywhere. Once it is known
from where, both are foretold, by the patch that a map keeps of each landmark. Of ten true matches eight are turned as
foretold and of that size; of false ones one is turned so, and a third are as large (the weak geometric consistency of
Jégou, Douze and Schmid, ECCV 2008, made exact by the pose).
"""

from __future__ import annotations

import numpy as np

from rholoc.features import FeatureSet
from rholoc.geometry import Camera, FloatArray, IntArray, patch_appearance
from rholoc.maps import Map

_TURN_RAD = np.deg2rad(8.0)  # half of the true matches are turned by no more from what is foretold
_SIZE_OCTAVES, _CHANCE_OCTAVES = 0.2, 0.8  # likewise of sizes; the mean deviation of false ones
_MOST_OCTAVES = 2.5  # beyond that sizes say no more
_TRUE_SHARE = 0.9  # of true matches: the others are as if by chance
_FEWEST = 3.0  # matches: of so few half is taken for chance


def patch_log_odds(
    map_: Map, features: FeatureSet, camera: Camera, T_map_camera: FloatArray, detections: IntArray, landmarks: IntArray
) -> FloatArray:
    """How much likelier pairs of detections (M,) and landmarks (M,) are true than not, by orientation and size.

    Returns:
        (M,) nats, as seen from a pose (4, 4); NaN where a patch or a detection's orientation is not known.
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
    """Nats (M,) for matches that are turned by so much from what is foretold; NaN where that is.

    True ones are spread as Cauchy has it, false ones evenly.
    """
    sharp = 2 / (_TURN_RAD * (1 + (_wrapped(turned_rad) / _TURN_RAD) ** 2))
    return np.asarray(np.log(_TRUE_SHARE * sharp + 1 - _TRUE_SHARE))


def size_log_odds(grown_octaves: FloatArray) -> FloatArray:
    """Nats (M,) for matches that are larger by so many octaves than what is foretold; 0 where that is not finite.

    True ones are spread as Cauchy has it, false ones as Laplace.
    """
    known = np.isfinite(grown_octaves)
    grown = np.clip(np.where(known, grown_octaves, 0.0), -_MOST_OCTAVES, _MOST_OCTAVES)
    true = 1 / (np.pi * _SIZE_OCTAVES * (1 + (grown / _SIZE_OCTAVES) ** 2))
    false = np.exp(-np.abs(grown) / _CHANCE_OCTAVES) / (2 * _CHANCE_OCTAVES)
    return np.where(known, np.log(_TRUE_SHARE * true / false + 1 - _TRUE_SHARE), 0.0)


def patch_agreement(log_odds: FloatArray) -> float:
    """What matches that agree with a pose say for it by orientation and size, of the log odds (M,) of each.

    Their mean, less where they are few: about 2 where it is right, -1 where it is not. NaN where none is known.
    """
    known = log_odds[np.isfinite(log_odds)]
    return float(known.sum() / (len(known) + _FEWEST)) if len(known) else np.nan


def _wrapped(angles_rad: FloatArray) -> FloatArray:
    """Angles from -π to π."""
    return np.asarray((angles_rad + np.pi) % (2 * np.pi) - np.pi)
