"""``rholoc job``: the mapping jobs of a server, and how soon their turn comes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from rholoc.cli.console import output, print_json, print_notice
from rholoc.cli.maps.page import trust_line
from rholoc.cli.operate.serve import Data, service_settings
from rholoc.cli.options import Json, choice

if TYPE_CHECKING:
    from rholoc.jobs.job import Job
    from rholoc.jobs.queue import JobQueue
    from rholoc.service import Settings

app = typer.Typer(help="Show the mapping jobs of a server, and say how soon their turn comes.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    pass


@app.command("list")
def list_jobs(data: Data = None, as_json: Json = False) -> None:
    """Show all jobs, the newest first, and whether their maps are to be trusted."""
    with open_queue(service_settings(data_dir=data)) as queue:
        jobs = sorted(queue.list(), key=lambda job: job.created, reverse=True)
    if as_json:
        print_json([asdict(job) | {"trusted": job.trusted} for job in jobs])
        return
    if not jobs:
        print_notice("There are no jobs.")
    for job in jobs:
        output.print(f"{job.id}: {job.map_name or _subject(job)}, {_outcome(job)}", markup=False, soft_wrap=True)


@app.command()
def prioritize(
    job: Annotated[str, typer.Argument(metavar="JOB", help="The job's id, as rholoc job list shows it.")],
    priority: Annotated[str, typer.Argument(metavar="high|normal|low", help="How soon its turn comes.")],
    data: Data = None,
) -> None:
    """Change the priority of a job that waits for a worker."""
    from rholoc.jobs.job import JobPriority

    wanted = choice(JobPriority, priority, "The priority")
    with open_queue(service_settings(data_dir=data)) as queue:
        changed = queue.prioritize(job, wanted)
    print_notice(f"The job for {_subject(changed)} has priority {changed.priority}.")


@contextmanager
def open_queue(settings: Settings) -> Iterator[JobQueue]:
    """The queue of a server, connected. Raises StorageUnavailable, StorageFull, InvalidInput, Conflict."""
    from rholoc.jobs.queue import JobQueue

    queue = JobQueue(settings.stores().recordings)
    try:
        queue.check()
        yield queue
    finally:
        queue.close()


def _subject(job: Job) -> str:
    """ "the map NAME" or "the site NAME" that a job is for."""
    return f"the site {job.site}" if job.site else f"the map {job.map_name}"


def _outcome(job: Job) -> str:
    """State of a job with its error, warnings, trust or stage, in one line."""
    if job.error_message is not None:
        return f"{job.state}: {job.error_message}"
    if job.trusted is None and job.warnings:
        return f"{job.state}: {' '.join(job.warnings)}"
    if job.trusted is not None:
        return f"{job.state}, trusted: {trust_line(job.trusted, ' '.join(job.warnings))}"
    return f"{job.state}, {job.stage if job.obstacle is None else job.message}"
