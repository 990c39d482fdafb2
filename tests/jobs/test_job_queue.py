"""The queue without a worker."""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import sqlalchemy as sa
from hypothesis import given
from hypothesis import strategies as st

from rholoc.errors import Conflict, InvalidName, StorageFull, UnknownJob, UnknownRecording
from rholoc.jobs import JobOptions, JobPriority, JobQueue, JobState, Obstacle
from rholoc.jobs.job import MoreMemoryNeeded, memory_for_walk
from rholoc.jobs.leases import Leases, overall
from rholoc.jobs.turns import turn_of
from rholoc.jobs.workers_table import WorkerTable
from rholoc.library.recording_notes import READ_FILES, RecordingNotes
from rholoc.library.recordings import RecordingStore
from rholoc.maps import DensityKind
from rholoc.progress import Stage
from rholoc.reports import report_to_json
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
    other = JobQueue(RecordingStore(site.data_dir))
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


def test_a_retried_job_waits_as_long_as_its_walk_is(site: Site, leases: Leases) -> None:
    """Its turn came by the size of its file, though a job had read how long the walk is."""
    long, short = site.submit(), site.submit()
    for job, length_s in ((long, 900.0), (short, 9.0)):
        notes = RecordingNotes(0.0, length_s, 30, 640, 480, "rholoc", imu=False)
        site.recordings.note(job.recording, {READ_FILES[0]: json.dumps(report_to_json(notes)).encode()})
        site.queue.cancel(job.id)
        site.queue.retry(job.id)
    assert leases.take("worker").lease.job == short.id


def test_a_job_cannot_be_retried_without_its_recording(site: Site) -> None:
    job = site.submit()
    site.queue.cancel(job.id)
    site.recordings.delete(job.recording)
    with pytest.raises(UnknownRecording):
        site.queue.retry(job.id)


def test_only_the_latest_worker_holds_a_job(site: Site) -> None:
    options = JobOptions(DensityKind.TENSOR, "sift", PoseMethod.GIVEN, "500,500,320,240")
    entry = site.recordings.create([("walk.mp4", [b"x"])])
    job = site.queue.submit(entry.id, "room", options)
    engine = open_database(site.data_dir)
    leases = Leases(engine)
    claim = leases.take("one")
    assert (claim.work.options, site.queue.get(job.id).worker) == (options, "one")
    assert leases.take("other") is None
    assert leases.take_back(["one", "other"]) == 0
    assert leases.take_back(["other"]) == 1
    began = site.queue.get(job.id).started
    first, second = claim.lease, leases.take("other").lease
    assert site.queue.get(job.id).started > began, "the time left counts from where the second began"
    assert (leases.holds(first), leases.holds(second)) == (False, True)
    assert second.run == first.run, "the second goes on where the first stopped"
    assert not leases.begin_publishing(first)
    assert not leases.publish(first, [])
    leases.note(first, Stage.POSES, 0.5, "of the first")
    assert (site.queue.get(job.id).state, site.queue.get(job.id).message) == (
        JobState.RUNNING,
        "waiting for another worker: its worker died",
    )
    site.queue.cancel(job.id)
    assert not leases.holds(second)
    assert leases.take("one") is None
    site.queue.retry(job.id)
    assert leases.take("one").lease.run != second.run, "what was done before the retry is done again"
    engine.dispose()


def taken(leases: Leases, **offered: Any) -> list[str]:
    """The maps of the jobs that a worker takes, in order, until there are no more for it."""
    names = []
    while claim := leases.take("worker", **offered):
        names.append(claim.work.map_name)
    return names


@pytest.fixture
def leases(site: Site) -> Iterator[Leases]:
    engine = open_database(site.data_dir)
    yield Leases(engine)
    engine.dispose()


def test_short_walks_and_high_priorities_come_first(site: Site, leases: Leases) -> None:
    site.submit(bytes(3_000_000), "long")
    site.submit(map_name="low", priority=JobPriority.LOW)
    site.submit(map_name="short")
    site.submit(map_name="high", priority=JobPriority.HIGH)
    raised = site.submit(bytes(3_000_000), "raised")
    assert site.queue.prioritize(raised.id, JobPriority.HIGH).priority is JobPriority.HIGH
    assert taken(leases) == ["high", "raised", "short", "long", "low"]
    with pytest.raises(Conflict, match="no longer waits"):
        site.queue.prioritize(raised.id, JobPriority.LOW)
    with pytest.raises(UnknownJob):
        site.queue.prioritize("0" * 32, JobPriority.LOW)


@given(
    first=st.sampled_from(JobPriority),
    later=st.sampled_from(JobPriority),
    lengths_s=st.tuples(st.floats(0, 3600), st.floats(0, 3600)),
)
def test_every_jobs_turn_comes(first: JobPriority, later: JobPriority, lengths_s: tuple[float, float]) -> None:
    """Nothing that is submitted four days later overtakes, whatever the two are."""
    assert turn_of(0.0, first, lengths_s[0]) < turn_of(4 * 86400.0, later, lengths_s[1])


