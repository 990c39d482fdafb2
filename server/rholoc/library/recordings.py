"""Stored recordings: files in a storage, entries in the database. Each is complete or does not exist."""

from __future__ import annotations

import json
import os
import re
import shutil
import time
import uuid
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path, PurePosixPath
from typing import BinaryIO

import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError

from rholoc.disk import reporting_full_disk, temporary_folder
from rholoc.errors import (
    Conflict,
    InvalidRecording,
    MissingObject,
    StorageFull,
    StorageUnavailable,
    TooLarge,
    UnknownRecording,
)
from rholoc.library.recording_notes import NOTE_FILES, notes_in
from rholoc.storage.database import database_engine, read_rows, reporting_full_database
from rholoc.storage.objects import ObjectStorage, StoredObject
from rholoc.storage.tables import recording_notes_table, recordings_table

ENTRY_FILE = ".entry.json"  # no uploaded file can have this name: theirs never start with a dot
_PREFIX = "recordings"
_PENDING_PREFIX = ".pending-"
_ORPHANED_AFTER_S = 24 * 3600.0  # older uploads without an entry are abandoned
_PENDING_EXPIRES_S = 24 * 3600.0
_MAX_NAME_LENGTH = 100
_MAX_DEPTH = 4
_ID = re.compile(r"[0-9a-f]{32}")
_UNSAFE = re.compile(r"[^A-Za-z0-9._-]+")


@dataclass(frozen=True)
class RecordingEntry:
    """A stored recording.

    Attributes:
        id: unique, 32 hex digits.
        files: names relative to the recording's folder, sorted.
        size_bytes: the sum of the files' sizes.
        created: seconds since the epoch.
    """

    id: str
    files: tuple[str, ...]
    size_bytes: int
    created: float


class PendingRecording:
    """A recording that is being uploaded, in a hidden folder until :meth:`commit`.

    As a context manager it is discarded at the end, unless it was committed.
    """

    def __init__(self, root: Path, max_bytes: int | None, publish: Callable[[Path, RecordingEntry], None]) -> None:
        self.id = uuid.uuid4().hex
        self._publish = publish
        self._folder = root / f"{_PENDING_PREFIX}{self.id}"
        self._max_bytes = max_bytes
        self._sizes: dict[str, int] = {}
        self._given_names: dict[str, str] = {}
        self._open: tuple[str, BinaryIO] | None = None
        self._size_bytes = 0
        self._ended = False
        with reporting_full_disk():
            self._folder.mkdir(parents=True)

    def __enter__(self) -> PendingRecording:
        return self

    def __exit__(self, *_: object) -> None:
        self.abort()

    @property
    def size_bytes(self) -> int:
        """Bytes written so far."""
        return self._size_bytes

    def write(self, name: str, chunk: bytes) -> None:
        """Append ``chunk`` to the file ``name``; an empty chunk makes an empty file.

        A name may have folders (``frames/0001.jpg``). It is written as :func:`sanitized`: characters other than
        letters, digits, ``.``, ``_`` and ``-`` become ``_``; leading dots, and parts such as ``..``, are dropped.

        Raises:
            Conflict: the upload was committed or aborted.
            TooLarge: the recording exceeds its limit.
            InvalidRecording: the name has no usable character or more than four parts, two files would get the same
                one, or a file's name is a folder's.
            StorageFull: the disk is full.
        """
        if self._ended:
            raise Conflict("The upload has ended.", "Start a new one.")
        if self._max_bytes is not None and self.size_bytes + len(chunk) > self._max_bytes:
            raise TooLarge(
                f"The recording is larger than {self._max_bytes} bytes.",
                "Record a shorter walk, or raise the limit on uploads.",
            )
        safe = sanitized(name)
        if self._given_names.setdefault(safe, name) != name:
            raise InvalidRecording(f"Two files would both be called {safe}.", "Give every file its own plain name.")
        with reporting_full_disk():
            self._file(safe).write(chunk)
        self._sizes[safe] = self._sizes.get(safe, 0) + len(chunk)
        self._size_bytes += len(chunk)

    def path(self, name: str) -> Path:
        """Path of a written file before the commit, flushed.

        Raises:
            StorageFull: the disk is full.
        """
        if self._open is not None:
            with reporting_full_disk():
                self._open[1].flush()
        return self._folder / sanitized(name)

    def commit(self) -> RecordingEntry:
        """Make the recording durable and visible, atomically. Any failure but Conflict discards what was written.

        Raises:
            Conflict: it was committed or aborted before.
            InvalidRecording: no file was written.
            StorageFull, StorageUnavailable: it cannot be stored.
        """
        if self._ended:
            raise Conflict("The upload has ended.", "Start a new one.")
        if not self._sizes:
            self.abort()
            raise InvalidRecording(
                "The upload contains no file.", "Send a video, a zip, or the files of a recording, as file parts."
            )
        entry = RecordingEntry(self.id, tuple(sorted(self._sizes)), self.size_bytes, time.time())
        try:
            with reporting_full_disk():
                self._close_file()
                self._publish(self._folder, entry)
        except BaseException:
            self.abort()
            raise
        self._ended = True
        return entry

    def abort(self) -> None:
        """Discard what was written. Does nothing once the recording was committed or aborted."""
        if self._ended:
            return
        self._ended = True
        if self._open is not None:
            # Closing flushes, which fails again on a full disk; the file is about to be removed anyway.
            _close_quietly(self._open[1])
        shutil.rmtree(self._folder, ignore_errors=True)

    def _file(self, safe: str) -> BinaryIO:
        """The file of a sanitized name, open for appending; the one open before is synced and closed."""
        if self._open is None or self._open[0] != safe:
            self._close_file()
            path = self._folder / safe
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                self._open = (safe, path.open("ab"))
            except (FileExistsError, NotADirectoryError, IsADirectoryError) as error:
                raise InvalidRecording(
                    f"{safe} is both a file and a folder.", "Give every file its own plain name."
                ) from error
        return self._open[1]

    def _close_file(self) -> None:
        """Sync the open file to disk and close it, if there is one."""
        if self._open is not None:
            file = self._open[1]
            file.flush()
            os.fsync(file.fileno())
            file.close()
            self._open = None


