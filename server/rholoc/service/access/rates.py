"""Rate limits of API keys: a token bucket for each key, in every server."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from starlette.types import ASGIApp, Receive, Scope, Send

from rholoc.service.access.keys import ApiKey, KeyStore
from rholoc.service.access.scopes import request_key
from rholoc.service.errors import TooManyRequests

_MAX_BUCKETS = 10_000  # from here on, those unused for ``_LONG_S`` are dropped
_LONG_S = 3600.0


@dataclass
class _Bucket:
    """Number of tokens, and the time of their last update."""

    tokens: float
    counted_s: float


class Rates:
    """Counts the requests of keys. Use it from the event loop's thread only.

    Args:
        clock: the time in seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._buckets: dict[str, _Bucket] = {}

    def take(self, keys: Sequence[ApiKey]) -> None:
        """Take a token from the bucket of each key with a rate, or from none.

        Raises:
            TooManyRequests: a bucket has less than a token; ``retry_after_s`` until it has one.
        """
        limited = [key for key in keys if key.limits.requests_per_s is not None]
        buckets = [self._filled(key) for key in limited]
        for key, bucket in zip(limited, buckets, strict=True):
            if bucket.tokens < 1:
                rate = _rate(key)
                raise TooManyRequests(
                    f"The key {key.name} may ask {rate:g} times a second, {_burst(key)} at once.",
                    "Ask less often; Retry-After says when to ask again.",
                    (1 - bucket.tokens) / rate,
                )
        for bucket in buckets:
            bucket.tokens -= 1

    def _filled(self, key: ApiKey) -> _Bucket:
        """The key's bucket, created full, refilled to the present time. At 10,000 buckets, those an hour unused go."""
        now_s = self._clock()
        if len(self._buckets) >= _MAX_BUCKETS:
            self._buckets = {name: one for name, one in self._buckets.items() if now_s - one.counted_s < _LONG_S}
        bucket = self._buckets.setdefault(key.name, _Bucket(_burst(key), now_s))
        bucket.tokens = min(_burst(key), bucket.tokens + (now_s - bucket.counted_s) * _rate(key))
        bucket.counted_s = now_s
        return bucket


class RateLimited:
    """ASGI middleware that enforces the keys' rates. It stands behind the guard.

    Args:
        app: the next application.
        keys: the key store.
    """

    def __init__(self, app: ASGIApp, keys: KeyStore) -> None:
        self._app = app
        self._keys = keys
        self._rates = Rates()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request. Raises TooManyRequests: its key asks too often."""
        key = request_key(scope) if scope["type"] in ("http", "websocket") else None
        if key is not None:
            self._rates.take(self._keys.chain(key))
        await self._app(scope, receive, send)


def _rate(key: ApiKey) -> float:
    """Requests a second that a key may send; inf without a limit."""
    return key.limits.requests_per_s or math.inf


def _burst(key: ApiKey) -> int:
    """Maximum number of tokens of a key with a rate: its burst, by default one second's worth, at least 1."""
    return key.limits.burst or max(1, round(_rate(key)))
