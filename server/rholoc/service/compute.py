"""Bounded thread pools for CPU-bound work, in which short work never waits for long work."""

from __future__ import annotations

import asyncio
import contextvars
import math
import os
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from enum import Enum, auto
from typing import TypeVar

import cv2
import faiss

from rholoc.errors import Busy

_T = TypeVar("_T")
_SMOOTHING = 0.2  # weight of the newest duration in the running mean
_FIRST_GUESS_S = 0.2
_CLOSE_TIMEOUT_S = 5.0
_BUSY_AFTER_S = 0.1  # between the frames of a client that sends one after another, the pool still counts as busy
_NICENESS = 5  # of large work; more would let it hold the interpreter while it waits for a core
_THREADS = "rholoc-compute"


class Effort(Enum):
    """How long work is expected to take."""

    ORDINARY = auto()  # like one camera frame
    LARGE = auto()  # many times that


class ComputePool:
    """Runs up to ``concurrency`` functions of each effort at a time; up to ``queue_length`` more of each may wait.

    Large work has threads and a queue of its own, one thread fewer where there are several: however much of it there
    is, ordinary work never waits for it and has a core left. Use it from the event loop's thread only.
    """

    def __init__(self, concurrency: int, queue_length: int) -> None:
        self._lanes = {
            Effort.ORDINARY: _Lane(_THREADS, concurrency, queue_length, _keep_to_one_core),
            Effort.LARGE: _Lane(f"{_THREADS}-large", max(1, concurrency - 1), queue_length, lower_priority),
        }

    @property
    def taken(self) -> int:
        """How many calls run or wait."""
        return sum(lane.taken for lane in self._lanes.values())

    @property
    def busy(self) -> bool:
        """Whether calls of ordinary effort run or wait, or did a moment ago."""
        return self._lanes[Effort.ORDINARY].busy

    @property
    def full(self) -> bool:
        """Whether the next call of ordinary effort is refused."""
        return self._lanes[Effort.ORDINARY].full

    def check_room(self, effort: Effort) -> None:
        """Raise Busy if :meth:`run` would, before any work is done for a request."""
        self._lanes[effort].check_room()

    async def run(self, work: Callable[[], _T], effort: Effort = Effort.ORDINARY) -> _T:
        """The result of ``work()``, computed in a thread. A call that is cancelled while it waits leaves the queue.

        Raises:
            Busy: the queue is full.
        """
        return await self._lanes[effort].run(work)

    def close(self) -> None:
        """Accept no more work, and wait a few seconds for what is running: nobody needs its result any more."""
        for lane in self._lanes.values():
            lane.close()
        deadline_s = time.monotonic() + _CLOSE_TIMEOUT_S
        for thread in compute_threads():
            thread.join(max(0.0, deadline_s - time.monotonic()))


def compute_threads() -> list[threading.Thread]:
    """The threads of all pools of this process that have not ended."""
    return [thread for thread in threading.enumerate() if thread.name.startswith(_THREADS)]


class _Lane:
    """A queue and its threads. Its counters need no lock, because only the event loop's thread uses them."""

    def __init__(self, name: str, concurrency: int, queue_length: int, prepare: Callable[[], None]) -> None:
        self._executor = ThreadPoolExecutor(concurrency, thread_name_prefix=name, initializer=prepare)
        self._concurrency = concurrency
        self._capacity = concurrency + queue_length
        self._mean_s = _FIRST_GUESS_S
        self.taken = 0
        self._last_end_s = -math.inf

    @property
    def busy(self) -> bool:
        return self.taken > 0 or time.monotonic() - self._last_end_s < _BUSY_AFTER_S

    @property
    def full(self) -> bool:
        return self.taken >= self._capacity

    def check_room(self) -> None:
        if self.full:
            wait_s = self._mean_s * self.taken / self._concurrency
            raise Busy("The service is overloaded.", "Try again after Retry-After.", wait_s)

    async def run(self, work: Callable[[], _T]) -> _T:
        self.check_room()

        def timed() -> tuple[_T, float]:
            start = time.perf_counter()
            return work(), time.perf_counter() - start

        self.taken += 1
        loop, context = asyncio.get_running_loop(), contextvars.copy_context()
        future = self._executor.submit(context.run, timed)
        # When the work ends, not when its caller gives up: a thread cannot be stopped, and keeps its place until then.
        future.add_done_callback(lambda _: _from_thread(loop, self._release))
        result, duration_s = await asyncio.wrap_future(future)
        self._mean_s += _SMOOTHING * (duration_s - self._mean_s)
        return result

    def _release(self) -> None:
        self.taken -= 1
        self._last_end_s = time.monotonic()

    def close(self) -> None:
        self._executor.shutdown(wait=False, cancel_futures=True)


def _from_thread(loop: asyncio.AbstractEventLoop, function: Callable[[], None]) -> None:
    with suppress(RuntimeError):  # the loop is closed: the counters no longer matter
        loop.call_soon_threadsafe(function)


def _keep_to_one_core() -> None:
    """Requests run in parallel; if each also used all cores, they would wait for one another."""
    faiss.omp_set_num_threads(1)  # OpenMP keeps this setting per thread
    cv2.setNumThreads(1)


def lower_priority() -> None:
    """As :func:`_keep_to_one_core`; and where cores are few, ordinary work gets them first."""
    _keep_to_one_core()
    if sys.platform == "linux":  # which has priorities per thread
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICENESS)
