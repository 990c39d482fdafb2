"""What is known of a stored recording: noted when it is read, and corrected by people without touching its files."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from rholoc.errors import InvalidWaypoints
from rholoc.jobs import JobOptions
from rholoc.library.recording_notes import (
    RecordedWaypoint,
    RecordingNotes,
    corrected_waypoints,
    notes_in,
    notes_of,
    read_notes,
    read_thumbnail,
    waypoints_file,
)
from rholoc.maps import Map
from rholoc.progress import silent
from rholoc.recordings import MemoryFrames, Recording, Waypoint, write_frames_csv, write_waypoints_csv
from rholoc.worker.pipeline import MappingPipeline, MappingTask

PLACES = [(0.0, 0.0, 1.5), (2.0, 0.0, 1.5), (2.0, 3.5, 1.5)]
GIVEN = tuple(RecordedWaypoint(f"W{i}", place, 1.0 * i, 0.05) for i, place in enumerate(PLACES))


def test_a_recording_is_noted_with_a_picture(tmp_path: Path) -> None:
    pictures = [np.full((90, 160, 3), 10 * i, np.uint8) for i in range(8)]
    own = tuple(Waypoint(f"W{i}", float("nan"), place) for i, place in enumerate(PLACES))
    assert read_notes({}) is None
    assert read_thumbnail({}) is None
    files = notes_of(Recording(MemoryFrames(pictures, 2.0), "walk", tmp_path, waypoints=own))
    expected = tuple(RecordedWaypoint(f"W{i}", place) for i, place in enumerate(PLACES))
    assert read_notes(files) == RecordingNotes(0.0, 3.5, 8, 160, 90, "rholoc", imu=False, waypoints=expected)
    shown = cv2.imdecode(np.frombuffer(read_thumbnail(files) or b"", np.uint8), cv2.IMREAD_COLOR)
    assert shown.shape == (90, 160, 3)
    assert abs(int(shown.mean()) - 20) <= 1  # a second after the first frame
    assert read_notes({".notes.json": b"damaged"}) is None


def test_corrected_waypoints_are_checked_and_read_again() -> None:
    notes = RecordingNotes(0.0, 3.5, 8, 160, 90, "rholoc", imu=False)
    assert corrected_waypoints({}, notes) is None
    assert corrected_waypoints({".waypoints.csv": waypoints_file(GIVEN, notes)}, notes) == GIVEN
    late = (*GIVEN[:2], replace(GIVEN[2], time_s=9.0))
    for wrong in (GIVEN[:2], late, (*GIVEN, GIVEN[0]), (replace(GIVEN[0], name=""), *GIVEN[1:])):
        with pytest.raises(InvalidWaypoints):
            waypoints_file(wrong, notes)


def test_a_job_reads_the_corrected_waypoints_and_the_chosen_frames(
    tmp_path: Path, room_recording: Path, monkeypatch: pytest.MonkeyPatch, picture_world: Any
) -> None:
    read: list[Recording] = []

    def build(recordings: list[Recording], *_: object) -> Map:
        read.extend(recordings)
        return picture_world.map_

    monkeypatch.setattr("rholoc.mapping.build.pipeline.build_map", build)
    task = MappingTask(room_recording, tmp_path / "map.rho", tmp_path, "room", JobOptions(), folder=room_recording)
    MappingPipeline().build(task, silent)
    notes = read_notes(notes_in(room_recording))
    assert (notes.frames, [one.name for one in notes.waypoints]) == (6, ["A", "B", "C"])
    corrected = waypoints_file([replace(one, time_s=0.05 * i) for i, one in enumerate(GIVEN)], notes)
    (room_recording / ".waypoints.csv").write_bytes(corrected)
    task.built_file.unlink()
    MappingPipeline().build(replace(task, options=JobOptions(frames="0:5")), silent)
    assert [len(one.frames.times) for one in read] == [6, 5]
    assert [[point.name for point in one.waypoints] for one in read] == [["A", "B", "C"], ["W0", "W1", "W2"]]
    assert read_notes(notes_in(room_recording)) == notes  # they are of the recording as it came


@pytest.fixture
def room_recording(tmp_path: Path) -> Path:
    """A stored recording of six pictures."""
    folder = tmp_path / "stored"
    folder.mkdir()
    for number in range(6):
        cv2.imwrite(str(folder / f"{number:04d}.png"), np.full((48, 64, 3), 40 * number, np.uint8))
    write_frames_csv(folder / "frames.csv", np.arange(6), np.arange(6) / 30)
    waypoints = [Waypoint(name, 0.03 * i, place) for i, (name, place) in enumerate(zip("ABC", PLACES, strict=True))]
    write_waypoints_csv(folder / "waypoints.csv", waypoints)
    return folder
