"""The Python client of the rholoc service: a frame goes in, a pose comes out.

::

    with Client("http://localhost:8080") as client:
        answer = client.localize("testsite", Path("frame.jpg"))
        if answer.localized:
            print(answer.pose.position, answer.pose.heading, answer.confidence)
"""

from rholoc_client.client import AsyncClient, Client
from rholoc_client.errors import (
    Busy,
    Cancelled,
    Conflict,
    ConnectionFailed,
    DeadlineExceeded,
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
    InvalidTrajectory,
    InvalidWaypoints,
    JobFailed,
    MappingFailed,
    MethodNotAllowed,
    NotFound,
    RholocClientError,
    ServiceError,
    StorageFull,
    TooLarge,
    UnknownJob,
    UnknownMap,
    UnknownRecording,
    UnknownRoute,
    UnsupportedMediaType,
    WaitTimedOut,
)
from rholoc_client.models import Camera, Features, Job, Localization, MapSummary, Pose, Prior

__all__ = [
    "AsyncClient",
    "Busy",
    "Camera",
    "Cancelled",
    "Client",
    "Conflict",
    "ConnectionFailed",
    "DeadlineExceeded",
    "Features",
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
    "InvalidTrajectory",
    "InvalidWaypoints",
    "Job",
    "JobFailed",
    "Localization",
    "MapSummary",
    "MappingFailed",
    "MethodNotAllowed",
    "NotFound",
    "Pose",
    "Prior",
    "RholocClientError",
    "ServiceError",
    "StorageFull",
    "TooLarge",
    "UnknownJob",
    "UnknownMap",
    "UnknownRecording",
    "UnknownRoute",
    "UnsupportedMediaType",
    "WaitTimedOut",
]
