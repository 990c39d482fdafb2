"""The Python client of the rholoc service: a frame goes in, a pose comes out.

::

    with Client("http://localhost:8080") as client:
        answer = client.localize("testsite", Path("frame.jpg"))
        if answer.localized:
            print(answer.pose.position, answer.pose.heading, answer.confidence)

:class:`Tracker` keeps track of a camera between answers; it needs NumPy (``rholoc-client[tracking]``), and OpenCV to
track by pictures alone (``rholoc-client[pictures]``).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rholoc_client._async.client import AsyncClient
from rholoc_client._sync.client import Client
from rholoc_client.errors import (
    Busy,
    Cancelled,
    ChecksumMismatch,
    Conflict,
    ConnectionFailed,
    CrossSite,
    DeadlineExceeded,
    Forbidden,
    Internal,
    InvalidAnswer,
    InvalidCamera,
    InvalidDescriptors,
    InvalidImage,
    InvalidInput,
    InvalidMap,
    InvalidName,
    InvalidRecording,
    InvalidRequest,
    InvalidTrack,
    InvalidTrajectory,
    InvalidWaypoints,
    JobFailed,
    MappingFailed,
    MethodNotAllowed,
    NotFound,
    NotInstalled,
    PreconditionFailed,
    QuotaExceeded,
    RequestTimeout,
    RholocClientError,
    ServiceError,
    StorageFull,
    StorageUnavailable,
    TooLarge,
    TooManyRequests,
    Unauthorized,
    UnknownCamera,
    UnknownJob,
    UnknownMap,
    UnknownPicture,
    UnknownRecording,
    UnknownRoute,
    UnknownSite,
    UnsupportedMediaType,
    UnsupportedVersion,
    WaitTimedOut,
)
from rholoc_client.models import (
    Alternative,
    Camera,
    CameraProfile,
    Features,
    Frame,
    FramePose,
    Job,
    Localization,
    MapSummary,
    Matches,
    NearPlace,
    OfSite,
    OnEarth,
    Place,
    Pose,
    Prior,
    Site,
    SiteMap,
    SitePose,
)

if TYPE_CHECKING:
    from rholoc_client.tracking import (
        AsyncTracker,
        ImuNoise,
        OdometryNoise,
        Tracked,
        Tracker,
        TrackOptions,
        TrackStatus,
    )

__all__ = [
    "Alternative",
    "AsyncClient",
    "AsyncTracker",
    "Busy",
    "Camera",
    "CameraProfile",
    "Cancelled",
    "ChecksumMismatch",
    "Client",
    "Conflict",
    "ConnectionFailed",
    "CrossSite",
    "DeadlineExceeded",
    "Features",
    "Forbidden",
    "Frame",
    "FramePose",
    "ImuNoise",
    "Internal",
    "InvalidAnswer",
    "InvalidCamera",
    "InvalidDescriptors",
    "InvalidImage",
    "InvalidInput",
    "InvalidMap",
    "InvalidName",
    "InvalidRecording",
    "InvalidRequest",
    "InvalidTrack",
    "InvalidTrajectory",
    "InvalidWaypoints",
    "Job",
    "JobFailed",
    "Localization",
    "MapSummary",
    "MappingFailed",
    "Matches",
    "MethodNotAllowed",
    "NearPlace",
    "NotFound",
    "NotInstalled",
    "OdometryNoise",
    "OfSite",
    "OnEarth",
    "Place",
    "Pose",
    "PreconditionFailed",
    "Prior",
    "QuotaExceeded",
    "RequestTimeout",
    "RholocClientError",
    "ServiceError",
    "Site",
    "SiteMap",
    "SitePose",
    "StorageFull",
    "StorageUnavailable",
    "TooLarge",
    "TooManyRequests",
    "TrackOptions",
    "TrackStatus",
    "Tracked",
    "Tracker",
    "Unauthorized",
    "UnknownCamera",
    "UnknownJob",
    "UnknownMap",
    "UnknownPicture",
    "UnknownRecording",
    "UnknownRoute",
    "UnknownSite",
    "UnsupportedMediaType",
    "UnsupportedVersion",
    "WaitTimedOut",
]

_OF_TRACKING = ("AsyncTracker", "ImuNoise", "OdometryNoise", "TrackOptions", "TrackStatus", "Tracked", "Tracker")


def __getattr__(name: str) -> Any:
    """Import what needs NumPy when it is first used: everything else works without."""
    if name in _OF_TRACKING:
        from rholoc_client import tracking

        return getattr(tracking, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
