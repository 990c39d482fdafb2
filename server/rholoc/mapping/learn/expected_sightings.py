"""Expected sightings: which landmarks cameras at given poses should have seen, and which of them they saw.

Furniture that was moved is as rigid as the room: a picture that shows little else is localized by it, confidently and
wrongly. Cameras that are localized by other landmarks and look at its old place miss it. The majority agrees on what
stayed, so cameras that rely on landmarks missed by the others are dropped, the most contradicted first. Landmarks that
many cameras should have seen and did not have vanished.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from rholoc.features import FeatureSet
from rholoc.geometry import BoolArray, Camera, FloatArray, IntArray
from rholoc.localization.index.map_index import MapIndex

_RADIUS_PX = 6.0  # of a landmark's projection, within which it counts as seen
_EDGE_PX = 12.0  # of the picture, where nothing is missed
_VIEWS_ALIKE = 10
_MIN_ALIKE = 3  # of these that saw a landmark, for a camera to be expected to see it
_BY_CHANCE = 0.05  # probability that a landmark that is gone counts as seen
_MIN_RATE, _HIGHEST_RATE = 0.1, 0.95
_HIDING_PX, _HIDING_SHARE = 40.0, 0.8  # a landmark seen within this distance, at less than this depth ratio, hides
_MIN_SEEN = 12  # landmarks; a camera that sees fewer is no evidence
GONE_NATS = 4.0  # of evidence that a landmark is gone
_ROUNDS = 2  # of estimating the cameras' sighting rates and the landmarks' presence in turn
_TELLING_NATS = 1.0  # minimum absolute log-likelihood ratio for a landmark to count as known
_MAX_CONTRADICTED = 0.2  # share of the landmarks that a camera sees; noise alone stays below
_MISPLACED = 0.3  # maximum share of the cameras looking at a place that moved objects mislead
_MIN_TELLING = 10  # known landmarks: lower bound on the denominator of the contradicted share
_MIN_MISSES = 6
_MIN_OCCASIONS = 2


@dataclass(frozen=True, eq=False)
class Looked:
    """A camera at a known pose and its features.

    Attributes:
        camera: its intrinsics.
        T_map_camera: (4, 4).
        features: all its features.
        occasion: number of the occasion, equal for cameras that looked at the same time.
    """

    camera: Camera
    T_map_camera: FloatArray
    features: FeatureSet
    occasion: int


@dataclass(frozen=True, eq=False)
class Sights:
    """Expected sightings of F landmarks by C cameras, in S rows of one camera and one landmark.

    A camera with too few features to tell what is missing has no rows.

    Attributes:
        cameras: (S,) 0 to C-1, ascending.
        landmarks: (S,) 0 to F-1.
        chances: (S,) probability that the camera sees the landmark, according to the map's own views.
        seen: (S,) whether it did.
        occasions: (C,) occasion of each camera.
        landmark_count: F.
    """

    cameras: IntArray
    landmarks: IntArray
    chances: FloatArray
    seen: BoolArray
    occasions: IntArray
    landmark_count: int

    @property
    def camera_count(self) -> int:
        """Number C of cameras."""
        return len(self.occasions)

    @classmethod
    def of(cls, index: MapIndex, cameras: Sequence[Looked], recorded: BoolArray) -> Sights:
        """Expected sightings of some cameras.

        Each camera is expected to see what nearby views of the map saw, with the probability that they did. Landmarks
        hidden behind one that the camera saw are not expected.

        Args:
            index: index of the map.
            cameras: the cameras.
            recorded: (K,) mask of the views from recordings. For landmarks seen by recordings only these views count,
                because the others may have come after the landmark was gone.
        """
        by_recording = np.zeros(len(index.map), dtype=bool)
        by_recording[index.map.observations.features[recorded[index.map.observations.views]]] = True
        found = [_sight(index, one, recorded, by_recording) for one in cameras]
        counts = [len(landmarks) for landmarks, _, _ in found]
        landmarks, chances, seen = (np.concatenate(column) for column in zip(_NOTHING, *found, strict=True))
        occasions = np.array([one.occasion for one in cameras], dtype=np.int64)
        return cls(np.repeat(np.arange(len(cameras)), counts), landmarks, chances, seen, occasions, len(index.map))

    def evidence(self, believed: BoolArray, misplaced: float = 0.0) -> FloatArray:
        """Log-likelihood ratio (S,) [nats] of each row, of any camera, for its landmark being present. Which landmarks
        count as present while the cameras' rates are estimated is judged by the ``believed`` (C,) cameras.

        A present landmark is seen as often as by the map's views, reduced by the camera's overall rate of sightings, so
        a dark or blurred picture says little. An absent one is seen by chance, and by the share ``misplaced`` of
        cameras that were localized by that landmark itself.
        """
        nats: FloatArray = np.zeros(len(self.cameras))
        for _ in range(_ROUNDS):
            there = self.sums(nats, believed)[self.landmarks] > -GONE_NATS
            saw = np.bincount(self.cameras, self.seen & there, self.camera_count)
            should = np.bincount(self.cameras, self.chances * there, self.camera_count)
            rate = np.clip(self.chances * (saw / np.maximum(should, 1.0))[self.cameras], _MIN_RATE, _HIGHEST_RATE)
            if_gone = np.maximum(_BY_CHANCE, misplaced * rate)
            nats = np.where(self.seen, np.log(rate / if_gone), np.log((1 - rate) / (1 - if_gone)))
        return nats

    def sums(self, values: FloatArray | BoolArray, believed: BoolArray) -> FloatArray:
        """Sum (F,) of ``values`` (S,) over the ``believed`` (C,) cameras, per landmark."""
        counted = values * believed[self.cameras]
        return np.bincount(self.landmarks, counted, self.landmark_count).astype(np.float64)


_Sight = tuple[IntArray, FloatArray, BoolArray]  # landmarks, chances, whether seen
_NOTHING: _Sight = (np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0, dtype=bool))


def _sight(index: MapIndex, one: Looked, recorded: BoolArray, by_recording: BoolArray) -> _Sight:
    """As :func:`_expected`, without hidden landmarks; empty if the camera saw fewer than twelve landmarks."""
    landmarks, chances, seen = _expected(index, one, recorded, by_recording)
    if seen.sum() < _MIN_SEEN:
        return _NOTHING
    counts = np.flatnonzero(seen | ~_hidden(index, one, landmarks, seen))
    return landmarks[counts], chances[counts], seen[counts]


def _expected(index: MapIndex, one: Looked, recorded: BoolArray, by_recording: BoolArray) -> _Sight:
    """Landmarks (E,) that a camera should see, the probabilities (E,), and whether it saw them (E,), within 6 px.

    The probability is the share of the ten most similar views that saw the landmark; 0 if fewer than three did. For
    landmarks ``by_recording`` (F,) these are views ``recorded`` (K,), for other landmarks the other views. Landmarks
    within 12 px of the picture's edge are left out.
    """
    found, _ = index.match_near(one.features, one.camera, one.T_map_camera, _RADIUS_PX)
    saw = np.zeros(len(index.map), dtype=bool)
    saw[found.landmarks] = True
    votes = index.seen_by_views(found.landmarks)
    rates = np.zeros(len(index.map))
    for among, of in ((recorded, by_recording), (~recorded, ~by_recording)):
        alike = np.argsort(np.where(among, -votes, 1), kind="stable")[:_VIEWS_ALIKE]
        alike = alike[among[alike] & (votes[alike] > 0)]
        if len(alike) >= _MIN_ALIKE:
            counts: FloatArray = np.asarray(index.visibility[alike].sum(axis=0)).ravel()
            rates[of] = np.where(counts >= _MIN_ALIKE, counts / len(alike), 0.0)[of]
    landmarks = np.flatnonzero(rates > 0)
    T = one.T_map_camera
    pixels = one.camera.project((index.landmarks[landmarks] - T[:3, 3]) @ T[:3, :3])
    size = np.array([one.camera.width, one.camera.height])
    with np.errstate(invalid="ignore"):
        inside = ((pixels >= _EDGE_PX) & (pixels < size - _EDGE_PX)).all(axis=1)
    landmarks = landmarks[inside & index.present(T[:3, 3], landmarks)]
    return landmarks, rates[landmarks], saw[landmarks]


def _hidden(index: MapIndex, one: Looked, landmarks: IntArray, seen: BoolArray) -> BoolArray:
    """Mask (E,) of landmarks within 40 px of one that was ``seen`` (E,) at less than 0.8 × their depth."""
    T = one.T_map_camera
    in_camera = (index.landmarks[landmarks] - T[:3, 3]) @ T[:3, :3]
    pixels, depth = one.camera.project(in_camera), one.camera.depths(in_camera)
    near = cKDTree(pixels).sparse_distance_matrix(cKDTree(pixels[seen]), _HIDING_PX, output_type="ndarray")
    nearest = np.full(len(landmarks), np.inf)
    np.minimum.at(nearest, near["i"], depth[seen][near["j"]])
    return np.asarray(nearest < _HIDING_SHARE * depth)


def agreeing(sights: Sights, speaking: BoolArray) -> BoolArray:
    """Mask (C,) of all cameras that the witnesses do not contradict.

    A camera is contradicted if the witnesses miss more than a fifth of the landmarks that it sees. The witnesses are
    the cameras ``speaking`` (C,), without the most contradicted ones, removed one by one until all agree.
    """
    believed = speaking.copy()
    while True:
        contradicted = _contradicted(sights, believed)
        doubtful = believed & (contradicted > _MAX_CONTRADICTED)
        if not doubtful.any():
            return contradicted <= _MAX_CONTRADICTED
        believed[np.argmax(np.where(doubtful, contradicted, 0.0))] = False


def _contradicted(sights: Sights, believed: BoolArray) -> FloatArray:
    """Share (C,) of the landmarks seen by each camera that are gone by over 1 nat according to ``believed`` (C,).

    A camera's own sightings do not count. The share is of the landmarks known by over 1 nat, at least ten.
    """
    nats = sights.evidence(believed, _MISPLACED)
    of_others = sights.sums(nats, believed)[sights.landmarks] - nats * believed[sights.cameras]
    missed = np.bincount(sights.cameras, sights.seen & (of_others < -_TELLING_NATS), sights.camera_count)
    known = np.bincount(sights.cameras, sights.seen & (np.abs(of_others) > _TELLING_NATS), sights.camera_count)
    return np.asarray(missed / np.maximum(known, _MIN_TELLING))


def vanished(sights: Sights) -> BoolArray:
    """Mask (F,) of landmarks that are gone.

    Their absence explains the sightings better by ``GONE_NATS``, with at least six misses on at least two occasions.
    """
    everyone = np.ones(sights.camera_count, dtype=bool)
    nats = sights.sums(sights.evidence(everyone), everyone)
    pairs = np.column_stack([sights.landmarks, sights.occasions[sights.cameras]])[~sights.seen]
    misses = np.bincount(pairs[:, 0], minlength=sights.landmark_count)
    occasions = np.bincount(np.unique(pairs, axis=0)[:, 0], minlength=sights.landmark_count)
    return (nats <= -GONE_NATS) & (misses >= _MIN_MISSES) & (occasions >= _MIN_OCCASIONS)
