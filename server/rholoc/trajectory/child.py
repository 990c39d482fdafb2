"""Run a reconstruction step in a child process, because its native code may crash or have to be killed."""

import logging
from collections.abc import Callable
from typing import Any, TypeVar

from rholoc.errors import MappingFailed
from rholoc.processes import child
from rholoc.progress import ProgressListener, Stage

Result = TypeVar("Result")

_log = logging.getLogger("rholoc.trajectory")
_SINGULAR = "Indeterminant linear system"  # of gtsam's message


class ReconstructionBroken(MappingFailed):
    """The process died, or a library failed unexpectedly."""

    code = MappingFailed.code


class ReconstructionKilled(ReconstructionBroken):
    """The operating system killed the process, probably for lack of memory."""

    code = MappingFailed.code


def run_in_child(function: Callable[..., Result], *args: Any, progress: ProgressListener, stage: Stage) -> Result:
    """Call ``function(*args, listener)`` in a new process and return what it returns.

    Args:
        function: a module-level function; its last parameter is a progress listener.
        args: its other arguments.
        progress: called at least every 0.2 s with the latest progress; if it raises, the process is killed.
        stage: reported until the function's first own report.

    Raises:
        ReconstructionKilled: the process was killed.
        ReconstructionBroken: the process died otherwise, or the function failed unexpectedly.
        MappingFailed: the measurements do not determine the shape of the walk (a singular system).
        RholocError: the function raised it.
    """
    latest: tuple[Stage, float, str] = (stage, 0.0, "")

    def note(stage: Stage, fraction: float, message: str = "") -> None:
        nonlocal latest
        latest = (stage, fraction, message)
        progress(*latest)

    try:
        return child.run_in_child(function, *args, progress=note, check=lambda: progress(*latest), quiet=True)
    except child.ChildDied as died:
        hint = "Give the machine more memory, or record a shorter walk."
        kind = ReconstructionKilled if died.was_killed else ReconstructionBroken
        raise kind(f"The reconstruction's process died ({died.reason}).", hint) from None
    except child.ChildFailed as error:
        _log.exception("the reconstruction failed unexpectedly")
        raise _unexpected(str(error)) from None


def _unexpected(error: str) -> MappingFailed:
    """MappingFailed in place of an unforeseen error, such as a library's, with its text.

    For a singular system the message says that the measurements do not determine the walk's shape.
    """
    if _SINGULAR in error:
        return MappingFailed("What was measured leaves the shape of the walk open.", "Walk further, and in loops.")
    return ReconstructionBroken(
        f"The reconstruction stopped at an unexpected error: {error}",
        "Retry. If it happens again, report this line together with the recording.",
    )
