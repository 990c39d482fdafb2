"""Resumable uploads: pieces in the storage, offsets in the database.

An upload can continue at any server, and becomes a recording once complete.
"""

import shutil
import threading
import time
import uuid
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import sqlalchemy as sa

from rholoc.disk import reporting_full_disk, storage_full
from rholoc.errors import (
    Busy,
    Conflict,
    InvalidInput,
    InvalidRecording,
    RholocError,
    StorageUnavailable,
    TooLarge,
    UnknownJob,
    UnknownRecording,
)
from rholoc.jobs.job import Job, JobOptions
from rholoc.jobs.queue import JobQueue
from rholoc.library.recordings import RecordingStore, is_recording_id, sanitized, unknown_recording
from rholoc.recordings import MAX_FILES, START_BYTES, ZIP_SUFFIXES, check_archive, check_file_name, check_file_start
from rholoc.reports import report_from_json
from rholoc.storage.database import read_rows, reporting_full_database
from rholoc.storage.tables import upload_pieces_table, uploads_table

_PREFIX = "uploads"
MAX_UNFINISHED = 100
_RETRY_AFTER_S = 60.0


@dataclass(frozen=True)
class Upload:
    """State of an upload.

    Attributes:
        id: also of the later recording and job, 32 hex digits.
        length: size of the complete file [bytes].
        offset: number of bytes stored.
        expires: time of removal without further bytes [s since the epoch]; None once it is complete.
        job: the mapping job, once the upload is complete.
    """

    id: str
    length: int
    offset: int
    expires: float | None = None
    job: Job | None = None


@dataclass(frozen=True)
class _Plan:
    """Row of an upload: its offset, and the job to queue once it is complete."""

    id: str
    file_name: str
    length: int
    offset: int
    map_name: str
    options: JobOptions
    touched: float


@dataclass(frozen=True)
class _Piece:
    start: int
    size_bytes: int
    blob: str


