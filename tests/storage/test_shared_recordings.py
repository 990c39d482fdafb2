"""Recordings and uploads that several processes share."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from rholoc.errors import Conflict, InvalidRecording, StorageFull, StorageUnavailable, TooLarge, UnknownRecording
from rholoc.jobs import JobOptions, JobQueue, JobState, SharedRecordingStore, SharedUploadStore
from rholoc.jobs.recording_notes import NOTE_FILES, WAYPOINTS_FILE

VIDEO = b"\0\0\0\x18ftypmp42" + bytes(range(256)) * 40


@pytest.fixture
def stores(open_storage: Any, tmp_path: Path) -> tuple[SharedRecordingStore, SharedRecordingStore]:
    """Of two machines."""
    return SharedRecordingStore(tmp_path / "a", open_storage()), SharedRecordingStore(tmp_path / "b", open_storage())


def test_what_one_machine_takes_in_another_reads(stores: Any) -> None:
    here, there = stores
    entry = here.create([("walk.mp4", [b"12", b"345"]), ("frames/1.csv", [b"6"])])
    assert there.get(entry.id) == entry
    assert there.list() == [entry]
    folder = there.path(entry.id)
    assert (folder / "walk.mp4").read_bytes() == b"12345"
    assert (folder / "frames" / "1.csv").read_bytes() == b"6"
    there.release(entry.id)
    assert not folder.exists()
    assert (there.path(entry.id) / "walk.mp4").read_bytes() == b"12345", "it is fetched again"
    there.delete(entry.id)
    with pytest.raises(UnknownRecording):
        here.path(entry.id)


def test_a_single_file_is_the_recording(stores: Any) -> None:
    here, there = stores
    entry = here.create([("walk.mp4", [b"12345"])])
    assert there.path(entry.id).read_bytes() == b"12345"


def test_notes_are_shared_without_the_files(stores: Any) -> None:
    here, there = stores
    entry = here.create([("walk.mp4", [b"12345"])])
    (here.folder(entry.id) / WAYPOINTS_FILE).write_text("name,x,y,z\n")
    here.share_notes(entry.id, [WAYPOINTS_FILE])
    folder = there.folder(entry.id)
    assert [path.name for path in folder.iterdir()] == [WAYPOINTS_FILE]
    (folder / NOTE_FILES[0]).write_text("{}")
    there.share_notes(entry.id, NOTE_FILES[:1])
    (here.folder(entry.id) / WAYPOINTS_FILE).unlink()
    here.share_notes(entry.id, [WAYPOINTS_FILE])
    assert {path.name for path in there.folder(entry.id).iterdir()} == {NOTE_FILES[0]}


def test_a_recording_that_the_storage_cut_short_is_not_mapped(stores: Any, storage_url: str) -> None:
    here, there = stores
    entry = here.create([("walk.mp4", [b"12345"])])
    stored = Path(storage_url.removeprefix("file://")) / "recordings" / entry.id / "walk.mp4"
    stored.write_bytes(b"12")
    with pytest.raises(StorageUnavailable):
        there.path(entry.id)
    stored.write_bytes(b"12345")
    assert there.path(entry.id).read_bytes() == b"12345"


def test_what_a_broken_off_upload_left_is_swept_up(
    stores: Any, storage_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, _ = stores
    entry = here.create([("walk.mp4", [b"12345"])])
    stored = Path(storage_url.removeprefix("file://")) / "recordings"
    shutil.copytree(stored / entry.id, stored / ("0" * 32))
    monkeypatch.setattr("rholoc.jobs.shared_recordings._ORPHANED_AFTER_S", -10)
    here.sweep()
    assert [path.parent.name for path in stored.rglob("*.mp4")] == [entry.id]


@pytest.fixture
def uploads(stores: Any, open_storage: Any, tmp_path: Path) -> Any:
    """Upload stores of two machines, and the queue."""
    made = []
    for recordings in stores:
        shared = open_storage()
        queue = JobQueue(tmp_path / "data", None, recordings)  # the one SQLite file
        made.append(SharedUploadStore(recordings, queue, shared, 3600.0, max_unfinished=3))
    yield made
    for store in made:
        store._jobs.close()


def test_an_upload_goes_on_at_whichever_server_it_reaches(uploads: Any, stores: Any) -> None:
    upload = uploads[0].create("walk.mp4", len(VIDEO), "hall", JobOptions())
    step = len(VIDEO) // 5
    for number, start in enumerate(range(0, len(VIDEO), step)):
        store = uploads[number % 2]
        assert store.get(upload.id).offset == start
        upload = store.append(upload.id, start, VIDEO[start : start + step])
    assert upload.job is not None
    assert (upload.job.state, upload.job.map_name, upload.job.recording) == (JobState.QUEUED, "hall", upload.id)
    assert uploads[0].get(upload.id) == uploads[1].get(upload.id)
    assert stores[0].path(upload.id).read_bytes() == VIDEO
    assert len(uploads[0]._jobs.list()) == 1


def test_bytes_from_elsewhere_too_many_or_of_no_recording_are_refused(uploads: Any) -> None:
    here, there = uploads
    upload = here.create("walk.mp4", 2000, "hall", JobOptions())
    here.append(upload.id, 0, VIDEO[:1000])
    for offset in (0, 999, 1500):
        with pytest.raises(Conflict, match="at byte 1000"):
            there.append(upload.id, offset, b"x")
    with pytest.raises(TooLarge):
        there.append(upload.id, 1000, bytes(1001))
    assert there.get(upload.id).offset == 1000
    there.delete(upload.id)
    with pytest.raises(UnknownRecording):
        here.get(upload.id)
    other = here.create("walk.mp4", 2000, "hall", JobOptions())
    with pytest.raises(InvalidRecording):
        there.append(other.id, 0, b"<html>" * 200)
    with pytest.raises(UnknownRecording):
        here.get(other.id)


def test_a_whole_upload_whose_server_died_gets_its_job_at_the_next_request(
    uploads: Any, stores: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, there = uploads
    upload = here.create("walk.mp4", len(VIDEO), "hall", JobOptions())

    def full(*_: object) -> None:
        raise StorageFull("The disk is full.")

    with monkeypatch.context() as patch:
        patch.setattr(type(stores[0]), "adopt", full)
        with pytest.raises(StorageFull):
            here.append(upload.id, 0, VIDEO)
    assert there.get(upload.id).job is not None
    assert here.get(upload.id).offset == len(VIDEO)


def test_uploads_are_bounded_and_expire(uploads: Any, storage_url: str) -> None:
    here, there = uploads
    there._expires_after_s = -1.0
    for _ in range(3):
        upload = here.create("walk.mp4", 2000, "hall", JobOptions())
        here.append(upload.id, 0, VIDEO[:1000])
    assert there._unfinished() == 3
    there.create("walk.mp4", 2000, "hall", JobOptions())
    assert there._unfinished() == 1, "those that have expired make room"
    there.sweep()
    assert there._unfinished() == 0
    assert not [path for path in (Path(storage_url.removeprefix("file://")) / "uploads").rglob("*") if path.is_file()]
