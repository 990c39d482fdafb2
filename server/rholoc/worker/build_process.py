"""Run a job's build in a child process, so that it can be killed and a native crash does not end the worker."""

import logging
from collections.abc import Callable
from dataclasses import dataclass

from rholoc.disk import is_full, storage_full
from rholoc.errors import RholocError
from rholoc.jobs.job import MoreMemoryNeeded
from rholoc.jobs.leases import Failure
from rholoc.processes.child import ChildDied, named, run_in_child
from rholoc.processes.limits import Limits, MemoryLimitExceeded, TimeLimitExceeded
from rholoc.processes.program import BACKGROUND_NICENESS
from rholoc.progress import ProgressListener
from rholoc.trajectory.child import ReconstructionKilled
from rholoc.worker.pipeline import MappingTask, Pipeline

_log = logging.getLogger("rholoc.worker")
_MAX_ERROR = 200  # characters


@dataclass(frozen=True)
class KilledForMemory:
    """A build was killed, certainly or probably for its memory.

    Attributes:
        failure: reported if no worker has more memory.
        held_bytes: measured memory before it was killed.
    """

    failure: Failure
    held_bytes: float


def build_in_process(
    pipeline: Pipeline,
    task: MappingTask,
    note: ProgressListener,
    check: Callable[[], object],
    poll_s: float,
    cancel_grace_s: float,
    limits: Limits,
) -> Failure | KilledForMemory | MoreMemoryNeeded | None:
    """Run ``pipeline.build(task)`` in a new process. Returns why there is no map file, or None on success. Errors
    become a Failure.

    Args:
        pipeline: of the service.
        task: the job's work.
        note: called with progress, at most every ``poll_s`` seconds.
        check: called every ``poll_s`` seconds; raises Cancelled if the build is no longer wanted.
        poll_s: interval of all checks [s].
        cancel_grace_s: time that a cancelled build has to stop by itself.
        limits: of the build.

    Raises:
        Cancelled: by ``check``. The process has ended.
    """
    try:
        return run_in_child(
            run_build,
            pipeline,
            task,
            limits,
            progress=note,
            check=check,
            poll_s=poll_s,
            grace_s=cancel_grace_s,
            limits=limits,
            niceness=BACKGROUND_NICENESS,
            own_group=True,
        )
    except TimeLimitExceeded:
        return _too_long(limits.time_s)
    except MemoryLimitExceeded as exceeded:
        return _too_much_memory(limits.memory_bytes, exceeded.held_bytes)
    except ChildDied as died:
        return KilledForMemory(_died(died), died.held_bytes) if died.was_killed else _died(died)


def _too_long(time_s: float) -> Failure:
    """Failure of a build that exceeded its time limit [s]."""
    return Failure(
        "mapping_failed",
        f"Mapping took longer than the limit of {time_s:g} s.",
        "Record a shorter walk, or raise RHOLOC_JOB_TIME_LIMIT_S.",
    )


def _too_much_memory(memory_bytes: float, held_bytes: float) -> KilledForMemory:
    """Outcome of a build that exceeded its memory limit [bytes]."""
    failure = Failure(
        "mapping_failed",
        f"Mapping needed more memory than the limit of {memory_bytes / 2**30:.3g} GiB.",
        "Record a shorter walk, raise RHOLOC_JOB_MEMORY_GIB, or run a worker that has more, and retry.",
    )
    return KilledForMemory(failure, held_bytes)


def _died(died: ChildDied) -> Failure:
    """Failure of a build whose process died."""
    return Failure(
        "internal",
        f"The mapping process ended unexpectedly ({died.reason}).",
        "It may have run out of memory: retry, record a shorter walk, or give the worker more memory.",
    )


def run_build(
    pipeline: Pipeline, task: MappingTask, limits: Limits, listener: ProgressListener
) -> Failure | KilledForMemory | MoreMemoryNeeded | None:
    """Run ``pipeline.build`` here; never raises. Returns why it failed or needs another worker, or None on success."""
    try:
        return pipeline.build(task, listener)
    except ReconstructionKilled as error:
        return KilledForMemory(describe(error), 0.0)
    except RholocError as error:
        return describe(error)
    except MemoryError:
        return _too_much_memory(limits.memory_bytes, limits.memory_bytes)
    except OSError as error:
        return describe(storage_full()) if is_full(error) else unexpected(error)
    except Exception as error:
        return unexpected(error)


def describe(error: RholocError) -> Failure:
    """The failure that reports a RholocError."""
    return Failure(error.code, error.message, error.hint)


def unexpected(error: Exception) -> Failure:
    """The failure that reports a bug; logs the traceback."""
    _log.error("A job failed unexpectedly.", exc_info=error)
    return Failure(
        "internal",
        f"An unexpected error stopped the job: {named(error)[:_MAX_ERROR]}",
        "Retry. If it happens again, report this line together with the worker's log.",
    )
