"""Jobs done by a real worker: what becomes of them."""

from __future__ import annotations

import math
import multiprocessing
import subprocess
import sys
import time
import uuid
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import sqlalchemy as sa

from fake_pipeline import BUILD_STAGES, TIMING, FakePipeline
from rholoc.errors import Conflict
from rholoc.jobs import JobOptions, JobState
from rholoc.jobs.leases import Failure, Lease
from rholoc.jobs.table import JobWork
from rholoc.jobs.workers_table import WorkerTable
from rholoc.library.maps import MapLibrary
from rholoc.processes.limits import Limits
from rholoc.progress import Stage, silent
from rholoc.storage.database import open_database
from rholoc.worker.build_process import KilledForMemory, build_in_process, run_build
from rholoc.worker.job_folders import JobFolders
from rholoc.worker.pipeline import MappingTask
from waiting import until

if TYPE_CHECKING:
    from job_site import Site


def test_a_recording_becomes_a_published_map_whose_room_is_drawn_afterwards(busy_site: Site) -> None:
    for point in ("poses", "furnish happy"):
        busy_site.control.hold(point)
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
    busy_site.wait_at("furnish happy")
    assert len(MapLibrary(busy_site.maps_dir).get("happy")) == 1
    busy_site.control.let_go("furnish happy")
    until(lambda: not list((busy_site.data_dir / "work").iterdir()))


