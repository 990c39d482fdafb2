"""Errors over HTTP: one shape, stable codes, never a traceback.

Every error of :mod:`rholoc.errors` has a status here; errors that only exist over HTTP are :class:`HttpError`.
"""

import errno
import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from pydantic import ValidationError
from sqlalchemy.exc import DatabaseError, InterfaceError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeout

from rholoc import errors
from rholoc.disk import is_full
from rholoc.errors import Busy, RholocError, StorageFull, StorageUnavailable


class HttpError(RholocError):
    """An error that only exists over HTTP."""


class InvalidRequest(HttpError):
    """A parameter or the body's JSON is missing, malformed or of the wrong type."""


class UnknownRoute(HttpError):
    """No route has this path."""


class MethodNotAllowed(HttpError):
    """The route exists, but not with this method."""

    def __init__(self, message: str, hint: str = "", allowed: Iterable[str] = ()) -> None:
        super().__init__(message, hint)
        self.allowed = tuple(sorted(allowed))


class UnsupportedMediaType(HttpError):
    """The body's content type is not one that the route reads."""


class Unauthorized(HttpError):
    """The request has no API key, or one that is not known, was revoked or has expired."""


class Forbidden(HttpError):
    """The API key's scope does not allow this."""


class CrossSite(HttpError):
    """A page of another site sent the request."""


class TooManyRequests(HttpError):
    """The API key asks more often than it may. Try again after ``retry_after_s`` seconds."""

    def __init__(self, message: str, hint: str = "", retry_after_s: float = 1.0) -> None:
        super().__init__(message, hint)
        self.retry_after_s = retry_after_s


class QuotaExceeded(TooManyRequests):
    """The API key would hold more maps, bytes or jobs than it may."""

    def __init__(self, message: str, hint: str = "", retry_after_s: float = 600.0) -> None:
        super().__init__(message, hint, retry_after_s)


class RequestTimeout(HttpError):
    """The request's body stops coming, or comes too slowly."""


class PreconditionFailed(HttpError):
    """The object to be replaced does not match the request's ``If-Match`` or ``If-None-Match``."""


class UnsupportedVersion(HttpError):
    """The client speaks a version of the upload protocol that the server does not."""


class ChecksumMismatch(HttpError):
    """The bytes that arrived are not those that were sent; none of them are kept."""


class Internal(HttpError):
    """The service itself failed; its log has the details under the request id."""


STATUS: Mapping[type[RholocError], int] = {
    errors.InvalidInput: 422,
    errors.InvalidMap: 422,
    errors.MappingFailed: 422,
    errors.NotFound: 404,
    errors.Conflict: 409,
    errors.Cancelled: 409,
    errors.TooLarge: 413,
    errors.StorageFull: 507,
    errors.StorageUnavailable: 503,
    errors.Busy: 503,
    errors.DeadlineExceeded: 504,
    InvalidRequest: 422,
    Unauthorized: 401,
    Forbidden: 403,
    CrossSite: 403,
    UnknownRoute: 404,
    TooManyRequests: 429,
    RequestTimeout: 408,
    MethodNotAllowed: 405,
    UnsupportedMediaType: 415,
    UnsupportedVersion: 412,
    PreconditionFailed: 412,
    ChecksumMismatch: 460,
    Internal: 500,
}

_STORAGE_RETRY_AFTER_S = "5"
TUS_VERSION = "1.0.0"  # the protocol of resumable uploads
_NOT_WRITABLE = (errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO)
# Exactly these classes: their subclasses are our bugs.
_DATABASE_ERRORS = (OperationalError, InterfaceError, DatabaseError, PoolTimeout)
_MAX_TEXT = 1000  # characters of a message, which may quote what was sent


def status_of(kind: type[RholocError]) -> int:
    """The HTTP status of an error class: its own, or that of the nearest base; 500 if there is none."""
    return next((STATUS[base] for base in kind.__mro__ if base in STATUS), 500)


def error_classes() -> Iterator[type[RholocError]]:
    """Iterate over every error class whose code may be in an answer."""
    waiting: list[type[RholocError]] = [RholocError]
    while waiting:
        kind = waiting.pop()
        if kind is not RholocError and kind is not HttpError:
            yield kind
        waiting.extend(kind.__subclasses__())


def as_rholoc_error(error: Exception) -> RholocError | None:
    """The error to report to the client: a RholocError itself, else one for a full or unwritable disk, an unavailable
    database, or input that pydantic refuses; None for a bug.
    """
    if isinstance(error, RholocError):
        return error
    if isinstance(error, OSError) and is_full(error):
        return StorageFull("The server's disk is full.", "Nothing was changed. Free space on the server and try again.")
    if isinstance(error, OSError) and error.errno in _NOT_WRITABLE:
        return StorageUnavailable("The server's storage cannot be written.", "Tell whoever runs the server.")
    if type(error) in _DATABASE_ERRORS:
        return StorageUnavailable("The server's database is locked, damaged or does not answer.", "Try again later.")
    if isinstance(error, ValidationError):
        return invalid_request(error.errors(include_url=False, include_context=False, include_input=False))
    return None


def invalid_request(found: Any) -> InvalidRequest:
    """The error for problems that pydantic found: one line with the first's place and message, and how many more."""
    first = found[0]
    place = ".".join(str(part) for part in first["loc"] if part not in ("body", "query", "path")) or "the request"
    more = f" ({len(found) - 1} more)" if len(found) > 1 else ""
    return InvalidRequest(f"{place}: {first['msg']}.{more}", "See /docs for what this route takes.")


def error_body(error: RholocError, request_id: str) -> dict[str, str]:
    """The one shape of all errors: code, message, hint and request id; texts are cut at 1000 characters."""
    message, hint = (text[:_MAX_TEXT].encode("utf-8", "replace").decode() for text in (error.message, error.hint))
    return {"code": error.code, "message": message, "hint": hint, "request_id": request_id}


def error_headers(error: RholocError) -> dict[str, str]:
    """Headers of an error's answer, by its kind; empty for most.

    ``Retry-After`` in whole seconds, at least 1; ``WWW-Authenticate``; ``Allow``; or the versions of tus.
    """
    if isinstance(error, Busy | TooManyRequests):
        return {"Retry-After": str(max(1, math.ceil(error.retry_after_s)))}
    if isinstance(error, StorageUnavailable):
        return {"Retry-After": _STORAGE_RETRY_AFTER_S}
    if isinstance(error, UnsupportedVersion):
        return {"Tus-Version": TUS_VERSION, "Tus-Resumable": TUS_VERSION}
    if isinstance(error, MethodNotAllowed):
        return {"Allow": ", ".join(error.allowed)}
    return {"WWW-Authenticate": "Bearer"} if isinstance(error, Unauthorized) else {}
