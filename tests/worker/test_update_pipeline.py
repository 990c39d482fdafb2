"""Updates as jobs: published once, atomically, and never over a change that they do not know of."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rholoc.errors import Conflict, MappingFailed, UnknownMap
from rholoc.jobs import JobKind, JobOptions
from rholoc.library.maps import MapLibrary
from rholoc.maps import Cloud, Map, Room
from rholoc.processes.limits import Limits
from rholoc.progress import silent
from rholoc.recordings import MemoryFrames, Recording
from rholoc.worker import pipeline
from rholoc.worker.pipeline import MappingPipeline, MappingTask


@pytest.fixture
def task(tmp_path: Path, point_room: Any, monkeypatch: pytest.MonkeyPatch) -> MappingTask:
    """An update of the map ``room``, whose recording needs no reading and is learned by counting the version up."""
    (tmp_path / "work").mkdir()
    MapLibrary(tmp_path / "maps").put("room", point_room.map_of(point_room.walk(60)[:30], "first"))
    recording = Recording(MemoryFrames([np.zeros((48, 64), np.uint8)] * 2), "walk", tmp_path)
    monkeypatch.setattr(pipeline, "read_recording", lambda *_args, **_options: recording)
    monkeypatch.setattr("rholoc.mapping.learn.from_recordings.update_map", lambda map_, *_: next_version(map_))
    options = JobOptions(kind=JobKind.UPDATE)
    return MappingTask(tmp_path / "walk.mp4", tmp_path / "work" / "map.rho", tmp_path / "maps", "room", options)


def next_version(map_: Map) -> Map:
    return replace(map_, info=replace(map_.info, version=map_.info.version + 1))


def test_an_update_takes_the_place_of_the_version_before_it_once(task: MappingTask) -> None:
    library, before = MapLibrary(task.maps_dir), MapLibrary(task.maps_dir).get("room")
    MappingPipeline().build(task, silent)
    assert library.get("room").info == before.info
    MappingPipeline().publish(task, MapLibrary(task.maps_dir))
    published = library.stat("room").signature
    assert library.get("room").info.version == before.info.version + 1
    MappingPipeline().build(task, silent)
    MappingPipeline().publish(task, MapLibrary(task.maps_dir))
    assert library.stat("room").signature == published


def test_an_update_of_a_map_that_changed_meanwhile_is_refused(task: MappingTask) -> None:
    library = MapLibrary(task.maps_dir)
    MappingPipeline().build(task, silent)
    changed = next_version(next_version(library.get("room")))
    library.put("room", changed)
    with pytest.raises(Conflict, match="changed in the meantime"):
        MappingPipeline().publish(task, MapLibrary(task.maps_dir))
    assert library.get("room").info.version == changed.info.version


def test_an_update_of_a_map_that_was_deleted_is_refused(task: MappingTask) -> None:
    MapLibrary(task.maps_dir).delete("room")
    with pytest.raises(UnknownMap):
        MappingPipeline().build(task, silent)
    assert not task.built_file.exists()


def test_a_recording_of_another_place_leaves_the_map(task: MappingTask, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> Map:
        raise MappingFailed("walk does not show the place of the map.")

    monkeypatch.setattr("rholoc.mapping.learn.from_recordings.update_map", refuse)
    before = save_state(task)
    with pytest.raises(MappingFailed):
        MappingPipeline().build(task, silent)
    assert save_state(task) == before
    assert not task.built_file.exists()


def save_state(task: MappingTask) -> bytes:
    return (task.maps_dir / "room.rho").read_bytes()


def test_a_room_that_is_drawn_is_put_into_the_published_map(
    task: MappingTask, point_room: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def draw(map_: Map, *_: object) -> Map:
        corners = Cloud(np.zeros((1, 3), np.float32), np.zeros((1, 3), np.uint8), np.zeros(1, np.int32))
        return replace(map_, room=Room(corners))

    monkeypatch.setattr(
        pipeline, "run_in_child", lambda function, *arguments, progress, **_: function(*arguments, silent)
    )
    MappingPipeline().build(task, silent)
    MappingPipeline().publish(task, MapLibrary(task.maps_dir))
    published = MapLibrary(task.maps_dir).get("room").info
    MappingPipeline().furnish(task, MapLibrary(task.maps_dir), lambda: None, Limits())  # the recording shows nothing
    assert len(MapLibrary(task.maps_dir).get("room").room) == 0
    monkeypatch.setattr("rholoc.mapping.room.drawing.draw_room", draw)
    MappingPipeline().furnish(task, MapLibrary(task.maps_dir), lambda: None, Limits())
    furnished = MapLibrary(task.maps_dir).get("room")
    assert (len(furnished.room), furnished.info) == (1, published)
