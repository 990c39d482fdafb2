"""Limit JSON bodies before they are parsed, to bound time and memory.

A parser blocks the interpreter, and a validator collects every error. Counting the bytes that begin a value takes a
thousandth of the time and bounds both.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from pydantic_core import from_json
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from rholoc.errors import TooLarge
from rholoc.reports.json_values import MAX_VALUES, check_json_value
from rholoc.service.access.scopes import found_route
from rholoc.service.errors import InvalidRequest
from rholoc.service.http.bodies import PieceListener, read_body

_MAX_MEMBERS = 1000
_SITE_BYTES, _SITE_VALUES, _SITE_MEMBERS = 8 * 2**20, 500_000, 200_000  # of the largest site
_VALUES_PER_FEATURE = 8  # u, v and their list, descriptor, channel, size, angle; and one to spare
_BYTES_PER_VALUE = 4


@dataclass(frozen=True)
class JsonLimits:
    """Limits on a JSON body. Commas, brackets and colons are counted, also those inside strings.

    Attributes:
        length: [bytes].
        values: number of numbers, strings, lists and objects.
        members: number of members of all objects together.
    """

    length: int
    values: int
    members: int = _MAX_MEMBERS

    @classmethod
    def of_options(cls, max_bytes: int) -> JsonLimits:
        """For a body of options (names, numbers, short lists): a value for each 4 bytes, 1000 members."""
        return cls(max_bytes, max_bytes // _BYTES_PER_VALUE)

    @classmethod
    def of_features(cls, max_bytes: int, max_features: int) -> JsonLimits:
        """For a descriptor set of ``max_features`` features: 8 values for each and 1000 more."""
        return cls(max_bytes, _VALUES_PER_FEATURE * max_features + _MAX_MEMBERS)

    def check(self, body: bytes) -> None:
        """Refuse a body beyond the limits, whether it is JSON or not.

        Raises:
            TooLarge: it is longer, or holds more values or members.
        """
        self.measured()(body)

    def measured(self, on_piece: PieceListener = lambda _: None) -> PieceListener:
        """A listener that measures a body piece by piece, to refuse it early, and passes the pieces to ``on_piece``.

        Raises:
            TooLarge: from the listener, once a limit is exceeded.
        """
        length = values = members = 0

        def measure(piece: bytes) -> None:
            nonlocal length, values, members
            length += len(piece)
            values += sum(piece.count(mark) for mark in (b",", b"[", b"{"))
            members += piece.count(b":")
            if length > self.length:
                raise TooLarge(f"The JSON is longer than {self.length} bytes.", "Send less.")
            if values > self.values:
                raise TooLarge(f"The JSON holds more than {self.values} values.", "Send less.")
            if members > self.members:
                raise TooLarge(f"The JSON's objects have more than {self.members} members.", "Send less.")
            on_piece(piece)

        return measure


def check_json(body: bytes, limits: JsonLimits) -> None:
    """Refuse a body that is not plain JSON.

    Raises:
        TooLarge: it is longer than ``limits``, or holds more values or members.
        InvalidRequest: it is not JSON, has NaN or infinite numbers, or is refused by :func:`check_json_value`.
    """
    limits.check(body)
    try:
        check_json_value(from_json(body, allow_inf_nan=False), max(MAX_VALUES, limits.values))
    except ValueError as error:
        raise InvalidRequest(f"The body is not plain JSON: {error}.", "See /docs for what this route takes.") from error


class JsonBodies:
    """ASGI middleware for routes whose bodies the framework parses, so that it only sees checked bodies."""

    def __init__(self, app: ASGIApp, max_bytes: int) -> None:
        self._app = app
        self._limits = JsonLimits.of_options(max_bytes)
        site = JsonLimits(max(max_bytes, _SITE_BYTES), _SITE_VALUES, _SITE_MEMBERS)
        self._limits_of = {("PUT", "/v1/sites/{site}"): site}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request.

        Raises:
            TooLarge, InvalidRequest: as :func:`check_json` does.
            ClientDisconnect: the sender broke off.
        """
        route = found_route(scope) if scope["type"] == "http" else None
        if route is None or not route.parses_body:
            await self._app(scope, receive, send)
            return
        limits = self._limits_of.get((scope["method"], route.path), self._limits)
        body = await read_body(Request(scope, receive), limits.length)
        await run_in_threadpool(check_json, body, limits)
        await self._app(scope, _replaying(body, receive), send)


def _replaying(body: bytes, receive: Receive) -> Callable[[], Awaitable[Message]]:
    """A ``receive`` that first gives a body that was already read."""
    messages: list[Message] = [{"type": "http.request", "body": body, "more_body": False}]

    async def replay() -> Message:
        return messages.pop() if messages else await receive()

    return replay
