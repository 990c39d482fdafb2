"""Values that are asked for elsewhere, as last known: for probes, which may not wait for a database that is silent."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Generic, TypeVar

T = TypeVar("T")

_WAIT_S = 0.25


class LastKnown(Generic[T]):
    """The last value of a function that may take long, called in a thread of its own, once at a time.

    Args:
        read: the function. It may raise any exception, which is then what is known.
        initial: the value until ``read`` has returned once.
    """

    def __init__(self, read: Callable[[], T], initial: T) -> None:
        self._read = read
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="rholoc-storage-known")
        self._begun_s: float | None = None
        self._under_way: asyncio.Future[T] | None = None
        self._known_s: float | None = None
        self.value = initial
        self.error: Exception | None = None

    @property
    def unanswered_s(self) -> float:
        """How long the call that is under way has taken so far; 0 if there is none."""
        return 0.0 if self._under_way is None or self._begun_s is None else time.monotonic() - self._begun_s

    @property
    def age_s(self) -> float | None:
        """The age of the value in seconds; None if it is the initial one."""
        return None if self._known_s is None else time.monotonic() - self._known_s

    async def refresh(self) -> None:
        """Ask again, for all who want to know together; wait for the answer a quarter of a second at most."""
        if self._under_way is None:
            self._begun_s = time.monotonic()
            self._under_way = asyncio.wrap_future(self._executor.submit(self._read))
            self._under_way.add_done_callback(self._take)
        if self._under_way is not None:
            await asyncio.wait({self._under_way}, timeout=_WAIT_S)

    def close(self) -> None:
        """Ask no more."""
        self._executor.shutdown(wait=False, cancel_futures=True)

    def _take(self, answered: asyncio.Future[T]) -> None:
        self._under_way = None
        if answered.cancelled():
            return
        error = answered.exception()
        if isinstance(error, Exception):
            self.error = error
        else:
            self.value, self.error, self._known_s = answered.result(), None, time.monotonic()
