"""Maps as sums: join another map in the same frame, or take a recording out again (forget it).

The result does not depend on the order of learning: A joined with B has the same landmarks as B joined with A and as a
map built from both, and a map without a recording has the landmarks of a map that never had it.
"""

from dataclasses import replace
from typing import TypeVar

import numpy as np

from rholoc.errors import Conflict, InvalidInput
from rholoc.geometry import BoolArray, IntArray
from rholoc.mapping.build.assembly import DESCRIPTORS_PER_FEATURE
from rholoc.mapping.build.density_fitting import ray_form
from rholoc.mapping.build.stored_observations import (
    keep_features,
    keep_view_rows,
    observed_rays,
    solve_landmarks,
    with_landmarks,
)
from rholoc.mapping.edit.versions import as_learned
from rholoc.maps import Cloud, Map, MapDescriptors, MapInfo, MapLandmarks, MapObservations, MapViews, check_memory
from rholoc.reports import LearningReport

_Sourced = TypeVar("_Sourced", MapDescriptors, MapViews)


def join(a: Map, b: Map, same: IntArray) -> Map:
    """``a`` with everything that ``b`` remembers; both in ``ray`` form and in the frame of ``a``, whose version stays.

    Args:
        a: a map.
        b: a map of other recordings.
        same: (F_b,) row of the feature of ``a`` that each feature of ``b`` is, or -1 for a new one. Observations that
            would leave a landmark of ``a`` undetermined are dropped.
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
    """The map in ``ray`` form without the recording in row ``source``, and without features only it saw or described.
    Landmarks it saw are triangulated again.

    Raises:
        InvalidInput: the map does not remember its observations.
    """
    memory = check_memory(map_, "The map")
    seen = memory.view_sources[map_.observations.views] != source
    touched = np.zeros(len(map_), dtype=bool)
    touched[map_.observations.features[~seen]] = True
    left = keep_view_rows(map_, memory.view_sources != source)
    left = replace(
        left,
        info=replace(map_.info, sources=tuple(one for row, one in enumerate(map_.info.sources) if row != source)),
        descriptors=_without_source(map_.descriptors.take(memory.descriptor_sources != source), source),
        views=_without_source(left.views, source),
        cloud=map_.cloud.without_source(source),
        room=map_.room.without_source(source),
    )
    described_still = np.bincount(left.descriptors.features, minlength=len(left)) > 0
    return with_landmarks(keep_features(left, described_still), touched[described_still])


def _without_source(table: _Sourced, source: int) -> _Sourced:
    """A table without the number ``source``: its rows are gone already; higher numbers are lowered by one."""
    assert table.sources is not None
    return replace(table, sources=(table.sources - (table.sources > source)).astype(np.int32))


def with_sources_once(map_: Map) -> Map:
    """The map with sources of the same id merged into the first. A feature keeps the last two descriptors of each
    merged source.

    Raises:
        InvalidInput: the map does not remember its observations.
    """
    memory, sources = check_memory(map_, "The map"), map_.info.sources
    ids = [source.id for source in sources]
    first = np.array([ids.index(one) for one in ids])
    stays = np.unique(first)
    number = np.searchsorted(stays, first).astype(np.int32)
    descriptors = replace(map_.descriptors, sources=number[memory.descriptor_sources])
    views = replace(map_.views, sources=number[memory.view_sources])
    counts = np.bincount(number[memory.view_sources], minlength=len(stays)).tolist()
    return replace(
        map_,
        info=replace(
            map_.info, sources=tuple(replace(sources[row], views=n) for row, n in zip(stays, counts, strict=True))
        ),
        descriptors=descriptors.take(_latest(descriptors.features, number[memory.descriptor_sources])),
        views=views,
        cloud=map_.cloud.renumbered(number),
        room=replace(map_.room, vertices=map_.room.vertices.renumbered(number)),
    )


def _latest(features: IntArray, sources: IntArray) -> BoolArray:
    """Mask (D,) of the last ``DESCRIPTORS_PER_FEATURE`` descriptors of each source (D,) for each feature (D,)."""
    order = np.lexsort((np.arange(len(features)), sources, features))[::-1]
    starts = np.append(True, (np.diff(features[order]) != 0) | (np.diff(sources[order]) != 0))
    rank = np.arange(len(order)) - np.maximum.accumulate(np.where(starts, np.arange(len(order)), 0))
    latest = np.zeros(len(features), dtype=bool)
    latest[order[rank < DESCRIPTORS_PER_FEATURE]] = True
    return latest


def _numbers(a: Map, same: IntArray) -> IntArray:
    """Rows (F_b,) of the second map's features in the joined map: ``same`` (F_b,), or for -1 new ones after ``a``."""
    new = same < 0
    return np.asarray(np.where(new, len(a) + np.cumsum(new) - 1, same))


