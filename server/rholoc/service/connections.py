"""Closes connections of clients that send slowly or nothing at all, so that they cannot take up all connections."""

from __future__ import annotations

import asyncio
import json
import time
import uuid
from typing import Any

import h11
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from rholoc.errors import Busy
from rholoc.service.errors import RequestTimeout, error_body, error_headers, status_of

_HEAD_TIMEOUT_S = 20.0  # for a request's line and headers
_LEAST_BYTES_PER_S = 500.0  # of a body, on average
_LEFTOVER_BYTES_PER_S = 4e6  # of a body that was refused before it arrived: reading it slows the others down
_RETRY_AFTER_S = 5.0
_STREAMED_BYTES = 8 * 2**20  # of one message of a WebSocket


class PatientProtocol(H11Protocol):
    """Uvicorn's HTTP/1.1, which closes a connection whose request's head does not arrive in time.

    Uvicorn itself closes connections that are silent between requests, but not those that send a byte now and then.
    At the limit of connections, a new one replaces the one that has been idle for longest; if none is idle, the new one
    is answered with `busy`.
    """

    head_timeout_s = _HEAD_TIMEOUT_S
    max_connections = 500
    _giving_up: asyncio.TimerHandle | None = None
    _waiting_since_s = 0.0

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self._watch_head()
        self._waiting_since_s = self.loop.time()
        if len(self.connections) > self.max_connections:
            self._make_room()

    def on_response_complete(self) -> None:
        super().on_response_complete()
        self._waiting_since_s = self.loop.time()

    def _make_room(self) -> None:
        others = [one for one in self.connections if isinstance(one, PatientProtocol) and one is not self]
        waiting = [one for one in others if one.cycle is None or one.cycle.response_complete]
        if waiting:
            oldest = min(waiting, key=lambda one: one._waiting_since_s)
            self.connections.discard(oldest)  # at once: many may come before its connection_lost is called
            oldest.transport.close()
        else:
            self.transport.write(_full_answer())
            self.transport.close()

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        self._watch_head()
        answered = self.cycle is not None and self.cycle.response_complete
        if answered and self.conn.their_state is h11.SEND_BODY:  # refused: the rest is read, slowly, and dropped
            self.transport.pause_reading()
            self.loop.call_later(len(data) / _LEFTOVER_BYTES_PER_S, self.transport.resume_reading)

    def connection_lost(self, exc: Exception | None) -> None:
        super().connection_lost(exc)
        self._stop_watching()

    def _watch_head(self) -> None:
        """Let the time run from a head's first byte, not from its last."""
        if self.conn.their_state is not h11.IDLE:
            self._stop_watching()
        elif self._giving_up is None:
            self._giving_up = self.loop.call_later(self.head_timeout_s, self._give_up)

    def _give_up(self) -> None:
        self._giving_up = None
        if self.conn.their_state is h11.IDLE and self.transport is not None:
            self.transport.close()

    def _stop_watching(self) -> None:
        if self._giving_up is not None:
            self._giving_up.cancel()
            self._giving_up = None


def _full_answer() -> bytes:
    """The response to a connection whose request is not read."""
    error = Busy("The service has reached its limit of connections.", "Try again after Retry-After.", _RETRY_AFTER_S)
    body = json.dumps(error_body(error, uuid.uuid4().hex)).encode()
    headers = {"Content-Type": "application/json", "Content-Length": len(body), **error_headers(error)}
    lines = "".join(f"{name}: {value}\r\n" for name, value in {**headers, "Connection": "close"}.items())
    return f"HTTP/1.1 {status_of(Busy)} Service Unavailable\r\n{lines}\r\n".encode() + body


def protocol_of(max_connections: int) -> type[PatientProtocol]:
    """The protocol for a server with this limit of connections."""
    return type("PatientProtocol", (PatientProtocol,), {"max_connections": max_connections})


def websocket_options(max_request_bytes: int) -> dict[str, Any]:
    """Uvicorn's options for WebSockets: a limit on messages, and no compression, since a small compressed message may
    expand to a huge one."""
    return {
        "ws": "websockets-sansio",
        "ws_max_size": min(max_request_bytes, _STREAMED_BYTES),
        "ws_per_message_deflate": False,
    }


class SlowBodies:
    """ASGI middleware that ends requests whose body stalls or trickles in.

    Args:
        app: what reads the bodies.
        silence_s: how long nothing may arrive, and how far a body may lag behind 500 bytes a second.
    """

    def __init__(self, app: ASGIApp, silence_s: float) -> None:
        self._app = app
        self._silence_s = silence_s

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request.

        Raises:
            RequestTimeout: its body takes too long.
        """
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
            if not whole and waited_s > self._silence_s + received / _LEAST_BYTES_PER_S:
                raise RequestTimeout(
                    "The request's body arrives too slowly.", "Send it again over a better connection."
                )
            return message

        await self._app(scope, receive_in_time, send)
