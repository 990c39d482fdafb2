"""Bounded thread pools for CPU-bound work, in which short work never waits for long work."""

from __future__ import annotations

import asyncio
import contextvars
import math
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum, auto
from functools import partial
from typing import Any, TypeVar

import cv2
import faiss

from rholoc.errors import Busy
from rholoc.service.caller import CLIENT
from rholoc.service.threads.niceness import make_thread_nice

_T = TypeVar("_T")
_SMOOTHING = 0.2  # weight of the newest duration in the running mean
_FIRST_GUESS_S = 0.2
_CLOSE_TIMEOUT_S = 5.0
_BUSY_AFTER_S = 0.1  # the pool counts as busy for this time after a frame, to bridge the gaps in a client's stream
_NICENESS = 5  # of large work; with more it might hold the interpreter while it waits for a core
_THREADS = "rholoc-compute"
_COSTLY_S, _COSTLY_RATIO = 0.25, 3.0  # minimum core time per result of a costly client, and its ratio to another's
_MIN_USEFUL = 0.05  # of a client's calls
_ACTIVE_S = 5.0
_MAX_CLIENTS = 1000


class Effort(Enum):
    """Expected duration of work."""

    ORDINARY = auto()  # like one camera frame
    LARGE = auto()  # many times that


class ComputePool:
    """Runs up to ``concurrency`` functions of each effort at a time; up to ``queue_length`` more of each may wait.

    Large work has its own queue and threads, one fewer than ``concurrency`` if that is over one, so that ordinary work
    never waits for it and always has a core. In each queue, the client with the least used core time goes first. While
    others are active, the ordinary work of a client counts as large if each useful result costs several times what
    theirs cost, because its work is long or seldom of use. Use it from the event loop's thread only.
    """

    def __init__(self, concurrency: int, queue_length: int) -> None:
        self._costs: dict[str, _Cost] = {}
        self._lanes = {
            Effort.ORDINARY: _Lane(_THREADS, concurrency, queue_length, _keep_to_one_core),
            Effort.LARGE: _Lane(f"{_THREADS}-large", max(1, concurrency - 1), queue_length, lower_priority),
        }

    @property
    def taken(self) -> int:
        """Number of running and waiting calls."""
        return sum(lane.taken for lane in self._lanes.values())

    @property
    def busy(self) -> bool:
        """Whether calls of ordinary effort run or wait, or did within the last 0.1 s."""
        return self._lanes[Effort.ORDINARY].busy

    @property
    def full(self) -> bool:
        """Whether ordinary calls run and wait up to the limit, so that the next is refused or displaces another."""
        return self._lanes[Effort.ORDINARY].full

    def check_room(self, effort: Effort) -> None:
        """Raise Busy if :meth:`run` would, before any work is done for a request."""
        self._lanes[effort].check_room(CLIENT.get())

    async def run(
        self,
        work: Callable[[], _T],
        effort: Effort = Effort.ORDINARY,
        is_useful: Callable[[_T], bool] = lambda result: True,
    ) -> _T:
        """The result of ``work()``, computed in a thread. A call that is cancelled while it waits leaves the queue.

        Args:
            work: function to run.
            effort: how long it is expected to take.
            is_useful: whether a result is of use to the client, as a pose is and a refusal is not.

        Raises:
            Busy: the queue is full, and no other client has more calls in it; or the call waited, and was displaced by
                one of a client with fewer.
        """
        client = CLIENT.get()
        if effort is Effort.LARGE:
            return (await self._lanes[effort].run(work, client))[0]
        lane = Effort.LARGE if self._is_costly(client) else effort
        result, cost_s = await self._lanes[lane].run(work, client)
        self._note(client, cost_s, is_useful(result))
        return result

    def _is_costly(self, client: str) -> bool:
        """Whether a client's useful results cost over 0.25 s of core time each, and over 3 × those of a client active
        in the last 5 s.
        """
        own, now_s = self._costs.get(client), time.monotonic()
        if own is None or own.per_result_s <= _COSTLY_S:
            return False
        others = [one for name, one in self._costs.items() if name != client and now_s - one.last_s < _ACTIVE_S]
        return any(own.per_result_s > _COSTLY_RATIO * other.per_result_s for other in others)

    def _note(self, client: str, cost_s: float, is_useful: bool) -> None:
        """Update the moving averages of a client's cost and usefulness."""
        now_s, before = time.monotonic(), self._costs.get(client, _Cost(cost_s, float(is_useful), 0.0))
        if client not in self._costs and len(self._costs) >= _MAX_CLIENTS:
            self._costs = {name: one for name, one in self._costs.items() if now_s - one.last_s < _ACTIVE_S}
        self._costs[client] = _Cost(
            before.mean_s + _SMOOTHING * (cost_s - before.mean_s),
            before.useful + _SMOOTHING * (is_useful - before.useful),
            now_s,
        )

    def close(self) -> None:
        """Start no more calls, and wait at most 5 s for running ones; callers of waiting ones get no answer."""
        for lane in self._lanes.values():
            lane.close()
        deadline_s = time.monotonic() + _CLOSE_TIMEOUT_S
        for lane in self._lanes.values():
            lane.join(deadline_s)