class RecordingStore:
    """The recordings of all processes that share a storage and a database.

    A recording's files are the objects ``recordings/ID/NAME``. Unless the storage is ``data_dir`` itself, they are
    fetched to ``data_dir/recordings/ID`` when they are needed. A recording exists while the database has its row. Its
    entry, a hidden file beside its files, outlives the database; see :meth:`recover`.

    Args:
        data_dir: folder for unfinished uploads, and for copies of files.
        objects: the storage; default: ``data_dir``.
        engine: of the database; default: the SQLite file in ``data_dir``.
    """

    def __init__(self, data_dir: Path, objects: ObjectStorage | None = None, engine: sa.Engine | None = None) -> None:
        self.root = Path(data_dir) / _PREFIX
        with reporting_full_disk():
            self.root.mkdir(parents=True, exist_ok=True)
        self.objects = objects or ObjectStorage(Path(data_dir))
        self.engine = engine or database_engine(data_dir)
        self.in_place = self.objects.is_at(Path(data_dir))
        self._drop_abandoned()

    def begin(self, max_bytes: int | None = None) -> PendingRecording:
        """Begin an upload of at most ``max_bytes``.

        Raises:
            StorageFull: the disk is full.
        """
        return PendingRecording(self.root, max_bytes, self._publish)

    def create(self, files: Iterable[tuple[str, Iterable[bytes]]], max_bytes: int | None = None) -> RecordingEntry:
        """Store files, each a name and its chunks. After an error, nothing is left behind.

        Raises Conflict, TooLarge, InvalidRecording, StorageFull, StorageUnavailable, and the errors of ``files``.
        """
        with self.begin(max_bytes) as pending:
            for name, chunks in files:
                pending.write(name, b"")
                for chunk in chunks:
                    pending.write(name, chunk)
            return pending.commit()

    def new_folder(self) -> AbstractContextManager[Path]:
        """A hidden folder beside the recordings, which is removed at the end unless it was renamed."""
        return temporary_folder(self.root, _PENDING_PREFIX)

    def adopt(self, folder: Path, recording_id: str, file_name: str) -> RecordingEntry:
        """Turn a folder beside the recordings that holds one complete file into a recording, atomically.

        Raises:
            StorageUnavailable, StorageFull: the folder stays where it is.
        """
        with reporting_full_disk(), (folder / file_name).open("rb") as file:
            os.fsync(file.fileno())
            entry = RecordingEntry(recording_id, (file_name,), os.fstat(file.fileno()).st_size, time.time())
        self._publish(folder, entry)
        return entry

    def take_in(self, folder: Path, entry: RecordingEntry) -> None:
        """Store a copy of a recording from a folder elsewhere, which stays. Storing it again changes nothing.

        Raises:
            StorageUnavailable, StorageFull: it is not stored.
        """
        for name in entry.files:
            self.objects.put(_key(entry.id, name), folder / name)
        self._register(entry)

    def get(self, recording_id: str) -> RecordingEntry:
        """The recording's entry.

        Raises:
            UnknownRecording: no recording has this id.
        """
        if not is_recording_id(recording_id):
            raise unknown_recording(recording_id)
        wanted = sa.select(recordings_table).where(recordings_table.c.id == recording_id)
        rows = read_rows(self.engine, wanted)
        if not rows:
            raise unknown_recording(recording_id)
        return _entry(rows[0])

    def list(self) -> list[RecordingEntry]:
        """All recordings, the newest first."""
        wanted = sa.select(recordings_table).order_by(recordings_table.c.created.desc())
        return [_entry(row) for row in read_rows(self.engine, wanted)]

    def path(self, recording_id: str) -> Path:
        """Path for :func:`rholoc.recordings.read_recording`: the only file (a video or a ZIP file), or the folder.

        Raises:
            UnknownRecording: no recording has this id.
            StorageUnavailable, StorageFull: the files cannot be fetched.
        """
        entry = self.get(recording_id)
        folder = self.root / recording_id
        missing = [file for name in entry.files if not (file := folder / name).is_file()]
        for file in missing:
            with reporting_full_disk():
                file.parent.mkdir(parents=True, exist_ok=True)
            self.objects.fetch(_key(recording_id, file.relative_to(folder).as_posix()), file)
        size = sum((folder / name).stat().st_size for name in entry.files)
        if missing and size != entry.size_bytes:  # files kept here may have been repaired by hand
            self.release(recording_id)
            raise StorageUnavailable(
                f"The storage gave {size} bytes of a recording of {entry.size_bytes}.", "Try again later."
            )
        return folder / entry.files[0] if len(entry.files) == 1 else folder

    def notes(self, recording_id: str) -> dict[str, bytes]:
        """Content, by file name, of what jobs and people noted about a recording (:data:`NOTE_FILES`); empty without
        notes.

        Raises:
            UnknownRecording: no recording has this id.
        """
        self.get(recording_id)
        wanted = sa.select(recording_notes_table).where(recording_notes_table.c.recording == recording_id)
        return {row["file"]: bytes(row["content"]) for row in read_rows(self.engine, wanted)}

    def note(self, recording_id: str, files: Mapping[str, bytes | None]) -> None:
        """Store a recording's notes by file name, replacing these files; None deletes one. Raises StorageFull."""
        table = recording_notes_table
        with reporting_full_database(), self.engine.begin() as connection:
            for name, content in files.items():
                connection.execute(table.delete().where(table.c.recording == recording_id, table.c.file == name))
                if content is not None:
                    connection.execute(table.insert().values(recording=recording_id, file=name, content=content))

    def delete(self, recording_id: str) -> None:
        """Remove the recording.

        Raises:
            UnknownRecording: no recording has this id.
            StorageUnavailable: nothing was removed.
        """
        entry = self.get(recording_id)
        self.objects.delete(_key(recording_id, ENTRY_FILE))  # else the next sweep would bring the recording back
        with self.engine.begin() as connection:
            notes = recording_notes_table
            connection.execute(notes.delete().where(notes.c.recording == recording_id))
            connection.execute(recordings_table.delete().where(recordings_table.c.id == recording_id))
        shutil.rmtree(self.root / recording_id, ignore_errors=True)
        for name in entry.files:
            with suppress(StorageUnavailable):  # the next sweep removes the rest
                self.objects.delete(_key(recording_id, name))

    def release(self, recording_id: str) -> None:
        """Remove the copies of the recording's files in ``data_dir``, if they can be fetched again from the storage."""
        folder = self.root / recording_id
        is_copy = (
            not self.in_place and not (folder / ENTRY_FILE).exists()
        )  # an entry stands beside the files themselves
        if is_recording_id(recording_id) and is_copy:
            shutil.rmtree(folder, ignore_errors=True)

    def sweep(self) -> None:
        """:meth:`recover`, and remove files that have belonged to no recording for a day: of uploads that broke off.

        Raises:
            SQLAlchemyError, StorageUnavailable: it is done the next time.
        """
        old = time.time() - _ORPHANED_AFTER_S
        for recording_id, left in self.recover().items():
            if all(one.modified < old for one in left):
                for one in left:
                    self.objects.delete(one.key)
                self.release(recording_id)

    def recover(self) -> Mapping[str, Sequence[StoredObject]]:
        """Register recordings with an entry in the storage but not in the database, such as after its loss.

        Returns:
            The objects without an entry that belong to no recording, by the id in their keys.

        Raises:
            SQLAlchemyError, StorageUnavailable: it is done the next time.
        """
        stored = _by_recording(self.objects.list(_PREFIX))
        known = {entry.id: entry for entry in self.list()}  # after the listing, to include recordings stored since then
        left = {}
        for recording_id, objects in stored.items():
            has_entry = any(one.key == _key(recording_id, ENTRY_FILE) for one in objects)
            if recording_id in known and not has_entry:
                self._write_entry(known[recording_id])
            elif recording_id not in known and has_entry:
                self._recover(objects)
            elif recording_id not in known:
                left[recording_id] = objects
        return left

    def _recover(self, objects: Sequence[StoredObject]) -> None:
        """Register a recording, with its notes, from those of its stored objects that hold entry and notes."""
        with self.new_folder() as folder, suppress(MissingObject):  # it was deleted meanwhile
            for one in objects:
                name = one.key.rpartition("/")[2]
                if name in (ENTRY_FILE, *NOTE_FILES):
                    self.objects.fetch(one.key, folder / name)
            entry = entry_in(folder)
            self._register(entry)
            self.note(entry.id, notes_in(folder))

    def _publish(self, folder: Path, entry: RecordingEntry) -> None:
        """Move a folder's files to the storage, and register them. Raises StorageUnavailable, StorageFull."""
        self.objects.put_folder(f"{_PREFIX}/{entry.id}", folder, entry.files)
        try:
            self._register(entry)
        except StorageFull:
            for name in entry.files:
                self.objects.delete(_key(entry.id, name))
            raise

    def _register(self, entry: RecordingEntry) -> None:
        """Add a recording whose files are stored, unless another process has done so. Raises StorageFull. The row is
        written before the entry, so that :meth:`recover` cannot restore an upload reported as failed.
        """
        with reporting_full_database(), suppress(IntegrityError), self.engine.begin() as connection:
            connection.execute(recordings_table.insert().values(**asdict(entry)))
        with suppress(StorageUnavailable, StorageFull):  # the next sweep writes it
            self._write_entry(entry)

    def _write_entry(self, entry: RecordingEntry) -> None:
        """Store the hidden file with a recording's entry beside its files."""
        self.objects.put(_key(entry.id, ENTRY_FILE), json.dumps(asdict(entry)).encode())

    def _drop_abandoned(self) -> None:
        """Remove uploads older than a day, whose processes have died."""
        for folder in self.root.glob(f"{_PENDING_PREFIX}*"):
            try:
                abandoned = time.time() - folder.stat().st_mtime > _PENDING_EXPIRES_S
            except FileNotFoundError:
                continue
            if abandoned:
                shutil.rmtree(folder, ignore_errors=True)