class UploadStore:
    """Unfinished uploads of all processes that share a storage and a database.

    Args:
        recordings: store of complete uploads; its storage and database are used.
        jobs: queue for their jobs.
        expires_after_s: time without further bytes after which an upload is removed.
        max_files: maximum number of files in a ZIP file.
        max_unfinished: maximum number of unfinished uploads.
    """

    def __init__(
        self,
        recordings: RecordingStore,
        jobs: JobQueue,
        expires_after_s: float,
        max_files: int = MAX_FILES,
        max_unfinished: int = MAX_UNFINISHED,
    ) -> None:
        self._max_unfinished = max_unfinished
        self._max_files = max_files
        self._recordings = recordings
        self._objects, self._engine = recordings.objects, recordings.engine
        self._jobs = jobs
        self._expires_after_s = expires_after_s
        self._assembling = threading.Lock()

    def create(self, file_name: str, length: int, map_name: str, options: JobOptions) -> Upload:
        """Begin an upload of ``length`` bytes of a recording's file; its job will make ``map_name`` with ``options``.

        Raises:
            InvalidRecording: the name is not a recording's, or there is nothing to upload.
            StorageFull: the disk is full, or has too little room.
            Busy: the limit of unfinished uploads is reached.
        """
        safe = _plain_file_name(file_name, length)
        self._check_room()
        copies = 2 if self._recordings.in_place else 1  # pieces, and the file that they are put together to
        if shutil.disk_usage(self._recordings.root).free < copies * length:
            raise storage_full()
        upload_id, now = uuid.uuid4().hex, time.time()
        values = {"id": upload_id, "file_name": safe, "length": length, "offset": 0, "map_name": map_name}
        with reporting_full_database(), self._engine.begin() as connection:
            connection.execute(uploads_table.insert().values(**values, options=asdict(options), touched=now))
        return Upload(upload_id, length, 0, now + self._expires_after_s)

    def get(self, upload_id: str) -> Upload:
        """The upload's state. If it is complete but a server died before queueing its job, queue it now.

        Raises:
            UnknownRecording: no upload has this id, or it expired.
            InvalidRecording, TooLarge: it is complete, and its content is not a recording's. It is removed.
            StorageFull: the disk is full.
        """
        plan = self._plan(upload_id)
        if plan is None:
            return self._recorded(upload_id)
        expires = plan.touched + self._expires_after_s
        if plan.offset < plan.length:
            if expires < time.time():
                self._forget(upload_id)
                raise unknown_recording(upload_id)
            return Upload(upload_id, plan.length, plan.offset, expires)
        try:
            with self._assembling:
                self._assemble(plan)
        except (InvalidInput, TooLarge):  # not a recording
            self._forget(upload_id)
            raise
        self._jobs.submit(upload_id, plan.map_name, plan.options, job_id=upload_id)
        self._forget(upload_id)
        return self._recorded(upload_id)

    def append(self, upload_id: str, offset: int, data: bytes) -> Upload:
        """Store the bytes from ``offset`` on; the last ones make the upload a recording and queue its job.

        Raises:
            UnknownRecording: there is no upload with this id, or it expired.
            Conflict: ``offset`` is not the upload's.
            TooLarge: more bytes than were declared.
            InvalidRecording, TooLarge: the first bytes or the whole are not a recording's. The upload is removed.
            StorageFull: the disk is full. What was stored before is kept.
        """
        standing = self.get(upload_id)
        _check_room_for_bytes(standing, offset, len(data))
        _check_offset(standing.offset, offset)
        if not data:
            return standing
        if offset == 0 and len(data) >= START_BYTES:
            self._check_start_of(upload_id, data)
        blob = uuid.uuid4().hex
        self._objects.put(_key(upload_id, blob), data)
        if not self._take(upload_id, _Piece(offset, len(data), blob)):
            with suppress(StorageUnavailable):
                self._objects.delete(_key(upload_id, blob))
            _check_offset(self.get(upload_id).offset, offset)
        return self.get(upload_id)

    def delete(self, upload_id: str) -> None:
        """Remove an unfinished upload and its pieces.

        Raises:
            UnknownRecording: no unfinished upload has this id.
        """
        if self._plan(upload_id) is None:
            raise unknown_recording(upload_id)
        self._forget(upload_id)

    def sweep(self) -> None:
        """Remove expired uploads and their pieces, and queue the jobs of complete uploads without one. Raises
        StorageUnavailable.
        """
        ids = self.unfinished()
        for upload_id in ids:
            with suppress(RholocError):
                self.get(upload_id)
        old = time.time() - self._expires_after_s
        for one in list(self._objects.list(_PREFIX)):
            if one.modified < old and one.key.split("/")[1] not in ids:
                self._objects.delete(one.key)

    def unfinished(self) -> dict[str, str]:
        """Upload id → map name of the uploads without a job yet."""
        rows = read_rows(self._engine, sa.select(uploads_table.c.id, uploads_table.c.map_name))
        return {row["id"]: row["map_name"] for row in rows}

    def _check_room(self) -> None:
        """Raise Busy at the limit of unfinished uploads, after expired ones were removed."""
        if len(self.unfinished()) < self._max_unfinished:
            return
        self.sweep()
        if len(self.unfinished()) >= self._max_unfinished:
            hint = "Finish or abandon (DELETE) another upload, or try again later."
            raise Busy(f"There are {self._max_unfinished} unfinished uploads already.", hint, _RETRY_AFTER_S)

    def _plan(self, upload_id: str) -> _Plan | None:
        """Row of an unfinished upload; None if there is none. Raises UnknownRecording if the id cannot be one."""
        if not is_recording_id(upload_id):
            raise unknown_recording(upload_id)
        rows = read_rows(self._engine, sa.select(uploads_table).where(uploads_table.c.id == upload_id))
        return report_from_json(_Plan, dict(rows[0])) if rows else None

    def _recorded(self, upload_id: str) -> Upload:
        """State of an upload that has become a recording, with its job if it has one. Raises UnknownRecording."""
        entry = self._recordings.get(upload_id)
        try:
            job = self._jobs.get(upload_id)
        except UnknownJob:  # it was uploaded in another way
            job = None
        return Upload(upload_id, entry.size_bytes, entry.size_bytes, job=job)

    def _take(self, upload_id: str, piece: _Piece) -> bool:
        """Advance the upload by a piece, if that begins at its offset. Returns whether it does. Raises StorageFull."""
        stands = sa.and_(uploads_table.c.id == upload_id, uploads_table.c.offset == piece.start)
        values = {"offset": piece.start + piece.size_bytes, "touched": time.time()}
        with reporting_full_database(), self._engine.begin() as connection:
            if not connection.execute(uploads_table.update().where(stands).values(**values)).rowcount:
                return False
            connection.execute(upload_pieces_table.insert().values(upload=upload_id, **asdict(piece)))
        return True

    def _pieces(self, upload_id: str) -> Sequence[_Piece]:
        """The pieces of an upload, by their starts."""
        table = upload_pieces_table
        wanted = sa.select(table.c.start, table.c.size_bytes, table.c.blob).where(table.c.upload == upload_id)
        return [_Piece(**row) for row in read_rows(self._engine, wanted.order_by(table.c.start))]

    def _assemble(self, plan: _Plan) -> None:
        """Turn a complete upload into a recording, unless another server has done so.

        Raises:
            InvalidRecording, TooLarge: its content is not a recording's.
            StorageUnavailable, StorageFull: it is tried again at the next request.
        """
        with suppress(UnknownRecording):
            self._recordings.get(plan.id)
            return
        with reporting_full_disk(), self._recordings.new_folder() as folder:
            path = folder / plan.file_name
            self._fetch(plan, path)
            with path.open("rb") as file:
                check_file_start(path.name, file.read(START_BYTES))
            if path.suffix.lower() in ZIP_SUFFIXES:
                check_archive(path, max_files=self._max_files)
            self._recordings.adopt(folder, plan.id, plan.file_name)

    def _fetch(self, plan: _Plan, path: Path) -> None:
        """Write all pieces into one file. Raises StorageUnavailable if some are missing."""
        with path.open("wb") as file:
            for piece in self._pieces(plan.id):
                file.write(self._objects.read(_key(plan.id, piece.blob), 0, piece.size_bytes))
        if path.stat().st_size != plan.length:
            raise StorageUnavailable("The storage does not give all of the upload.", "Try again later.")

    def _check_start_of(self, upload_id: str, data: bytes) -> None:
        """Check an upload's first bytes against its file's name; refused uploads are forgotten."""
        plan = self._plan(upload_id)
        if plan is None:  # another request removed it
            raise unknown_recording(upload_id)
        try:
            check_file_start(plan.file_name, data[:START_BYTES])
        except RholocError:
            self._forget(upload_id)
            raise

    def _forget(self, upload_id: str) -> None:
        """Remove an upload and its pieces; pieces that the storage does not delete are left to :meth:`sweep`."""
        pieces = self._pieces(upload_id)
        with self._engine.begin() as connection:
            connection.execute(upload_pieces_table.delete().where(upload_pieces_table.c.upload == upload_id))
            connection.execute(uploads_table.delete().where(uploads_table.c.id == upload_id))
        for piece in pieces:
            with suppress(StorageUnavailable):  # what is left is swept up
                self._objects.delete(_key(upload_id, piece.blob))


def _plain_file_name(file_name: str, length: int) -> str:
    """The sanitized name of an uploaded file of ``length`` bytes. Raises InvalidRecording: its suffix is no
    recording's, or the file is empty.
    """
    safe = sanitized(file_name).rsplit("/", 1)[-1]
    check_file_name(safe)
    if length < 1:
        raise InvalidRecording(f"{safe} is empty.", "Record again.")
    return safe


def _check_room_for_bytes(standing: Upload, offset: int, count: int) -> None:
    """Raise TooLarge if ``count`` bytes at ``offset`` exceed the upload's declared length."""
    if offset + count > standing.length:
        raise TooLarge(
            f"More than the declared {standing.length} bytes.", "Start an upload that declares the whole size."
        )


def _check_offset(stands_at: int, offset: int) -> None:
    """Raise Conflict unless ``offset`` is where the upload stands."""
    if stands_at != offset:
        raise Conflict(
            f"The upload is at byte {stands_at}, not at {offset}.",
            "Ask for the offset with HEAD, and continue from there.",
        )


def _key(upload_id: str, blob: str) -> str:
    """Key of the object with a piece of an upload."""
    return f"{_PREFIX}/{upload_id}/{blob}"
