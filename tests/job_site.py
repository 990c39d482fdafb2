"""A place for jobs, with real workers in processes of their own."""

import math
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from fake_pipeline import Control
from rholoc.jobs import Job, JobOptions, JobPriority, JobQueue, JobState
from rholoc.library.stores import Stores
from waiting import TIMEOUT_S, until

_HERE = Path(__file__).parent
_KILL_TIMEOUT_S = 60.0


class Site:
    """A data folder, a map folder, the queue on them, and the workers that a test started.

    With a database and a storage, each worker has folders of its own, as on another machine.
    """

    def __init__(self, folder: Path, database_url: str | None = None, storage_url: str | None = None) -> None:
        self._folder = folder
        self._urls = (database_url, storage_url) if database_url and storage_url else ()
        self.data_dir, self.maps_dir = folder / "data", folder / "maps"
        control_dir = folder / "control"
        control_dir.mkdir()
        self.control = Control(control_dir)
        self.stores = Stores(self.maps_dir, self.data_dir, database_url, storage_url)
        self.stores.open(follow=True)
        self.recordings, self.library = self.stores.recordings, self.stores.library
        self.queue = JobQueue(self.recordings)
        self._workers: list[subprocess.Popen[bytes]] = []

    def start_worker(self, memory_gib: float = math.inf, jobs: int = 1) -> subprocess.Popen[bytes]:
        """A worker that makes tiny maps."""
        folder = self._folder / f"worker-{len(self._workers)}" if self._urls else self._folder
        folders = [folder / "data", folder / "maps", self.control.folder]
        capacity = (jobs, memory_gib)
        arguments = [str(_HERE / "fake_pipeline.py"), *map(str, (*folders, *capacity)), *self._urls]
        worker = subprocess.Popen([sys.executable, *arguments])
        self._workers.append(worker)
        return worker

    def submit(
        self, content: bytes = b"a walk", map_name: str = "room", priority: JobPriority = JobPriority.NORMAL
    ) -> Job:
        """Upload a recording and queue its job."""
        entry = self.recordings.create([("walk.mp4", [content])])
        return self.queue.submit(entry.id, map_name, JobOptions(priority=priority))

    def wait_for(self, job: Job, *states: JobState) -> Job:
        """The job, once it is in one of the states."""
        until(lambda: self.queue.get(job.id).state in states)
        return self.queue.get(job.id)

    def wait_at(self, point: str, times: int = 1) -> None:
        """Wait until workers have been at a point of the pipeline."""
        until(lambda: self.control.count(point) >= times)

    def survive_kills(self, plans: Sequence[Sequence[str]]) -> list[Job]:
        """Do jobs, each of which has points where its worker is killed once; the jobs, when all have ended.

        Two workers are kept alive.
        """
        jobs = []
        for number, points in enumerate(plans):
            content = "kill at" + "".join(f" {point}," for point in points)
            jobs.append(self.submit(content.encode(), f"room-{number}"))
        until(lambda: self._have_ended(jobs), TIMEOUT_S + _KILL_TIMEOUT_S * sum(map(len, plans)))
        return [self.queue.get(job.id) for job in jobs]

    def _have_ended(self, jobs: list[Job]) -> bool:
        for _ in range(2 - sum(worker.poll() is None for worker in self._workers)):
            self.start_worker()
        return all(self.queue.get(job.id).state.ended for job in jobs)

    def close(self) -> None:
        """End what was started."""
        for point in list(self.control.folder.glob("hold-*")):
            point.unlink()
        for worker in self._workers:
            worker.send_signal(signal.SIGTERM)
        for worker in self._workers:
            worker.wait(TIMEOUT_S)
        self.queue.close()
        self.stores.close()


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    """A site without workers."""
    site = Site(tmp_path)
    yield site
    site.close()


@pytest.fixture(scope="module")
def busy_site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """A site with one worker, shared by tests that do not harm it."""
    site = Site(tmp_path_factory.mktemp("site"))
    site.start_worker()
    yield site
    site.close()


@pytest.fixture
def campus(tmp_path: Path, postgres_url: str, storage_url: str) -> Iterator[Site]:
    """A site whose workers share no folder."""
    site = Site(tmp_path, postgres_url, storage_url)
    yield site
    site.close()
