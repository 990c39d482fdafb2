"""Jobs done by a real worker: what becomes of them."""

from __future__ import annotations

import time
import uuid
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from fake_pipeline import BUILD_STAGES, FakePipeline
from job_site import until

from rholoc.errors import Conflict
from rholoc.jobs import JobOptions, JobState, MappingTask
from rholoc.jobs.build_process import run_build
from rholoc.maps import MapLibrary
from rholoc.progress import Stage, silent

if TYPE_CHECKING:
    from job_site import Site


def test_a_recording_becomes_a_published_map(busy_site: Site) -> None:
    busy_site.control.hold("poses")
    job = busy_site.submit(map_name="happy")
    until(lambda: busy_site.queue.get(job.id).stage is Stage.POSES)
    running = busy_site.queue.get(job.id)
    assert (running.state, running.message) == (JobState.RUNNING, "at poses")
    assert 0.2 < running.progress < 0.8
    busy_site.control.let_go("poses")
    done = busy_site.wait_for(job, JobState.PUBLISHED, JobState.FAILED)
    assert (done.state, done.stage, done.progress) == (JobState.PUBLISHED, Stage.PUBLISHED, 1.0)
    assert done.attempts == 1
    assert done.created <= done.started <= done.ended
    assert [line.split(" ", 1)[1] for line in done.log] == [
        *(f"{stage}: at {stage}" for stage in BUILD_STAGES),
        "published",
    ]
    assert len(MapLibrary(busy_site.maps_dir).get("happy")) == 1
    assert not list((busy_site.data_dir / "work").iterdir())


@pytest.mark.parametrize(
    ("content", "code", "message"),
    [
        (b"bug at poses", "internal", "An unexpected ZeroDivisionError stopped the job: something"),
        (b"crash at poses", "internal", "The mapping process ended unexpectedly (signal 9)."),
    ],
)
def test_a_failing_job_says_why_and_keeps_the_recording(
    busy_site: Site, content: bytes, code: str, message: str
) -> None:
    name = f"never-{uuid.uuid4().hex[:8]}"
    job = busy_site.wait_for(busy_site.submit(content, name), JobState.FAILED, JobState.PUBLISHED)
    assert (job.state, job.error_code, job.error_message) == (JobState.FAILED, code, message)
    assert job.error_hint
    assert job.ended is not None
    assert "Traceback" not in "".join(job.log)
    assert busy_site.recordings.path(job.recording).read_bytes() == content
    assert name not in MapLibrary(busy_site.maps_dir).names()


def test_a_failed_job_can_be_retried(busy_site: Site) -> None:
    job = busy_site.submit(b"unreadable at read", "retried")
    failed = busy_site.wait_for(job, JobState.FAILED, JobState.PUBLISHED)
    assert (failed.error_code, failed.error_message) == ("invalid_recording", "The video has no frames.")
    busy_site.recordings.path(job.recording).write_bytes(b"a good walk")
    queued = busy_site.queue.retry(job.id)
    assert (queued.state, queued.error_code, queued.log) == (JobState.QUEUED, None, ())
    assert busy_site.wait_for(job, JobState.PUBLISHED, JobState.FAILED).state is JobState.PUBLISHED
    with pytest.raises(Conflict):
        busy_site.queue.retry(job.id)
    with pytest.raises(Conflict):
        busy_site.queue.cancel(job.id)


@pytest.mark.parametrize("point", ["poses", "deaf-poses"])
def test_a_running_job_is_cancelled_within_two_seconds(busy_site: Site, point: str) -> None:
    control, name = busy_site.control, f"cancelled-{point}"
    seen = control.count(point)
    control.hold(point)
    job = busy_site.submit(map_name=name)
    busy_site.wait_at(point, seen + 1)
    busy_site.queue.cancel(job.id)
    asked = time.monotonic()
    while list((busy_site.data_dir / "work").iterdir()):
        assert time.monotonic() - asked < 2.0, "its worker still works on it"
        time.sleep(0.02)
    control.let_go(point)
    assert busy_site.queue.get(job.id).state is JobState.CANCELLED
    assert name not in MapLibrary(busy_site.maps_dir).names()


def test_a_full_disk_is_told(busy_site: Site, tmp_path: Path) -> None:
    recording = tmp_path / "walk.mp4"
    recording.write_bytes(b"disk full at poses")
    task = MappingTask(recording, tmp_path / "map.rho", tmp_path, "room", JobOptions())
    failure = run_build(FakePipeline(busy_site.control), task, silent)
    assert (failure.code, failure.message) == ("storage_full", "The disk is full; nothing that was stored is changed.")
    assert not task.map_file.exists()
