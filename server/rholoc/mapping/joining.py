"""Maps as sums: one joined to another in the same frame, one recording taken out again.

What a map has learned does not depend on the order of learning: A joined to B has the landmarks of B joined to A and
of both built at once, and a recording that is taken out leaves the landmarks of a map that never had it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rholoc.geometry import BoolArray, ByteArray, FloatArray, IntArray
from rholoc.mapping.assembly import DESCRIPTORS_PER_FEATURE
from rholoc.mapping.memory import (
    keep_features,
    observed_rays,
    solve_landmarks,
    with_landmarks,
)
from rholoc.maps import Cloud, Map, Observations, check_observations


def join(a: Map, b: Map, same: IntArray) -> Map:
    """``a`` with all that ``b`` remembers added to it; both are of ``ray`` form and in the frame of ``a``.

    Args:
        a: a map.
        b: another, of other recordings.
        same: (F_b,) for each feature of ``b`` the feature of ``a`` that it is, or -1 where it is new. Observations that
            would leave a landmark of ``a`` undetermined are not believed: they are left out.
    """
    joined = _joined(a, b, same)
    counted = np.zeros(len(joined), dtype=bool)
    counted[_numbers(a, same)] = True
    _, _, determined = solve_landmarks(observed_rays(joined), len(joined), counted)
    spoiled = np.flatnonzero(counted & ~determined)
    disbelieved = np.isin(same, spoiled[spoiled < len(a)])
    if disbelieved.any():
        joined = _joined(a, keep_features(b, ~disbelieved), same[~disbelieved])
        counted = np.zeros(len(joined), dtype=bool)
        counted[_numbers(a, same[~disbelieved])] = True
    return with_landmarks(joined, counted)


def without_source(map_: Map, source: int) -> Map:
    """The map, of ``ray`` form, without the recording in row ``source`` of its sources.

    Features that only it saw, or described, vanish.
    """
    observations = check_observations(map_, "The map")
    stays = observations.view_sources != source
    seen, described = stays[map_.observation_views], observations.descriptor_sources != source
    number = np.cumsum(stays) - 1
    touched = np.zeros(len(map_), dtype=bool)
    touched[map_.observation_features[~seen]] = True

    def renumbered(sources: IntArray) -> IntArray:
        return (sources - (sources > source)).astype(np.int32)

    left = replace(
        map_,
        info=replace(map_.info, sources=tuple(one for row, one in enumerate(map_.info.sources) if row != source)),
        descriptors=map_.descriptors[described],
        descriptor_features=map_.descriptor_features[described],
        view_times=map_.view_times[stays],
        T_map_camera=map_.T_map_camera[stays],
        view_covariances=None if map_.view_covariances is None else map_.view_covariances[stays],
        pictures=map_.pictures_of(stays),
        cloud=map_.cloud.without_source(source),
        observation_views=number[map_.observation_views[seen]].astype(np.int32),
        observation_features=map_.observation_features[seen],
        observations=Observations(
            observations.pixels[seen],
            renumbered(observations.view_sources[stays]),
            renumbered(observations.descriptor_sources[described]),
        ),
    )
    described_still = np.bincount(left.descriptor_features, minlength=len(left)) > 0
    return with_landmarks(keep_features(left, described_still), touched[described_still])


def with_sources_once(map_: Map) -> Map:
    """The map, its sources of one id taken together, as the first of them.

    Of the descriptors that they brought for a feature the last stay, as many as one source brings.
    """
    kept, sources = check_observations(map_, "The map"), map_.info.sources
    ids = [source.id for source in sources]
    first = np.array([ids.index(one) for one in ids])
    stays = np.unique(first)
    number = np.searchsorted(stays, first).astype(np.int32)
    view_sources, descriptor_sources = number[kept.view_sources], number[kept.descriptor_sources]
    latest = _latest(map_.descriptor_features, descriptor_sources)
    views = np.bincount(view_sources, minlength=len(stays)).tolist()
    return replace(
        map_,
        info=replace(
            map_.info, sources=tuple(replace(sources[row], views=n) for row, n in zip(stays, views, strict=True))
        ),
        descriptors=map_.descriptors[latest],
        descriptor_features=map_.descriptor_features[latest],
        cloud=replace(map_.cloud, sources=number[map_.cloud.sources]),
        observations=Observations(kept.pixels, view_sources, descriptor_sources[latest]),
    )


def _latest(features: IntArray, sources: IntArray) -> BoolArray:
    """Which descriptors (D,) are among the last that a source brought for a feature."""
    order = np.lexsort((np.arange(len(features)), sources, features))[::-1]
    starts = np.append(True, (np.diff(features[order]) != 0) | (np.diff(sources[order]) != 0))
    rank = np.arange(len(order)) - np.maximum.accumulate(np.where(starts, np.arange(len(order)), 0))
    latest = np.zeros(len(features), dtype=bool)
    latest[order[rank < DESCRIPTORS_PER_FEATURE]] = True
    return latest


def _numbers(a: Map, same: IntArray) -> IntArray:
    """The rows (F_b,) that the features of the second map get in the joined one."""
    new = same < 0
    return np.asarray(np.where(new, len(a) + np.cumsum(new) - 1, same))


def _joined(a: Map, b: Map, same: IntArray) -> Map:
    """All arrays of both; landmarks as they were."""
    numbers, new = _numbers(a, same), same < 0
    owners = np.concatenate([a.descriptor_features, numbers[b.descriptor_features]])
    order = np.argsort(owners, kind="stable")
    of_a, of_b = check_observations(a, "The map"), check_observations(b, "The map")
    shift, views = np.int32(len(a.info.sources)), np.int32(len(a.view_times))
    return replace(
        a,
        info=replace(a.info, sources=a.info.sources + b.info.sources, waypoints=a.info.waypoints + b.info.waypoints),
        channels=np.concatenate([a.channels, b.channels[new]]),
        landmarks=np.concatenate([a.landmarks, b.landmarks[new]]),
        covariances=np.concatenate([a.covariances, b.covariances[new]]),
        colours=_both_colours(a, b, new),
        patches=_both_patches(a, b, same),
        descriptors=np.concatenate([a.descriptors, b.descriptors])[order],
        descriptor_features=owners[order].astype(np.int32),
        view_times=np.concatenate([a.view_times, b.view_times]),
        T_map_camera=np.concatenate([a.T_map_camera, b.T_map_camera]),
        view_covariances=_both_covariances(a, b),
        pictures=_both_pictures(a, b),
        cloud=Cloud.joined(a.cloud, b.cloud.with_sources_after(len(a.info.sources))),
        observation_views=np.concatenate([a.observation_views, views + b.observation_views]),
        observation_features=np.concatenate([a.observation_features, numbers[b.observation_features].astype(np.int32)]),
        observations=Observations(
            np.concatenate([of_a.pixels, of_b.pixels]),
            np.concatenate([of_a.view_sources, of_b.view_sources + shift]),
            np.concatenate([of_a.descriptor_sources, of_b.descriptor_sources + shift])[order],
        ),
    )


def _both_patches(a: Map, b: Map, same: IntArray) -> FloatArray | None:
    """Of each feature the patch that ``a`` knows, else that of ``b``."""
    if a.patches is None and b.patches is None:
        return None
    known, other = a.known_patches.copy(), b.known_patches
    further = same >= 0
    further[further] = np.isnan(known[same[further], 0])
    known[same[further]] = other[further]
    return np.concatenate([known, other[same < 0]])


def _both_covariances(a: Map, b: Map) -> FloatArray | None:
    if a.view_covariances is None and b.view_covariances is None:
        return None
    return np.concatenate([a.known_view_covariances, b.known_view_covariances])


def _both_pictures(a: Map, b: Map) -> tuple[bytes, ...] | None:
    if a.pictures is None and b.pictures is None:
        return None
    return a.known_pictures + b.known_pictures


def _both_colours(a: Map, b: Map, new: BoolArray) -> ByteArray | None:
    if a.colours is None and b.colours is None:
        return None
    return np.concatenate([a.known_colours, b.known_colours[new]])
