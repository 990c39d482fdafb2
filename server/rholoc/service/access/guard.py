"""Access control: API keys, requests from other sites, and security headers for browsers."""

import asyncio
from collections.abc import Collection, Sequence
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders, QueryParams
from starlette.routing import BaseRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from rholoc.service.access.keys import ApiKey, KeyStore
from rholoc.service.access.keys import Scope as KeyScope
from rholoc.service.access.scopes import (
    STREAM_KEY_PREFIX,
    Access,
    RouteAccess,
    find_route,
    forbidden,
    grant,
    note_client,
    request_key,
    route_access,
    undeclared,
)
from rholoc.service.caller import ASKER
from rholoc.service.errors import CrossSite, InvalidRequest, MethodNotAllowed, Unauthorized, UnknownRoute
from rholoc.service.settings import KeyPolicy, is_loopback, keys_needed
from rholoc.service.threads.storage import StorageLanes

_READING = ("GET", "HEAD", "OPTIONS")
API_PATHS = ("/v1/", "/geopose")
"""Where paths of the API begin; all others are of pages."""

_KEY_HINT = "Make one on the server with rholoc key create, and send it as Authorization: Bearer KEY."

SECURITY_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; media-src 'self' blob:; "
        "connect-src 'self'; worker-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'none'; "
        "frame-ancestors 'none'"
    ),
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(self), accelerometer=(self), gyroscope=(self), microphone=(), geolocation=()",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}


class SecurityHeaders:
    """ASGI middleware that adds the security headers to every response."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in SECURITY_HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        await self._app(scope, receive, send_with_headers)


class Guard:
    """ASGI middleware that checks a request before any of its body is read.

    It finds the request's route and enforces the route's declaration. Requests without a declared route are refused.

    Args:
        app: the application to guard.
        routes: its routes.
        keys: the key store.
        lanes: threads that reload the keys.
        policy: when a request needs a key.
        host: the address that the server listens on.
        open_paths: routes that need no key, whatever they declare.
        origins: sites whose pages may send requests.
    """

    def __init__(
        self,
        app: ASGIApp,
        routes: Sequence[BaseRoute],
        keys: KeyStore,
        lanes: StorageLanes,
        policy: KeyPolicy,
        host: str,
        open_paths: Collection[str] = (),
        origins: Collection[str] = (),
    ) -> None:
        self._app = app
        self._routes = route_access(routes)
        self._keys, self._lanes = keys, lanes
        self._open_paths = frozenset(open_paths)
        self._origins = frozenset(origins)
        self._keys_needed = keys_needed(policy, host)
        self._looking: asyncio.Task[None] | None = None
        self._local_only = policy is KeyPolicy.AUTO and not self._keys_needed

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request.

        Raises:
            CrossSite: another site sent it.
            Unauthorized: it needs a key, and has none or an invalid one.
            Forbidden: its key's scope is too small, or the route declares no access.
            UnknownRoute, MethodNotAllowed: no route takes it; only clients of at least the scope READ learn this.
            InvalidRequest: the query has a name that the route does not know.
        """
        if scope["type"] in ("http", "websocket"):
            headers = Headers(scope=scope)
            check_same_site(scope.get("method", "GET"), headers, self._local_only, self._origins)
            found = find_route(self._routes, scope)
            access = Access(KeyScope.READ) if found.route is None else found.route.access
            if access is None:
                raise undeclared()
            if access.scope is not None:
                is_open = found.route is not None and found.route.path in self._open_paths
                key = None if is_open else await self._check_key(_authorization(scope, headers), access.scope)
                grant(scope, access.scope if is_open else KeyScope.ADMIN if key is None else key.scope, key)
                ASKER.set(_address(scope) if key is None else key.name)
                note_client(scope, _address(scope) if key is None else self._keys.chain(key)[-1].name)
            if found.route is None and found.methods:
                hint = "The answer's header Allow names those that it takes."
                raise MethodNotAllowed("This route does not support this method.", hint, found.methods)
            if found.route is None:
                raise UnknownRoute("There is nothing at this path.", "See /docs for the routes.")
            check_query(scope, found.route)
        await self._app(scope, self._receive_while_valid(scope, receive), send)

    def _receive_while_valid(self, scope: Scope, receive: Receive) -> Receive:
        """A receive function for the request's body that raises Unauthorized once its key is invalid; ``receive``
        itself for a WebSocket or without a key.
        """
        key = request_key(scope) if scope["type"] == "http" else None
        if key is None:
            return receive

        async def receive_checked() -> Message:
            message = await receive()
            if message.get("body") and not self._keys.is_valid(key):
                raise Unauthorized("This API key was revoked.", _KEY_HINT)
            return message

        return receive_checked

    async def _known(self, secret: str) -> ApiKey | None:
        """The key of a secret; unless in memory, all keys are read again, in a thread. None if there is none."""
        key = self._keys.find(secret)
        if key is None:
            if self._looking is None or self._looking.done():
                self._looking = asyncio.create_task(self._lanes.database(self._keys.refresh))
            await asyncio.shield(self._looking)
            key = self._keys.find(secret)
        return key

    async def _check_key(self, authorization: str, needed: KeyScope) -> ApiKey | None:
        """The key in a header ``authorization``, of at least the scope ``needed``; None if the server needs no keys.

        Raises:
            Unauthorized: there is no key, or it is unknown, revoked or expired.
            Forbidden: its scope is too small.
        """
        if not self._keys_needed:
            return None
        kind, _, secret = authorization.partition(" ")
        if kind.lower() != "bearer" or not secret.strip():
            raise Unauthorized("This server requires an API key.", _KEY_HINT)
        key = await self._known(secret.strip())
        if key is None:
            raise Unauthorized("This API key is unknown, or was revoked.", _KEY_HINT)
        if not self._keys.is_valid(key):
            raise Unauthorized("This API key has expired.", _KEY_HINT)
        if not key.scope.allows(needed):
            raise forbidden(key.scope, needed)
        return key


