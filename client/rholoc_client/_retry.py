"""When to ask again, and after how long."""

import random
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import httpx

from rholoc_client._calls import Call, Outcome

BUSY = 503
TOO_MANY_REQUESTS = 429
_LONGEST_RETRY_AFTER_S = 60.0


@dataclass(frozen=True)
class Backoff:
    """Waits that double, with jitter: between half and all of ``first_s``, twice that, … up to ``longest_s``."""

    retries: int
    first_s: float = 0.2
    longest_s: float = 10.0

    def waits_s(self) -> Iterator[float]:
        """Seconds to wait before each retry."""
        for attempt in range(self.retries):
            longest = min(self.longest_s, self.first_s * 2**attempt)
            yield random.uniform(longest / 2, longest)


class Attempts:
    """How often one call may still be tried."""

    def __init__(self, backoff: Backoff, call: Call[Any]) -> None:
        self._call = call
        self._waits_s = backoff.waits_s()

    def wait_s(self, outcome: Outcome) -> float | None:
        """Seconds to wait before the next attempt, or None where ``outcome`` is final."""
        if isinstance(outcome, httpx.TransportError):
            return next(self._waits_s, None) if may_repeat(outcome, self._call.idempotent) else None
        if not _says_later(outcome) or outcome.status_code in self._call.answers:
            return None
        wait_s = next(self._waits_s, None)
        return None if wait_s is None else max(wait_s, _retry_after_s(outcome))


def _says_later(response: httpx.Response) -> bool:
    """Whether the service asks to be asked again soon; a quota that is used up has another ``Retry-After``."""
    if response.status_code == TOO_MANY_REQUESTS:
        return 0 < _asked_s(response) <= _LONGEST_RETRY_AFTER_S
    return response.status_code == BUSY


def may_repeat(error: httpx.TransportError, idempotent: bool) -> bool:
    """Whether a request that got no answer can be sent again without being done twice."""
    if isinstance(error, httpx.UnsupportedProtocol):
        return False
    never_sent = isinstance(error, httpx.ConnectError | httpx.ConnectTimeout | httpx.PoolTimeout)
    return never_sent or idempotent


def _retry_after_s(response: httpx.Response) -> float:
    return min(max(_asked_s(response), 0.0), _LONGEST_RETRY_AFTER_S)


def _asked_s(response: httpx.Response) -> float:
    try:
        return float(response.headers.get("Retry-After", "0"))
    except ValueError:  # an HTTP date, which the service does not send
        return 0.0