@pytest.mark.parametrize(
    ("content", "code", "message"),
    [
        pytest.param(
            b"bug at poses",
            "internal",
            "An unexpected error stopped the job: ZeroDivisionError: something",
            marks=pytest.mark.slow,
        ),
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


def test_a_panorama_is_no_stored_camera(site: Site) -> None:
    recording = site.recordings.create([("walk.mp4", [b"a walk"])]).id
    work = JobWork(recording, "round", JobOptions(camera="equirectangular"))
    JobFolders(site.stores, 10**8).task(Lease("0" * 32, "run", 1), work, math.inf)


@pytest.mark.slow
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


@pytest.mark.parametrize("point", ["poses", pytest.param("deaf-poses", marks=pytest.mark.slow)])
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


@pytest.mark.slow
def test_a_worker_that_was_taken_for_dead_takes_jobs_again(busy_site: Site) -> None:
    """While the database was gone it could not tell that it lives; another worker forgot it."""
    engine = open_database(busy_site.data_dir)
    workers = WorkerTable(engine)
    until(lambda: workers.living())
    (worker,) = workers.living()
    workers.remove(worker.id)
    until(lambda: [one.id for one in workers.living()] == [worker.id])
    job = busy_site.submit(map_name="after-all")
    assert busy_site.wait_for(job, JobState.PUBLISHED, JobState.FAILED).state is JobState.PUBLISHED
    engine.dispose()


def test_what_is_being_published_cannot_be_cancelled(busy_site: Site) -> None:
    busy_site.control.hold("publishing")
    job = busy_site.submit(map_name="too-late")
    busy_site.wait_at("publishing")
    with pytest.raises(Conflict):
        busy_site.queue.cancel(job.id)
    busy_site.control.let_go("publishing")
    assert busy_site.wait_for(job, JobState.PUBLISHED, JobState.CANCELLED).state is JobState.PUBLISHED


def test_doubts_about_a_map_are_reported(busy_site: Site) -> None:
    job = busy_site.wait_for(busy_site.submit(b"a doubtful walk", "doubtful"), JobState.PUBLISHED, JobState.FAILED)
    assert job.warnings == ("The frame poses are not trusted: Two reconstructions disagree.",)
    assert [line.split(" ", 1)[1] for line in job.log[-2:]] == [f"warning: {job.warnings[0]}", "published"]


@pytest.mark.slow
def test_a_database_that_fails_at_the_end_costs_nothing(busy_site: Site) -> None:
    engine = open_database(busy_site.data_dir)
    with engine.begin() as connection:
        connection.execute(
            sa.text(
                "CREATE TRIGGER broken BEFORE UPDATE ON rholoc_jobs WHEN NEW.state = 'published' "
                "BEGIN SELECT RAISE(FAIL, 'disk I/O error'); END"
            )
        )
    put = busy_site.control.count("put")
    job = busy_site.submit(map_name="stubborn")
    until(lambda: busy_site.control.count("put") > put and busy_site.queue.get(job.id).attempts > 1)
    with engine.begin() as connection:
        connection.execute(sa.text("DROP TRIGGER broken"))
    done = busy_site.wait_for(job, JobState.PUBLISHED, JobState.FAILED)
    assert (done.state, busy_site.control.count("put")) == (JobState.PUBLISHED, put + 1)
    engine.dispose()


@pytest.mark.slow
def test_a_disk_that_is_full_as_a_build_ends_keeps_no_job_running(busy_site: Site) -> None:
    engine = open_database(busy_site.data_dir)
    put = busy_site.control.count("put")
    seen = busy_site.control.count("report")
    busy_site.control.hold("report")
    job = busy_site.submit(map_name="cramped")
    busy_site.wait_at("report", seen + 1)
    with engine.begin() as connection:
        connection.execute(
            sa.text(
                "CREATE TRIGGER full BEFORE UPDATE ON rholoc_jobs "
                "BEGIN SELECT RAISE(FAIL, 'database or disk is full'); END"
            )
        )
    busy_site.control.let_go("report")
    time.sleep(2 * TIMING.dead_after_s)
    assert busy_site.queue.get(job.id).state is JobState.RUNNING
    with engine.begin() as connection:
        connection.execute(sa.text("DROP TRIGGER full"))
    done = busy_site.wait_for(job, JobState.PUBLISHED, JobState.FAILED)
    assert (done.state, busy_site.control.count("put")) == (JobState.PUBLISHED, put + 1)
    engine.dispose()


@pytest.mark.slow
def test_a_database_that_is_locked_for_a_while_is_waited_for(busy_site: Site) -> None:
    engine = open_database(busy_site.data_dir)
    seen = busy_site.control.count("poses")
    busy_site.control.hold("poses")
    job = busy_site.submit(map_name="patient")
    busy_site.wait_at("poses", seen + 1)
    with engine.begin():  # IMMEDIATE: nobody else can write
        busy_site.control.let_go("poses")
        time.sleep(2 * TIMING.dead_after_s)
    done = busy_site.wait_for(job, JobState.PUBLISHED, JobState.FAILED)
    assert done.state is JobState.PUBLISHED
    engine.dispose()


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        (Limits(time_s=0.1), "Mapping took longer than"),
        pytest.param(Limits(memory_bytes=2**20), "Mapping needed more memory", marks=pytest.mark.slow),
    ],
)
def test_a_build_beyond_its_limits_is_ended(site: Site, tmp_path: Path, limits: Limits, message: str) -> None:
    site.control.hold("deaf-poses")
    recording = tmp_path / "walk.mp4"
    recording.write_bytes(b"a walk")
    task = MappingTask(recording, tmp_path / "map.rho", tmp_path, "room", JobOptions())
    stopped = build_in_process(
        FakePipeline(site.control), task, silent, lambda: None, poll_s=0.1, cancel_grace_s=0.1, limits=limits
    )
    failure = stopped.failure if isinstance(stopped, KilledForMemory) else stopped
    assert isinstance(failure, Failure)
    assert failure.code == "mapping_failed"
    assert failure.message.startswith(message)
    assert "RHOLOC_JOB_" in failure.hint
    assert multiprocessing.active_children() == []


def test_a_full_disk_is_reported(busy_site: Site, tmp_path: Path) -> None:
    recording = tmp_path / "walk.mp4"
    recording.write_bytes(b"disk full at poses")
    task = MappingTask(recording, tmp_path / "map.rho", tmp_path, "room", JobOptions())
    failure = run_build(FakePipeline(busy_site.control), task, Limits(), silent)
    assert (failure.code, failure.message) == ("storage_full", "The disk is full; nothing stored was changed.")
    assert not task.built_file.exists()


_SIGNALLED_ON_THE_WAY = """
import signal, sys, threading
from pathlib import Path
from rholoc.worker import WorkerSetup
from rholoc.worker.worker import run_worker

class Stop(threading.Event):
    def wait(self, timeout=None):
        with self._cond:
            signal.raise_signal(signal.SIGINT)
        return super().wait(timeout)

run_worker(WorkerSetup(Path(sys.argv[1]) / "data", Path(sys.argv[1]) / "maps"), stop=Stop())
"""


@pytest.mark.slow
def test_a_signal_that_comes_as_the_worker_begins_to_wait_stops_it(tmp_path: Path) -> None:
    subprocess.run([sys.executable, "-c", _SIGNALLED_ON_THE_WAY, str(tmp_path)], check=True, timeout=200)
