"""Recordings that several servers and workers share: files in object storage, what they are in the database."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

import sqlalchemy as sa

from rholoc.disk import reporting_full_disk
from rholoc.errors import StorageUnavailable
from rholoc.jobs.recording_notes import NOTE_FILES
from rholoc.jobs.recording_store import RecordingEntry, RecordingStore, is_recording_id, unknown_recording
from rholoc.maps.files import replace_file
from rholoc.storage import ObjectStorage, SharedStorage
from rholoc.storage.tables import recording_notes_table, recordings_table

_PREFIX = "recordings"
_ORPHANED_AFTER_S = 24 * 3600.0  # an upload that takes longer has broken off


class SharedRecordingStore(RecordingStore):
    """What :class:`RecordingStore` does, for all servers and workers that share a storage.

    A recording's folder here holds what is noted beside its files, and the files themselves while a job reads them.
    """

    def __init__(self, data_dir: Path, shared: SharedStorage) -> None:
        super().__init__(data_dir)
        self._objects: ObjectStorage = shared.objects
        self._engine = shared.engine

    def get(self, recording_id: str) -> RecordingEntry:
        """The recording's entry. Raises UnknownRecording."""
        wanted = sa.select(recordings_table).where(recordings_table.c.id == recording_id)
        with self._engine.connect() as connection:
            row = connection.execute(wanted).mappings().first()
        if row is None:
            raise unknown_recording(recording_id)
        return _entry(row)

    def list(self) -> list[RecordingEntry]:
        """All recordings, the newest first."""
        with self._engine.connect() as connection:
            rows = connection.execute(sa.select(recordings_table).order_by(recordings_table.c.created.desc()))
            return [_entry(row) for row in rows.mappings()]

    def path(self, recording_id: str) -> Path:
        """As :meth:`RecordingStore.path`; the files are fetched where they are not here.

        Raises:
            UnknownRecording: no recording has this id.
            StorageUnavailable, StorageFull: they cannot be fetched.
        """
        entry, folder = self.get(recording_id), self.folder(recording_id)
        for name in entry.files:
            file = folder / name
            if not file.is_file():
                with reporting_full_disk():
                    file.parent.mkdir(parents=True, exist_ok=True)
                self._objects.fetch(_key(recording_id, name), file)
        size = sum((folder / name).stat().st_size for name in entry.files)
        if size != entry.size_bytes:
            self.release(recording_id)
            raise StorageUnavailable(
                f"The storage gave {size} bytes of a recording of {entry.size_bytes}.", "Try again later."
            )
        return folder / entry.files[0] if len(entry.files) == 1 else folder

    def folder(self, recording_id: str) -> Path:
        """Where what is noted beside the recording's files is, as it is now.

        Raises:
            UnknownRecording: no recording has this id.
        """
        self.get(recording_id)
        folder = self._folder(recording_id)
        wanted = sa.select(recording_notes_table).where(recording_notes_table.c.recording == recording_id)
        with self._engine.connect() as connection:
            notes = {row["file"]: bytes(row["content"]) for row in connection.execute(wanted).mappings()}
        with reporting_full_disk():
            folder.mkdir(parents=True, exist_ok=True)
            for name in NOTE_FILES:
                if name in notes:
                    _write(folder / name, notes[name])
                else:
                    (folder / name).unlink(missing_ok=True)
        return folder

    def share_notes(self, recording_id: str, files: Iterable[str]) -> None:
        """As :meth:`RecordingStore.share_notes`."""
        table, folder = recording_notes_table, self._folder(recording_id)
        with self._engine.begin() as connection:
            for name in files:
                connection.execute(table.delete().where(table.c.recording == recording_id, table.c.file == name))
                with suppress(FileNotFoundError):
                    content = (folder / name).read_bytes()
                    connection.execute(table.insert().values(recording=recording_id, file=name, content=content))

    def release(self, recording_id: str) -> None:
        """Remove the copies of the recording's files."""
        if is_recording_id(recording_id):
            shutil.rmtree(self._folder(recording_id), ignore_errors=True)

    def delete(self, recording_id: str) -> None:
        """Remove the recording.

        Raises:
            UnknownRecording: no recording has this id.
        """
        entry = self.get(recording_id)
        with self._engine.begin() as connection:
            notes = recording_notes_table
            connection.execute(notes.delete().where(notes.c.recording == recording_id))
            connection.execute(recordings_table.delete().where(recordings_table.c.id == recording_id))
        for name in entry.files:
            with suppress(StorageUnavailable):  # what is left is swept up
                self._objects.delete(_key(recording_id, name))
        self.release(recording_id)

    def sweep(self) -> None:
        """Remove the files from the storage of recordings that there are not: uploads and removals that broke off.

        Raises:
            SQLAlchemyError, StorageUnavailable: it is done the next time.
        """
        old = time.time() - _ORPHANED_AFTER_S
        stored = [one.key for one in self._objects.list(_PREFIX) if one.modified < old]
        known = {entry.id for entry in self.list()}
        for key in stored:
            if key.split("/")[1] not in known:
                self._objects.delete(key)

    def take_in(self, folder: Path, entry: RecordingEntry) -> None:
        """Store the files of a recording that is elsewhere now, and then its entry.

        Raises:
            StorageUnavailable, StorageFull: it is not stored.
        """
        for name in entry.files:
            self._objects.put(_key(entry.id, name), folder / name)
        with self._engine.begin() as connection:
            connection.execute(recordings_table.insert().values(**asdict(entry)))

    def _publish(self, folder: Path, entry: RecordingEntry) -> None:
        self.take_in(folder, entry)
        shutil.rmtree(folder, ignore_errors=True)


def _entry(row: sa.RowMapping) -> RecordingEntry:
    return RecordingEntry(row["id"], tuple(row["files"]), row["size_bytes"], row["created"])


def _key(recording_id: str, name: str) -> str:
    return f"{_PREFIX}/{recording_id}/{name}"


def _write(path: Path, content: bytes) -> None:
    """Replace a file, unless it is so already."""
    with suppress(FileNotFoundError):
        if path.read_bytes() == content:
            return
    replace_file(path, content)
