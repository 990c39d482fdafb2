"""A function in a child process, so that native code can be killed and may crash without taking us along."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any, TypeVar

from rholoc.errors import MappingFailed, RholocError
from rholoc.progress import ProgressListener, Stage

Result = TypeVar("Result")

_POLL_S = 0.2


def run_in_child(function: Callable[..., Result], *args: Any, progress: ProgressListener, stage: Stage) -> Result:
    """Call ``function(*args, listener)`` in a new process and return what it returns.

    Function, arguments and result must be picklable. What the child tells its listener reaches ``progress``, which is
    called at least every 0.2 s with the last that was told; when it raises, the child is killed.

    Args:
        function: a module's function whose last parameter is a progress listener.
        args: its other arguments.
        progress: hears of progress here; may raise :class:`rholoc.errors.Cancelled`.
        stage: told until the child tells something itself.

    Raises:
        MappingFailed: the child died.
        RholocError: the function raised it.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_child, args=(theirs, function, args), name=f"rholoc-{function.__name__}")
    process.start()
    theirs.close()
    last: tuple[Stage, float, str] = (stage, 0.0, "")
    try:
        while True:
            progress(*last)
            if not ours.poll(_POLL_S):
                continue
            try:
                kind, content = ours.recv()
            except EOFError:
                process.join()
                raise MappingFailed(
                    f"The reconstruction's process died (status {process.exitcode}).",
                    "Give the machine more memory, or record a shorter walk.",
                ) from None
            if kind == "progress":
                last = content
            elif kind == "error":
                raise content
            else:
                return content  # type: ignore[no-any-return]
    finally:
        process.kill()
        process.join()
        ours.close()


def _child(pipe: Connection, function: Callable[..., Any], args: tuple[Any, ...]) -> None:
    threading.Thread(target=_die_with_parent, daemon=True).start()
    _silence_native_code()
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # pycolmap's own handler may wait for itself for ever
    lock = threading.Lock()

    def listener(stage: Stage, fraction: float, message: str = "") -> None:
        with lock:
            pipe.send(("progress", (stage, fraction, message)))

    with contextlib.suppress(BrokenPipeError):
        try:
            answer = ("result", function(*args, listener))
        except RholocError as error:
            answer = ("error", error)
        except Exception as error:
            answer = (
                "error",
                MappingFailed(f"The reconstruction failed: {error}".splitlines()[0], "Please report this recording."),
            )
        with lock:
            pipe.send(answer)


def _silence_native_code() -> None:
    """Native libraries print what they meet on the way; what matters comes back as an error."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(nowhere, stream)
    os.close(nowhere)


def _die_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
