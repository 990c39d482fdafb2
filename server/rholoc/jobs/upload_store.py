"""Uploads that survive lost connections: files that grow piece by piece, and become recordings once complete."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from io import RawIOBase
from pathlib import Path

from rholoc.disk import reporting_full_disk, storage_full
from rholoc.errors import Busy, Conflict, InvalidRecording, RholocError, TooLarge, UnknownJob
from rholoc.jobs.job import Job, JobOptions
from rholoc.jobs.queue import JobQueue
from rholoc.jobs.recording_store import RecordingStore, is_recording_id, sanitized, unknown_recording
from rholoc.recordings import MAX_FILES, START_BYTES, ZIP_SUFFIX, check_archive, check_file_name, check_file_start

_PREFIX = ".upload-"
MAX_UNFINISHED = 100
_RETRY_AFTER_S = 60.0
_LOCK_TIMEOUT_S = 2.0
_LOCK_POLL_S = 0.02
_PLAN_FILE = ".upload.json"  # no uploaded file can have this name: theirs never start with a dot


@dataclass(frozen=True)
class Upload:
    """Where an upload stands.

    Attributes:
        id: the id of the recording and of the job that it becomes, 32 hex digits.
        length: the size of the complete file in bytes.
        offset: how many of them are stored.
        expires: when an upload without further bytes is removed, seconds since the epoch; None once it is complete.
        job: the mapping job, once the upload is complete.
    """

    id: str
    length: int
    offset: int
    expires: float | None = None
    job: Job | None = None


@dataclass(frozen=True)
class _Plan:
    """What to do with an upload once it is complete."""

    file_name: str
    length: int
    map_name: str
    options: JobOptions


class UploadStore:
    """Unfinished uploads, each a hidden folder beside the recordings.

    The length of the file is the offset, so that no crash can make the two differ. Any number of processes may share
    the folder.
    """

    def __init__(
        self,
        recordings: RecordingStore,
        jobs: JobQueue,
        expires_after_s: float,
        max_files: int = MAX_FILES,
        max_unfinished: int = MAX_UNFINISHED,
    ) -> None:
        """Open the store.

        Args:
            recordings: where completed uploads go.
            jobs: where their jobs are queued.
            expires_after_s: how long an upload is kept without a further byte.
            max_files: how many files a ZIP file may hold.
            max_unfinished: how many uploads there may be at a time.
        """
        self._max_unfinished = max_unfinished
        self._max_files = max_files
        self._recordings = recordings
        self._jobs = jobs
        self._expires_after_s = expires_after_s

    def create(self, file_name: str, length: int, map_name: str, options: JobOptions) -> Upload:
        """Begin an upload of ``length`` bytes.

        Raises:
            InvalidRecording: the name is not a recording's, or there is nothing to upload.
            StorageFull: the disk is full, or has too little room.
            Busy: the limit of unfinished uploads is reached.
        """
        safe = plain_file_name(file_name, length)
        self._check_room()
        upload_id = uuid.uuid4().hex
        with reporting_full_disk(), self._recordings.new_folder() as folder:
            if shutil.disk_usage(folder).free < length:
                raise storage_full()
            (folder / safe).touch()
            plan = json.dumps(asdict(_Plan(safe, length, map_name, options)))
            (folder / _PLAN_FILE).write_text(plan, encoding="utf-8")
            folder.rename(self._folder(upload_id))
        return self.get(upload_id)

    def get(self, upload_id: str) -> Upload:
        """Where the upload stands. One that is complete but has no job yet, because the server died, gets it now.

        Raises:
            UnknownRecording: no upload has this id, or it expired.
            InvalidRecording, TooLarge: it is complete, and its content is not a recording's. It is removed.
            StorageFull: the disk is full.
        """
        try:
            with self._locked(upload_id) as plan:
                status = (self._folder(upload_id) / plan.file_name).stat()
                expires = status.st_mtime + self._expires_after_s
                if status.st_size < plan.length:
                    if expires < time.time():
                        self._remove(upload_id)
                        raise unknown_recording(upload_id)
                    return Upload(upload_id, plan.length, status.st_size, expires)
                self._check_whole(upload_id, plan)
                self._recordings.adopt(self._folder(upload_id), upload_id, plan.file_name)
        except FileNotFoundError:
            pass  # it is complete already, or never existed
        return self._whole(upload_id)

    def append(self, upload_id: str, offset: int, data: bytes) -> Upload:
        """Store the bytes from ``offset`` on; the last ones make the upload a recording and queue its job.

        Raises:
            UnknownRecording: there is no upload with this id, or it expired.
            Conflict: ``offset`` is not where the upload stands.
            TooLarge: more bytes than were declared.
            InvalidRecording, TooLarge: the content is not a recording's. The upload is removed.
            StorageFull: the disk is full. What was stored before is kept.
        """
        standing = self.get(upload_id)
        check_room_for_bytes(standing, offset, len(data))
        try:
            with self._locked(upload_id) as plan:
                path = self._folder(upload_id) / plan.file_name
                check_offset(path.stat().st_size, offset)
                with reporting_full_disk(), path.open("ab", buffering=0) as file:
                    _write(file, data)
                if offset < START_BYTES <= offset + len(data):
                    self._check_start(upload_id, path)
        except FileNotFoundError:  # another request brought the last bytes
            check_offset(standing.length, offset)
        return self.get(upload_id)

    def delete(self, upload_id: str) -> None:
        """Forget an unfinished upload.

        Raises:
            UnknownRecording: no recording has this id.
        """
        try:
            with self._locked(upload_id):
                self._remove(upload_id)
        except FileNotFoundError as error:
            raise unknown_recording(upload_id) from error

    def sweep(self) -> None:
        """Remove the uploads that expired; those that are complete but have no job get it."""
        for plan_file in list(self._recordings.root.glob(f"*/{_PLAN_FILE}")):
            with suppress(RholocError):
                self.get(plan_file.parent.name.removeprefix(_PREFIX))

    def _check_room(self) -> None:
        """Refuse an upload beyond the limit of unfinished ones; expired ones do not count."""
        if self._unfinished() < self._max_unfinished:
            return
        self.sweep()
        if self._unfinished() >= self._max_unfinished:
            hint = "Finish or abandon (DELETE) another upload, or try again later."
            raise Busy(f"There are {self._max_unfinished} unfinished uploads already.", hint, _RETRY_AFTER_S)

    def unfinished(self) -> dict[str, str]:
        """The ids of the uploads that have no job yet, and the maps that they will become."""
        found = {}
        for path in list(self._recordings.root.glob(f"*/{_PLAN_FILE}")):
            with suppress(FileNotFoundError):  # it was finished or removed meanwhile
                found[path.parent.name.removeprefix(_PREFIX)] = _read_plan(path).map_name
        return found

    def _unfinished(self) -> int:
        return sum(1 for _ in self._recordings.root.glob(f"{_PREFIX}*"))

    def _whole(self, upload_id: str) -> Upload:
        """An upload that has become a recording; queues its job if that was not done yet."""
        plan_file = self._recordings.root / upload_id / _PLAN_FILE
        with suppress(FileNotFoundError):
            plan = _read_plan(plan_file)
            self._jobs.submit(upload_id, plan.map_name, plan.options, job_id=upload_id)
            plan_file.unlink()
        return self._recorded(upload_id)

    def _recorded(self, upload_id: str) -> Upload:
        """An upload that has become a recording. Raises UnknownRecording."""
        entry = self._recordings.get(upload_id)
        try:
            job = self._jobs.get(upload_id)
        except UnknownJob:  # it was uploaded in another way
            job = None
        return Upload(upload_id, entry.size_bytes, entry.size_bytes, job=job)

    def _check_start(self, upload_id: str, path: Path) -> None:
        with path.open("rb") as file, self._removing_if_refused(upload_id):
            check_file_start(path.name, file.read(START_BYTES))

    def _check_whole(self, upload_id: str, plan: _Plan) -> None:
        path = self._folder(upload_id) / plan.file_name
        self._check_start(upload_id, path)
        if path.suffix.lower() == ZIP_SUFFIX:
            with self._removing_if_refused(upload_id):
                check_archive(path, max_files=self._max_files)

    @contextmanager
    def _removing_if_refused(self, upload_id: str) -> Iterator[None]:
        try:
            yield
        except RholocError:
            self._remove(upload_id)
            raise

    def _remove(self, upload_id: str) -> None:
        shutil.rmtree(self._folder(upload_id), ignore_errors=True)

    def _folder(self, upload_id: str) -> Path:
        if not is_recording_id(upload_id):
            raise unknown_recording(upload_id)
        return self._recordings.root / f"{_PREFIX}{upload_id}"

    @contextmanager
    def _locked(self, upload_id: str) -> Iterator[_Plan]:
        """The plan of an unfinished upload, locked against other requests.

        Raises:
            FileNotFoundError: there is no such upload.
            Busy: another request holds the lock for too long.
        """
        folder = self._folder(upload_id)
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            _lock(descriptor)
            yield _read_plan(folder / _PLAN_FILE)
        finally:
            os.close(descriptor)


def _lock(descriptor: int) -> None:
    """Lock a file without blocking a thread for long. Raises Busy."""
    deadline_s = time.monotonic() + _LOCK_TIMEOUT_S
    while True:
        try:
            return fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > deadline_s:
                raise Busy("Another request is working on this upload.", "Try again.") from None
            time.sleep(_LOCK_POLL_S)


def _read_plan(path: Path) -> _Plan:
    fields = json.loads(path.read_text(encoding="utf-8"))
    return _Plan(**{**fields, "options": JobOptions.from_json(fields["options"])})


def plain_file_name(file_name: str, length: int) -> str:
    """The name that an uploaded file of ``length`` bytes gets.

    Raises:
        InvalidRecording: it is no recording's, or the file is empty.
    """
    safe = sanitized(file_name).rsplit("/", 1)[-1]
    check_file_name(safe)
    if length < 1:
        raise InvalidRecording(f"{safe} is empty.", "Record again.")
    return safe


def check_room_for_bytes(standing: Upload, offset: int, count: int) -> None:
    """Refuse more bytes than were declared. Raises TooLarge."""
    if offset + count > standing.length:
        raise TooLarge(
            f"More than the declared {standing.length} bytes.", "Start an upload that declares the whole size."
        )


def check_offset(stands_at: int, offset: int) -> None:
    """Refuse bytes from elsewhere than where an upload stands. Raises Conflict."""
    if stands_at != offset:
        raise Conflict(
            f"The upload is at byte {stands_at}, not at {offset}.",
            "Ask for the offset with HEAD, and continue from there.",
        )


def _write(file: RawIOBase, data: bytes) -> None:
    left = memoryview(data)
    while left:
        left = left[file.write(left) :]