def _joined(a: Map, b: Map, same: IntArray) -> Map:
    """Map of the rows of both maps, ``a`` first, the landmarks' positions unchanged. ``same`` (F_b,): features of
    ``a``, or -1 for new ones.
    """
    numbers, views = _numbers(a, same).astype(np.int32), np.int32(len(a.views))
    of_b, first_source = check_memory(b, "The map"), np.int32(len(a.info.sources))
    descriptors = MapDescriptors.concat(
        [
            a.descriptors,
            replace(
                b.descriptors,
                features=numbers[b.descriptors.features],
                sources=of_b.descriptor_sources + first_source,
            ),
        ]
    )
    numbers_of_b = np.arange(len(b.info.sources), dtype=np.int32) + len(a.info.sources)
    seen_by_b = replace(b.observations, views=views + b.observations.views, features=numbers[b.observations.features])
    return replace(
        a,
        info=replace(a.info, sources=a.info.sources + b.info.sources, waypoints=a.info.waypoints + b.info.waypoints),
        landmarks=MapLandmarks.concat([_with_patches(a, b, same), b.landmarks.take(same < 0)]),
        descriptors=descriptors.take(np.argsort(descriptors.features, kind="stable")),
        views=MapViews.concat([a.views, replace(b.views, sources=of_b.view_sources + first_source)]),
        observations=MapObservations.concat([a.observations, seen_by_b]),
        cloud=Cloud.joined(a.cloud, b.cloud.renumbered(numbers_of_b)),
        room=a.room.joined(replace(b.room, vertices=b.room.vertices.renumbered(numbers_of_b))),
    )


def _with_patches(a: Map, b: Map, same: IntArray) -> MapLandmarks:
    """Landmarks of ``a``, with missing patches taken from ``b``. ``same`` (F_b,) is the row in ``a`` of each landmark
    of ``b``, or -1 if ``a`` lacks it.
    """
    if b.landmarks.patches is None:
        return a.landmarks
    patches = a.landmarks.known_patches.copy()
    further = same >= 0
    further[further] = np.isnan(patches[same[further], 0])
    patches[same[further]] = b.landmarks.patches[further]
    return replace(a.landmarks, patches=patches)


def forget_recording(map_: Map, recording: str) -> Map:
    """Next version of the map without what it learned from ``recording``, given by id or by an unambiguous name.

    Raises:
        InvalidInput: the map does not remember its observations, never learned the recording, or learned several of
            that name; lists those that it learned.
        Conflict: it has views of no other recording.
    """
    memory = check_memory(map_, "The map")
    row = _source_row(map_.info, recording)
    if (memory.view_sources == row).all():
        raise Conflict(f"{recording} is the only recording in the map that has views.", "Delete the map instead.")
    after = without_source(ray_form(map_), row)
    return as_learned(map_, after, LearningReport(map_.info.version + 1, forgotten=map_.info.sources[row].id))


def _source_row(info: MapInfo, recording: str) -> int:
    """Row of the source with this id, else with this name. Raises InvalidInput for none or several."""
    rows = [row for row, source in enumerate(info.sources) if source.id == recording]
    rows = rows or [row for row, source in enumerate(info.sources) if source.name == recording]
    sources = ", ".join(f"{source.name} ({source.id})" for source in info.sources)
    if not rows:
        raise InvalidInput(f"The map does not contain {recording}.", f"It contains: {sources}.")
    if len(rows) > 1:
        raise InvalidInput(f"The map contains {len(rows)} recordings named {recording}.", f"Give the id: {sources}.")
    return rows[0]
