"""Workers that are killed: the next one finishes their jobs, and publishes once."""

from __future__ import annotations

import os
import signal
from typing import TYPE_CHECKING

import pytest

from fake_pipeline import KILL_POINTS
from rholoc.jobs import JobState
from rholoc.library import MapLibrary

if TYPE_CHECKING:
    from job_site import Site


@pytest.mark.slow
@pytest.mark.timeout(900)  # eleven workers are started again, each in a minute on a busy machine
def test_workers_killed_in_every_stage_lose_no_job_and_publish_each_once(site: Site) -> None:
    plans = [KILL_POINTS[:3], KILL_POINTS[3:6], KILL_POINTS[6:8], KILL_POINTS[8:]]
    jobs = site.survive_kills(plans)
    assert [job.state for job in jobs] == [JobState.PUBLISHED] * len(jobs)
    assert {job.map_name: site.control.count(f"put {job.map_name}") for job in jobs} == {
        job.map_name: 1 for job in jobs
    }
    assert all(job.attempts > len(points) for job, points in zip(jobs, plans, strict=True)), "each point killed"
    assert len(site.recordings.list()) == len(jobs)
    assert MapLibrary(site.maps_dir).names() == sorted(job.map_name for job in jobs)


@pytest.mark.slow
def test_two_workers_share_the_queue_and_one_takes_over_from_the_other(site: Site) -> None:
    site.control.hold("poses")
    workers = [site.start_worker(), site.start_worker()]
    jobs = [site.submit(map_name=f"room-{number}") for number in range(2)]
    site.wait_at("poses", 2)
    assert [site.queue.get(job.id).state for job in jobs] == [JobState.RUNNING] * 2
    os.kill(workers[0].pid, signal.SIGKILL)
    site.control.let_go("poses")
    done = [site.wait_for(job, JobState.PUBLISHED, JobState.FAILED) for job in jobs]
    assert [job.state for job in done] == [JobState.PUBLISHED] * 2
    assert sorted(job.attempts for job in done) == [1, 2]
    assert site.control.count("put") == 2


@pytest.mark.slow
def test_a_stopped_worker_gives_its_job_back_at_once(site: Site) -> None:
    site.control.hold("poses")
    first = site.start_worker()
    job = site.submit()
    site.wait_at("poses")
    first.terminate()
    assert first.wait(60) == 0
    assert site.queue.get(job.id).state is JobState.QUEUED
    site.control.let_go("poses")
    site.start_worker()
    assert site.wait_for(job, JobState.PUBLISHED, JobState.FAILED).attempts == 2
    assert site.control.count("put") == 1


@pytest.mark.slow
def test_what_a_killed_worker_had_built_is_not_built_again(site: Site) -> None:
    job = site.survive_kills([["built", "publishing", "after-publishing"]])[0]
    assert (job.state, job.attempts) == (JobState.PUBLISHED, 4)
    assert (len(site.control.processes()), site.control.count("put")) == (1, 1)


@pytest.mark.slow
def test_stopping_workers_does_not_fail_a_job(site: Site) -> None:
    site.control.hold("read")
    job = site.submit()
    for number in range(6):
        worker = site.start_worker()
        site.wait_at("read", number + 1)
        worker.terminate()
        assert worker.wait(60) == 0
    assert site.queue.get(job.id).state is JobState.QUEUED
    site.control.let_go("read")
    site.start_worker()
    done = site.wait_for(job, JobState.PUBLISHED, JobState.FAILED)
    assert (done.state, done.attempts) == (JobState.PUBLISHED, 7)
