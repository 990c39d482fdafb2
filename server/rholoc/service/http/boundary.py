"""The outermost layer: a request id in every answer, every error in one shape."""

import asyncio
import logging
import re
import uuid

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import ClientDisconnect
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from rholoc.errors import RholocError
from rholoc.service.errors import Internal, as_rholoc_error, error_body, error_headers, status_of

REQUEST_ID_HEADER = "X-Request-ID"
_REQUEST_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")
_REFUSED = 400  # statuses from here on
_REFUSAL_TAKES_S = 0.02  # minimum, against clients that repeat invalid requests without pause
_log = logging.getLogger("rholoc.service")


class RequestBoundary:
    """ASGI middleware. Takes the caller's ``X-Request-ID`` if it is well-formed, else makes one. Errors wait for 20 ms.

    An exception that nothing else turned into an answer becomes ``internal`` and is logged with its traceback.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] == "websocket":
            await self._open_socket(scope, receive, send)
            return
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request_id = _request_id(Headers(scope=scope).get(REQUEST_ID_HEADER))
        scope.setdefault("state", {})["request_id"] = request_id
        started = False

        async def send_with_id(message: Message) -> None:
            nonlocal started
            if message["type"] == "http.response.start":
                if message["status"] >= _REFUSED:
                    await asyncio.sleep(_REFUSAL_TAKES_S)
                started = True
                MutableHeaders(scope=message)[REQUEST_ID_HEADER] = request_id
            await send(message)

        try:
            await self._app(scope, receive, send_with_id)
        except ClientDisconnect:
            _log.info("client_disconnected", extra={"request_id": request_id, "path": scope["path"]})
        except Exception as error:
            known = as_rholoc_error(error)
            if known is None:
                _log.exception("internal_error", extra={"request_id": request_id, "path": scope["path"]})
                known = Internal(
                    "The service failed.",
                    f"Its log has the details under the request id {request_id}.",
                )
            if not started:
                answer = JSONResponse(error_body(known, request_id), status_of(type(known)), error_headers(known))
                await answer(scope, receive, send_with_id)

    async def _open_socket(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let the application accept a WebSocket; a RholocError before that becomes the answer to its handshake."""
        request_id = _request_id(Headers(scope=scope).get(REQUEST_ID_HEADER))
        try:
            await self._app(scope, receive, send)
        except RholocError as error:
            await asyncio.sleep(_REFUSAL_TAKES_S)
            answer = JSONResponse(error_body(error, request_id), status_of(type(error)), error_headers(error))
            answer.headers[REQUEST_ID_HEADER] = request_id
            await answer(scope, receive, send)


def _request_id(offered: str | None) -> str:
    """The offered id if it is well-formed, else a new one of 32 hex digits."""
    return offered if offered and _REQUEST_ID.fullmatch(offered) else uuid.uuid4().hex
