"""The exception tree of the client. The codes are the service's own.

::

    RholocClientError
    ├── ConnectionFailed            the service cannot be reached, or the connection broke
    ├── InvalidAnswer               the answer is not the service's, or of another version of it
    ├── JobFailed                   the job that was waited for ended without a map
    ├── WaitTimedOut                the job that was waited for did not end in time
    ├── InvalidTrack                a tracker's input is invalid: times that go backward, poses that are not rigid
    └── ServiceError                the service answered with an error; it has code, hint, request_id
        ├── InvalidInput            what was sent cannot be used
        │   ├── InvalidRequest      a parameter is missing or of the wrong type
        │   ├── InvalidImage        not an image, truncated, too large
        │   ├── InvalidCamera       intrinsics missing or impossible
        │   ├── InvalidDescriptors  a descriptor set of wrong length, shape or number
        │   ├── InvalidName         not a valid map name
        │   ├── InvalidRecording    a recording that cannot be read
        │   ├── InvalidWaypoints    waypoints missing, malformed, too few or collinear
        │   ├── InvalidTrajectory   a pose table that cannot be read
        │   ├── NotInstalled        features that need a package which the service does not have
        │   └── UnsupportedMediaType
        ├── InvalidMap              a map file that is corrupt, truncated or foreign
        ├── NotFound
        │   ├── UnknownMap
        │   ├── UnknownCamera
        │   ├── UnknownRecording
        │   ├── UnknownSite
        │   ├── UnknownPicture
        │   ├── UnknownJob
        │   └── UnknownRoute        an older service, or a wrong base URL
        ├── Unauthorized            no API key was sent, or one that is no longer valid
        ├── Forbidden               the API key's scope does not allow this
        ├── CrossSite               a page of another site sent the request
        ├── MethodNotAllowed
        ├── Conflict                the request contradicts the present state
        ├── PreconditionFailed      what is to be replaced was changed meanwhile
        ├── MappingFailed           no trustworthy map could be made from a recording
        ├── Cancelled               the work was cancelled
        ├── TooLarge                the upload exceeds the service's limit
        ├── StorageFull             the service's disk is full
        ├── StorageUnavailable      the service's storage or database cannot be used at present
        ├── RequestTimeout          the request reached the service too slowly
        ├── TooManyRequests         the API key asks more often than it may, retries included
        │   └── QuotaExceeded       the API key would hold more maps, bytes or jobs than it may
        ├── Busy                    the service's queue is full, retries included
        ├── DeadlineExceeded        the deadline passed
        ├── UnsupportedVersion      the service speaks another version of the upload protocol
        ├── ChecksumMismatch        the bytes of an upload were changed on the way
        └── Internal                the service itself failed
"""

import re
from collections.abc import Iterator

_WORD_START = re.compile(r"(?<!^)(?=[A-Z])")


class RholocClientError(Exception):
    """The base of all errors of the client."""


class ConnectionFailed(RholocClientError):
    """The service cannot be reached, or the connection broke, after all retries."""


class InvalidAnswer(RholocClientError):
    """The answer is not the service's, or of another version of it."""


class InvalidTrack(RholocClientError):
    """A tracker's input is invalid: times that go backward, poses that are not rigid, odometry in a map without
    scale."""


class JobFailed(RholocClientError):
    """The job that was waited for failed or was cancelled. ``code`` and ``hint`` are the job's."""

    def __init__(self, code: str, message: str, hint: str) -> None:
        super().__init__(f"{message} {hint}".strip())
        self.code = code
        self.message = message
        self.hint = hint


class WaitTimedOut(RholocClientError):
    """The job that was waited for did not end in time; it goes on."""


class ServiceError(RholocClientError):
    """The service answered with an error. ``request_id`` finds it in the service's log.

    The ``code`` of a class below is its name in snake case, unless it states another.
    """

    code = "error"

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "code" not in vars(cls):
            cls.code = _WORD_START.sub("_", cls.__name__).lower()

    def __init__(self, message: str, hint: str = "", request_id: str = "", status: int = 0, code: str = "") -> None:
        super().__init__(f"{message} {hint}".strip())
        self.code = code or type(self).code
        self.message = message
        self.hint = hint
        self.request_id = request_id
        self.status = status


