"""Close connections of slow or silent clients, so that they cannot take up all connections."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from typing import Any

import h11
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from rholoc.errors import Busy
from rholoc.service.access.scopes import client_of
from rholoc.service.errors import RequestTimeout, TooManyRequests

_HEAD_TIMEOUT_S = 20.0  # for a request's line and headers
_MIN_BYTES_PER_S = 500.0  # of a body, on average
_LEFTOVER_BYTES_PER_S = 4e6  # of a refused body, whose reading slows other requests down
_RETRY_AFTER_S = 5.0
_STALLED_READER_S = 30.0
_FOR_PROBES = 128  # connections beyond the limit
_YOUNG_S = 1.0  # minimum age of an idle connection
BEYOND_LIMIT = "beyond_limit"  # member of a request's state, set for connections beyond the limit
_STREAMED_BYTES = 8 * 2**20  # of one message of a WebSocket


class PatientProtocol(H11Protocol):
    """Uvicorn's HTTP/1.1, which closes a connection whose request's head takes over ``head_timeout_s``.

    Uvicorn itself closes connections that are silent between requests, but not those that send a byte now and then. At
    the limit of connections, a new one replaces the one idle for longest, over 1 s. If none is, ``_FOR_PROBES`` more
    are accepted for probes only; each further one replaces the oldest of these. A connection is aborted if its client
    does not read for ``stalled_reader_s``.
    """

    head_timeout_s = _HEAD_TIMEOUT_S
    max_connections = 500
    stalled_reader_s = _STALLED_READER_S
    _giving_up: asyncio.TimerHandle | None = None
    _breaking_off: asyncio.TimerHandle | None = None
    _waiting_since_s = 0.0
    _beyond_limit = False

    def connection_made(self, transport: Any) -> None:
        """Also watch the head's timeout, and make room at the limit of connections."""
        super().connection_made(transport)
        self._watch_head()
        self._waiting_since_s = self.loop.time()
        if len(self.connections) > self.max_connections:
            self._make_room()

    def pause_writing(self) -> None:
        """Also schedule an abort, unless the client reads again within ``stalled_reader_s``."""
        super().pause_writing()
        if self._breaking_off is None:
            self._breaking_off = self.loop.call_later(self.stalled_reader_s, self.transport.abort)

    def resume_writing(self) -> None:
        """Also cancel the scheduled abort."""
        super().resume_writing()
        self._stop_breaking_off()

    def _stop_breaking_off(self) -> None:
        """Cancel the abort that awaits a client that does not read."""
        if self._breaking_off is not None:
            self._breaking_off.cancel()
            self._breaking_off = None

    def on_response_complete(self) -> None:
        """Also note since when the connection is idle."""
        super().on_response_complete()
        self._waiting_since_s = self.loop.time()

    def _make_room(self) -> None:
        """Close the connection that has been idle longest; if none is idle, mark this one as beyond the limit. Of
        ``_FOR_PROBES`` others beyond it, the one that has waited longest is then closed.
        """
        others = [one for one in self.connections if isinstance(one, PatientProtocol) and one is not self]
        now_s = self.loop.time()
        idle = [one for one in others if one._is_idle and now_s - one._waiting_since_s > _YOUNG_S]
        beyond = [one for one in others if one._beyond_limit]
        if idle:
            self._replace(min(idle, key=lambda one: one._waiting_since_s))
            return
        self._beyond_limit = True
        self.app_state = {**self.app_state, BEYOND_LIMIT: True}
        if len(beyond) >= _FOR_PROBES:
            self._replace(min(beyond, key=lambda one: one._waiting_since_s))

    @property
    def _is_idle(self) -> bool:
        """Whether no request is under way."""
        return self.cycle is None or self.cycle.response_complete

    def _replace(self, other: PatientProtocol) -> None:
        """Close another connection to make room for this one."""
        self.connections.discard(other)  # now: many may arrive before its connection_lost is called
        other.transport.close()

    def data_received(self, data: bytes) -> None:
        """Also watch the head's timeout; what is left of a refused body is read slowly, and dropped."""
        super().data_received(data)
        self._watch_head()
        answered = self.cycle is not None and self.cycle.response_complete
        if answered and self.conn.their_state is h11.SEND_BODY:  # refused: the rest is read, slowly, and dropped
            self.transport.pause_reading()
            self.loop.call_later(len(data) / _LEFTOVER_BYTES_PER_S, self.transport.resume_reading)

    def connection_lost(self, exc: Exception | None) -> None:
        """Also cancel the timeouts."""
        super().connection_lost(exc)
        self._stop_watching()
        self._stop_breaking_off()

    def _watch_head(self) -> None:
        """Start the timeout while a head is awaited, unless it runs; stop it once the head is complete."""
        if self.conn.their_state is not h11.IDLE:
            self._stop_watching()
        elif self._giving_up is None:
            self._giving_up = self.loop.call_later(self.head_timeout_s, self._give_up)

    def _give_up(self) -> None:
        """Close the connection if a request's head is still awaited."""
        self._giving_up = None
        if self.conn.their_state is h11.IDLE and self.transport is not None:
            self.transport.close()

    def _stop_watching(self) -> None:
        """Cancel the head's timeout."""
        if self._giving_up is not None:
            self._giving_up.cancel()
            self._giving_up = None


