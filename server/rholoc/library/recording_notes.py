"""Notes on a stored recording: figures read by a job, and corrected waypoints.

They are hidden files, which no upload can name.
"""

import contextlib
import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rholoc.disk import reporting_full_disk
from rholoc.errors import InvalidRecording
from rholoc.mapping.build.frame_features import small_picture
from rholoc.recordings import Recording, Waypoint, read_waypoints_csv, write_waypoints_csv
from rholoc.recordings.frames.memory_frames import MissingImages
from rholoc.reports import report_from_json, report_to_json

WAYPOINTS_FILE = ".waypoints.csv"
_NOTES_FILE = ".notes.json"
_THUMBNAIL_FILE = ".thumbnail.jpg"
READ_FILES = (_NOTES_FILE, _THUMBNAIL_FILE)  # written by a job
NOTE_FILES = (*READ_FILES, WAYPOINTS_FILE)
_THUMBNAIL_S = 1.0  # after the first frame: the first is often of the floor


@dataclass(frozen=True)
class RecordedWaypoint:
    """A waypoint as users see it.

    Attributes:
        name: its name.
        position: (3,) metres.
        time_s: on the recording's clock; None where only the order is known.
        sigma_m: standard deviation of each coordinate.
    """

    name: str
    position: tuple[float, float, float]
    time_s: float | None = None
    sigma_m: float = 0.02


@dataclass(frozen=True)
class RecordingNotes:
    """Figures of a recording, read by a job.

    Attributes:
        first_s, last_s: the times of its first and last frame, on its own clock; None if its pictures have no times.
        frames: their number.
        width, height: of a frame [px].
        format: name of the recording's format.
        imu: whether it has IMU readings.
        waypoints: its own.
    """

    first_s: float | None
    last_s: float | None
    frames: int
    width: int
    height: int
    format: str
    imu: bool
    waypoints: tuple[RecordedWaypoint, ...] = ()

    @property
    def length_s(self) -> float | None:
        """Length of the walk [s]; None if its pictures have no times."""
        return None if self.first_s is None or self.last_s is None else self.last_s - self.first_s


def notes_of(recording: Recording) -> dict[str, bytes]:
    """Files with notes on a recording and a small picture of 1 s after its start, by name; without the picture if that
    frame is damaged.
    """
    times, (width, height) = recording.frames.times, recording.frames.size
    notes = RecordingNotes(
        first_s=float(times[0]) if recording.frames.timed else None,
        last_s=float(times[-1]) if recording.frames.timed else None,
        frames=len(times),
        width=width,
        height=height,
        format=str(recording.format),
        imu=recording.imu is not None,
        waypoints=tuple(_recorded(waypoint) for waypoint in recording.waypoints),
    )
    files = {_NOTES_FILE: json.dumps(report_to_json(notes)).encode()}
    row = int(np.searchsorted(times, times[0] + _THUMBNAIL_S).clip(0, len(times) - 1))
    with contextlib.suppress(InvalidRecording):  # the job itself reports damaged frames
        files[_THUMBNAIL_FILE] = small_picture(next(iter(recording.frames.images([row]))))
    return files


def write_notes(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files with notes into a folder, which is made if it is missing.

    Raises:
        StorageFull: the disk is full.
    """
    with reporting_full_disk():
        folder.mkdir(exist_ok=True)
        for name, content in files.items():
            (folder / name).write_bytes(content)


def notes_in(folder: Path) -> dict[str, bytes]:
    """The files with notes in a folder, by name."""
    return {name: (folder / name).read_bytes() for name in NOTE_FILES if (folder / name).is_file()}


def read_notes(files: Mapping[str, bytes]) -> RecordingNotes | None:
    """Notes that a job made on a recording; None if no job has read it yet, or the notes are broken."""
    try:
        return report_from_json(RecordingNotes, json.loads(files[_NOTES_FILE]))
    except (KeyError, ValueError):
        return None


def read_thumbnail(files: Mapping[str, bytes]) -> bytes | None:
    """A small picture of a recording (JPEG); None if there is none."""
    return files.get(_THUMBNAIL_FILE)


def corrected_waypoints(
    files: Mapping[str, bytes], notes: RecordingNotes | None
) -> tuple[RecordedWaypoint, ...] | None:
    """The corrected waypoints in ``files``, which replace the recording's own; None if ``files`` has none.

    ``notes`` give the recording's time span, against which they are checked (None: unchecked). Raises InvalidWaypoints,
    also for fewer than three.
    """
    if WAYPOINTS_FILE not in files:
        return None
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / WAYPOINTS_FILE
        path.write_bytes(files[WAYPOINTS_FILE])
        return tuple(_recorded(waypoint) for waypoint in read_waypoints_csv(path, _span(notes)))


def waypoints_file(waypoints: Sequence[RecordedWaypoint], notes: RecordingNotes | None) -> bytes:
    """Content of the file (CSV) with waypoints that replace a recording's own.

    Raises:
        InvalidWaypoints: they cannot be used, or are outside the time span that ``notes`` give (None: unchecked).
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / WAYPOINTS_FILE
        write_waypoints_csv(path, [_waypoint(one) for one in waypoints])
        read_waypoints_csv(path, _span(notes))
        return path.read_bytes()


def _span(notes: RecordingNotes | None) -> MissingImages:
    """The times of a recording's first and last frame, infinite if unknown; no frame numbers."""
    span = (-np.inf, np.inf)
    if notes is not None and notes.first_s is not None and notes.last_s is not None:
        span = (notes.first_s, notes.last_s)
    return MissingImages(np.array(span), np.zeros(0, dtype=np.int64))


def _recorded(waypoint: Waypoint) -> RecordedWaypoint:
    """The waypoint as users see it, with None in place of a time that is NaN."""
    time_s = None if np.isnan(waypoint.time) else waypoint.time
    return RecordedWaypoint(waypoint.name, waypoint.position, time_s, waypoint.sigma_m)


def _waypoint(recorded: RecordedWaypoint) -> Waypoint:
    """The waypoint as mapping uses it, with NaN in place of a time that is None."""
    time = float("nan") if recorded.time_s is None else recorded.time_s
    return Waypoint(recorded.name, time, recorded.position, recorded.sigma_m)
