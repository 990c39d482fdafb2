"""Trace each request, as part of the caller's trace if it sends a W3C ``traceparent``."""

from __future__ import annotations

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from rholoc import telemetry
from rholoc.service.access.guard import API_PATHS
from rholoc.service.access.scopes import found_route, request_key

_FAILED = 500  # statuses from here on


class Traced:
    """ASGI middleware that traces requests to routes that need a key, so neither the page nor probes.

    Args:
        app: the next application.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if not telemetry.is_on() or scope["type"] != "http" or not scope["path"].startswith(API_PATHS):
            await self._app(scope, receive, send)
            return
        method = scope["method"]
        with telemetry.request_span(method, Headers(scope=scope)) as marks:
            status = 0

            async def send_noting_status(message: Message) -> None:
                nonlocal status
                if message["type"] == "http.response.start":
                    status = message["status"]
                await send(message)

            try:
                await self._app(scope, receive, send_noting_status)
            finally:
                route, key = found_route(scope), request_key(scope)
                if route is not None:
                    marks.rename(f"{method} {route.path}")
                    marks.set({"http.route": route.path})
                if key is not None:
                    marks.set({"rholoc.key": key.name})
                marks.set(
                    {
                        "http.request.method": method,
                        "http.response.status_code": status,
                        "url.path": scope["path"],
                        "rholoc.request_id": scope.get("state", {}).get("request_id", ""),
                    }
                )
                if status >= _FAILED:
                    marks.fail(f"answered with {status}")
