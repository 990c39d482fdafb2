"""Folders with the inputs of a worker's jobs, and with built files until they are published."""

import shutil
from collections.abc import Callable, Collection, Sequence
from pathlib import Path

from rholoc.disk import link_file, reporting_full_disk
from rholoc.jobs.job import JobKind
from rholoc.jobs.leases import Lease
from rholoc.jobs.table import JobWork
from rholoc.library.cameras import CameraLibrary, names_a_camera
from rholoc.library.map_folder import place_of
from rholoc.library.maps import MapLibrary
from rholoc.library.queries import QueryStore
from rholoc.library.recording_notes import READ_FILES, notes_in, write_notes
from rholoc.library.shared_maps import ActOnPublishing
from rholoc.library.sites import SiteLibrary
from rholoc.library.stores import CAMERAS, SITES, Stores
from rholoc.worker.pipeline import MappingTask

_WORK, _INPUTS, _NOTES, _MAP_FILE, _LINKS_FILE = "work", "inputs", "notes", "map.rho", "links.json"


class JobFolders:
    """The folders of a worker's jobs, and the libraries that jobs read and publish to.

    Each run of a job has a folder for its built file, so that the next worker on the same machine need not build again.

    Args:
        stores: where the inputs are.
        max_frame_pixels: upper bound on a video frame's pixels.
    """

    def __init__(self, stores: Stores, max_frame_pixels: int) -> None:
        self._stores = stores
        self._max_frame_pixels = max_frame_pixels

    def task(self, lease: Lease, work: JobWork, memory_bytes: float) -> MappingTask:
        """The job's task, granted ``memory_bytes``, its inputs fetched to this machine.

        Raises:
            UnknownRecording, UnknownMap, UnknownSite, UnknownCamera: an input was deleted.
            StorageUnavailable, StorageFull: inputs cannot be fetched.
        """
        folder = self._folder(lease)
        with reporting_full_disk():
            folder.mkdir(parents=True, exist_ok=True)
        needs_recording = work.options.kind.reads_recording
        if needs_recording:
            write_notes(folder / _NOTES, self._stores.recordings.notes(work.recording))
        return MappingTask(
            recording=self._stores.recordings.path(work.recording) if needs_recording else None,
            built_file=self.built_file(lease, work),
            maps_dir=self._inputs(lease, work),
            map_name=work.map_name,
            options=work.options,
            max_frame_pixels=self._max_frame_pixels,
            folder=folder / _NOTES if needs_recording else None,
            data_dir=folder / _INPUTS,
            memory_bytes=memory_bytes,
        )

    def built_file(self, lease: Lease, work: JobWork) -> Path:
        """Output file of a run. It exists only once it is complete."""
        return self._folder(lease) / (_MAP_FILE if work.options.site is None else _LINKS_FILE)

    def library(self, note: ActOnPublishing) -> MapLibrary:
        """The library to publish to, refreshed. ``note`` is called in each transaction that publishes to shared
        storage. Raises SQLAlchemyError.
        """
        self._stores.refresh()
        return self._stores.library_acting(note)

    def maps(self) -> MapLibrary:
        """The library of published maps."""
        return self._stores.library

    def sites(self) -> SiteLibrary:
        """The sites."""
        return SiteLibrary(self._stores.documents(SITES))

    def store_notes(self, lease: Lease, work: JobWork) -> None:
        """Store the notes that a run made on its recording, if any."""
        if work.recording:
            notes = notes_in(self._folder(lease) / _NOTES)
            self._stores.recordings.note(work.recording, {name: notes[name] for name in READ_FILES if name in notes})

    def release(self, work: JobWork) -> None:
        """Remove copies of the files of a job's recording."""
        self._stores.recordings.release(work.recording)

    def remove(self, lease: Lease) -> None:
        """Remove the folder of a run."""
        shutil.rmtree(self._folder(lease), ignore_errors=True)

    def clear(self, unfinished_runs: Callable[[], Collection[str]]) -> None:
        """Remove the folders of runs that have ended.

        Args:
            unfinished_runs: called after the folders were listed, so that the folder of a new run is not removed.
        """
        folders = list((self._stores.data_dir / _WORK).glob("*"))
        wanted = unfinished_runs()
        for folder in folders:
            if folder.name not in wanted:
                shutil.rmtree(folder, ignore_errors=True)

    def _folder(self, lease: Lease) -> Path:
        """Folder of a run, whether it exists or not."""
        return self._stores.data_dir / _WORK / lease.run

    def _inputs(self, lease: Lease, work: JobWork) -> Path:
        """Folder with the maps, the site, the camera and the queries that a job needs; raises the errors of
        :meth:`task`. If the job's file is built already, nothing is fetched.
        """
        self._stores.refresh()
        inputs = self._folder(lease) / _INPUTS
        inputs.mkdir(exist_ok=True)
        if self.built_file(lease, work).exists():
            return inputs
        if work.options.site is not None:
            site = self.sites().get(work.options.site)
            SiteLibrary(inputs).put(work.options.site, site)
            present = set(self._stores.library.names())
            self._link_maps([one.map for one in site.maps if one.map in present], inputs)
        elif work.options.kind is not JobKind.BUILD:
            self._link_maps([work.map_name], inputs)
        if work.options.kind is JobKind.LEARN:
            queries = QueryStore(self._stores.objects)
            queries.fetch(self._stores.library.map_id(work.map_name), inputs)
        if work.options.camera is not None and names_a_camera(work.options.camera):
            cameras = CameraLibrary(self._stores.documents(CAMERAS))
            CameraLibrary(inputs).put(work.options.camera, cameras.get(work.options.camera))
        return inputs

    def _link_maps(self, names: Sequence[str], folder: Path) -> None:
        """Link the files of the named maps into the folder, unless they are there. Raises UnknownMap, and the errors of
        :meth:`task`.
        """
        for name in names:
            if not (link := folder / place_of(name)).exists():
                link_file(self._stores.library.path(name), link)
