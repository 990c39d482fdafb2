"""Merge two maps of overlapping rooms."""

import uuid
from dataclasses import replace

import numpy as np
from scipy.sparse import coo_array

from rholoc.errors import Conflict, InvalidInput
from rholoc.features import FeatureSet
from rholoc.features.matching import LIMITS
from rholoc.geometry import Camera, IntArray, evenly, patch_appearance
from rholoc.localization import Localizer
from rholoc.mapping.build.density_fitting import ray_form
from rholoc.mapping.build.view_covariance import uncertainty_in
from rholoc.mapping.edit.moving import move_map
from rholoc.mapping.edit.sources import join, without_source
from rholoc.mapping.edit.versions import as_learned
from rholoc.mapping.learn.registration import LEARNING_RECOGNIZED, align_to_found, alignment_report, find_frames
from rholoc.maps import DensityKind, Map, check_memory, source_cameras
from rholoc.progress import ProgressListener, Stage, silent

_MAX_LOCALIZED = 60
_RADIUS_PX = 5.0
_MIN_VOTES = 2
_MIN_SHARE = 0.5  # of the times that two features could have been recognised as one


def merge_maps(a: Map, b: Map, progress: ProgressListener = silent) -> Map:
    """New map, with an id of its own, of everything that two maps have learned, in the frame of ``a``.

    The views that ``b`` remembers are localized in ``a``, which aligns the maps, rigidly if both are metric. Features
    within 5 px with similar descriptors are identified. A recording that both have learned counts once.

    Raises:
        InvalidInput: a map does not remember its observations, the features differ, or the densities are not ``ray``.
        Conflict: ``a`` has learned every recording that ``b`` has views of.
        MappingFailed: the maps do not overlap, or contradict each other; says by how much.
        Cancelled: ``progress`` asked to stop.
    """
    check_alike(a, b)
    shared = {source.id for source in a.info.sources}
    viewed = np.unique(check_memory(b, "The second map").view_sources)
    if all(b.info.sources[row].id in shared for row in viewed.tolist()):
        raise Conflict("The first map already contains all that the second does.", "There is nothing to merge.")
    b = _without_shared(ray_form(b), shared)
    localizer = Localizer(ray_form(a), min_recognized=LEARNING_RECOGNIZED)
    frames, own = remembered_frames(b), b.views.T_map_camera
    tried = evenly(len(frames), _MAX_LOCALIZED)
    found = find_frames(localizer, frames, tried, "The second map", progress)
    alignment = align_to_found(own, found, a.info.metric and b.info.metric, "The second map")
    moved = _placed_in(localizer.map, move_map(b, alignment.similarity))
    same = _same_features(localizer, moved, progress)
    merged = join(localizer.map, moved, same)
    progress(Stage.DENSITIES, 1.0, f"{len(merged)} features, {int((same >= 0).sum())} of them in both maps")
    report = replace(
        alignment_report(alignment, found),
        version=a.info.version + 1,
        merged=b.info.id,
        features_in_both=int((same >= 0).sum()),
        features_new=int((same < 0).sum()),
    )
    merged = as_learned(a, merged, report, progress)
    version = max(a.info.version, b.info.version) + 1
    return replace(merged, info=replace(merged.info, id=uuid.uuid4().hex, version=version))


def _placed_in(a: Map, b: Map) -> Map:
    """``b``, already in the frame of ``a``, with the covariances of ``a`` added to its own.

    Unchanged if ``b`` has none; NaN if only ``a`` has none.
    """
    if b.views.covariances is None:
        return b
    covariances = b.views.covariances + uncertainty_in(a, b.views.T_map_camera)
    return replace(b, views=replace(b.views, covariances=covariances))


def check_alike(a: Map, b: Map) -> None:
    """Check that views of one map can be found in the other and learned.

    Raises:
        InvalidInput: a map does not remember its observations, the features differ, or the densities are not ``ray``.
    """
    for map_, which in ((a, "The first map"), (b, "The second map")):
        check_memory(map_, which)
        if map_.info.density is not DensityKind.RAY:
            raise InvalidInput(
                f"{which} has {map_.info.density} densities, which cannot be merged.",
                "Build it with ray densities, and merge those.",
            )
    if a.info.features != b.info.features:
        raise InvalidInput(
            f"The maps have different features, {a.info.features} and {b.info.features}.", "Build both with the same."
        )


def _without_shared(map_: Map, shared: set[str | None]) -> Map:
    """The map without the recordings whose ids are in ``shared``."""
    rows = [row for row, source in enumerate(map_.info.sources) if source.id in shared]
    for row in reversed(rows):
        map_ = without_source(map_, row)
    return map_


def remembered_frames(map_: Map) -> list[tuple[Camera, FeatureSet]]:
    """Views that the map remembers, as cameras and features: the observed ones, each with its first descriptor and
    predicted patch.

    Raises:
        InvalidInput: the map does not remember its observations.
    """
    observations = check_memory(map_, "The map")
    first = np.searchsorted(map_.descriptors.features, np.arange(len(map_)))
    cameras, patches = source_cameras(map_.info), map_.landmarks.known_patches
    frames = []
    for k, source in enumerate(observations.view_sources):
        rows = slice(int(map_.view_offsets[k]), int(map_.view_offsets[k + 1]))
        features = map_.observations.features[rows]
        angles, sizes = patch_appearance(
            cameras[source], map_.views.T_map_camera[k], map_.landmarks.positions[features], patches[features]
        )
        seen = FeatureSet(
            observations.pixels[rows].astype(np.float32),
            map_.landmarks.channels[features],
            map_.descriptors.values[first[features]],
            np.nan_to_num(sizes).astype(np.float32),
            angles.astype(np.float32),
        )
        frames.append((cameras[source], seen))
    return frames


def _same_features(localizer: Localizer, moved: Map, progress: ProgressListener) -> IntArray:
    """Row (F_b,) of the same feature in the localizer's map for each feature of ``moved``, or -1; by votes of the
    views. At least two views, and half of those that found a match, must agree; no feature is taken twice.
    """
    index, metric = localizer.index, localizer.extractor.metric
    frames, poses = remembered_frames(moved), moved.views.T_map_camera
    pairs = [np.zeros((0, 2), dtype=np.int64)]
    for k, (camera, features) in enumerate(frames):
        matches, _ = index.match_near(features, camera, poses[k], _RADIUS_PX)
        alike = index.distances_to(features, matches.detections, matches.landmarks) <= LIMITS[metric].strict
        of_b = moved.observations.features[moved.view_offsets[k] + matches.detections[alike]]
        pairs.append(np.column_stack([of_b, matches.landmarks[alike]]))
        progress(Stage.OBSERVATIONS, (k + 1) / len(frames), f"{k + 1} of {len(frames)} views compared")
    voted = np.concatenate(pairs)
    votes = coo_array(
        (np.ones(len(voted), dtype=np.int64), (voted[:, 0], voted[:, 1])), shape=(len(moved), len(index.map))
    ).tocsr()
    votes.sum_duplicates()
    total = np.bincount(voted[:, 0], minlength=len(moved))
    entries = votes.tocoo()
    order = np.lexsort((entries.col, entries.row, -entries.data))
    same = np.full(len(moved), -1, dtype=np.int64)
    taken = np.zeros(len(index.map), dtype=bool)
    for entry in order.tolist():
        ours, theirs, count = entries.row[entry], entries.col[entry], entries.data[entry]
        enough = count >= _MIN_VOTES and count >= _MIN_SHARE * total[ours]
        if enough and same[ours] < 0 and not taken[theirs]:
            same[ours], taken[theirs] = theirs, True
    return same
