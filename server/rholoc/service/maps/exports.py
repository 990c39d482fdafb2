"""Long exports of maps, each in a child process that ends when the client disconnects."""

import asyncio
import json
import math
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from starlette.requests import ClientDisconnect
from starlette.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from rholoc.errors import Busy, DeadlineExceeded, InvalidInput, InvalidMap
from rholoc.exports import ExportFormat
from rholoc.exports.process import REFUSED
from rholoc.processes.async_program import AsyncProgram

SHORT_NUMBERS = 4_000_000  # a few seconds' work, less than the start of a process on a busy machine
_NUMBERS_PER_SURFACE = 40_000
_VARIABLES, _DEGREE = 8, 2  # of the tensor form of equation (3), the default degree
_AT_ONCE = 1
_MAX_WAITING = 8
_PIECE_BYTES = 2**16
_RETRY_AFTER_S = 10.0
_LOOK_EVERY_S = 0.5


@dataclass(frozen=True)
class ExportRequest:
    """What to export: see :func:`rholoc.exports.export_map`.

    Attributes:
        source: the map's file.
        title: what the map is called.
        format: the format to write.
        degree: of CSV.
        features: of surfaces.
    """

    source: Path
    title: str
    format: ExportFormat
    degree: int | None = None
    features: Sequence[int] | None = None

    def as_dict(self) -> dict[str, object]:
        """The attributes by name, JSON-serialisable, with an absolute path; the exporting process reads them."""
        features = None if self.features is None else list(self.features)
        members = {"source": str(self.source.resolve()), "title": self.title, "format": self.format}
        return {**members, "degree": self.degree, "features": features}


def is_long(landmarks: int, format: ExportFormat, degree: int | None, features: Sequence[int] | None) -> bool:
    """Whether an export is made by a process of its own: CSV or surfaces of over 4 million numbers."""
    match format:
        case ExportFormat.CSV:
            powers = 1 + (_DEGREE if degree is None else max(0, degree))
            return landmarks * math.pow(powers, _VARIABLES) > SHORT_NUMBERS
        case ExportFormat.SURFACES:
            chosen = landmarks if features is None else len(features)
            return chosen * _NUMBERS_PER_SURFACE > SHORT_NUMBERS
        case _:
            return False


class Exports:
    """Makes exports, one at a time, each within ``time_limit_s``. Use it from the event loop's thread only."""

    def __init__(self, time_limit_s: float) -> None:
        self._time_limit_s = time_limit_s
        self._turn = asyncio.Semaphore(_AT_ONCE)
        self._open = 0

    async def answer(
        self, wanted: ExportRequest, headers: dict[str, str], is_gone: Callable[[], Awaitable[bool]]
    ) -> StreamingResponse:
        """The response that streams an export; its first bytes are ready when this returns.

        Args:
            wanted: what to export.
            headers: the response's.
            is_gone: whether the client has gone.

        Raises:
            ClientDisconnect: it has.
            InvalidMap, InvalidInput: the map or an option does not allow it.
            Busy: more than eight others wait or are made, or the process was killed.
            DeadlineExceeded: it takes longer than the limit.
        """
        if self._open > _MAX_WAITING:
            raise Busy("Too many maps are being exported.", "Try again after Retry-After.", _RETRY_AFTER_S)
        self._open += 1
        export = _Export(self._time_limit_s)
        try:
            await _unless_gone(is_gone, self._turn.acquire())
            try:
                await _unless_gone(is_gone, export.begin(wanted))
            except BaseException:
                self._turn.release()
                raise
        except BaseException:
            self._open -= 1
            await export.close()
            raise
        return _ExportAnswer(export, self._ended, headers, wanted.format.media_type)

    def _ended(self) -> None:
        """Let the next export begin."""
        self._open -= 1
        self._turn.release()


async def _unless_gone(is_gone: Callable[[], Awaitable[bool]], work: Coroutine[Any, Any, object]) -> None:
    """Do work, looking every 0.5 s for the client; once it is gone, cancel the work and raise ClientDisconnect."""
    task = asyncio.create_task(work)
    try:
        while not (await asyncio.wait({task}, timeout=_LOOK_EVERY_S))[0]:
            if await is_gone():
                raise ClientDisconnect
    finally:
        task.cancel()
    await task


class _Export:
    """One process and its output."""

    def __init__(self, time_limit_s: float) -> None:
        self._last_s = 0.0
        self._time_limit_s = time_limit_s
        self._first = b""
        self._program: AsyncProgram | None = None

    async def begin(self, wanted: ExportRequest) -> None:
        """Start the process and wait for its first bytes.

        Raises:
            InvalidMap, InvalidInput: it refuses the export.
            Busy: it was killed.
            DeadlineExceeded: it takes longer than the limit.
        """
        self._last_s = asyncio.get_running_loop().time() + self._time_limit_s
        self._program = program = await AsyncProgram.start("rholoc.exports.process", collect_errors=True)
        await program.ask(wanted.as_dict())
        self._first = await self._read(program)
        if not self._first:
            status, errors = await program.end()
            if status == REFUSED:
                refusal = json.loads(errors.splitlines()[-1])
                kind = InvalidMap if refusal["code"] == InvalidMap.code else InvalidInput
                raise kind(refusal["message"], refusal["hint"])
            if status:
                raise Busy("The process that exports was killed.", "Try again after Retry-After.", _RETRY_AFTER_S)

    async def pieces(self) -> AsyncIterator[bytes]:
        """Iterate over the output, from its beginning. Raises ConnectionError if it is killed, DeadlineExceeded."""
        assert self._program is not None
        piece = self._first
        while piece:
            yield piece
            piece = await self._read(self._program)
        status, _ = await self._program.end()
        if status:
            raise ConnectionError("the process that exports was killed")  # breaks the response off, which clients see

    async def _read(self, program: AsyncProgram) -> bytes:
        """The next piece of the output, empty at its end. Raises DeadlineExceeded at the time limit."""
        try:
            return await program.read(_PIECE_BYTES, self._last_s - asyncio.get_running_loop().time())
        except TimeoutError:
            hint = "Ask for fewer densities, or raise RHOLOC_EXPORT_TIME_LIMIT_S."
            raise DeadlineExceeded(f"The export takes longer than {self._time_limit_s:g} s.", hint) from None

    async def close(self) -> None:
        """End the process, if it is still running."""
        if self._program is not None:
            await self._program.kill()


class _ExportAnswer(StreamingResponse):
    """Ends the export when the response ends, however that happens."""

    def __init__(self, export: _Export, ended: Callable[[], None], headers: dict[str, str], media_type: str) -> None:
        super().__init__(export.pieces(), headers=headers, media_type=media_type)
        self._export = export
        self._ended = ended

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._ended()
            await asyncio.shield(self._export.close())
