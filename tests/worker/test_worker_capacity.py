"""Workers of different sizes on one PostgreSQL."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from rholoc.jobs import JobState, Obstacle
from rholoc.jobs.workers_table import WorkerTable
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
