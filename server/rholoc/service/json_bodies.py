"""JSON from clients: measured before it is parsed, so that no body takes more time or memory than its limits allow.

A parser holds the interpreter until it is done, and a validator notes every error it finds. Counting the bytes that
begin a value takes a thousandth of the time and bounds both.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from pydantic_core import from_json
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from rholoc.errors import TooLarge
from rholoc.maps.json_values import check_json_value
from rholoc.service.access import found_route
from rholoc.service.bodies import PieceListener, read_body
from rholoc.service.errors import InvalidRequest

_MAX_MEMBERS = 1000  # names with values, in all objects of a body together
_VALUES_PER_FEATURE = 8  # u, v and their list, descriptor, channel, size, angle; and one to spare
_BYTES_PER_VALUE = 4


@dataclass(frozen=True)
class JsonLimits:
    """What a JSON body may hold.

    Attributes:
        length: in bytes.
        values: how many numbers, strings, lists and objects.
    """

    length: int
    values: int

    @classmethod
    def of_options(cls, max_bytes: int) -> JsonLimits:
        """For a body of options: names, numbers, short lists."""
        return cls(max_bytes, max_bytes // _BYTES_PER_VALUE)

    @classmethod
    def of_features(cls, max_bytes: int, max_features: int) -> JsonLimits:
        """For a descriptor set of so many features."""
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
            TooLarge: from the listener, as :meth:`check` does.
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
            if members > _MAX_MEMBERS:
                raise TooLarge(f"The JSON's objects have more than {_MAX_MEMBERS} members.", "Send less.")
            on_piece(piece)

        return measure


def check_json(body: bytes, limits: JsonLimits) -> None:
    """Refuse a body that is not plain JSON.

    Raises:
        TooLarge: see :meth:`JsonLimits.check`.
        InvalidRequest: it is not JSON, or what :func:`rholoc.maps.json_values.check_json_value` refuses.
    """
    limits.check(body)
    try:
        check_json_value(from_json(body, allow_inf_nan=False))
    except ValueError as error:
        raise InvalidRequest(f"The body is not plain JSON: {error}.", "See /docs for what this route takes.") from error


class JsonBodies:
    """ASGI middleware for routes whose bodies the framework parses, so that it only sees checked bodies."""

    def __init__(self, app: ASGIApp, max_bytes: int) -> None:
        self._app = app
        self._limits = JsonLimits.of_options(max_bytes)

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
        body = await read_body(Request(scope, receive), self._limits.length)
        check_json(body, self._limits)
        await self._app(scope, _replaying(body, receive), send)


def _replaying(body: bytes, receive: Receive) -> Callable[[], Awaitable[Message]]:
    """A ``receive`` that repeats a body that was already read."""
    messages: list[Message] = [{"type": "http.request", "body": body, "more_body": False}]

    async def replay() -> Message:
        return messages.pop() if messages else await receive()

    return replay
