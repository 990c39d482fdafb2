"""Threads for calls that block on database, storage or disk, so that the event loop never does."""

import asyncio
import contextvars
import threading
from collections.abc import Callable, Coroutine
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any, ParamSpec, TypeVar

from rholoc.errors import StorageUnavailable

P = ParamSpec("P")
T = TypeVar("T")

_NAME = "rholoc-storage"


class StorageThreads:
    """Runs calls in a few threads of its own; ``await threads(library.get, name)``. Use it from the event loop only.

    A call blocked by a database that does not answer keeps its thread until the database's own timeout, but its caller
    gets an error after ``timeout_s``. While such calls hold all threads, further calls are refused at once.

    Args:
        threads: maximum number of running calls; any number may wait.
        timeout_s: of a call, including its wait for a thread.
    """

    def __init__(self, threads: int, timeout_s: float) -> None:
        self._threads = threads
        self._timeout_s = timeout_s
        self._executor = ThreadPoolExecutor(threads, thread_name_prefix=_NAME)
        self._overdue = 0

    async def __call__(self, call: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """The result of ``call(*args, **kwargs)``. Raises StorageUnavailable after too long; the call may go on."""
        if self._overdue >= self._threads:
            raise _unavailable()
        context = contextvars.copy_context()
        future = self._executor.submit(context.run, partial(call, *args, **kwargs))
        waiting = asyncio.wrap_future(future)
        try:
            done, _ = await asyncio.wait({waiting}, timeout=self._timeout_s)
        except asyncio.CancelledError:
            self._give_up(future, waiting)
            raise
        if done:
            return waiting.result()
        self._give_up(future, waiting)
        raise _unavailable()

    def offload(self, call: Callable[P, T]) -> Callable[P, Coroutine[Any, Any, T]]:
        """Coroutine function that runs ``call`` in these threads; it raises StorageUnavailable after too long."""

        async def offloaded(*args: P.args, **kwargs: P.kwargs) -> T:
            return await self(call, *args, **kwargs)

        return offloaded

    def close(self) -> None:
        """Accept no more calls, and cancel those that wait for a thread; running ones go on."""
        self._executor.shutdown(wait=False, cancel_futures=True)

    def _give_up(self, future: Future[T], waiting: asyncio.Future[T]) -> None:
        """Remove a call from the queue; if it is running, count its thread as blocked until it returns."""
        loop = asyncio.get_running_loop()
        waiting.add_done_callback(lambda ended: ended.cancelled() or ended.exception())
        if future.cancel():
            return
        self._overdue += 1
        future.add_done_callback(lambda _: _in_loop(loop, self._returned))

    def _returned(self) -> None:
        """Count a blocked thread as free again."""
        self._overdue -= 1


@dataclass(frozen=True)
class StorageLanes:
    """Threads by resource, so that a database or storage that does not answer blocks only its own users.

    Attributes:
        database: SQL, and small files of the data folder.
        files: maps and pictures on this machine.
        fetches: fetching maps from the storage.
        transfers: storing maps and recordings, within 300 s; the other lanes' calls may take 8 s.
    """

    database: StorageThreads = field(default_factory=lambda: StorageThreads(16, 8.0))
    files: StorageThreads = field(default_factory=lambda: StorageThreads(8, 8.0))
    fetches: StorageThreads = field(default_factory=lambda: StorageThreads(4, 8.0))
    transfers: StorageThreads = field(default_factory=lambda: StorageThreads(8, 300.0))

    def close(self) -> None:
        """Accept no more calls, and cancel those that wait for a thread; running ones go on."""
        for lane in (self.database, self.files, self.fetches, self.transfers):
            lane.close()


def storage_threads() -> list[threading.Thread]:
    """Living threads of this process's lanes; a blocked call keeps one alive."""
    return [thread for thread in threading.enumerate() if thread.name.startswith(_NAME)]


def _in_loop(loop: asyncio.AbstractEventLoop, function: Callable[[], None]) -> None:
    """Call a function in the event loop's thread; nothing if the loop is closed."""
    with suppress(RuntimeError):  # the loop is closed
        loop.call_soon_threadsafe(function)


def _unavailable() -> StorageUnavailable:
    """Error for a call that took too long, or could not begin."""
    return StorageUnavailable(
        "The server's storage or its database does not answer.", "What it has in memory is still served. Try again."
    )
