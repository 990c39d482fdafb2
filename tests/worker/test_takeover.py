"""Workers that are killed: the next one finishes their jobs, and publishes once."""

import os
import signal
from pathlib import Path

import pytest
import sqlalchemy as sa

from fake_pipeline import KILL_POINTS
from job_site import Site
from postgres_server import PostgresServer
from rholoc.jobs import JobState, Obstacle
from rholoc.jobs.table import jobs_table
from rholoc.jobs.workers_table import WorkerTable
from rholoc.library.maps import MapLibrary
from waiting import until

pytestmark = pytest.mark.slow


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


def test_what_a_killed_worker_had_built_is_not_built_again(site: Site) -> None:
    job = site.survive_kills([["built", "publishing", "after-publishing"]])[0]
    assert (job.state, job.attempts) == (JobState.PUBLISHED, 4)
    assert (len(site.control.processes()), site.control.count("put")) == (1, 1)


def test_stopped_workers_give_their_job_back_at_once_and_do_not_fail_it(site: Site) -> None:
    site.control.hold("read")
    job = site.submit()
    for number in range(2):
        worker = site.start_worker()
        site.wait_at("read", number + 1)
        worker.terminate()
        assert worker.wait(60) == 0
        assert site.queue.get(job.id).state is JobState.QUEUED
    with site.queue.engine.connect() as connection:
        assert connection.execute(sa.select(jobs_table.c.deaths)).scalar_one() == 0, "five would fail it"
    site.control.let_go("read")
    site.start_worker()
    done = site.wait_for(job, JobState.PUBLISHED, JobState.FAILED)
    assert (done.state, done.attempts) == (JobState.PUBLISHED, 3)
    assert site.control.count("put") == 1


@pytest.mark.timeout(900)  # workers are started again after each kill, in a minute on a busy machine
def test_workers_killed_while_they_publish_are_followed_by_others_elsewhere_and_publish_once(campus: Site) -> None:
    jobs = campus.survive_kills([KILL_POINTS[-3:]])
    assert [job.state for job in jobs] == [JobState.PUBLISHED] * len(jobs)
    campus.stores.refresh()
    assert campus.library.names() == sorted(job.map_name for job in jobs)
    assert all(campus.library.versions(name) == {} for name in campus.library.names()), "each was published once"
    assert all(campus.library.get(name).info.version == 1 for name in campus.library.names())


def test_a_job_outlives_a_storage_that_is_gone_for_a_while(campus: Site, storage_url: str) -> None:
    folder = Path(storage_url.removeprefix("file://"))
    campus.control.hold("built")
    campus.start_worker()
    job = campus.submit()
    campus.wait_at("built")
    folder.rename(folder.with_name("gone"))
    folder.write_text("a file stands where the storage was")
    campus.control.let_go("built")
    until(lambda: "publishing" in campus.queue.get(job.id).message)
    folder.unlink()
    folder.with_name("gone").rename(folder)
    assert campus.wait_for(job, JobState.PUBLISHED, JobState.FAILED).state is JobState.PUBLISHED
    until(lambda: campus.library.names() == ["room"])


def test_a_job_outlives_a_database_that_is_started_again(campus: Site, postgres: PostgresServer) -> None:
    campus.control.hold("poses")
    campus.start_worker()
    job = campus.submit()
    campus.wait_at("poses")
    campus.library.names()
    postgres.stop()
    postgres.start()
    campus.control.let_go("poses")
    assert campus.wait_for(job, JobState.PUBLISHED, JobState.FAILED).state is JobState.PUBLISHED
    until(lambda: campus.library.names() == ["room"])


_ENDED = (JobState.PUBLISHED, JobState.FAILED)


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


def test_a_worker_does_as_many_jobs_at_a_time_as_it_has_memory_for(campus: Site) -> None:
    campus.control.hold("poses")
    campus.start_worker(memory_gib=8, jobs=3)
    jobs = [campus.submit(b"3 GiB", f"room-{number}") for number in range(3)]
    campus.wait_at("poses", 2)
    states = [campus.queue.get(job.id).state for job in jobs]
    assert sorted(states) == [JobState.QUEUED, JobState.RUNNING, JobState.RUNNING]
    campus.control.let_go("poses")
    assert all(campus.wait_for(job, *_ENDED).state is JobState.PUBLISHED for job in jobs)
