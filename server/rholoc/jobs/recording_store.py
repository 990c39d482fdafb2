"""Recordings on disk: each a folder that is either complete or does not exist."""

from __future__ import annotations

import json
import os
import re
import shutil
import time
import uuid
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path, PurePosixPath
from typing import BinaryIO

from rholoc.disk import reporting_full_disk, sync_folder
from rholoc.errors import Conflict, InvalidRecording, TooLarge, UnknownRecording

ENTRY_FILE = ".entry.json"  # no uploaded file can have this name: theirs never start with a dot
_PENDING_PREFIX = ".pending-"
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
        files: the files' names, relative to the recording's folder, sorted.
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
        """How much has been written so far."""
        return self._size_bytes

    def write(self, name: str, chunk: bytes) -> None:
        """Append ``chunk`` to the file ``name``; an empty chunk makes an empty file.

        A name may have folders (``frames/0001.jpg``). Characters other than letters, digits, ``.``, ``_`` and ``-``
        become ``_``; parts such as ``..`` are dropped.

        Raises:
            TooLarge: the recording exceeds its limit.
            InvalidRecording: the name has no usable character, or two files would get the same one.
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
        """Where a file that was written is until the commit, completely flushed.

        Raises:
            StorageFull: the disk is full.
        """
        if self._open is not None:
            with reporting_full_disk():
                self._open[1].flush()
        return self._folder / sanitized(name)

    def commit(self) -> RecordingEntry:
        """Make the recording durable and visible, all at once.

        Raises:
            InvalidRecording: no file was written.
            StorageFull: the disk is full; nothing is left behind.
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
        if self._open is not None:
            file = self._open[1]
            file.flush()
            os.fsync(file.fileno())
            file.close()
            self._open = None


