"""Uploads that go on at whichever server they reach: pieces in object storage, how far they are in the database."""

from __future__ import annotations

import time
import uuid
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError

from rholoc.disk import reporting_full_disk
from rholoc.errors import InvalidInput, RholocError, StorageUnavailable, TooLarge, UnknownRecording
from rholoc.jobs.job import JobOptions
from rholoc.jobs.queue import JobQueue
from rholoc.jobs.recording_store import is_recording_id, unknown_recording
from rholoc.jobs.shared_recordings import SharedRecordingStore
from rholoc.jobs.upload_store import (
    MAX_UNFINISHED,
    Upload,
    UploadStore,
    check_offset,
    check_room_for_bytes,
    plain_file_name,
)
from rholoc.recordings import MAX_FILES, START_BYTES, ZIP_SUFFIX, check_archive, check_file_start
from rholoc.storage import SharedStorage
from rholoc.storage.tables import upload_pieces_table, uploads_table

_PREFIX = "uploads"


@dataclass(frozen=True)
class _Plan:
    """What to do with an upload once it is complete, and how far it is."""

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


class SharedUploadStore(UploadStore):
    """What :class:`UploadStore` does, for all servers that share a storage."""

    def __init__(
        self,
        recordings: SharedRecordingStore,
        jobs: JobQueue,
        shared: SharedStorage,
        expires_after_s: float,
        max_files: int = MAX_FILES,
        max_unfinished: int = MAX_UNFINISHED,
    ) -> None:
        super().__init__(recordings, jobs, expires_after_s, max_files, max_unfinished)
        self._objects = shared.objects
        self._engine = shared.engine

    def create(self, file_name: str, length: int, map_name: str, options: JobOptions) -> Upload:
        """As :meth:`UploadStore.create`."""
        safe = plain_file_name(file_name, length)
        self._check_room()
        upload_id, now = uuid.uuid4().hex, time.time()
        values = {"id": upload_id, "file_name": safe, "length": length, "offset": 0, "map_name": map_name}
        with self._engine.begin() as connection:
            connection.execute(uploads_table.insert().values(**values, options=asdict(options), touched=now))
        return Upload(upload_id, length, 0, now + self._expires_after_s)

    def get(self, upload_id: str) -> Upload:
        """As :meth:`UploadStore.get`."""
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
            self._assemble(plan)
        except (InvalidInput, TooLarge):  # it is no recording
            self._forget(upload_id)
            raise
        self._jobs.submit(upload_id, plan.map_name, plan.options, job_id=upload_id)
        self._forget(upload_id)
        return self._recorded(upload_id)

    def append(self, upload_id: str, offset: int, data: bytes) -> Upload:
        """As :meth:`UploadStore.append`."""
        standing = self.get(upload_id)
        check_room_for_bytes(standing, offset, len(data))
        check_offset(standing.offset, offset)
        if not data:
            return standing
        if offset == 0 and len(data) >= START_BYTES:
            self._check_start_of(upload_id, data)
        blob = uuid.uuid4().hex
        self._objects.put(_key(upload_id, blob), data)
        if not self._take(upload_id, _Piece(offset, len(data), blob)):
            with suppress(StorageUnavailable):
                self._objects.delete(_key(upload_id, blob))
            check_offset(self.get(upload_id).offset, offset)
        return self.get(upload_id)

    def delete(self, upload_id: str) -> None:
        """As :meth:`UploadStore.delete`."""
        if self._plan(upload_id) is None:
            raise unknown_recording(upload_id)
        self._forget(upload_id)

    def sweep(self) -> None:
        """Remove the uploads that expired; those that are whole but have no job get it."""
        with self._engine.connect() as connection:
            ids = connection.execute(sa.select(uploads_table.c.id)).scalars().all()
        for upload_id in ids:
            with suppress(RholocError):
                self.get(upload_id)
        old = time.time() - self._expires_after_s
        for one in list(self._objects.list(_PREFIX)):
            if one.modified < old and one.key.split("/")[1] not in ids:
                self._objects.delete(one.key)

    def unfinished(self) -> dict[str, str]:
        """As :meth:`UploadStore.unfinished`."""
        with self._engine.connect() as connection:
            rows = connection.execute(sa.select(uploads_table.c.id, uploads_table.c.map_name))
            return {row.id: row.map_name for row in rows}

    def _unfinished(self) -> int:
        with self._engine.connect() as connection:
            return connection.execute(sa.select(sa.func.count()).select_from(uploads_table)).scalar_one()

    def _plan(self, upload_id: str) -> _Plan | None:
        if not is_recording_id(upload_id):
            raise unknown_recording(upload_id)
        with self._engine.connect() as connection:
            row = connection.execute(sa.select(uploads_table).where(uploads_table.c.id == upload_id)).mappings().first()
        return None if row is None else _Plan(**{**row, "options": JobOptions.from_json(row["options"])})

    def _take(self, upload_id: str, piece: _Piece) -> bool:
        """Count a piece in, if the upload still stands where it begins."""
        stands = sa.and_(uploads_table.c.id == upload_id, uploads_table.c.offset == piece.start)
        values = {"offset": piece.start + piece.size_bytes, "touched": time.time()}
        with self._engine.begin() as connection:
            if not connection.execute(uploads_table.update().where(stands).values(**values)).rowcount:
                return False
            connection.execute(upload_pieces_table.insert().values(upload=upload_id, **asdict(piece)))
        return True

    def _pieces(self, upload_id: str) -> Sequence[_Piece]:
        table = upload_pieces_table
        wanted = sa.select(table.c.start, table.c.size_bytes, table.c.blob).where(table.c.upload == upload_id)
        with self._engine.connect() as connection:
            return [_Piece(**row) for row in connection.execute(wanted.order_by(table.c.start)).mappings()]

    def _assemble(self, plan: _Plan) -> None:
        """Make a whole upload a recording, unless another server has done so.

        Raises:
            InvalidRecording, TooLarge: its content is no recording's.
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
            if path.suffix.lower() == ZIP_SUFFIX:
                check_archive(path, max_files=self._max_files)
            with suppress(IntegrityError):  # another server was quicker
                self._recordings.adopt(folder, plan.id, plan.file_name)

    def _fetch(self, plan: _Plan, path: Path) -> None:
        part = path.with_name(".part")
        with path.open("wb") as file:
            for piece in self._pieces(plan.id):
                self._objects.fetch(_key(plan.id, piece.blob), part)
                file.write(part.read_bytes())
        part.unlink(missing_ok=True)
        if path.stat().st_size != plan.length:
            raise StorageUnavailable("The storage does not give all of the upload.", "Try again later.")

    def _check_start_of(self, upload_id: str, data: bytes) -> None:
        plan = self._plan(upload_id)
        if plan is None:  # another request gave it up
            raise unknown_recording(upload_id)
        try:
            check_file_start(plan.file_name, data[:START_BYTES])
        except RholocError:
            self._forget(upload_id)
            raise

    def _forget(self, upload_id: str) -> None:
        """Remove an upload and its pieces."""
        pieces = self._pieces(upload_id)
        with self._engine.begin() as connection:
            connection.execute(upload_pieces_table.delete().where(upload_pieces_table.c.upload == upload_id))
            connection.execute(uploads_table.delete().where(uploads_table.c.id == upload_id))
        for piece in pieces:
            with suppress(StorageUnavailable):  # what is left is swept up
                self._objects.delete(_key(upload_id, piece.blob))


def _key(upload_id: str, blob: str) -> str:
    return f"{_PREFIX}/{upload_id}/{blob}"
