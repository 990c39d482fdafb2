"""Pictures and figures of maps: made once for each version in a child process, and cached.

One low-priority process draws them, so the threads that localize are not involved. Its output is served from a file,
with an ETag, until the map changes.
"""

import asyncio
import hashlib
import json
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from rholoc import __version__
from rholoc.errors import Busy, InvalidMap, RholocError, StorageFull
from rholoc.library.map_catalogue import MapFile
from rholoc.library.maps import MapLibrary
from rholoc.pictures.rendering import Rendering
from rholoc.processes.async_program import AsyncProgram
from rholoc.service.threads.storage import StorageLanes

_IDLE_S = 120.0  # then the process ends and frees its memory
_MAX_WAITING = 200
_RETRY_AFTER_S = 5.0
_ATTEMPTS = 2  # the process may be killed for its memory
_LONGEST_S = 120.0


@dataclass(frozen=True)
class Rendered:
    """A rendering and the tag that changes with it."""

    content: bytes
    etag: str


def etag_of(file: MapFile, *parts: object) -> str:
    """An HTTP entity tag of a map's file, of this version of rholoc, and of further parts."""
    text = repr((__version__, file.key, file.signature, *parts))
    return f'"{hashlib.blake2b(text.encode(), digest_size=12).hexdigest()}"'


class Renderings:
    """Renderings of a library's maps, kept in a folder. Use it from the event loop's thread only.

    Args:
        folder: of the renderings.
        library: the maps.
        threads: for reading both.
    """

    def __init__(self, folder: Path, library: MapLibrary, threads: StorageLanes) -> None:
        self._folder = folder
        self._library = library
        self._threads = threads
        self._program: AsyncProgram | None = None
        self._turn = asyncio.Lock()
        self._making: dict[Path, asyncio.Task[None]] = {}
        self._idle: asyncio.TimerHandle | None = None

    def etag(self, name: str, kind: Rendering) -> str:
        """The tag of a rendering, whether or not it has been made yet.

        Raises:
            InvalidName, UnknownMap: there is no such map.
        """
        return etag_of(self._library.stat(name), kind)

    async def get(self, name: str, kind: Rendering) -> Rendered:
        """A rendering of the map as it is now. Requests for one that is being made wait for the same work.

        Raises:
            InvalidName, UnknownMap, InvalidMap: there is no such map, or it cannot be read.
            StorageFull: the disk is full.
            Busy: 200 renderings are waiting, or the process that draws was killed.
        """
        files = self._threads.files
        etag = await files(self.etag, name, kind)
        path = self._folder / f"{etag.strip(chr(34))}-{kind}"
        kept = await files(_read, path)
        if kept is None:
            await asyncio.shield(self._made(name, kind, path))
            kept = await files(path.read_bytes)
        return Rendered(kept, etag)

    def _made(self, name: str, kind: Rendering, path: Path) -> asyncio.Task[None]:
        """The task that makes a rendering in ``path``; the same while it is made. Raises Busy if 200 are being made."""
        if path not in self._making:
            if len(self._making) >= _MAX_WAITING:
                raise Busy("Too many pictures are being drawn.", "Try again after Retry-After.", _RETRY_AFTER_S)
            self._making[path] = asyncio.create_task(self._make(name, kind, path))
            self._making[path].add_done_callback(lambda _: self._making.pop(path))
        return self._making[path]

    async def _make(self, name: str, kind: Rendering, path: Path) -> None:
        """Draw the map's rendering into the file ``path``. Raises as :meth:`get`."""
        await self._threads.files(lambda: self._folder.mkdir(parents=True, exist_ok=True))
        source = await self._threads.fetches(self._library.path, name)
        request = {"source": str(source), "name": name, "kind": kind, "target": str(path)}
        async with self._turn:
            for _ in range(_ATTEMPTS):
                answer = await self._ask(request)
                if answer is not None:
                    break
            else:
                raise Busy("The process that draws was killed.", "Try again after Retry-After.", _RETRY_AFTER_S)
        if "error" in answer:
            kind_of_error = StorageFull if answer["code"] == StorageFull.code else InvalidMap
            raise kind_of_error(answer["error"], answer["hint"])

    async def _ask(self, request: dict[str, str]) -> dict[str, str] | None:
        """The process's answer, started if necessary; None if it ended or gave none within 120 s, and is killed."""
        if self._idle is not None:
            self._idle.cancel()
        if self._program is None or not self._program.running:
            self._program = await AsyncProgram.start("rholoc.pictures.rendering")
        await self._program.ask(request)
        line = b""
        with suppress(TimeoutError):
            line = await self._program.read_line(_LONGEST_S)
        if not line:
            await self.close()
            return None
        loop = asyncio.get_running_loop()
        self._idle = loop.call_later(_IDLE_S, lambda: loop.create_task(self.close()))
        answer: dict[str, str] = json.loads(line)
        return answer

    def sweep(self) -> None:
        """Remove renderings of maps that no longer exist or have changed. Safe in any thread."""
        current = set()
        for name in self._library.names():
            with suppress(RholocError):  # deleted meanwhile
                current |= {self.etag(name, kind).strip('"') for kind in Rendering}
        for path in self._folder.glob("*-*"):
            if path.name.partition("-")[0] not in current:
                path.unlink(missing_ok=True)

    async def close(self) -> None:
        """End the process; a rendering that is being made is abandoned."""
        if self._idle is not None:
            self._idle.cancel()
        program, self._program = self._program, None
        if program is not None:
            await program.kill()


def _read(path: Path) -> bytes | None:
    """Content of a file; None if it is missing."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        return None
