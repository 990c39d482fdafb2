"""Workers of different sizes and releases on one PostgreSQL."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from rholoc.jobs import JobQueue, JobState, Obstacle
from rholoc.jobs.table import RELEASE, WorkerTable
from waiting import until

if TYPE_CHECKING:
    from job_site import Site

_ENDED = (JobState.PUBLISHED, JobState.FAILED)


@pytest.mark.slow
def test_a_long_walk_is_left_to_the_worker_that_has_the_memory(campus: Site) -> None:
    campus.start_worker(memory_gib=2)
    long = campus.submit(b"4 GiB, a long walk", "long")
    until(lambda: campus.queue.get(long.id).obstacle is Obstacle.MEMORY)
    assert "4.0 GiB" in campus.queue.get(long.id).message
    short = campus.submit(b"1 GiB, a short walk", "short")
    assert campus.wait_for(short, *_ENDED).state is JobState.PUBLISHED, "the small worker goes on with others"
    campus.start_worker(memory_gib=6, jobs=2)
    done = campus.wait_for(long, *_ENDED)
    assert (done.state, done.attempts, done.obstacle) == (JobState.PUBLISHED, 2, None)


@pytest.mark.slow
def test_a_job_that_is_killed_for_its_memory_goes_to_a_worker_with_more(campus: Site) -> None:
    campus.start_worker(memory_gib=2)
    alone = campus.submit(b"killed below 4 GiB", "alone")
    failed = campus.wait_for(alone, *_ENDED)
    assert (failed.state, failed.attempts) == (JobState.FAILED, 1), "nobody has more"
    campus.start_worker(memory_gib=6)
    until(lambda: {worker.memory_bytes for worker in WorkerTable(campus.queue.engine).living()} == {2**31, 6 * 2**30})
    jobs = [campus.submit(b"killed below 4 GiB", f"room-{number}") for number in range(4)]
    assert all(campus.wait_for(job, *_ENDED).state is JobState.PUBLISHED for job in jobs)
    campus.queue.retry(alone.id)
    done = campus.wait_for(alone, *_ENDED)
    assert (done.state, done.attempts <= 2) == (JobState.PUBLISHED, True)


@pytest.mark.slow
def test_a_worker_does_as_many_jobs_at_a_time_as_it_has_memory_for(campus: Site) -> None:
    campus.control.hold("poses")
    campus.start_worker(memory_gib=8, jobs=3)
    jobs = [campus.submit(b"3 GiB", f"room-{number}") for number in range(3)]
    campus.wait_at("poses", 2)
    states = [campus.queue.get(job.id).state for job in jobs]
    assert sorted(states) == [JobState.QUEUED, JobState.RUNNING, JobState.RUNNING]
    campus.control.let_go("poses")
    assert all(campus.wait_for(job, *_ENDED).state is JobState.PUBLISHED for job in jobs)


@pytest.mark.slow
def test_a_rolling_update_loses_no_job(campus: Site, tmp_path: Path, postgres_url: str) -> None:
    """An old and a new release's server submit, their workers work, the old worker dies in the middle of a job."""
    updated = JobQueue(tmp_path / "updated", postgres_url, campus.recordings, release=RELEASE + 1)
    campus.control.hold("poses")
    old = campus.start_worker()
    first = campus.submit(map_name="of-old")
    campus.wait_at("poses")
    entry = campus.recordings.create([("walk.mp4", [b"a walk"])])
    of_new = updated.submit(entry.id, "of-new")
    assert campus.queue.get(of_new.id).obstacle is Obstacle.RELEASE
    campus.start_worker(release=RELEASE + 1)
    campus.wait_at("poses", 2)
    second = campus.submit(map_name="of-old-too")
    assert updated.get(first.id).worker != updated.get(of_new.id).worker
    os.kill(old.pid, signal.SIGKILL)
    campus.control.let_go("poses")
    done = [campus.wait_for(job, *_ENDED) for job in (first, of_new, second)]
    assert [job.state for job in done] == [JobState.PUBLISHED] * 3
    assert [job.attempts for job in done] == [2, 1, 1]
    until(lambda: campus.library.names() == ["of-new", "of-old", "of-old-too"])
    assert all(campus.library.versions(name) == {} for name in campus.library.names()), "each was published once"
    updated.close()