def protocol_of(max_connections: int, stalled_reader_s: float = _STALLED_READER_S) -> type[PatientProtocol]:
    """A protocol class for ``max_connections`` that aborts one whose client reads nothing for ``stalled_reader_s``."""
    limits = {"max_connections": max_connections, "stalled_reader_s": stalled_reader_s}
    return type("PatientProtocol", (PatientProtocol,), limits)


def websocket_options(max_request_bytes: int) -> dict[str, Any]:
    """Uvicorn's options for WebSockets: messages up to the smaller of ``max_request_bytes`` and 8 MiB, uncompressed,
    because compression hides their length.
    """
    return {
        "ws": "websockets-sansio",
        "ws_max_size": min(max_request_bytes, _STREAMED_BYTES),
        "ws_per_message_deflate": False,
    }


class ConcurrencyLimited:
    """ASGI middleware that limits each client's concurrent requests. It stands behind the guard.

    Args:
        app: the next application.
        max_of_client: maximum number for a key with those that it handed on, or for an address.
    """

    def __init__(self, app: ASGIApp, max_of_client: int) -> None:
        self._app = app
        self._max_of_client = max_of_client
        self._under_way: Counter[str] = Counter()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request. Raises TooManyRequests: the client is at its limit."""
        client = client_of(scope) if scope["type"] == "http" else ""
        if not client:
            await self._app(scope, receive, send)
            return
        if self._under_way[client] >= self._max_of_client:
            raise TooManyRequests(
                f"You have {self._max_of_client} requests under way, the most allowed.", "Wait for their answers."
            )
        self._under_way[client] += 1
        try:
            await self._app(scope, receive, send)
        finally:
            self._under_way[client] -= 1
            if not self._under_way[client]:
                del self._under_way[client]


class ProbesOnly:
    """ASGI middleware for connections beyond the limit: only routes open to everyone are served.

    It stands behind the guard, which finds the route.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request. Raises Busy: the route is not open to everyone."""
        if scope.get("state", {}).get(BEYOND_LIMIT) and client_of(scope):
            text = "The service has reached its limit of connections."
            raise Busy(text, "Try again after Retry-After.", _RETRY_AFTER_S)
        await self._app(scope, receive, send)


class SlowBodies:
    """ASGI middleware that ends requests whose body stalls or trickles in.

    Args:
        app: the next application.
        silence_s: maximum silence, and maximum lag behind 500 bytes/s.
    """

    def __init__(self, app: ASGIApp, silence_s: float) -> None:
        self._app = app
        self._silence_s = silence_s

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request. Raises RequestTimeout: its body takes too long."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        waited_s, received, whole = 0.0, 0, False

        async def receive_in_time() -> Message:
            nonlocal waited_s, received, whole
            if whole:
                return await receive()  # which waits for the client to disconnect
            begun = time.monotonic()
            try:
                async with asyncio.timeout(self._silence_s):
                    message = await receive()
            except TimeoutError:
                raise RequestTimeout("The request's body stopped coming.", "Send it again.") from None
            waited_s += time.monotonic() - begun
            received += len(message.get("body", b""))
            whole = not message.get("more_body", False)
            if not whole and waited_s > self._silence_s + received / _MIN_BYTES_PER_S:
                raise RequestTimeout(
                    "The request's body arrives too slowly.", "Send it again over a better connection."
                )
            return message

        await self._app(scope, receive_in_time, send)
