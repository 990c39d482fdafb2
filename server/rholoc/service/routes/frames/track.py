"""A stream of frames → a pose for each."""

from __future__ import annotations

import uuid
from contextlib import suppress

import structlog
from fastapi import APIRouter, WebSocket, WebSocketDisconnect

from rholoc.errors import RholocError
from rholoc.service.access.open_streams import StreamKind
from rholoc.service.access.scopes import STREAM_NEEDS_LOCALIZE, STREAM_PROTOCOL
from rholoc.service.errors import Internal, as_rholoc_error, error_body
from rholoc.service.routes.frames.track_messages import StreamError
from rholoc.service.routes.frames.track_stream import Stream
from rholoc.service.state import State

router = APIRouter(prefix="/v1", tags=["localization"])

_log = structlog.get_logger("rholoc.service")
_ENDED_BY_ERROR = 1008  # a WebSocket's "policy violation": what was sent cannot be used
_ENDED_BY_FAILURE = 1011


@router.websocket("/maps/{map_name}/track", dependencies=[STREAM_NEEDS_LOCALIZE])
async def track(socket: WebSocket, map_name: str) -> None:
    """Frames, odometry and IMU readings come in; poses go out. See the README of the service for the messages."""
    service: State = socket.app.state.rholoc
    offered = socket.scope.get("subprotocols") or []
    await socket.accept(STREAM_PROTOCOL if STREAM_PROTOCOL in offered else None)
    request_id = uuid.uuid4().hex

    try:
        await service.frames.check_known([map_name])
        async with service.streams.serving(service.streams.admit(StreamKind.FRAMES, socket.scope)):
            await Stream(socket, map_name, service).run()
    except WebSocketDisconnect:
        return
    except Exception as error:
        known = as_rholoc_error(error)
        if known is None:
            _log.exception("internal_error", request_id=request_id, path=socket.url.path)
            known = Internal("The service failed.", f"Its log has the details under the request id {request_id}.")
        await _end(socket, known, request_id)


async def _end(socket: WebSocket, error: RholocError, request_id: str) -> None:
    """Send the error with the request's id, and close the WebSocket; does nothing if the client has left."""
    code = _ENDED_BY_FAILURE if isinstance(error, Internal) else _ENDED_BY_ERROR
    with suppress(RuntimeError, WebSocketDisconnect):  # the client has left
        await socket.send_text(StreamError.model_validate(error_body(error, request_id)).model_dump_json())
        await socket.close(code, error.code)
