"""Audit log: a database row for each request that changed something."""

import logging
import time
from dataclasses import asdict, dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.exc import SQLAlchemyError
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from rholoc.errors import RholocError
from rholoc.service.access.keys import Scope as KeyScope
from rholoc.service.access.scopes import found_route, request_key
from rholoc.service.threads.storage import StorageLanes
from rholoc.storage.database import read_rows
from rholoc.storage.tables import changes_table

_ROWS = 100_000  # of the table
_ROWS_AT_ONCE = 500
_MAX_PATH = 300
_MAPS = "/v1/maps/"
_CHANGING = frozenset({"POST", "PUT", "PATCH", "DELETE"})
_SCOPES = frozenset({KeyScope.MAP, KeyScope.ADMIN})  # routes that change something need one of these
_PIECES = ("PATCH", "/v1/recordings/{recording}")  # piece of an upload, which is logged once, at its beginning
_log = logging.getLogger("rholoc.service")


@dataclass(frozen=True)
class Change:
    """A request that changed something.

    Attributes:
        time: seconds since the epoch.
        who: name of the API key, or the address if no key is needed.
        method: of the request.
        path: of the request, without its query.
        status: of the answer.
        job: id of the job that it began, or empty.
        request_id: as in the answer and the service's log.
    """

    time: float
    who: str
    method: str
    path: str
    status: int
    job: str
    request_id: str


class AuditLog:
    """The changes of all servers that share a database. Keeps the last 100 000. Safe to share between threads.

    Args:
        engine: of a database that has rholoc's tables.
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
        """The last ``most`` changes, the newest first; if given, only those to ``map_name``. Raises SQLAlchemyError."""
        fields = [column for column in changes_table.c if column.name != "id"]
        wanted = sa.select(*fields).order_by(changes_table.c.id.desc()).limit(most)
        if map_name is not None:
            path, of_map = changes_table.c.path, f"{_MAPS}{map_name}"
            wanted = wanted.where(sa.or_(path == of_map, path.startswith(f"{of_map}/", autoescape=True)))
        return [Change(**row) for row in read_rows(self._engine, wanted)]


class Audited:
    """ASGI middleware that logs successful requests to change something (scope map or admin) before they are answered.

    A change that cannot be noted is only a warning in the service's log.

    Args:
        app: the next application.
        log: the audit log.
        lanes: threads that write to it.
    """

    def __init__(self, app: ASGIApp, log: AuditLog, lanes: StorageLanes) -> None:
        self._app, self._audit, self._lanes = app, log, lanes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http" or scope["method"] not in _CHANGING:
            await self._app(scope, receive, send)
            return

        async def send_noting(message: Message) -> None:
            if message["type"] == "http.response.start" and 200 <= message["status"] < 300 and _is_change(scope):
                location = Headers(raw=message.get("headers", [])).get("location", "")
                job = location.rpartition("/v1/jobs/")[2] if "/v1/jobs/" in location else ""
                change = _change(scope, message["status"], job)
                try:
                    await self._lanes.database(self._audit.note, change)
                except (SQLAlchemyError, RholocError) as error:  # the change has been made already
                    _log.warning("change_not_noted", extra={"error": str(error)[:200], **asdict(change)})
            await send(message)

        await self._app(scope, receive, send_noting)


def _is_change(scope: Scope) -> bool:
    """Whether a request of this route is logged: those of scope map or admin, except for pieces of uploads."""
    route = found_route(scope)
    if route is None or route.access is None or route.access.scope not in _SCOPES:
        return False
    return (scope["method"], route.path) != _PIECES


def _change(scope: Scope, status: int, job: str) -> Change:
    """The log's entry for a request, with the id of the ``job`` that it began, if any."""
    key, client, state = request_key(scope), scope.get("client"), scope.get("state", {})
    who = key.name if key is not None else (client[0] if client else "")
    path: Any = scope["path"]
    return Change(time.time(), who, scope["method"], path[:_MAX_PATH], status, job, state.get("request_id", ""))
