"""The exception tree. Every error a user can meet is one of these.

::

    RholocError
    ├── InvalidInput            what was given cannot be used
    │   ├── InvalidImage        not an image, truncated, too large
    │   ├── InvalidCamera       intrinsics missing or impossible
    │   ├── InvalidDescriptors  a descriptor set of wrong length, shape or number
    │   ├── InvalidName         not a valid map name
    │   ├── InvalidRecording    a video, image folder or table that cannot be read
    │   ├── InvalidWaypoints    waypoints missing, malformed, too few or collinear
    │   ├── InvalidTrajectory   a trajectory or pose table that cannot be read
    │   └── NotInstalled        features that need a package which is not installed
    ├── InvalidMap              a map file that is corrupt, truncated or foreign
    ├── NotFound
    │   ├── UnknownMap
    │   ├── UnknownCamera
    │   ├── UnknownRecording
    │   ├── UnknownSite
    │   └── UnknownJob
    ├── Conflict                the request contradicts the present state
    ├── MappingFailed           a recording was read but gave no trustworthy map
    ├── Cancelled               the work was cancelled on request
    ├── TooLarge                the upload exceeds the limit
    ├── StorageFull             the disk is full; nothing was replaced
    ├── StorageUnavailable      storage or database cannot be written, is locked or damaged
    ├── Busy                    the queue is full; try again later
    └── DeadlineExceeded        the caller's deadline passed

``message`` says what is wrong, ``hint`` what to do; both are one line. ``code`` is stable and public.
"""

import re

_WORD_START = re.compile(r"(?<!^)(?=[A-Z])")
_UNPRINTABLE = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]+")  # what a quoted value may contain


def one_line(text: str) -> str:
    """Replace each run of line breaks, control characters and surrogates in a text by one space."""
    return _UNPRINTABLE.sub(" ", text)


class RholocError(Exception):
    """The base of all errors that a user can meet. ``code`` is the class's name in snake case, unless the class states
    another; a subclass does not inherit it.
    """

    code = "error"

    def __init_subclass__(cls) -> None:
        if "code" not in vars(cls):
            cls.code = _WORD_START.sub("_", cls.__name__).lower()

    def __init__(self, message: str, hint: str = "") -> None:
        self.message = one_line(message)
        self.hint = one_line(hint)
        super().__init__(self.message)

    def __str__(self) -> str:
        return f"{self.message} {self.hint}".strip()


class InvalidInput(RholocError):
    """The input cannot be used."""


class InvalidImage(InvalidInput):
    """The bytes are not an image, are truncated, or claim more pixels than allowed."""


class InvalidCamera(InvalidInput):
    """Intrinsics are missing or physically impossible."""


class InvalidDescriptors(InvalidInput):
    """A descriptor set has the wrong length, shape, channel or number, or values that are not finite."""


class InvalidName(InvalidInput):
    """A map name is empty, too long, or has characters outside letters, digits, ``-``, ``_`` and ``.``."""


class InvalidRecording(InvalidInput):
    """A video, image folder or table of a recording cannot be read."""


class InvalidWaypoints(InvalidInput):
    """Waypoints are malformed, fewer than three, or collinear."""


class InvalidTrajectory(InvalidInput):
    """A trajectory or pose table cannot be read."""


class NotInstalled(InvalidInput):
    """The features asked for need a package that is not installed on this machine."""


class InvalidMap(RholocError):
    """A map file is corrupt, truncated, of a later version, or not a map at all."""


class NotFound(RholocError):
    """The requested object does not exist."""


class UnknownMap(NotFound):
    """No map has this name."""


class UnknownCamera(NotFound):
    """No camera has this name."""


class UnknownRecording(NotFound):
    """No recording has this id."""


class UnknownSite(NotFound):
    """No site has this name."""


class UnknownPicture(NotFound):
    """No picture of this is kept, or it is not to be shown."""


class UnknownJob(NotFound):
    """No job has this id."""


class Conflict(RholocError):
    """The request contradicts the present state, as cancelling a job that has ended does."""


class MappingFailed(RholocError):
    """A recording was read, but gave no map that can be trusted."""


class Cancelled(RholocError):
    """The work was cancelled on request."""


class TooLarge(RholocError):
    """The upload exceeds the limit of the service."""


class StorageFull(RholocError):
    """The disk is full. Nothing that was stored before is changed."""


class StorageUnavailable(RholocError):
    """Storage or database cannot be written, is locked or damaged. Nothing that was stored before is changed."""


class MissingObject(StorageUnavailable):
    """The catalogue names a file that the storage does not have (any more)."""

    code = StorageUnavailable.code


class Busy(RholocError):
    """The service's queue is full. Try again after ``retry_after_s`` seconds."""

    def __init__(self, message: str, hint: str = "", retry_after_s: float = 1.0) -> None:
        super().__init__(message, hint)
        self.retry_after_s = retry_after_s


class DeadlineExceeded(RholocError):
    """The caller's deadline passed before an answer was found."""