def test_a_worker_leaves_what_it_has_no_memory_for(site: Site, leases: Leases) -> None:
    big, small = site.submit(map_name="big"), site.submit(map_name="small")
    assert leases.hand_on(leases.take("one").lease, 4 * 2**30)
    assert site.queue.get(big.id).memory_bytes == 4 * 2**30
    assert leases.take("one", memory_bytes=8 * 2**30, free_bytes=2**30) is None, (
        "the long one is not overtaken for ever"
    )
    assert taken(leases, memory_bytes=2 * 2**30) == ["small"]
    assert taken(leases, memory_bytes=8 * 2**30) == ["big"]
    assert {site.queue.get(job.id).worker for job in (big, small)} == {"worker"}


def test_a_job_that_no_worker_can_take_says_why(site: Site, leases: Leases) -> None:
    workers = WorkerTable(site.queue.engine)
    job = site.submit()
    assert (job.obstacle, job.message) == (Obstacle.NO_WORKER, "waiting for a worker: none is running")
    workers.beat("small", memory_bytes=2 * 2**30)
    assert [(one.obstacle, one.message) for one in site.queue.list()] == [(None, "waiting for a worker")]
    leases.hand_on(leases.take("small").lease, 4 * 2**30)
    waiting = site.queue.get(job.id)
    assert waiting.obstacle is Obstacle.MEMORY
    assert waiting.message == "waiting for a worker with 4.0 GiB of memory for it: none has more than 2.0 GiB"
    assert site.queue.waiting() == {None: 0, Obstacle.NO_WORKER: 0, Obstacle.WORKER_FAILS: 0, Obstacle.MEMORY: 1}
    workers.beat("large", memory_bytes=8 * 2**30)
    assert site.queue.get(job.id).obstacle is None
    assert site.queue.waiting()[None] == 1


def test_a_worker_that_dies_again_and_again_stands_in_the_way(site: Site, leases: Leases) -> None:
    job = site.submit()
    site.queue.report_worker("the worker died 2 times in a row: signal 6")
    waiting = site.queue.get(job.id)
    assert waiting.obstacle is Obstacle.WORKER_FAILS
    assert waiting.message == "waiting for a worker: the worker died 2 times in a row: signal 6"
    WorkerTable(site.queue.engine).beat("another")
    assert site.queue.get(job.id).obstacle is None, "it can take the job"
    WorkerTable(site.queue.engine).remove("another")
    site.queue.report_worker(None)
    assert site.queue.get(job.id).obstacle is Obstacle.NO_WORKER


def test_only_deaths_are_counted(site: Site, leases: Leases) -> None:
    job = site.submit()
    for _ in range(6):
        claim = leases.take("worker")
        assert claim.deaths == 0
        leases.give_back(claim.lease)
    for deaths in range(3):
        assert leases.take("worker").deaths == deaths
        assert leases.take_back(["another"]) == 1
    waiting = site.queue.get(job.id)
    assert waiting.log[-1].endswith("waiting for another worker: its worker died")
    site.queue.cancel(job.id)
    site.queue.retry(job.id)
    assert leases.take("worker").deaths == 0


@pytest.mark.parametrize(
    ("held", "granted", "most", "needed"),
    [
        (1000.0, 1000.0, 1000.0, None),  # nobody has more
        (1000.0, math.inf, math.inf, None),
        (1000.0, 1000.0, 1200.0, 1200),
        (1000.0, 1000.0, 4000.0, 1500),
        (0.0, 1000.0, math.inf, 1001),  # it was killed before anybody looked
    ],
)
def test_what_was_killed_for_its_memory_needs_more(
    held: float, granted: float, most: float, needed: int | None
) -> None:
    more = MoreMemoryNeeded.after(held, granted, most)
    assert (None if more is None else more.memory_bytes) == needed


def test_memory_is_estimated_from_length_and_pixels() -> None:
    walk = {length_s: memory_for_walk(length_s, 640 * 480) / 1e9 for length_s in (30, 120, 300, 600)}
    measured_gb = {30: 1.12, 120: 1.43, 300: 2.25, 600: 3.68}
    assert all(measured_gb[length_s] < walk[length_s] < measured_gb[length_s] * 1.15 for length_s in walk)
    assert memory_for_walk(30, 3840 * 2160) > memory_for_walk(30, 640 * 480)


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
    placing = (Stage.RECEIVED, Stage.LINKS, Stage.PUBLISHED)
    for stages in ([stage for stage in Stage if stage is not Stage.LINKS], placing):
        steps = [overall(stage, fraction) for stage in stages for fraction in (0.0, 0.5, 1.0)]
        assert steps == sorted(steps)
        assert steps[-1] == pytest.approx(1.0)


def test_progress_is_steady() -> None:
    measured_s = {  # of the first 450 frames of a phone's video with IMU
        Stage.READ: 0.5, Stage.KEYFRAMES: 11.8, Stage.FEATURES: 1.7, Stage.POSES: 12.3, Stage.OBSERVATIONS: 3.7,
        Stage.DENSITIES: 0.5, Stage.REPORT: 0.1,
    }  # fmt: skip
    spent_s = 0.0
    for stage, duration_s in measured_s.items():
        spent_s += duration_s
        assert overall(stage, 1.0) == pytest.approx(spent_s / sum(measured_s.values()), abs=0.03)


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