def _address(scope: Scope) -> str:
    """The client's IP address; empty if unknown."""
    client = scope.get("client")
    return f"{client[0]}" if client else ""


def _authorization(scope: Scope, headers: Headers) -> str:
    """A request's Authorization header; else "Bearer KEY" with a WebSocket's subprotocol's key; else empty."""
    offered = scope.get("subprotocols", ()) if scope["type"] == "websocket" else ()
    keys = [one.removeprefix(STREAM_KEY_PREFIX) for one in offered if one.startswith(STREAM_KEY_PREFIX)]
    return headers.get("authorization", f"Bearer {keys[0]}" if keys else "")


def check_query(scope: Scope, route: RouteAccess) -> None:
    """Raise InvalidRequest for a query parameter that an API route does not know, so no typing error is ignored."""
    if not route.path.startswith(API_PATHS):
        return
    given = QueryParams(scope["query_string"])
    unknown = next((name for name in given if name not in route.query), None)
    if unknown is not None:
        known = ", ".join(sorted(route.query)) or "none"
        raise InvalidRequest(f"The query has '{unknown[:64]}', which this route does not take.", f"It takes: {known}.")


def check_same_site(method: str, headers: Headers, local_only: bool, origins: Collection[str] = ()) -> None:
    """Refuse requests that a page of another site makes a browser send; requests without a browser's headers pass.

    Reading by following a link from another site is allowed, and so is everything from one of ``origins``. With
    ``local_only`` only local host names are accepted, against DNS rebinding.

    Raises:
        CrossSite: another site sent it, or it uses another name of this machine.
    """
    host, origin, site = headers.get("host", ""), headers.get("origin"), headers.get("sec-fetch-site")
    if local_only and not is_loopback(_host_name(host)):
        raise CrossSite(f"This server does not answer to the name {host[:64]}.", "Use localhost.")
    if origin in origins:
        return
    if site is not None:
        followed = method in _READING and headers.get("sec-fetch-mode") == "navigate"
        foreign = site not in ("same-origin", "none") and not followed
    else:
        foreign = origin is not None and origin.partition("://")[2] != host
    if foreign:
        raise CrossSite("Another site may not use this server from a browser.", "Open the server's own page.")


def _host_name(host: str) -> str:
    """The name or address in a ``Host`` header, without its port; empty if there is none or it is malformed."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""
