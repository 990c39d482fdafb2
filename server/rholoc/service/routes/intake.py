"""The options of an upload, and whether they are possible."""

from typing import Annotated, Literal

from pydantic import Field

from rholoc.errors import (
    Busy,
    InvalidInput,
    InvalidMap,
    InvalidName,
    InvalidRecording,
    RholocError,
    StorageFull,
    TooLarge,
    UnknownCamera,
    UnknownMap,
)
from rholoc.features import extractor_names, get_extractor
from rholoc.jobs import JobKind, JobOptions, JobPriority
from rholoc.maps import DensityKind, check_map_name, check_memory
from rholoc.recordings import parse_frame_slice
from rholoc.service.errors import InvalidRequest
from rholoc.service.http.models import CAMERA_TEXT, RequestModel
from rholoc.service.state import State
from rholoc.trajectory import PoseMethod

UPLOAD_FAILURES: tuple[type[RholocError], ...] = (
    InvalidRequest,
    InvalidName,
    InvalidInput,
    InvalidRecording,
    UnknownMap,
    UnknownCamera,
    InvalidMap,
    TooLarge,
    StorageFull,
    Busy,
)


class RecordingFields(RequestModel):
    """The text fields beside the files of an uploaded recording."""

    map: Annotated[str, Field(description="the name of the map to publish")]
    kind: Literal[JobKind.BUILD, JobKind.UPDATE] = Field(
        default=JobKind.BUILD, description="build a new map, or update the one of that name"
    )
    features: str = Field(default=JobOptions.features, description="the extractor: " + ", ".join(extractor_names()))
    density: DensityKind = Field(default=JobOptions.density, description="the form of the densities")
    poses: PoseMethod | None = Field(
        default=None,
        description="where frame poses come from; default: auto, or for an update the recording's own, else "
        "each frame is localized",
    )
    camera: str | None = Field(
        default=None,
        description=CAMERA_TEXT,
    )
    frames: str | None = Field(
        default=None, description="only these frames, by number: start:stop[:step], like 30:900", examples=["30:900"]
    )
    priority: JobPriority = Field(
        default=JobOptions.priority, description="how soon its turn comes, among jobs submitted within a day"
    )


async def checked_options(fields: RecordingFields, service: State) -> JobOptions:
    """The options of the job that maps a recording, with this server's setting of pictures.

    Raises:
        InvalidRecording: the choice of frames is not valid.
        InvalidName, InvalidInput, UnknownCamera: the map's name is not valid; no such features; no such camera.
        UnknownMap, InvalidMap: the map to update does not exist, or cannot learn.
    """
    check_map_name(fields.map)
    get_extractor(fields.features)
    await service.cameras.named_in(fields.camera)
    if fields.kind is JobKind.UPDATE:
        check_memory(await service.maps.get(fields.map), f"The map {fields.map}")
    if fields.frames is not None:
        parse_frame_slice(fields.frames)
    return JobOptions(
        fields.density,
        fields.features,
        fields.poses,
        fields.camera,
        fields.kind,
        service.settings.keep_pictures,
        fields.frames,
        fields.priority,
    )