class RecordingStore:
    """The recordings under ``data_dir/recordings``."""

    def __init__(self, data_dir: Path) -> None:
        self.root = Path(data_dir) / "recordings"
        with reporting_full_disk():
            self.root.mkdir(parents=True, exist_ok=True)
        self._drop_abandoned()

    def begin(self, max_bytes: int | None = None) -> PendingRecording:
        """Begin an upload of at most ``max_bytes``.

        Raises:
            StorageFull: the disk is full.
        """
        return PendingRecording(self.root, max_bytes, self._publish)

    def create(self, files: Iterable[tuple[str, Iterable[bytes]]], max_bytes: int | None = None) -> RecordingEntry:
        """Store files, each a name and its chunks. If anything goes wrong, nothing is left behind.

        Raises: as :meth:`PendingRecording.write` and :meth:`PendingRecording.commit` do, and what ``files`` raises.
        """
        with self.begin(max_bytes) as pending:
            for name, chunks in files:
                pending.write(name, b"")
                for chunk in chunks:
                    pending.write(name, chunk)
            return pending.commit()

    @contextmanager
    def new_folder(self) -> Iterator[Path]:
        """A hidden folder beside the recordings, which is removed at the end unless it was renamed."""
        folder = self.root / f"{_PENDING_PREFIX}{uuid.uuid4().hex}"
        folder.mkdir(parents=True)
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def adopt(self, folder: Path, recording_id: str, file_name: str) -> RecordingEntry:
        """Turn a folder beside the recordings, which holds one complete file, into a recording; all at once.

        Raises:
            StorageFull: the disk is full; the folder stays where it is.
        """
        with reporting_full_disk(), (folder / file_name).open("rb") as file:
            os.fsync(file.fileno())
            entry = RecordingEntry(recording_id, (file_name,), os.fstat(file.fileno()).st_size, time.time())
            self._publish(folder, entry)
        return entry

    def get(self, recording_id: str) -> RecordingEntry:
        """The recording's entry.

        Raises:
            UnknownRecording: no recording has this id.
        """
        try:
            text = (self._folder(recording_id) / ENTRY_FILE).read_text(encoding="utf-8")
        except (FileNotFoundError, NotADirectoryError) as error:
            raise unknown_recording(recording_id) from error
        fields = json.loads(text)
        return RecordingEntry(**{**fields, "files": tuple(fields["files"])})

    def list(self) -> list[RecordingEntry]:
        """All recordings, the newest first."""
        entries = [self.get(folder.name) for folder in self._complete_folders()]
        return sorted(entries, key=lambda entry: entry.created, reverse=True)

    def path(self, recording_id: str) -> Path:
        """What :func:`rholoc.recordings.read_recording` takes: the only file (a video or a zip), or the folder.

        Raises:
            UnknownRecording: no recording has this id.
        """
        entry = self.get(recording_id)
        folder = self._folder(recording_id)
        return folder / entry.files[0] if len(entry.files) == 1 else folder

    def folder(self, recording_id: str) -> Path:
        """Where the recording's files are.

        Raises:
            UnknownRecording: no recording has this id.
        """
        self.get(recording_id)
        return self._folder(recording_id)

    def delete(self, recording_id: str) -> None:
        """Remove the recording.

        Raises:
            UnknownRecording: no recording has this id.
        """
        folder = self._folder(recording_id)
        doomed = self.root / f"{_PENDING_PREFIX}{uuid.uuid4().hex}"
        try:
            folder.rename(doomed)
        except FileNotFoundError as error:
            raise unknown_recording(recording_id) from error
        shutil.rmtree(doomed, ignore_errors=True)

    def sweep(self) -> None:
        """Remove what is stored and belongs to no recording: here, nothing that a start does not remove."""

    def release(self, recording_id: str) -> None:
        """Say that the recording's files are not needed here for now: what can be fetched again may go."""

    def share_notes(self, recording_id: str, files: Iterable[str]) -> None:
        """Say that these files beside the recording's own have changed, so that others see it elsewhere."""

    def _publish(self, folder: Path, entry: RecordingEntry) -> None:
        """Write the entry, make everything durable, and give the folder the name under which recordings are found."""
        with (folder / ENTRY_FILE).open("w", encoding="utf-8") as file:
            json.dump(asdict(entry), file)
            file.flush()
            os.fsync(file.fileno())
        for inner in {folder / Path(name).parent for name in entry.files}:
            sync_folder(inner)
        folder.rename(self.root / entry.id)
        sync_folder(self.root)

    def _folder(self, recording_id: str) -> Path:
        if not is_recording_id(recording_id):
            raise unknown_recording(recording_id)
        return self.root / recording_id

    def _complete_folders(self) -> Iterator[Path]:
        return (path for path in self.root.iterdir() if is_recording_id(path.name))

    def _drop_abandoned(self) -> None:
        """Remove uploads whose process died: an upload in progress is younger than a day."""
        for folder in self.root.glob(f"{_PENDING_PREFIX}*"):
            try:
                abandoned = time.time() - folder.stat().st_mtime > _PENDING_EXPIRES_S
            except FileNotFoundError:
                continue
            if abandoned:
                shutil.rmtree(folder, ignore_errors=True)


def is_recording_id(text: str) -> bool:
    """Whether the text could be a recording's id."""
    return _ID.fullmatch(text) is not None


def sanitized(name: str) -> str:
    """A relative path of plain, visible parts.

    Raises:
        InvalidRecording: nothing usable is left of the name, or it is too deep.
    """
    parts = (_UNSAFE.sub("_", part).lstrip(".")[-_MAX_NAME_LENGTH:] for part in name.replace("\\", "/").split("/"))
    kept = [part for part in parts if part.strip("_")]
    if not kept or len(kept) > _MAX_DEPTH:
        raise InvalidRecording(
            f"{name[:_MAX_NAME_LENGTH]!r} is not a valid file name.", "Use letters, digits, '.', '_' and '-'."
        )
    return str(PurePosixPath(*kept))


def unknown_recording(recording_id: str) -> UnknownRecording:
    return UnknownRecording(
        f"There is no recording {recording_id[:_MAX_NAME_LENGTH]!r}.", "Upload it, or list the recordings."
    )


def _close_quietly(file: BinaryIO) -> None:
    try:
        file.close()
    except OSError:
        return
