"""Key scopes that routes need: each route declares its own, and OpenAPI shows it.

A route is added with ``dependencies=[NEEDS_READ]``, or another of the constants below. The guard checks the key against
the declaration before any of the body is read. Routes without a declaration are refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from fastapi import Request, Security, WebSocket
from fastapi.dependencies.models import Dependant
from fastapi.params import Security as SecurityParameter
from fastapi.routing import RouteContext, iter_route_contexts
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer, SecurityScopes
from starlette.routing import BaseRoute, Match
from starlette.types import Scope as RequestScope

from rholoc.service.access.keys import ApiKey, Scope
from rholoc.service.caller import CLIENT
from rholoc.service.errors import Forbidden

_KEY = "api_key"  # members of a request's state: its key …
_GRANTED = "granted"  # … its granted scope …
_FOUND = "found_route"  # … its route …
_CLIENT = "counted_to"  # … and its client
_bearer = HTTPBearer(
    scheme_name="ApiKey",
    description="A key from `rholoc key create`. A server that only listens on its own machine needs none.",
    auto_error=False,
)


def grant(request_scope: RequestScope, scope: Scope, key: ApiKey | None = None) -> None:
    """Record a request's granted scope and its key in its state; None if no key is needed."""
    state = request_scope.setdefault("state", {})
    state[_GRANTED], state[_KEY] = scope, key


def granted_key(request: Request) -> tuple[Scope, float | None, bool]:
    """A request's granted scope, its key's expiry (seconds since the epoch; None: never), and whether it has a key."""
    key: ApiKey | None = getattr(request.state, _KEY, None)
    return getattr(request.state, _GRANTED), None if key is None else key.expires, key is not None


def request_key(request_scope: RequestScope) -> ApiKey | None:
    """The request's key; None if none is needed or the guard has not seen it."""
    key: ApiKey | None = request_scope.get("state", {}).get(_KEY)
    return key


def note_client(request_scope: RequestScope, name: str) -> None:
    """Record a request's client: the root of its key's chain, or an address if no key is needed."""
    CLIENT.set(name)
    request_scope.setdefault("state", {})[_CLIENT] = name


def client_of(request_scope: RequestScope) -> str:
    """A request's client: its root key's name, or its address if no key is needed; empty if the route is open."""
    return str(request_scope.get("state", {}).get(_CLIENT, ""))


def found_route(request_scope: RequestScope) -> RouteAccess | None:
    """The route that :func:`find_route` recorded in a request's state; None if there is none."""
    found: RouteAccess | None = request_scope.get("state", {}).get(_FOUND)
    return found


def forbidden(held: Scope, needed: Scope) -> Forbidden:
    """The error for a key whose scope is too small."""
    return Forbidden(
        f"This API key may not do that: its scope is {held}, and {needed} is needed.",
        f"On the server, rholoc key create NAME --scope {needed} makes one.",
    )


def check_granted(
    request: Request, needed: SecurityScopes, _key: Annotated[HTTPAuthorizationCredentials | None, Security(_bearer)]
) -> None:
    """Dependency of every route that needs a key: check that the guard granted a scope that includes the route's.

    Raises:
        Forbidden: the guard did not.
    """
    held: Scope | None = getattr(request.state, _GRANTED, None)
    for scope in map(Scope, needed.scopes):
        if held is None or not held.allows(scope):
            raise forbidden(held, scope) if held else undeclared()


def allow_everyone() -> None:
    """The dependency of a route that needs no key."""


STREAM_PROTOCOL = "rholoc.track.1"
STREAM_KEY_PREFIX = "rholoc.key."


def check_stream_granted(socket: WebSocket, needed: SecurityScopes) -> None:
    """Dependency of every WebSocket route: check that the guard granted a scope that includes the route's.

    Raises:
        Forbidden: the guard did not.
    """
    held: Scope | None = getattr(socket.state, _GRANTED, None)
    for scope in map(Scope, needed.scopes):
        if held is None or not held.allows(scope):
            raise forbidden(held, scope) if held else undeclared()


STREAM_NEEDS_LOCALIZE = Security(check_stream_granted, scopes=[Scope.LOCALIZE])
NEEDS_VISIT = Security(check_granted, scopes=[Scope.VISIT])
NEEDS_READ = Security(check_granted, scopes=[Scope.READ])
NEEDS_LOCALIZE = Security(check_granted, scopes=[Scope.LOCALIZE])
NEEDS_MAP = Security(check_granted, scopes=[Scope.MAP])
NEEDS_ADMIN = Security(check_granted, scopes=[Scope.ADMIN])
OPEN = Security(allow_everyone)
_CHECKS = (check_granted, check_stream_granted)


def undeclared() -> Forbidden:
    """The error for a route without a declaration, a bug in the service."""
    return Forbidden("This route does not declare who may use it.", "Report this to whoever runs the service.")


@dataclass(frozen=True)
class Access:
    """Required access of a route.

    Attributes:
        scope: required of the key; None if no key is needed.
    """

    scope: Scope | None


@dataclass(frozen=True)
class RouteAccess:
    """A route with its required access.

    Attributes:
        path: as in OpenAPI, with ``{parameters}``.
        methods: the HTTP methods that it supports.
        access: None without a declaration.
        query: the names of its query parameters.
        parses_body: whether the framework reads and parses its body.
        context: the framework's, which matches requests.
    """

    path: str
    methods: frozenset[str]
    access: Access | None
    query: frozenset[str]
    parses_body: bool
    context: RouteContext


@dataclass(frozen=True)
class FoundRoute:
    """Result of routing a request.

    Attributes:
        route: the matching route, or None.
        methods: if only the method does not match, the methods of the path; else empty.
    """

    route: RouteAccess | None
    methods: frozenset[str] = frozenset()


def route_access(routes: Sequence[BaseRoute]) -> list[RouteAccess]:
    """All routes, including those of included routers, in the order in which they are tried."""
    return [_route_access(context) for context in iter_route_contexts(routes)]


def find_route(routes: Sequence[RouteAccess], request_scope: RequestScope) -> FoundRoute:
    """The first route for a request's path and method, recorded for :func:`found_route`; else the path's methods."""
    methods: frozenset[str] = frozenset()
    for route in routes:
        match, _ = route.context.matches(request_scope)
        if match is Match.FULL:
            request_scope.setdefault("state", {})[_FOUND] = route
            return FoundRoute(route)
        if match is Match.PARTIAL:
            methods |= route.methods
    return FoundRoute(None, methods)


def _route_access(context: RouteContext) -> RouteAccess:
    """A route with the access that it declares."""
    dependant = getattr(context, "dependant", None)
    return RouteAccess(
        path=context.path or "",
        methods=frozenset(context.methods or ()),
        access=_declared(context),
        query=frozenset() if dependant is None else _query(dependant),
        parses_body=getattr(context, "body_field", None) is not None,
        context=context,
    )


def _query(dependant: Dependant) -> frozenset[str]:
    """Names of the query parameters of a route's function and of its dependencies."""
    own = frozenset(parameter.alias for parameter in dependant.query_params)
    return own.union(*map(_query, dependant.dependencies))


def _declared(context: RouteContext) -> Access | None:
    """Access that a route declares: the greatest of its scopes, or open to everyone; None without a declaration."""
    declared = [one for one in getattr(context, "dependencies", ()) if isinstance(one, SecurityParameter)]
    scopes = [Scope(scope) for one in declared if one.dependency in _CHECKS for scope in one.scopes or ()]
    if scopes:
        return Access(max(scopes, key=list(Scope).index))
    return Access(None) if any(one.dependency is allow_everyone for one in declared) else None
