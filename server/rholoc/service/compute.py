"""A bounded pool of threads for work that keeps a core busy."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import TypeVar

import faiss

from rholoc.errors import Busy

_T = TypeVar("_T")
_SMOOTHING = 0.2  # weight of the newest duration in the running mean
_FIRST_GUESS_S = 0.2


class ComputePool:
    """Runs at most ``concurrency`` functions at a time; at most ``queue_length`` more wait.

    Used from the event loop's thread alone, so its counters need no lock.
    """

    def __init__(self, concurrency: int, queue_length: int) -> None:
        self._executor = ThreadPoolExecutor(
            concurrency, thread_name_prefix="rholoc-compute", initializer=_keep_to_one_core
        )
        self._concurrency = concurrency
        self._capacity = concurrency + queue_length
        self._taken = 0
        self._mean_s = _FIRST_GUESS_S

    @property
    def taken(self) -> int:
        """How many calls run or wait."""
        return self._taken

    @property
    def full(self) -> bool:
        """Whether the next call is refused."""
        return self._taken >= self._capacity

    async def run(self, work: Callable[[], _T]) -> _T:
        """The result of ``work()``, computed in a thread. Who is cancelled while waiting leaves the queue.

        Raises:
            Busy: as many calls wait as may.
        """
        if self.full:
            wait_s = self._mean_s * self._taken / self._concurrency
            raise Busy("The service has as much to do as it can hold.", "Try again after Retry-After.", wait_s)

        def timed() -> tuple[_T, float]:
            start = time.perf_counter()
            return work(), time.perf_counter() - start

        self._taken += 1
        loop, future = asyncio.get_running_loop(), self._executor.submit(timed)
        # When the work ends, not when its caller gives up: a thread cannot be stopped, and keeps its place until then.
        future.add_done_callback(lambda _: _from_thread(loop, self._release))
        result, duration_s = await asyncio.wrap_future(future)
        self._mean_s += _SMOOTHING * (duration_s - self._mean_s)
        return result

    def _release(self) -> None:
        self._taken -= 1

    def close(self) -> None:
        """Let running work end and take no more."""
        self._executor.shutdown(wait=True, cancel_futures=True)


def _from_thread(loop: asyncio.AbstractEventLoop, function: Callable[[], None]) -> None:
    with suppress(RuntimeError):  # the loop is closed: nobody counts any more
        loop.call_soon_threadsafe(function)


def _keep_to_one_core() -> None:
    """Requests run beside each other; were each to spread over all cores too, they would wait for one another."""
    faiss.omp_set_num_threads(1)  # OpenMP keeps this for each thread apart
