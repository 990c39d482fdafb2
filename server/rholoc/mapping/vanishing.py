"""Landmarks that are no longer there: many cameras should have seen them, and did not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from rholoc.features import FeatureSet
from rholoc.geometry import BoolArray, Camera, FloatArray, IntArray
from rholoc.localization.map_index import MapIndex

_RADIUS_PX = 6.0  # of a landmark's projection, within which it counts as seen
_EDGE_PX = 12.0  # of the picture, where nothing is missed
_VIEWS_ALIKE = 10
_FEWEST_ALIKE = 3  # of these that saw a landmark, for a camera to be expected to see it
_BY_CHANCE = 0.05  # how often a landmark that is gone is found all the same
_LEAST_RATE, _HIGHEST_RATE = 0.1, 0.95
_HIDING_PX, _HIDING_SHARE = 40.0, 0.8  # what is seen so close in the picture, and so much nearer, hides
_FEWEST_SEEN = 12  # landmarks, by a camera that is to say what is missing
_NATS = 4.0  # of evidence that a landmark is gone
_ROUNDS = 2  # how well a camera sees shows in what is there; what is there, in what cameras see
_FEWEST_MISSES = 6
_FEWEST_OCCASIONS = 2


@dataclass(frozen=True, eq=False)
class Looked:
    """A camera that looked at a map's place, and what it saw.

    Attributes:
        camera: its intrinsics.
        T_map_camera: (4, 4).
        features: all that it saw.
        occasion: what is the same for cameras that looked together, 0, 1, ….
    """

    camera: Camera
    T_map_camera: FloatArray
    features: FeatureSet
    occasion: int


def vanished(index: MapIndex, cameras: Sequence[Looked], recorded: BoolArray) -> BoolArray:
    """Which landmarks (F,) of a map are gone.

    Each camera is expected to see what the map's views saw that saw most of what it sees: with the probability that
    they did, times how much of all that is expected it sees; so a dim or a blurred picture says little. What is hidden
    behind something that the camera did see is not missed. A landmark is gone where being gone explains what was seen
    and missed better by a large factor, on several occasions.

    Args:
        index: of the map.
        cameras: that looked.
        recorded: (K,) which views are of recordings; landmarks that those saw are expected by those alone, for the
            others may have come after they were gone.
    """
    by_recording = np.zeros(len(index.map), dtype=bool)
    by_recording[index.map.observation_features[recorded[index.map.observation_views]]] = True
    sights = [sight for one in cameras if (sight := _sight(index, one, recorded, by_recording)) is not None]
    nats: FloatArray = np.zeros(len(index.map))
    for _ in range(_ROUNDS):
        nats = _evidence(sights, there=nats > -_NATS)
    misses, occasions = np.zeros(len(index.map), dtype=np.int64), np.zeros(len(index.map), dtype=np.int64)
    for occasion in {sight.occasion for sight in sights}:
        missed = [sight.missing for sight in sights if sight.occasion == occasion]
        for landmarks in missed:
            misses[landmarks] += 1
        occasions[np.unique(np.concatenate(missed))] += 1
    return (nats <= -_NATS) & (misses >= _FEWEST_MISSES) & (occasions >= _FEWEST_OCCASIONS)


@dataclass(frozen=True, eq=False)
class _Sight:
    """What a camera was expected to see.

    Attributes:
        landmarks: (E,) rows of the map.
        chances: (E,) how probably, by the map's own views.
        seen: (E,) whether it did.
        occasion: of the camera.
    """

    landmarks: IntArray
    chances: FloatArray
    seen: BoolArray
    occasion: int

    @property
    def missing(self) -> IntArray:
        """The landmarks that it did not see."""
        return self.landmarks[~self.seen]


def _evidence(sights: Sequence[_Sight], there: BoolArray) -> FloatArray:
    """Nats (F,) that each landmark is there; ``there`` (F,) are those by which is told how well a camera sees."""
    nats = np.zeros(len(there))
    for one in sights:
        sure = there[one.landmarks]
        share = one.seen[sure].sum() / max(one.chances[sure].sum(), 1.0)
        rate = np.clip(one.chances * share, _LEAST_RATE, _HIGHEST_RATE)
        nats[one.landmarks] += np.where(one.seen, np.log(rate / _BY_CHANCE), np.log((1 - rate) / (1 - _BY_CHANCE)))
    return nats


def _sight(index: MapIndex, one: Looked, recorded: BoolArray, by_recording: BoolArray) -> _Sight | None:
    """What a camera was expected to see and was not hidden from it; None where it sees too little to say."""
    landmarks, chances, seen = _expected(index, one, recorded, by_recording)
    if seen.sum() < _FEWEST_SEEN:
        return None
    counts = np.flatnonzero(seen | ~_hidden(index, one, landmarks, seen))
    return _Sight(landmarks[counts], chances[counts], seen[counts], one.occasion)


def _expected(
    index: MapIndex, one: Looked, recorded: BoolArray, by_recording: BoolArray
) -> tuple[IntArray, FloatArray, BoolArray]:
    """Landmarks (E,) that a camera should see, how probably (E,) by the map's own views, and whether it did (E,)."""
    found, _ = index.match_near(one.features, one.camera, one.T_map_camera, _RADIUS_PX)
    saw = np.zeros(len(index.map), dtype=bool)
    saw[found.landmarks] = True
    votes = index.seen_by_views(found.landmarks)
    rates = np.zeros(len(index.map))
    for among, of in ((recorded, by_recording), (~recorded, ~by_recording)):
        alike = np.argsort(np.where(among, -votes, 1), kind="stable")[:_VIEWS_ALIKE]
        alike = alike[among[alike] & (votes[alike] > 0)]
        if len(alike) >= _FEWEST_ALIKE:
            counts: FloatArray = np.asarray(index.visibility[alike].sum(axis=0)).ravel()
            rates[of] = np.where(counts >= _FEWEST_ALIKE, counts / len(alike), 0.0)[of]
    landmarks = np.flatnonzero(rates > 0)
    T = one.T_map_camera
    pixels = one.camera.project((index.landmarks[landmarks] - T[:3, 3]) @ T[:3, :3])
    size = np.array([one.camera.width, one.camera.height])
    with np.errstate(invalid="ignore"):
        inside = ((pixels >= _EDGE_PX) & (pixels < size - _EDGE_PX)).all(axis=1)
    landmarks = landmarks[inside & index.present(T[:3, 3], landmarks)]
    return landmarks, rates[landmarks], saw[landmarks]


def _hidden(index: MapIndex, one: Looked, landmarks: IntArray, seen: BoolArray) -> BoolArray:
    """Which landmarks (E,) lie behind one that was seen beside them in the picture."""
    T = one.T_map_camera
    in_camera = (index.landmarks[landmarks] - T[:3, 3]) @ T[:3, :3]
    pixels, depth = one.camera.project(in_camera), in_camera[:, 2]
    near = cKDTree(pixels).sparse_distance_matrix(cKDTree(pixels[seen]), _HIDING_PX, output_type="ndarray")
    nearest = np.full(len(landmarks), np.inf)
    np.minimum.at(nearest, near["i"], depth[seen][near["j"]])
    return np.asarray(nearest < _HIDING_SHARE * depth)
