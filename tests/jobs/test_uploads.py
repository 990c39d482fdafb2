"""Uploads that go on at whichever server they reach."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from rholoc.errors import Conflict, InvalidRecording, StorageFull, TooLarge, UnknownRecording
from rholoc.jobs import JobOptions, JobQueue, JobState, UploadStore
from rholoc.library.recordings import RecordingStore
from rholoc.storage import ObjectStorage
from rholoc.storage.database import open_database

VIDEO = b"\0\0\0\x18ftypmp42" + bytes(range(256)) * 40


@pytest.fixture(params=["in place", "memory"])
def uploads(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[list[UploadStore]]:
    """Of two processes, on two machines if they share a storage."""
    in_place = request.param == "in place"
    objects, engine = ObjectStorage(tmp_path / "a" if in_place else "memory:///"), open_database(tmp_path)
    machines = [tmp_path / "a", tmp_path / ("a" if in_place else "b")]
    recordings = [RecordingStore(machine, objects, engine) for machine in machines]
    queues = [JobQueue(one) for one in recordings]
    yield [UploadStore(one, queue, 3600.0, max_unfinished=3) for one, queue in zip(recordings, queues, strict=True)]
    engine.dispose()


def test_an_upload_goes_on_at_whichever_server_it_reaches(uploads: Any) -> None:
    upload = uploads[0].create("walk.mp4", len(VIDEO), "hall", JobOptions())
    step = len(VIDEO) // 5
    for number, start in enumerate(range(0, len(VIDEO), step)):
        store = uploads[number % 2]
        assert store.get(upload.id).offset == start
        upload = store.append(upload.id, start, VIDEO[start : start + step])
    assert (upload.job.state, upload.job.map_name, upload.job.recording) == (JobState.QUEUED, "hall", upload.id)
    assert uploads[0].get(upload.id) == uploads[1].get(upload.id)
    assert uploads[0]._recordings.path(upload.id).read_bytes() == VIDEO
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
    uploads: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, there = uploads
    upload = here.create("walk.mp4", len(VIDEO), "hall", JobOptions())

    def full(*_: object) -> None:
        raise StorageFull("The disk is full.")

    with monkeypatch.context() as patch:
        patch.setattr(RecordingStore, "adopt", full)
        with pytest.raises(StorageFull):
            here.append(upload.id, 0, VIDEO)
    assert there.get(upload.id).job is not None
    assert here.get(upload.id).offset == len(VIDEO)


def test_uploads_are_bounded_and_expire(uploads: Any) -> None:
    here, there = uploads
    there._expires_after_s = -1.0
    for _ in range(3):
        upload = here.create("walk.mp4", 2000, "hall", JobOptions())
        here.append(upload.id, 0, VIDEO[:1000])
    assert len(there.unfinished()) == 3
    there.create("walk.mp4", 2000, "hall", JobOptions())
    assert len(there.unfinished()) == 1, "those that have expired make room"
    there.sweep()
    assert len(there.unfinished()) == 0
    assert not list(here._objects.list("uploads"))


def test_an_upload_for_which_there_is_no_room_is_refused(uploads: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rholoc.jobs.uploads.shutil.disk_usage", lambda _: Mock(free=1000))
    uploads[0].create("walk.mp4", 500, "hall", JobOptions())
    with pytest.raises(StorageFull):
        uploads[0].create("walk.mp4", 1001, "hall", JobOptions())


def test_a_crash_between_a_recordings_files_and_its_row_is_mended(uploads: Any, monkeypatch: Any) -> None:
    here, there = uploads
    upload = here.create("walk.mp4", len(VIDEO), "hall", JobOptions())
    with monkeypatch.context() as patch:
        patch.setattr(RecordingStore, "_register", Mock(side_effect=KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            here.append(upload.id, 0, VIDEO)
    assert there.get(upload.id).job is not None
    assert here._recordings.path(upload.id).read_bytes() == VIDEO
