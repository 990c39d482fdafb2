"""Views and landmarks → the arrays of a map."""

from __future__ import annotations

import numpy as np

from rholoc.features import Metric
from rholoc.geometry import IntArray
from rholoc.mapping.landmarks import Landmarks, representative_rows
from rholoc.mapping.memory import DESCRIPTOR_SOURCES, PIXELS, VIEW_SOURCES, packed_pixels, packed_poses
from rholoc.mapping.observations import Views
from rholoc.maps import Map, MapInfo

_DESCRIPTORS_PER_FEATURE = 2


def assemble(info: MapInfo, views: Views, landmarks: Landmarks, view_sources: IntArray, metric: Metric) -> Map:
    """The map, of ``ray`` form, of landmarks that are all observed; its memory included.

    Every recording that saw a feature brings its own descriptors for it, so that each can be forgotten.

    Args:
        info: the map's description.
        views: K views.
        landmarks: F landmarks and which detections of the views are theirs.
        view_sources: (K,) the row of ``info.sources`` that each view comes from.
        metric: how descriptors are compared.
    """
    observed = landmarks.observed_rows
    features, of_view = landmarks.labels[observed], views.view_of[observed]
    packed = np.concatenate(
        [packed_pixels(views.features.pixels[observed[of_view == k]], views.cameras[k]) for k in range(len(views))]
    )
    owners, rows = _descriptor_rows(views, landmarks, view_sources, metric)
    channels = np.zeros(len(landmarks), dtype=np.uint8)
    channels[features] = views.features.channels[observed]
    upper = np.triu_indices(3)
    return Map(
        info=info,
        channels=channels,
        landmarks=landmarks.positions.astype(np.float32),
        covariances=landmarks.covariances[:, upper[0], upper[1]].astype(np.float32),
        descriptors=views.features.descriptors[rows],
        descriptor_features=owners.astype(np.int32),
        view_times=views.times.astype(np.float64),
        view_poses=packed_poses(views.T_map_camera),
        view_offsets=np.searchsorted(of_view, np.arange(len(views) + 1)).astype(np.int32),
        view_features=features.astype(np.int32),
        extras={
            PIXELS: packed,
            VIEW_SOURCES: view_sources.astype(np.int32),
            DESCRIPTOR_SOURCES: view_sources[views.view_of[rows]].astype(np.int32),
        },
    )


def _descriptor_rows(
    views: Views, landmarks: Landmarks, view_sources: IntArray, metric: Metric
) -> tuple[IntArray, IntArray]:
    """The feature (D,) of each descriptor, rising, and the detection (D,) that it is taken from."""
    labels = landmarks.labels
    sources = view_sources[views.view_of]
    owners, rows = [], []
    for source in np.unique(view_sources):
        mine = np.where(sources == source, labels, -1)
        chosen = representative_rows(views, mine, len(landmarks), metric, _DESCRIPTORS_PER_FEATURE)
        owners.append(np.repeat(np.arange(len(landmarks)), [len(one) for one in chosen]))
        rows.append(np.concatenate(chosen))
    owner, row = np.concatenate(owners), np.concatenate(rows)
    order = np.argsort(owner, kind="stable")
    return owner[order], row[order]
