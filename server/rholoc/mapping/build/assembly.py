"""Assemble views and landmarks into a map."""

import numpy as np

from rholoc.features import Metric
from rholoc.geometry import (
    ByteArray,
    FloatArray,
    IntArray,
    mean_patches,
    patch_vectors,
    poses_from_rows,
    rows_from_poses,
)
from rholoc.mapping.build.landmarks import Landmarks, representative_rows
from rholoc.mapping.build.tracks import Views
from rholoc.maps import (
    Map,
    MapDescriptors,
    MapInfo,
    MapLandmarks,
    MapObservations,
    MapViews,
    packed_pixels,
    storable_patches,
    unpacked_pixels,
)

DESCRIPTORS_PER_FEATURE = 2


def assemble(info: MapInfo, views: Views, landmarks: Landmarks, view_sources: IntArray, metric: Metric) -> Map:
    """Map with ``ray`` densities from views and landmarks. Every landmark must have observations.

    Pixels, poses and patches are rounded as in files, so that a map read back learns like the one that was built. Each
    recording contributes its own descriptors of a feature, so that it can be forgotten.

    Args:
        info: description of the map.
        views: K views.
        landmarks: F landmarks and their detections in the views.
        view_sources: (K,) row of ``info.sources`` for each view.
        metric: metric of the descriptors.
    """
    observed = landmarks.observed_rows
    features, of_view = landmarks.labels[observed], views.view_of[observed]
    pixels = np.zeros((len(observed), 2))
    for k, camera in enumerate(views.cameras):
        mine = np.flatnonzero(of_view == k)
        pixels[mine] = unpacked_pixels(packed_pixels(views.features.pixels[observed[mine]], camera), camera)
    owners, rows = _descriptor_rows(views, landmarks, view_sources, metric)
    channels = np.zeros(len(landmarks), dtype=np.uint8)
    channels[features] = views.features.channels[observed]
    return Map(
        info=info,
        landmarks=MapLandmarks(
            channels=channels,
            positions=landmarks.positions.astype(np.float32),
            covariances=landmarks.covariances.astype(np.float32),
            colours=(
                None
                if views.features.colours is None
                else mean_colours(views.features.colours[observed], features, len(landmarks))
            ),
            patches=_patches(views, landmarks),
        ),
        descriptors=MapDescriptors(
            values=views.features.descriptors[rows],
            features=owners.astype(np.int32),
            sources=view_sources[views.view_of[rows]].astype(np.int32),
        ),
        views=MapViews(
            times=views.times.astype(np.float64),
            T_map_camera=poses_from_rows(rows_from_poses(views.T_map_camera).astype(np.float32)),
            sources=view_sources.astype(np.int32),
        ),
        observations=MapObservations(
            of_view.astype(np.int32),
            features.astype(np.int32),
            pixels,
            None if np.isnan(views.ranges_m).all() else views.ranges_m[observed].astype(np.float32),
        ),
    )


def mean_colours(seen: ByteArray, features: IntArray, count: int) -> ByteArray:
    """Mean colour (count, 3) of each feature over observations of ``features`` (V,) in colours (V, 3); 0 without."""
    sums = [np.bincount(features, weights=seen[:, channel], minlength=count) for channel in range(3)]
    counts = np.maximum(np.bincount(features, minlength=count), 1)
    return np.asarray(np.round(np.column_stack(sums) / counts[:, None]).astype(np.uint8))


def _patches(views: Views, landmarks: Landmarks) -> FloatArray | None:
    """Mean patch (F, 3) of each landmark over its observations; None if no observation has one."""
    features, vectors = views.features, np.full((len(landmarks.labels), 3), np.nan)
    for k, camera in enumerate(views.cameras):
        here = np.arange(views.offsets[k], views.offsets[k + 1])
        rows = here[landmarks.labels[here] >= 0]
        seen = landmarks.positions[landmarks.labels[rows]]
        vectors[rows] = patch_vectors(camera, views.T_map_camera[k], seen, features.angles[rows], features.sizes[rows])
    observed = landmarks.observed_rows
    return storable_patches(mean_patches(vectors[observed], landmarks.labels[observed], len(landmarks)))


def _descriptor_rows(
    views: Views, landmarks: Landmarks, view_sources: IntArray, metric: Metric
) -> tuple[IntArray, IntArray]:
    """Feature (D,) of each descriptor, ascending, and the detection (D,) it is copied from."""
    labels = landmarks.labels
    sources = view_sources[views.view_of]
    owners, rows = [], []
    for source in np.unique(view_sources):
        mine = np.where(sources == source, labels, -1)
        chosen = representative_rows(views, mine, len(landmarks), metric, DESCRIPTORS_PER_FEATURE)
        owners.append(np.repeat(np.arange(len(landmarks)), [len(one) for one in chosen]))
        rows.append(np.concatenate(chosen))
    owner, row = np.concatenate(owners), np.concatenate(rows)
    order = np.argsort(owner, kind="stable")
    return owner[order], row[order]
