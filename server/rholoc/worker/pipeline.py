"""Steps of a job: build a map file from a recording, and publish it.

What makes maps is loaded where a job needs it: a worker that waits for jobs, or for their processes, keeps no solvers.
"""

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from rholoc.errors import InvalidMap, UnknownMap
from rholoc.jobs.job import JobKind, JobOptions, MoreMemoryNeeded, memory_for
from rholoc.library.cameras import CameraLibrary
from rholoc.library.maps import MapLibrary
from rholoc.library.queries import QueryStore
from rholoc.library.recording_notes import WAYPOINTS_FILE, notes_of, write_notes
from rholoc.maps import Map, load_map, save_map, trust_of
from rholoc.processes.child import run_in_child
from rholoc.processes.limits import Limits
from rholoc.processes.program import BACKGROUND_NICENESS
from rholoc.progress import ProgressListener, Stage, silent
from rholoc.recordings import MAX_FRAME_PIXELS, Recording, frame_pixels_limited, read_recording
from rholoc.storage import ObjectStorage
from rholoc.worker.site_placing import write_links


@dataclass(frozen=True)
class MappingTask:
    """One job's work.

    Attributes:
        recording: the uploaded file or folder; None if the job needs none.
        built_file: output of the build, a map or the links of a site. It exists only once it is complete.
        maps_dir: folder with the maps, cameras and sites that the build needs.
        map_name: name to publish the map under; empty if there is none.
        options: of the job.
        max_frame_pixels: maximum pixels of a video frame.
        folder: with notes on the recording, and waypoints that replace its own; None without a recording.
        data_dir: folder of the kept queries to learn from.
        memory_bytes: memory granted to the job.
    """

    recording: Path | None
    built_file: Path
    maps_dir: Path
    map_name: str
    options: JobOptions
    max_frame_pixels: int = MAX_FRAME_PIXELS
    folder: Path | None = None
    data_dir: Path | None = None
    memory_bytes: float = math.inf


class Pipeline(Protocol):
    """The steps of a job. The first two must be idempotent, because they may be repeated after a crash.

    ``build`` runs in a child process that may be killed at any time, so a pipeline must be picklable.
    """

    def build(self, task: MappingTask, progress: ProgressListener) -> MoreMemoryNeeded | None:
        """Write ``task.built_file``, atomically; do nothing if it exists.

        Returns:
            None; or the required memory if that exceeds ``task.memory_bytes``, and nothing was written.
        """
        ...

    def publish(self, task: MappingTask, library: MapLibrary) -> tuple[str, ...]:
        """Put ``task.built_file`` into the library, atomically; do nothing if it is there already.

        Returns:
            Why the map is not to be trusted, one line each.
        """
        ...

    def furnish(self, task: MappingTask, library: MapLibrary, check: Callable[[], object], limits: Limits) -> None:
        """Draw the room's surfaces and add them to the published map of ``task.built_file``.

        Does nothing if that map has changed meanwhile. Callers must catch errors: the map is as good without.

        Args:
            task: the work of a job whose map was published.
            library: the maps.
            check: called now and then; raises Cancelled if the worker must stop.
            limits: of the process that draws.
        """
        ...


class MappingPipeline:
    """The service's pipeline: recording → map → library; kept queries → the map's next version → library; or a site's
    maps → links, stored by :func:`rholoc.worker.site_placing.store_links`."""

    def build(self, task: MappingTask, progress: ProgressListener) -> MoreMemoryNeeded | None:
        """Read the recording, build its map or learn it into the existing one, and save the result.

        Reading the recording shows the required memory; if that is too much, the build ends.

        Raises the errors of :func:`rholoc.recordings.read_recording`, and of :func:`rholoc.mapping.build_map`,
        ``update_map``, ``learn_from_queries`` or :func:`rholoc.worker.site_placing.write_links`.
        """
        if task.built_file.exists():
            return None
        if task.options.kind is JobKind.PLACE:
            assert task.options.site is not None
            write_links(task.maps_dir, task.options.site, task.built_file, progress)
            return None
        built = _learned(task, progress) if task.options.kind is JobKind.LEARN else _mapped(task, progress)
        if isinstance(built, MoreMemoryNeeded):
            return built
        partial = task.built_file.with_name(f"{os.getpid()}-{task.built_file.name}")
        save_map(built, partial)
        partial.replace(task.built_file)
        return None

    def publish(self, task: MappingTask, library: MapLibrary) -> tuple[str, ...]:
        """Put the map into the library, unless it is already there. Returns the reasons not to trust its poses.

        Raises:
            Conflict: the map that was updated is no longer the one in the library.
            InvalidName, InvalidMap, StorageFull, InvalidInput: the map cannot be stored.
        """
        map_ = load_map(task.built_file)
        if _updates(task):
            library.replace(task.map_name, map_)
        elif _published_id(library, task.map_name) != map_.info.id:
            library.put_file(task.map_name, task.built_file)
        return doubts(map_)

    def furnish(self, task: MappingTask, library: MapLibrary, check: Callable[[], object], limits: Limits) -> None:
        """Draw the room's surfaces from the recording, in a child process, and put them into the map if there are any.

        Raises RholocError, such as Cancelled from ``check``, and the errors of :func:`run_in_child`.
        """
        furnished = task.built_file.with_name(f"room-{task.built_file.name}")
        draw = run_in_child(
            write_room, task, furnished, progress=silent, check=check, limits=limits, niceness=BACKGROUND_NICENESS
        )
        if draw:
            library.furnish(task.map_name, task.built_file, furnished)


