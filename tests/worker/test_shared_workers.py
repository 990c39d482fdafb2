"""Workers on several machines: a database and a storage in common, and nothing else."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from fake_pipeline import KILL_POINTS
from rholoc.jobs import JobState
from waiting import until

if TYPE_CHECKING:
    from job_site import Site
    from postgres_server import PostgresServer


@pytest.mark.slow
@pytest.mark.timeout(900)  # workers are started again after each kill, in a minute on a busy machine
def test_workers_killed_while_they_publish_are_followed_by_others_elsewhere_and_publish_once(campus: Site) -> None:
    jobs = campus.survive_kills([KILL_POINTS[-3:]])
    assert [job.state for job in jobs] == [JobState.PUBLISHED] * len(jobs)
    campus.stores.refresh()
    assert campus.library.names() == sorted(job.map_name for job in jobs)
    assert all(campus.library.versions(name) == {} for name in campus.library.names()), "each was published once"
    assert all(campus.library.get(name).info.version == 1 for name in campus.library.names())


@pytest.mark.slow
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


@pytest.mark.slow
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