def compute_threads() -> list[threading.Thread]:
    """The threads of all pools of this process that have not ended."""
    return [thread for thread in threading.enumerate() if thread.name.startswith(_THREADS)]


@dataclass(frozen=True)
class _Cost:
    """Mean core time of a client's ordinary calls, the share that was useful, and the end of the last one."""

    mean_s: float
    useful: float
    last_s: float

    @property
    def per_result_s(self) -> float:
        """Core time per useful result [s]; at least 5 % of the calls count as useful."""
        return self.mean_s / max(self.useful, _MIN_USEFUL)


@dataclass(eq=False)
class _Call:
    """A running or waiting call; ``result`` gets its return value and its core time [s]."""

    client: str
    work: Callable[[], Any]
    result: asyncio.Future[tuple[Any, float]]
    expected_s: float = 0.0


class _Lane:
    """Threads, and a queue for each client. It needs no lock, because only the event loop's thread uses it."""

    def __init__(self, name: str, concurrency: int, queue_length: int, prepare: Callable[[], None]) -> None:
        self._threads: list[threading.Thread] = []
        self._prepare = prepare
        self._executor = ThreadPoolExecutor(concurrency, thread_name_prefix=name, initializer=self._begin_thread)
        self._concurrency = concurrency
        self._queue_length = queue_length
        self._mean_s = _FIRST_GUESS_S
        self._running = 0
        self._waiting: dict[str, deque[_Call]] = {}
        self._used_s: dict[str, float] = {}  # core time of each client, at least that of the client served last
        self._served_s = 0.0
        self._last_end_s = -math.inf

    @property
    def taken(self) -> int:
        """Number of running and waiting calls."""
        return self._running + sum(map(len, self._waiting.values()))

    @property
    def busy(self) -> bool:
        """Whether calls run or wait, or did within the last 0.1 s."""
        return self.taken > 0 or time.monotonic() - self._last_end_s < _BUSY_AFTER_S

    @property
    def full(self) -> bool:
        """Whether as many calls run and wait as may."""
        return self.taken >= self._concurrency + self._queue_length

    def check_room(self, client: str) -> None:
        """Raise Busy if the queue is full and no client has more calls in it than ``client`` would have."""
        if self.full and self._greediest(client) is None:
            raise self._busy()

    async def run(self, work: Callable[[], _T], client: str) -> tuple[_T, float]:
        """The result of ``work()`` and its core time [s]. Raises Busy as :meth:`ComputePool.run`."""
        self.check_room(client)
        greediest = self._greediest(client) if self.full else None
        if greediest is not None:
            self._waiting[greediest].pop().result.set_exception(self._busy())
        loop, context = asyncio.get_running_loop(), contextvars.copy_context()
        call = _Call(client, lambda: context.run(work), loop.create_future())
        self._used_s[client] = max(self._used_s.get(client, 0.0), self._served_s)
        self._waiting.setdefault(client, deque()).append(call)
        self._dispatch(loop)
        try:
            return await call.result
        finally:
            with suppress(KeyError, ValueError):
                self._waiting[client].remove(call)

    def _greediest(self, client: str) -> str | None:
        """The client with the most waiting calls; None unless it has more than ``client`` will have."""
        most = max(self._waiting, key=lambda name: len(self._waiting[name]), default=None)
        mine = len(self._waiting.get(client, ()))
        return most if most is not None and len(self._waiting[most]) > mine + 1 else None

    def _busy(self) -> Busy:
        """Error for a refused call; its ``retry_after_s`` is the expected wait of the calls taken."""
        wait_s = self._mean_s * self.taken / self._concurrency
        return Busy("The service is overloaded.", "Try again after Retry-After.", wait_s)

    def _dispatch(self, loop: asyncio.AbstractEventLoop) -> None:
        """Start waiting calls in free threads, first those of the client that has used the least core time."""
        self._waiting = {client: calls for client, calls in self._waiting.items() if calls}
        while self._running < self._concurrency and self._waiting:
            client = min(self._waiting, key=lambda name: self._used_s[name])
            call = self._waiting[client].popleft()
            if not self._waiting[client]:
                del self._waiting[client]
            self._served_s = max(self._served_s, self._used_s[client])
            # Counts as a mean call until its cost is known, so that a client's calls do not all start at once.
            call.expected_s = self._mean_s
            self._used_s[client] += call.expected_s
            self._running += 1
            # A thread cannot be stopped: it keeps its place until its work ends, even without a waiting caller.
            self._executor.submit(_timed, call.work).add_done_callback(partial(self._from_thread, loop, call))

    def _from_thread(self, loop: asyncio.AbstractEventLoop, call: _Call, ended: Future[_Ended]) -> None:
        """Pass the end of a call from its thread to the event loop."""
        with suppress(RuntimeError):  # the loop is closed: nobody waits
            loop.call_soon_threadsafe(self._ended, call, ended, loop)

    def _ended(self, call: _Call, ended: Future[_Ended], loop: asyncio.AbstractEventLoop) -> None:
        """Take a call's outcome, count its core time to the client, and start the next calls."""
        self._running -= 1
        self._last_end_s = time.monotonic()
        if not ended.cancelled():
            outcome = ended.result()
            self._used_s[call.client] += outcome.cost_s - call.expected_s
            self._mean_s += _SMOOTHING * (outcome.cost_s - self._mean_s)
            if not call.result.done():
                if outcome.error is not None:
                    call.result.set_exception(outcome.error)
                else:
                    call.result.set_result((outcome.value, outcome.cost_s))
        if not self._waiting and not self._running:
            self._used_s, self._served_s = {}, 0.0
        self._dispatch(loop)

    def _begin_thread(self) -> None:
        """Note and prepare a new thread, which calls this."""
        self._threads.append(threading.current_thread())
        self._prepare()

    def close(self) -> None:
        """Start no more calls, without waiting for those that run."""
        self._executor.shutdown(wait=False, cancel_futures=True)

    def join(self, deadline_s: float) -> None:
        """Wait until ``deadline_s`` [monotonic clock] for the threads of this lane."""
        for thread in self._threads:
            thread.join(max(0.0, deadline_s - time.monotonic()))


@dataclass(frozen=True)
class _Ended:
    """Return value or exception of a call, and its core time [s]."""

    value: Any
    error: BaseException | None
    cost_s: float


def _timed(work: Callable[[], Any]) -> _Ended:
    """Do work; returns its value or its exception, and its core time."""
    begun_s = time.thread_time()
    try:
        value, error = work(), None
    except BaseException as raised:
        value, error = None, raised
    return _Ended(value, error, time.thread_time() - begun_s)


def _keep_to_one_core() -> None:
    """Let faiss in this thread, and OpenCV, use one core: requests run in parallel, and would wait for one another."""
    faiss.omp_set_num_threads(1)  # OpenMP keeps this setting per thread
    cv2.setNumThreads(1)


def lower_priority() -> None:
    """Let faiss in this thread, and OpenCV, use one core; also lower the thread's priority."""
    _keep_to_one_core()
    make_thread_nice(_NICENESS)
