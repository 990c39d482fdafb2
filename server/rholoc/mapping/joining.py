"""Maps as sums: one joined to another in the same frame, one recording taken out again.

What a map has learned does not depend on the order of learning: A joined to B has the landmarks of B joined to A and
of both built at once, and a recording that is taken out leaves the landmarks of a map that never had it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rholoc.geometry import IntArray
from rholoc.mapping.memory import (
    DESCRIPTOR_SOURCES,
    PIXELS,
    VIEW_SOURCES,
    keep_features,
    observations_of,
    solve_landmarks,
    with_landmarks,
)
from rholoc.maps import Map


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
    _, _, determined = solve_landmarks(observations_of(joined), len(joined), counted)
    spoiled = np.flatnonzero(counted & ~determined)
    disbelieved = np.isin(same, spoiled[spoiled < len(a)])
    if disbelieved.any():
        joined = _joined(a, keep_features(b, ~disbelieved), same[~disbelieved])
        counted = np.zeros(len(joined), dtype=bool)
        counted[_numbers(a, same[~disbelieved])] = True
    return with_landmarks(joined, counted)


def without_source(map_: Map, source: int) -> Map:
    """The map, of ``ray`` form, without the recording in row ``source`` of its sources.

    Features that only it saw vanish.
    """
    views = np.repeat(np.arange(len(map_.view_times)), np.diff(map_.view_offsets))
    stays = map_.extras[VIEW_SOURCES] != source
    seen, described = stays[views], map_.extras[DESCRIPTOR_SOURCES] != source
    number = np.cumsum(stays) - 1
    touched = np.zeros(len(map_), dtype=bool)
    touched[map_.view_features[~seen]] = True

    def renumbered(sources: IntArray) -> IntArray:
        return (sources - (sources > source)).astype(np.int32)

    left = replace(
        map_,
        info=replace(map_.info, sources=tuple(one for row, one in enumerate(map_.info.sources) if row != source)),
        descriptors=map_.descriptors[described],
        descriptor_features=map_.descriptor_features[described],
        view_times=map_.view_times[stays],
        view_poses=map_.view_poses[stays],
        view_offsets=np.searchsorted(number[views[seen]], np.arange(int(stays.sum()) + 1)).astype(np.int32),
        view_features=map_.view_features[seen],
        extras=map_.extras
        | {
            PIXELS: map_.extras[PIXELS][seen],
            VIEW_SOURCES: renumbered(map_.extras[VIEW_SOURCES][stays]),
            DESCRIPTOR_SOURCES: renumbered(map_.extras[DESCRIPTOR_SOURCES][described]),
        },
    )
    return with_landmarks(left, touched)


def _numbers(a: Map, same: IntArray) -> IntArray:
    """The rows (F_b,) that the features of the second map get in the joined one."""
    new = same < 0
    return np.asarray(np.where(new, len(a) + np.cumsum(new) - 1, same))


def _joined(a: Map, b: Map, same: IntArray) -> Map:
    """All arrays of both; landmarks as they were."""
    numbers, new = _numbers(a, same), same < 0
    owners = np.concatenate([a.descriptor_features, numbers[b.descriptor_features]])
    order = np.argsort(owners, kind="stable")
    shift = len(a.info.sources)

    def both(name: str, added: int = 0) -> IntArray:
        return np.concatenate([a.extras[name], b.extras[name] + np.asarray(added, dtype=b.extras[name].dtype)])

    return replace(
        a,
        info=replace(a.info, sources=a.info.sources + b.info.sources, waypoints=a.info.waypoints + b.info.waypoints),
        channels=np.concatenate([a.channels, b.channels[new]]),
        landmarks=np.concatenate([a.landmarks, b.landmarks[new]]),
        covariances=np.concatenate([a.covariances, b.covariances[new]]),
        descriptors=np.concatenate([a.descriptors, b.descriptors])[order],
        descriptor_features=owners[order].astype(np.int32),
        view_times=np.concatenate([a.view_times, b.view_times]),
        view_poses=np.concatenate([a.view_poses, b.view_poses]),
        view_offsets=np.concatenate([a.view_offsets, a.view_offsets[-1] + b.view_offsets[1:]]),
        view_features=np.concatenate([a.view_features, numbers[b.view_features].astype(np.int32)]),
        extras={
            PIXELS: both(PIXELS),
            VIEW_SOURCES: both(VIEW_SOURCES, shift),
            DESCRIPTOR_SOURCES: both(DESCRIPTOR_SOURCES, shift)[order],
        },
    )
