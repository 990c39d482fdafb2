"""The queue without a worker."""

from __future__ import annotations

import math
import threading
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import sqlalchemy as sa

from rholoc.errors import Conflict, InvalidName, StorageFull, UnknownJob, UnknownRecording
from rholoc.jobs import JobOptions, JobQueue, JobState
from rholoc.jobs.table import JobTable, overall
from rholoc.maps import DensityKind
from rholoc.progress import Stage
from rholoc.storage.database import open_database, reporting_full_database
from rholoc.storage.tables import jobs_table
from rholoc.trajectory import PoseMethod

if TYPE_CHECKING:
    from job_site import Site


def test_a_submitted_job_waits(site: Site) -> None:
    job = site.submit(map_name="room")
    assert (job.state, job.stage, job.progress, job.attempts) == (JobState.QUEUED, Stage.RECEIVED, 0.0, 0)
    assert site.queue.get(job.id) == job
    later = site.submit()
    assert [listed.id for listed in site.queue.list()] == [later.id, job.id]


def test_another_process_sees_the_same_queue(site: Site) -> None:
    job = site.submit()
    other = JobQueue(site.data_dir)
    assert other.list() == [job]
    other.close()


def test_what_is_wrong_is_refused(site: Site) -> None:
    entry = site.recordings.create([("walk.mp4", [b"x"])])
    with pytest.raises(UnknownRecording):
        site.queue.submit("0" * 32, "room")
    with pytest.raises(InvalidName):
        site.queue.submit(entry.id, "../room")
    for ask in (site.queue.get, site.queue.cancel, site.queue.retry):
        with pytest.raises(UnknownJob):
            ask("0" * 32)
    assert site.queue.list() == []


def test_a_queued_job_is_cancelled_and_retried(site: Site) -> None:
    job = site.submit()
    cancelled = site.queue.cancel(job.id)
    assert (cancelled.state, cancelled.ended is not None) == (JobState.CANCELLED, True)
    with pytest.raises(Conflict):
        site.queue.cancel(job.id)
    again = site.queue.retry(job.id)
    assert (again.state, again.ended) == (JobState.QUEUED, None)
    with pytest.raises(Conflict):
        site.queue.retry(job.id)


def test_a_job_cannot_be_retried_without_its_recording(site: Site) -> None:
    job = site.submit()
    site.queue.cancel(job.id)
    site.recordings.delete(job.recording)
    with pytest.raises(UnknownRecording):
        site.queue.retry(job.id)


def test_only_the_latest_worker_holds_a_job(tmp_path: Path, site: Site) -> None:
    options = JobOptions(DensityKind.TENSOR, "sift", PoseMethod.GIVEN, "500,500,320,240")
    entry = site.recordings.create([("walk.mp4", [b"x"])])
    job = site.queue.submit(entry.id, "room", options)
    engine = open_database(site.data_dir)
    table = JobTable(engine)
    with engine.connect() as connection:
        workflow = connection.execute(sa.select(jobs_table.c.workflow_id)).scalar_one()
    first, work = table.take_up(job.id, workflow)
    assert work.options == options
    second, _ = table.take_up(job.id, workflow)
    assert (table.holds(first), table.holds(second)) == (False, True)
    assert not table.begin_publishing(first)
    assert not table.publish(first, [])
    table.note(first, Stage.POSES, 0.5, "of the first")
    assert (table.get(job.id).state, table.get(job.id).message) == (JobState.RUNNING, "waiting for a worker")
    site.queue.cancel(job.id)
    assert not table.holds(second)
    assert table.take_up(job.id, workflow) is None
    site.queue.retry(job.id)
    assert table.take_up(job.id, workflow) is None, "the workflow before the retry is not wanted any more"
    engine.dispose()


def test_many_threads_may_submit(site: Site) -> None:
    entry = site.recordings.create([("walk.mp4", [b"x"])])
    threads = [threading.Thread(target=site.queue.submit, args=(entry.id, f"room-{number}")) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {job.map_name for job in site.queue.list()} == {f"room-{number}" for number in range(8)}


def test_a_full_database_is_reported(tmp_path: Path) -> None:
    engine = sa.create_engine(f"sqlite:///{tmp_path / 'full.sqlite'}")
    with engine.begin() as connection:
        connection.execute(sa.text("CREATE TABLE t (x)"))
        connection.execute(sa.text("PRAGMA max_page_count = 3"))
        with pytest.raises(StorageFull), reporting_full_database():
            connection.execute(sa.text("INSERT INTO t VALUES (zeroblob(100000))"))


def test_progress_never_goes_back_and_ends_at_one() -> None:
    steps = [overall(stage, fraction) for stage in Stage for fraction in (0.0, 0.5, 1.0)]
    assert steps == sorted(steps)
    assert steps[-1] == pytest.approx(1.0)


def test_recordings_go_when_their_maps_have_been_there_for_long(site: Site) -> None:
    mapped, failed = site.submit(), site.submit()
    both = [mapped.recording, failed.recording]
    with open_database(site.data_dir).begin() as connection:
        for job, state in ((mapped, JobState.PUBLISHED), (failed, JobState.FAILED)):
            connection.execute(jobs_table.update().where(jobs_table.c.id == job.id).values(state=state, ended=1000.0))
    site.queue.delete_mapped_recordings(math.inf)
    assert {entry.id for entry in site.recordings.list()} == set(both)
    site.queue.retry(failed.id)
    again = site.queue.submit(mapped.recording, "other")
    site.queue.delete_mapped_recordings(0.0)
    assert {entry.id for entry in site.recordings.list()} == set(both), "jobs still need them"
    with pytest.raises(Conflict):
        site.queue.delete_recording(mapped.recording)
    with open_database(site.data_dir).begin() as connection:
        connection.execute(
            jobs_table.update().where(jobs_table.c.id == again.id).values(state=JobState.PUBLISHED, ended=1000.0)
        )
    site.queue.delete_mapped_recordings(0.0)
    assert [entry.id for entry in site.recordings.list()] == [failed.recording]


def test_the_same_submission_twice_is_one_job(site: Site) -> None:
    entry = site.recordings.create([("walk.mp4", [b"x"])])
    first = site.queue.submit(entry.id, "room", job_id="1" * 32)
    assert site.queue.submit(entry.id, "room", job_id="1" * 32) == first
    assert site.queue.list() == [first]
