"""Assign the detections of registered views to landmarks of a map, or to new landmarks."""

import numpy as np

from rholoc.features.matching import LIMITS
from rholoc.geometry import IntArray
from rholoc.localization import Localizer
from rholoc.mapping.build.landmarks import Landmarks, are_stable, extend_and_merge, triangulate
from rholoc.mapping.build.reconstruction_cloud import cloud_of
from rholoc.mapping.build.tracks import Views, link_observations
from rholoc.maps import Cloud, Map
from rholoc.progress import ProgressListener, Stage

_FEATURES_PER_VIEW = 400
_RADIUS_PX = 5.0
_EXTENSION_ROUNDS = 1


def recognize(localizer: Localizer, views: Views, progress: ProgressListener) -> tuple[IntArray, Landmarks, Cloud]:
    """Assign N detections of posed views to the map's landmarks, and triangulate the others.

    A detection is recognized within 5 px of a landmark's projection if its descriptor is within the strict limit.

    Returns:
        Feature (N,) of the map for each detection, or -1; new landmarks, with labels (N,) of the same detections; and
        the other triangulated points, which are not stable enough for landmarks, as a cloud.
    """
    index, metric = localizer.index, localizer.extractor.metric
    labels = np.full(len(views.features), -1, dtype=np.int64)
    for k in range(len(views)):
        features = views.of_view(k)
        matches, _ = index.match_near(features, views.cameras[k], views.T_map_camera[k], _RADIUS_PX)
        alike = index.distances_to(features, matches.detections, matches.landmarks) <= LIMITS[metric].strict
        labels[views.offsets[k] + matches.detections[alike]] = matches.landmarks[alike]
        progress(Stage.OBSERVATIONS, 0.3 * (k + 1) / len(views), f"{k + 1} of {len(views)} views compared with the map")
    known_per_view = int(np.median(np.bincount(views.view_of[labels >= 0], minlength=len(views))))
    unknown = np.flatnonzero(labels < 0)
    others = Views.from_features(
        views.cameras,
        views.T_map_camera,
        views.times,
        [views.features.take(unknown[views.view_of[unknown] == k]) for k in range(len(views))],
    )
    fresh = triangulate(others, link_observations(others, metric, progress))
    for _ in range(_EXTENSION_ROUNDS):
        fresh = extend_and_merge(others, fresh, metric)
    stable = are_stable(others, fresh, max(0, _FEATURES_PER_VIEW - known_per_view))
    cloud = cloud_of(others, fresh, stable, np.zeros(len(views), dtype=np.int64))
    fresh = fresh.keep(stable)
    in_all = np.full(len(labels), -1, dtype=np.int64)
    in_all[unknown] = fresh.labels
    return labels, Landmarks(fresh.information, fresh.eta, in_all, fresh.positions, fresh.covariances), cloud


def seen_landmarks(known: Map, labels: IntArray, new: Landmarks) -> tuple[IntArray, Landmarks]:
    """All L landmarks that a recording saw: those of the map in ``labels`` (N,) (-1: none), then the ``new`` ones.

    Returns:
        Feature (L,) of the map for each landmark, -1 for a new one; and the landmarks. Information sums of the map's
        landmarks are 0.
    """
    again, number = np.unique(labels[labels >= 0], return_inverse=True)
    together = np.where(new.labels >= 0, new.labels + len(again), -1)
    together[labels >= 0] = number
    unknown = np.zeros((len(again), 3, 3))  # the sums are found anew when the maps are joined
    landmarks = Landmarks(
        np.concatenate([unknown, new.information]),
        np.concatenate([unknown[:, 0], new.eta]),
        together,
        np.concatenate([known.landmarks.positions[again].astype(np.float64), new.positions]),
        np.concatenate([known.landmarks.covariances[again].astype(np.float64), new.covariances]),
    )
    return np.concatenate([again, np.full(len(new), -1, dtype=np.int64)]), landmarks
