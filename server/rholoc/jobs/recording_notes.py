"""What is known about a stored recording besides its files: what a job read from it, and corrected waypoints.

It is kept in hidden files of the recording's folder, which no upload can name.
"""

from __future__ import annotations

import contextlib
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rholoc.disk import reporting_full_disk
from rholoc.errors import InvalidRecording
from rholoc.geometry import FloatArray, IntArray
from rholoc.mapping import small_picture
from rholoc.recordings import Recording, Waypoint, read_waypoints_csv, write_waypoints_csv
from rholoc.reports import report_from_json, report_to_json

WAYPOINTS_FILE = ".waypoints.csv"
_NOTES_FILE = ".notes.json"
_THUMBNAIL_FILE = ".thumbnail.jpg"
READ_FILES = (_NOTES_FILE, _THUMBNAIL_FILE)  # what a job writes
NOTE_FILES = (*READ_FILES, WAYPOINTS_FILE)
_THUMBNAIL_S = 1.0  # after the first frame: the first is often of the floor


@dataclass(frozen=True)
class RecordedWaypoint:
    """A waypoint as users see it.

    Attributes:
        name: its name.
        position: (3,) metres.
        time_s: on the recording's clock; None where only the order is known.
        sigma_m: how well the camera was held to it.
    """

    name: str
    position: tuple[float, float, float]
    time_s: float | None = None
    sigma_m: float = 0.02


@dataclass(frozen=True)
class RecordingNotes:
    """What a job read from a recording.

    Attributes:
        first_s, last_s: the times of its first and last frame, on its own clock.
        frames: how many it has.
        width, height: of a frame, pixels.
        format: how it is laid out.
        imu: whether it has an IMU's table.
        waypoints: its own.
    """

    first_s: float
    last_s: float
    frames: int
    width: int
    height: int
    format: str
    imu: bool
    waypoints: tuple[RecordedWaypoint, ...] = ()


def note_recording(folder: Path, recording: Recording) -> None:
    """Write notes on a recording, and a small picture of it, into its folder."""
    times, (width, height) = recording.frames.times, recording.frames.size
    notes = RecordingNotes(
        first_s=float(times[0]),
        last_s=float(times[-1]),
        frames=len(times),
        width=width,
        height=height,
        format=str(recording.format),
        imu=recording.imu is not None,
        waypoints=tuple(_recorded(waypoint) for waypoint in recording.waypoints),
    )
    _write(folder / _NOTES_FILE, json.dumps(report_to_json(notes)).encode())
    row = int(np.searchsorted(times, times[0] + _THUMBNAIL_S).clip(0, len(times) - 1))
    with contextlib.suppress(InvalidRecording):  # the job itself reports damaged frames
        _write(folder / _THUMBNAIL_FILE, small_picture(next(iter(recording.frames.images([row])))))


def read_notes(folder: Path) -> RecordingNotes | None:
    """What a job read from a recording; None if none has read it yet."""
    try:
        return report_from_json(RecordingNotes, json.loads((folder / _NOTES_FILE).read_text(encoding="utf-8")))
    except (FileNotFoundError, NotADirectoryError, ValueError):
        return None


def read_thumbnail(folder: Path) -> bytes | None:
    """A small picture of a recording; None where there is none."""
    try:
        return (folder / _THUMBNAIL_FILE).read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        return None


def has_thumbnail(folder: Path) -> bool:
    """Whether there is a small picture of a recording."""
    return (folder / _THUMBNAIL_FILE).is_file()


def corrected_waypoints(folder: Path, notes: RecordingNotes | None) -> tuple[RecordedWaypoint, ...] | None:
    """The waypoints that replace the recording's own; None if they were not corrected."""
    path = folder / WAYPOINTS_FILE
    if not path.is_file():
        return None
    return tuple(_recorded(waypoint) for waypoint in read_waypoints_csv(path, _Span.of(notes)))


def correct_waypoints(
    folder: Path, waypoints: tuple[RecordedWaypoint, ...] | None, notes: RecordingNotes | None
) -> None:
    """Replace a recording's waypoints, or return to its own if ``waypoints`` is None.

    Raises:
        InvalidWaypoints: they cannot be used; nothing changes.
        StorageFull: the disk is full; nothing changes.
    """
    path, arrived = folder / WAYPOINTS_FILE, folder / f"{WAYPOINTS_FILE}.new"
    if waypoints is None:
        path.unlink(missing_ok=True)
        return
    try:
        with reporting_full_disk():
            write_waypoints_csv(arrived, [_waypoint(one) for one in waypoints])
            read_waypoints_csv(arrived, _Span.of(notes))
            arrived.replace(path)
    finally:
        arrived.unlink(missing_ok=True)


@dataclass(frozen=True, eq=False)
class _Span:
    """The times of a recording's first and last frame; no frame numbers, as corrected waypoints only have times."""

    times: FloatArray
    numbers: IntArray

    @staticmethod
    def of(notes: RecordingNotes | None) -> _Span:
        span = np.array([-np.inf, np.inf] if notes is None else [notes.first_s, notes.last_s])
        return _Span(span, np.zeros(0, dtype=np.int64))


def _recorded(waypoint: Waypoint) -> RecordedWaypoint:
    time_s = None if np.isnan(waypoint.time) else waypoint.time
    return RecordedWaypoint(waypoint.name, waypoint.position, time_s, waypoint.sigma_m)


def _waypoint(recorded: RecordedWaypoint) -> Waypoint:
    time = float("nan") if recorded.time_s is None else recorded.time_s
    return Waypoint(recorded.name, time, recorded.position, recorded.sigma_m)


def _write(path: Path, content: bytes) -> None:
    with reporting_full_disk():
        arrived = path.with_name(f"{path.name}.new")
        arrived.write_bytes(content)
        arrived.replace(path)