class InvalidInput(ServiceError):
    """What was sent cannot be used."""


class InvalidRequest(InvalidInput):
    """A parameter or the body is missing, malformed or of the wrong type."""


class InvalidImage(InvalidInput):
    """The bytes are not an image, are truncated, or claim more pixels than allowed."""


class InvalidCamera(InvalidInput):
    """Intrinsics are missing or physically impossible."""


class InvalidDescriptors(InvalidInput):
    """A descriptor set has the wrong length, shape, channel or number."""


class InvalidName(InvalidInput):
    """A map name is not valid."""


class InvalidRecording(InvalidInput):
    """A recording that cannot be read."""


class InvalidWaypoints(InvalidInput):
    """Waypoints are malformed, fewer than three, or collinear."""


class InvalidTrajectory(InvalidInput):
    """A pose table that cannot be read."""


class NotInstalled(InvalidInput):
    """The features asked for need a package that is not installed where the service runs."""


class UnsupportedMediaType(InvalidInput):
    """The body is of a type that the route does not read."""


class InvalidMap(ServiceError):
    """A map file is corrupt, truncated, of a later version, or not a map at all."""


class NotFound(ServiceError):
    """What was asked for does not exist."""


class UnknownMap(NotFound):
    """No map has this name."""


class UnknownCamera(NotFound):
    """No camera has this name."""


class UnknownRecording(NotFound):
    """No recording has this id."""


class UnknownSite(NotFound):
    """No site has this name."""


class UnknownPicture(NotFound):
    """No picture of this is kept, or the service does not show it."""


class UnknownJob(NotFound):
    """No job has this id."""


class UnknownRoute(NotFound):
    """The service has no such route: an older service, or a wrong base URL."""


class Unauthorized(ServiceError):
    """The service requires an API key, and none was sent, or one that is unknown, was revoked or has expired."""


class Forbidden(ServiceError):
    """The API key's scope does not allow this."""


class CrossSite(ServiceError):
    """The request looks as if a page of another site had sent it."""


class MethodNotAllowed(ServiceError):
    """The route does not take this method: an older service, or a wrong base URL."""


class Conflict(ServiceError):
    """The request contradicts the present state."""


class PreconditionFailed(ServiceError):
    """What is to be replaced was changed meanwhile."""


class MappingFailed(ServiceError):
    """No map that can be trusted could be made from a recording."""


class Cancelled(ServiceError):
    """The work was cancelled on request."""


class TooLarge(ServiceError):
    """The upload exceeds the service's limit."""


class StorageFull(ServiceError):
    """The service's disk is full; nothing stored was changed."""


class StorageUnavailable(ServiceError):
    """The service's storage or database cannot be used at present; nothing stored was changed."""


class RequestTimeout(ServiceError):
    """The request reached the service too slowly, or stopped half-way."""


class TooManyRequests(ServiceError):
    """The API key asks more often than it may, and did so at every retry."""


class QuotaExceeded(TooManyRequests):
    """The API key would hold more maps, bytes or jobs than it may."""


class Busy(ServiceError):
    """The service's queue is full, and stayed so at every retry."""


class DeadlineExceeded(ServiceError):
    """The deadline passed before an answer was found."""


class UnsupportedVersion(ServiceError):
    """The service speaks another version of the upload protocol: an older or newer service."""


class ChecksumMismatch(ServiceError):
    """The bytes of an upload were changed on the way, repeatedly."""


class Internal(ServiceError):
    """The service failed."""


def _all(kind: type[ServiceError]) -> Iterator[type[ServiceError]]:
    yield kind
    for below in kind.__subclasses__():
        yield from _all(below)


BY_CODE = {kind.code: kind for kind in _all(ServiceError)}
