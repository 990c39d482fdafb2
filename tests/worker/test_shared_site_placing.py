"""A site of shared maps placed by workers that share no folder."""

from __future__ import annotations

import os
import signal
from typing import TYPE_CHECKING

import pytest

from house import DOORS, PAIRS, placed, put_house, put_rooms
from rholoc.jobs import JobState
from rholoc.library import SiteLibrary
from rholoc.library.stores import SITES
from waiting import until

if TYPE_CHECKING:
    from job_site import Site as Workplace


@pytest.mark.slow
def test_another_machine_places_the_site_of_one_that_died(campus: Workplace) -> None:
    put_rooms(campus.library)
    sites = put_house(SiteLibrary(campus.stores.documents(SITES)))
    campus.control.hold(PAIRS[-1])
    worker = campus.start_worker()
    job = campus.queue.submit_placing("house")
    campus.wait_at(PAIRS[-1])
    os.kill(worker.pid, signal.SIGKILL)
    campus.control.let_go(PAIRS[-1])
    campus.start_worker()
    done = campus.wait_for(job, JobState.PUBLISHED, JobState.FAILED)
    assert (done.state, done.attempts, done.error_message) == (JobState.PUBLISHED, 2, None)
    until(lambda: set(placed(sites.get("house"))) == set(DOORS))