def entry_in(folder: Path) -> RecordingEntry:
    """The entry in a recording's folder. Raises OSError, ValueError or KeyError if there is no valid one."""
    fields = json.loads((folder / ENTRY_FILE).read_text(encoding="utf-8"))
    return RecordingEntry(**{**fields, "files": tuple(fields["files"])})


def _by_recording(objects: Iterable[StoredObject]) -> dict[str, list[StoredObject]]:
    """Objects by the recording's id in their keys; without those of uploads in progress."""
    found: dict[str, list[StoredObject]] = {}
    for one in objects:
        recording_id = one.key.split("/")[1]
        if is_recording_id(recording_id):
            found.setdefault(recording_id, []).append(one)
    return found


def _entry(row: sa.RowMapping) -> RecordingEntry:
    """The entry in a row of the database."""
    return RecordingEntry(row["id"], tuple(row["files"]), row["size_bytes"], row["created"])


def _key(recording_id: str, name: str) -> str:
    """Key of the object with a recording's file ``name``."""
    return f"{_PREFIX}/{recording_id}/{name}"


def is_recording_id(text: str) -> bool:
    """Whether the text could be a recording's id: 32 hex digits."""
    return _ID.fullmatch(text) is not None


def sanitized(name: str) -> str:
    """A name as a relative path of plain, visible parts: other characters become "_", leading dots and empty parts go.

    Of a part the last 100 characters are kept.

    Raises:
        InvalidRecording: nothing usable is left of the name, or it has more than four parts.
    """
    parts = (_UNSAFE.sub("_", part).lstrip(".")[-_MAX_NAME_LENGTH:] for part in name.replace("\\", "/").split("/"))
    kept = [part for part in parts if part.strip("_")]
    if not kept or len(kept) > _MAX_DEPTH:
        raise InvalidRecording(
            f"{name[:_MAX_NAME_LENGTH]!r} is not a valid file name.", "Use letters, digits, '.', '_' and '-'."
        )
    return str(PurePosixPath(*kept))


def unknown_recording(recording_id: str) -> UnknownRecording:
    """Error for an id that no recording has."""
    return UnknownRecording(
        f"There is no recording {recording_id[:_MAX_NAME_LENGTH]!r}.", "Upload it, or list the recordings."
    )


def _close_quietly(file: BinaryIO) -> None:
    """Close a file, ignoring errors of the operating system."""
    try:
        file.close()
    except OSError:
        return
