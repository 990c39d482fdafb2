"""Priority for frames: while one is being localized, other requests wait after each of their steps.

Localization often needs the interpreter, which runs one thread at a time: any other Python code in this process slows
it down, regardless of cores and priorities.
"""

import asyncio
import time
from collections.abc import Callable

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from rholoc.service.access.keys import Scope as KeyScope
from rholoc.service.access.scopes import found_route

_SHARE = 0.2  # of the time, for everything except frames
_LONGEST_S = 1.0


class Pace:
    """Limits the total time of all steps that share it to ``share`` of the time.

    Args:
        share: of the time.
        longest_s: maximum wait after one step.
        clock: the time in seconds.
    """

    def __init__(
        self, share: float = _SHARE, longest_s: float = _LONGEST_S, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._share = share
        self._longest_s = longest_s
        self._clock = clock
        self._free_s = 0.0  # end of the waits for all steps so far

    def delay_s(self, took_s: float) -> float:
        """Time to wait [s] after a step of ``took_s``, at most ``longest_s``; counts the step."""
        now_s = self._clock()
        self._free_s = min(max(now_s, self._free_s) + took_s / self._share, now_s + self._longest_s)
        return self._free_s - now_s


class FramesFirst:
    """ASGI middleware: requests other than frames wait before each piece of their body and before their answer.

    The wait depends on the time since the piece before. Routes that localize and routes open to everyone never wait.

    Args:
        app: the next application.
        busy: whether frames are being localized.
        pace: shared by the waiting requests.
    """

    def __init__(self, app: ASGIApp, busy: Callable[[Scope], bool], pace: Pace | None = None) -> None:
        self._app = app
        self._busy = busy
        self._pace = pace or Pace()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http" or not _gives_way(scope):
            await self._app(scope, receive, send)
            return
        since_s, whole = time.monotonic(), False

        async def give_way() -> None:
            if self._busy(scope):
                await asyncio.sleep(self._pace.delay_s(time.monotonic() - since_s))

        async def receive_in_turn() -> Message:
            nonlocal since_s, whole
            if whole:
                return await receive()  # which waits for the client to disconnect
            await give_way()
            message = await receive()
            since_s, whole = time.monotonic(), not message.get("more_body", False)
            return message

        async def send_in_turn(message: Message) -> None:
            if message["type"] == "http.response.start":
                await give_way()
            await send(message)

        await self._app(scope, receive_in_turn, send_in_turn)


def _gives_way(scope: Scope) -> bool:
    """Whether a request's route needs another scope than localizing."""
    route = found_route(scope)
    access = None if route is None else route.access
    return access is not None and access.scope not in (None, KeyScope.LOCALIZE)
