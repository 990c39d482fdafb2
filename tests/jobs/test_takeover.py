"""Workers that are killed: the next one finishes their jobs, and publishes once."""

from __future__ import annotations

import os
import signal
from typing import TYPE_CHECKING

import pytest
from job_site import alive, until

from rholoc.jobs import JobState
from rholoc.maps import MapLibrary

if TYPE_CHECKING:
    from job_site import Site


KILLED_AT = (
    ("read", "keyframes", "features", "poses"),
    ("observations", "densities", "report", "built"),
    ("publishing", "after-publishing"),
)


@pytest.mark.slow
def test_workers_killed_in_every_stage_lose_no_job_and_publish_each_once(site: Site) -> None:
    worker = site.start_worker()
    for number, points in enumerate(KILLED_AT):
        seen = {point: site.control.count(point) for point in points}
        for point in points:
            site.control.hold(point)
        job = site.submit(map_name=f"room-{number}")
        for point in points:
            site.wait_at(point, seen[point] + 1)
            next_worker = site.start_worker()
            worker.kill()
            worker.wait()
            until(lambda: not any(alive(pid) for pid in site.control.processes()))
            site.control.let_go(point)
            worker = next_worker
        done = site.wait_for(job, JobState.PUBLISHED, JobState.FAILED)
        assert (done.state, done.attempts) == (JobState.PUBLISHED, len(points) + 1)
        assert site.control.count("put") == number + 1
        assert site.recordings.get(job.recording).files == ("walk.mp4",)
    assert site.control.count("read") == 4 + 4 + 1, "what was built is not built again"
    assert MapLibrary(site.maps_dir).names() == ["room-0", "room-1", "room-2"]


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


def test_a_stopped_worker_gives_its_job_back_at_once(site: Site) -> None:
    site.control.hold("poses")
    first = site.start_worker()
    job = site.submit()
    site.wait_at("poses")
    first.terminate()
    assert first.wait(10) == 0
    assert site.queue.get(job.id).state is JobState.QUEUED
    site.control.let_go("poses")
    site.start_worker()
    assert site.wait_for(job, JobState.PUBLISHED, JobState.FAILED).attempts == 2
    assert site.control.count("put") == 1
