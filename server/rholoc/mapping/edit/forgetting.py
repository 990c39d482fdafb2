"""Forget a recording: the map as if it had never been learned."""

from __future__ import annotations

from rholoc.errors import Conflict, InvalidInput
from rholoc.mapping.build.density_fitting import ray_form
from rholoc.mapping.edit.sources import without_source
from rholoc.mapping.edit.versions import as_learned
from rholoc.maps import Map, MapInfo, check_memory
from rholoc.reports import LearningReport


def forget_recording(map_: Map, recording: str) -> Map:
    """Next version of the map without what it learned from ``recording``, given by id or by an unambiguous name.

    Raises:
        InvalidInput: the map does not remember its observations, never learned the recording, or learned several of
            that name; lists those that it learned.
        Conflict: it learned nothing else.
    """
    check_memory(map_, "The map")
    row = _source_row(map_.info, recording)
    if len(map_.info.sources) == 1:
        raise Conflict(f"{recording} is the only recording in the map.", "Delete the map instead.")
    after = without_source(ray_form(map_), row)
    return as_learned(map_, after, LearningReport(map_.info.version + 1, forgotten=map_.info.sources[row].id))


def _source_row(info: MapInfo, recording: str) -> int:
    rows = [row for row, source in enumerate(info.sources) if source.id == recording]
    rows = rows or [row for row, source in enumerate(info.sources) if source.name == recording]
    sources = ", ".join(f"{source.name} ({source.id})" for source in info.sources)
    if not rows:
        raise InvalidInput(f"The map does not contain {recording}.", f"It contains: {sources}.")
    if len(rows) > 1:
        raise InvalidInput(f"The map contains {len(rows)} recordings named {recording}.", f"Give the id: {sources}.")
    return rows[0]