def write_room(task: MappingTask, target: Path, progress: ProgressListener) -> bool:
    """Write the task's built map with the surfaces of its room to ``target``. Returns False, without a file, if there
    are none to draw.

    Raises the errors of :func:`read_recording`, and Cancelled.
    """
    from rholoc.mapping.room.drawing import draw_room

    map_ = load_map(task.built_file)
    drawn = draw_room(map_, [_recording_of(task)], progress)
    if drawn is map_:
        return False
    save_map(drawn, target)
    return True


def _mapped(task: MappingTask, progress: ProgressListener) -> Map | MoreMemoryNeeded:
    """The map built from the recording, or updated by it; or the memory it needs if that exceeds the task's."""
    progress(Stage.READ, 0.0, "reading the recording")
    recording = _recording_of(task)
    if task.folder is not None and task.options.frames is None and _corrected(task) is None:
        write_notes(task.folder, notes_of(recording))
    needed_bytes = memory_for(recording)
    if needed_bytes > task.memory_bytes:
        return MoreMemoryNeeded(needed_bytes)
    return _updated(task, recording, progress) if _updates(task) else _built(task, recording, progress)


def _recording_of(task: MappingTask) -> Recording:
    """The task's recording, with its camera, frames and corrected waypoints. Raises as :func:`read_recording`."""
    assert task.recording is not None
    camera = CameraLibrary(task.maps_dir).named_in(task.options.camera)
    with frame_pixels_limited(task.max_frame_pixels):
        return read_recording(
            task.recording, camera, task.options.frames, _corrected(task), workdir=task.built_file.parent
        )


def _learned(task: MappingTask, progress: ProgressListener) -> Map:
    """The published map after learning from its kept queries."""
    from rholoc.mapping.learn.from_queries import learn_from_queries

    assert task.data_dir is not None
    progress(Stage.READ, 0.0, "reading the queries")
    map_ = MapLibrary(task.maps_dir).get(task.map_name)
    return learn_from_queries(map_, QueryStore(ObjectStorage(task.data_dir)).load(map_.info.id), progress)


def _corrected(task: MappingTask) -> Path | None:
    """File of the waypoints that replace the recording's own; None if they were not corrected."""
    path = None if task.folder is None else task.folder / WAYPOINTS_FILE
    return path if path is not None and path.is_file() else None


def _updates(task: MappingTask) -> bool:
    """Whether the job makes the next version of a published map instead of a new one."""
    return task.options.kind is not JobKind.BUILD


def _built(task: MappingTask, recording: Recording, progress: ProgressListener) -> Map:
    """New map from the recording. Raises as :func:`build_map`."""
    from rholoc.mapping.build.pipeline import BuildOptions, build_map

    poses = task.options.poses or BuildOptions.poses
    options = BuildOptions(
        density=task.options.density, features=task.options.features, poses=poses, pictures=task.options.pictures
    )
    return build_map([recording], options, progress)


def _updated(task: MappingTask, recording: Recording, progress: ProgressListener) -> Map:
    """Next version of the published map, with the recording learned. Raises as :func:`update_map`."""
    from rholoc.mapping.learn.from_recordings import UpdateOptions, update_map

    map_ = MapLibrary(task.maps_dir).get(task.map_name)
    return update_map(map_, recording, UpdateOptions(task.options.poses, pictures=task.options.pictures), progress)


def doubts(map_: Map) -> tuple[str, ...]:
    """Reasons not to trust a map's frame poses; empty if they are trusted, or the map does not say."""
    trust = trust_of(map_.info)
    return tuple(f"The frame poses are not trusted: {why}" for why in trust.reasons if trust.trusted is False)


def _published_id(library: MapLibrary, name: str) -> str | None:
    """Id of the map in the library; None if there is none or it is damaged."""
    try:
        return library.get(name).info.id
    except (UnknownMap, InvalidMap):
        return None
