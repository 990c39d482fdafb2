"""Open streams: counted for each client, listed, and ended when their key is revoked."""

import asyncio
import math
import time
import uuid
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from enum import StrEnum

from fastapi.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from rholoc.errors import Busy, Conflict, NotFound, RholocError
from rholoc.service.access.keys import ApiKey, KeyStore
from rholoc.service.access.scopes import client_of, request_key
from rholoc.service.errors import TooManyRequests, Unauthorized

_RETRY_AFTER_S = 5.0


class StreamKind(StrEnum):
    """Content of a stream."""

    FRAMES = "frames"  # a WebSocket
    EVENTS = "events"  # server-sent


@dataclass(eq=False)
class OpenStream:
    """A stream from its admission to its end.

    Attributes:
        id: of the stream.
        kind: of the stream.
        client: the root of its key's chain, or an address.
        key: of its request; None if none is needed.
        path: of its request.
        since: time of its opening [s since the epoch].
        timeout: of the block that serves it; None before that begins.
        ended_by: the reason given to :meth:`end`; None until then.
    """

    id: str
    kind: StreamKind
    client: str
    key: ApiKey | None
    path: str
    since: float = field(default_factory=time.time)
    timeout: asyncio.Timeout | None = None
    ended_by: RholocError | None = None

    def end(self, reason: RholocError) -> None:
        """Raise ``reason`` where the stream is served, now or as soon as that begins; only the first reason counts."""
        self.ended_by = self.ended_by or reason
        if self.timeout is not None and not self.timeout.expired():
            self.timeout.reschedule(asyncio.get_running_loop().time())


class OpenStreams:
    """Admits streams and keeps track of them. Use it from the event loop's thread only.

    Args:
        keys: the key store.
        max_open: maximum number of open streams of each kind.
        max_of_client: maximum number for one client: a key with those that it handed on, or an address.
    """

    def __init__(
        self, keys: KeyStore, max_open: Mapping[StreamKind, int], max_of_client: Mapping[StreamKind, int]
    ) -> None:
        self._keys, self._max_open, self._max_of_client = keys, max_open, max_of_client
        self._open: dict[str, OpenStream] = {}

    def all(self) -> list[OpenStream]:
        """The open streams, the oldest first."""
        return list(self._open.values())

    def count(self, kind: StreamKind) -> int:
        """Number of open streams of a kind."""
        return sum(one.kind is kind for one in self._open.values())

    def admit(self, kind: StreamKind, scope: Scope) -> OpenStream:
        """Add a stream of the request; it counts until the end of :meth:`serving`, which must follow.

        Raises:
            TooManyRequests: the client has the maximum number open.
            Busy: all clients together have.
        """
        client, most = client_of(scope), self._max_open[kind]
        if self.count(kind) >= most:
            raise Busy(f"{most} streams of {kind} are open, the most allowed.", "Try again later.", _RETRY_AFTER_S)
        mine = sum(one.kind is kind and one.client == client for one in self._open.values())
        if mine >= self._max_of_client[kind]:
            raise TooManyRequests(
                f"{mine} streams of {kind} are open for you, the most allowed.", "Close one.", _RETRY_AFTER_S
            )
        stream = OpenStream(uuid.uuid4().hex, kind, client, request_key(scope), scope["path"])
        self._open[stream.id] = stream
        return stream

    @asynccontextmanager
    async def serving(self, stream: OpenStream) -> AsyncIterator[None]:
        """Serve a stream within the block, which is cancelled when the stream is ended from elsewhere.

        Raises:
            Unauthorized: its key was revoked or has expired.
            Conflict: an administrator ended it.
        """
        try:
            if stream.ended_by is not None:
                raise stream.ended_by
            async with asyncio.timeout(None) as stream.timeout:
                yield
        except TimeoutError:
            if stream.ended_by is None:
                raise
        finally:
            self._open.pop(stream.id, None)
        if stream.ended_by is not None:
            raise stream.ended_by

    def end(self, stream_id: str) -> None:
        """End a stream with Conflict. Raises NotFound."""
        stream = self._open.get(stream_id)
        if stream is None:
            raise NotFound(f"There is no open stream {stream_id[:64]}.", "GET /v1/streams lists them.")
        stream.end(Conflict("An administrator ended this stream.", "Ask whoever runs the server."))

    def end_invalid(self) -> None:
        """End streams whose keys are revoked or expired, with Unauthorized."""
        for one in self.all():
            if one.key is not None and not self._keys.is_valid(one.key):
                one.end(Unauthorized("This API key was revoked, or has expired.", "Ask for another one."))


class EventStream(StreamingResponse):
    """Server-sent events, which end with the validity of their key.

    Args:
        events: encoded events.
        streams: the register of open streams.
        stream: the admitted stream.
    """

    def __init__(self, events: AsyncIterator[str], streams: OpenStreams, stream: OpenStream) -> None:
        headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
        super().__init__(events, headers=headers, media_type="text/event-stream")
        self._streams, self._stream = streams, stream

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the events."""
        try:
            async with self._streams.serving(self._stream):
                await super().__call__(scope, receive, send)
        except (Unauthorized, Conflict):
            await send({"type": "http.response.body", "body": b"", "more_body": False})


def stream_limits(max_streams: int, max_connections: int) -> tuple[Mapping[StreamKind, int], Mapping[StreamKind, int]]:
    """Maximum numbers of open streams by kind: for all clients (events: half of ``max_connections``), and for one
    client (half of these frames, a fifth of these events, rounded up).
    """
    events = max(1, max_connections // 2)
    return (
        {StreamKind.FRAMES: max_streams, StreamKind.EVENTS: events},
        {StreamKind.FRAMES: math.ceil(max_streams / 2), StreamKind.EVENTS: math.ceil(events / 5)},
    )
