"""Who changed what: a line for each request that changed something, kept in files of bounded size."""

from __future__ import annotations

import fcntl
import json
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Protocol

import sqlalchemy as sa
import structlog
from sqlalchemy.exc import SQLAlchemyError
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from rholoc.service.access import found_route, request_key
from rholoc.service.keys import Scope as KeyScope
from rholoc.storage.tables import changes_table

_FOLDER, _FILE, _LOCK = "audit", "audit.jsonl", ".lock"
_FILE_BYTES = 4 * 2**20
_FILES = 5  # with the one that is written to
_ROWS = 100_000  # of the table
_ROWS_AT_ONCE = 500
_MAX_PATH = 300
_MAPS = "/v1/maps/"
_CHANGING = frozenset({"POST", "PUT", "PATCH", "DELETE"})
_SCOPES = frozenset({KeyScope.MAP, KeyScope.ADMIN})  # what changes nothing needs less
_PIECES = ("PATCH", "/v1/recordings/{recording}")  # of an upload, which is noted when it begins
_log = structlog.get_logger("rholoc.service")


@dataclass(frozen=True)
class Change:
    """A request that changed something.

    Attributes:
        time: seconds since the epoch.
        who: the name of the API key, or the address where no key is needed.
        method: of the request.
        path: of the request, without its query.
        status: of the answer.
        job: the job that it began, empty where it began none.
        request_id: as in the answer and the service's log.
    """

    time: float
    who: str
    method: str
    path: str
    status: int
    job: str
    request_id: str


class AuditLog(Protocol):
    """The changes; the oldest are forgotten. Safe to share between threads and processes."""

    def note(self, change: Change) -> None:
        """Add a change. Raises OSError, SQLAlchemyError."""
        ...

    def changes(self, most: int, map_name: str | None = None) -> list[Change]:
        """The last changes, the newest first; of all, or those whose path names a map."""
        ...


class FolderAuditLog:
    """The changes of the servers that share a data folder; the oldest are forgotten beyond 20 MiB.

    Safe to share between threads and processes.
    """

    def __init__(self, data_dir: Path) -> None:
        self._folder = Path(data_dir) / _FOLDER

    def note(self, change: Change) -> None:
        """Add a change. Raises OSError."""
        line = json.dumps(asdict(change), ensure_ascii=False).encode() + b"\n"
        self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        with (self._folder / _LOCK).open("a") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            path = self._file(0)
            if path.exists() and path.stat().st_size + len(line) > _FILE_BYTES:
                for number in range(_FILES - 1, 0, -1):
                    if self._file(number - 1).exists():
                        self._file(number - 1).replace(self._file(number))
            with path.open("ab") as file:
                file.write(line)

    def changes(self, most: int, map_name: str | None = None) -> list[Change]:
        """The last changes, the newest first; of all, or those whose path names a map."""
        wanted = (one for one in self._newest_first() if map_name is None or _names(one.path, map_name))
        return list(islice(wanted, most))

    def _newest_first(self) -> Iterator[Change]:
        for number in range(_FILES):
            try:
                lines = self._file(number).read_bytes().splitlines()
            except FileNotFoundError:
                continue
            for line in reversed(lines):
                try:
                    yield Change(**json.loads(line))
                except (ValueError, TypeError):  # a line that a crash cut off
                    continue

    def _file(self, number: int) -> Path:
        return self._folder / (_FILE if number == 0 else f"{_FILE}.{number}")


class SharedAuditLog:
    """The changes of all servers that share a database; the oldest are forgotten beyond 100 000.

    Args:
        engine: the database's, with rholoc's tables in it.
    """

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine

    def note(self, change: Change) -> None:
        """Add a change. Raises SQLAlchemyError."""
        with self._engine.begin() as connection:
            added = connection.execute(changes_table.insert().values(**asdict(change)))
            number = added.inserted_primary_key[0] if added.inserted_primary_key else 0
            if number % _ROWS_AT_ONCE == 0:
                connection.execute(changes_table.delete().where(changes_table.c.id <= number - _ROWS))

    def changes(self, most: int, map_name: str | None = None) -> list[Change]:
        """The last changes, the newest first; of all, or those whose path names a map. Raises SQLAlchemyError."""
        fields = [column for column in changes_table.c if column.name != "id"]
        wanted = sa.select(*fields).order_by(changes_table.c.id.desc()).limit(most)
        if map_name is not None:
            path, of_map = changes_table.c.path, f"{_MAPS}{map_name}"
            wanted = wanted.where(sa.or_(path == of_map, path.startswith(f"{of_map}/", autoescape=True)))
        with self._engine.connect() as connection:
            return [Change(**row) for row in connection.execute(wanted).mappings()]


def _names(path: str, map_name: str) -> bool:
    return path == f"{_MAPS}{map_name}" or path.startswith(f"{_MAPS}{map_name}/")


class Audited:
    """ASGI middleware that notes the requests that changed something, before they are answered.

    Args:
        app: what answers them.
        log: where they are noted.
    """

    def __init__(self, app: ASGIApp, log: AuditLog) -> None:
        self._app = app
        self._audit = log

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http" or scope["method"] not in _CHANGING:
            await self._app(scope, receive, send)
            return

        async def send_noting(message: Message) -> None:
            if message["type"] == "http.response.start" and 200 <= message["status"] < 300 and _is_change(scope):
                location = Headers(raw=message.get("headers", [])).get("location", "")
                job = location.rpartition("/v1/jobs/")[2] if "/v1/jobs/" in location else ""
                await run_in_threadpool(self._note, _change(scope, message["status"], job))
            await send(message)

        await self._app(scope, receive, send_noting)

    def _note(self, change: Change) -> None:
        try:
            self._audit.note(change)
        except (OSError, SQLAlchemyError) as error:  # what was changed is changed: the answer stands
            _log.warning("change_not_noted", error=str(error)[:200], **asdict(change))


def _is_change(scope: Scope) -> bool:
    route = found_route(scope)
    if route is None or route.access is None or route.access.scope not in _SCOPES:
        return False
    return (scope["method"], route.path) != _PIECES


def _change(scope: Scope, status: int, job: str) -> Change:
    key, client, state = request_key(scope), scope.get("client"), scope.get("state", {})
    who = key.name if key is not None else (client[0] if client else "")
    path: Any = scope["path"]
    return Change(time.time(), who, scope["method"], path[:_MAX_PATH], status, job, state.get("request_id", ""))
