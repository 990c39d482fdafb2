"""Uploads over a line that breaks: recordings piece by piece, and maps that replace the map before them once."""

import os
import tempfile
import zipfile
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import httpx

from rholoc_client._calls import (
    PRECONDITION_FAILED,
    Call,
    begin_upload,
    camera_text,
    continue_upload,
    fetch,
    stored_map,
    upload_map,
    upload_standing,
)
from rholoc_client._retry import may_repeat
from rholoc_client.errors import (
    ChecksumMismatch,
    Conflict,
    ConnectionFailed,
    InvalidAnswer,
    InvalidRecording,
    ServiceError,
)
from rholoc_client.models import Camera, Job, MapSummary, parse_job, parse_map

UploadProgress = Callable[[int, int], None]  # bytes that the service has, total bytes

_PIECE_BYTES = 4 * 2**20
_WAYPOINTS_FILE = "waypoints.csv"
_PACKED = frozenset({".jpg", ".jpeg", ".png", ".webp", ".mp4", ".mov", ".webm", ".mkv"})


def upload_steps(
    name: str, file: BinaryIO, fields: Mapping[str, str | None], retries: int, progress: UploadProgress | None
) -> Generator[Call[Any], Any, Job]:
    """The calls of an upload, one after another: the caller sends each call's answer back in, or throws its error.

    After a piece that failed, the service is asked what it has, and that is not sent again.

    Args:
        name: the file's name.
        file: what to upload.
        fields: how the service is to use it.
        retries: how often in a row a piece may fail.
        progress: called after every piece that arrived.

    Returns:
        The mapping job.
    """
    length = file.seek(0, os.SEEK_END)
    recording = yield begin_upload(name, length, fields)
    offset, job_id, failures = 0, None, 0
    while offset < length:
        file.seek(offset)
        try:
            offset, job_id = yield continue_upload(recording, offset, file.read(_PIECE_BYTES))
            failures = 0
            if progress is not None:
                progress(offset, length)
        except (ConnectionFailed, Conflict, ChecksumMismatch):
            failures += 1
            if failures > retries:
                raise
            offset, job_id = yield upload_standing(recording)
    if job_id is None:
        raise InvalidAnswer("The service has the whole upload, but names no job.")
    job: Job = yield fetch(parse_job, "jobs", job_id)
    return job


def map_upload_steps(name: str, content: bytes, retries: int) -> Generator[Call[Any], Any, MapSummary]:
    """The calls that put a map under a name, as :func:`upload_steps` has them.

    A lost answer does not say whether the map has arrived: the stored file does, and the map is only sent again on the
    condition that this file is still the one that was looked at. The service stores a CSV as another file, so a CSV is
    not sent again.

    Args:
        name: the map's.
        content: its file.
        retries: how often an answer may be lost.

    Returns:
        The map as the service describes it.
    """
    condition: dict[str, str] = {}
    for attempts_left in range(retries, -1, -1):
        try:
            summary: MapSummary = yield upload_map(name, content, condition)
            return summary
        except ServiceError as error:
            if error.status != PRECONDITION_FAILED or not attempts_left:
                raise
        except ConnectionFailed as failure:
            lost = isinstance(failure.__cause__, httpx.TransportError) and not may_repeat(failure.__cause__, False)
            if not (lost and attempts_left and _is_rho(content)):
                raise
        stored, condition = yield stored_map(name)
        if stored == content:
            break
    arrived: MapSummary = yield fetch(parse_map, "maps", name)
    return arrived


def _is_rho(content: bytes) -> bool:
    """Whether a map's file is a ``.rho``: eight bytes, then JSON."""
    return content[8:9] == b"{"


@contextmanager
def opened_recording(path: Path | str, waypoints: Path | str | None = None) -> Iterator[tuple[str, BinaryIO]]:
    """A recording as one file: a video or a ZIP file as it is; a folder, or a video with its waypoints, packed.

    Yields:
        The file's name and the file.

    Raises:
        InvalidRecording: waypoints cannot be added to a ZIP file.
        OSError: the path cannot be read.
    """
    path = Path(path)
    waypoints = None if waypoints is None else Path(waypoints)
    if path.suffix.lower() == ".zip" and waypoints is not None:
        raise InvalidRecording("Waypoints were given beside a ZIP file.", f"Put {_WAYPOINTS_FILE} into the ZIP file.")
    with ExitStack() as stack:
        if path.is_dir() or waypoints is not None:
            file: BinaryIO = stack.enter_context(tempfile.TemporaryFile())
            _pack(_contents(path, waypoints), file)
            yield f"{path.resolve().stem if path.is_file() else path.resolve().name}.zip", file
        else:
            yield path.name, stack.enter_context(path.open("rb"))


def _contents(path: Path, waypoints: Path | None) -> dict[str, Path]:
    """What is packed: name → file."""
    files = {path.name: path} if path.is_file() else {}
    for inner in sorted(path.rglob("*")):
        relative = inner.relative_to(path)
        if inner.is_file() and not any(part.startswith(".") for part in relative.parts):
            files[relative.as_posix()] = inner
    return files if waypoints is None else {**files, _WAYPOINTS_FILE: waypoints}


def _pack(contents: Mapping[str, Path], file: BinaryIO) -> None:
    with zipfile.ZipFile(file, "w") as archive:
        for name, path in contents.items():
            packed = path.suffix.lower() in _PACKED
            archive.write(path, name, zipfile.ZIP_STORED if packed else zipfile.ZIP_DEFLATED)


def content_of(source: Path | str | bytes) -> bytes:
    """Content of a file, given by its path or as it is."""
    return source if isinstance(source, bytes) else Path(source).read_bytes()


def recording_fields(
    map_name: str,
    kind: str | None,
    features: str | None,
    density: str | None,
    poses: str | None,
    camera: Camera | str | None,
    priority: str | None,
) -> dict[str, str | None]:
    """Metadata of a recording's upload."""
    return {
        "map": map_name,
        "kind": kind,
        "features": features,
        "density": density,
        "poses": poses,
        "camera": camera_text(camera),
        "priority": priority,
    }
