"""Recordings: uploaded as a stream, mapped by a job."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict, Field
from starlette.concurrency import run_in_threadpool

from rholoc.errors import InvalidInput, InvalidMap, InvalidName, InvalidRecording, StorageFull, TooLarge, UnknownMap
from rholoc.features import extractor_names, get_extractor
from rholoc.jobs import JobKind, JobOptions, PendingRecording
from rholoc.mapping import check_memory
from rholoc.maps import DensityKind, check_map_name
from rholoc.service.bodies import media_type, read_multipart
from rholoc.service.errors import InvalidRequest, UnsupportedMediaType
from rholoc.service.openapi import BINARY, failures, request_body
from rholoc.service.routes.jobs import job_out
from rholoc.service.schemas import RecordingAccepted
from rholoc.service.state import Service, State
from rholoc.trajectory import PoseMethod

router = APIRouter(prefix="/v1/recordings", tags=["recordings"])

_WAYPOINTS_FILE = "waypoints.csv"
_FORM_BYTES = 2**20  # what the multipart form may take beside its files


class RecordingFields(BaseModel):
    """The text fields beside the files of an uploaded recording."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    map: Annotated[str, Field(description="the name of the map to publish")]
    kind: JobKind = Field(default=JobOptions.kind, description="build a new map, or update the one of that name")
    features: str = Field(default=JobOptions.features, description="the extractor: " + ", ".join(extractor_names()))
    density: DensityKind = Field(default=JobOptions.density, description="the form of the densities")
    poses: PoseMethod | None = Field(
        default=None,
        description="where frame poses come from; default: visual-inertial; of an update: the recording's own, else "
        "each frame is localized",
    )
    camera: str | None = Field(
        default=None, description="fx,fy,cx,cy[,k1,k2,p1,p2[,k3]] in pixels; default: the recording's own"
    )


def _form_schema() -> dict[str, Any]:
    fields = RecordingFields.model_json_schema()
    inlined = {
        **fields["properties"],
        "density": {
            "type": "string",
            "enum": [kind.value for kind in DensityKind],
            "default": JobOptions.density.value,
        },
        "kind": {"type": "string", "enum": [kind.value for kind in JobKind], "default": JobOptions.kind.value},
        "poses": {
            "type": "string",
            "enum": [method.value for method in PoseMethod],
            "description": fields["properties"]["poses"]["description"],
        },
        "camera": {"type": "string", "description": fields["properties"]["camera"]["description"]},
    }
    files = {
        "file": {
            "type": "array",
            "items": BINARY,
            "description": "a video, a ZIP file, or the files of a recording's folder",
        },
        "waypoints": {**BINARY, "description": "waypoints.csv: name,time or frame,x,y,z; not beside a ZIP file"},
    }
    return {"type": "object", "required": ["file", "map"], "properties": {**files, **inlined}}


@router.post(
    "",
    status_code=202,
    summary="Upload a recording and map it",
    responses=failures(
        InvalidRequest,
        InvalidName,
        InvalidInput,
        InvalidRecording,
        UnknownMap,
        InvalidMap,
        TooLarge,
        StorageFull,
        UnsupportedMediaType,
    ),
    openapi_extra=request_body(
        {"multipart/form-data": {"schema": _form_schema(), "example": {"map": "testsite", "features": "gray"}}}
    ),
)
async def upload_recording(request: Request, service: Service, response: Response) -> RecordingAccepted:
    """Multipart: one or more parts `file`, and the field `map`. An upload that breaks off leaves nothing behind. The
    answer names the mapping job, whose address is in `Location` too; ask there how it goes on."""
    if media_type(request) != "multipart/form-data":
        raise UnsupportedMediaType("A recording comes as multipart/form-data.", "curl -F file=@walk.mp4 -F map=hall")
    pending = await run_in_threadpool(service.recordings.begin, service.settings.max_upload_bytes)
    try:
        fields = await _receive(request, pending, service)
        check_map_name(fields.map)
        get_extractor(fields.features)
        if fields.kind is JobKind.UPDATE:
            check_memory(await run_in_threadpool(service.library.get, fields.map), f"The map {fields.map}")
        entry = await run_in_threadpool(pending.commit)
    finally:
        await run_in_threadpool(pending.abort)
    options = JobOptions(fields.density, fields.features, fields.poses, fields.camera, fields.kind)
    try:
        job = await run_in_threadpool(service.jobs.submit, entry.id, fields.map, options)
    except Exception:
        await run_in_threadpool(service.recordings.delete, entry.id)  # no job would ever read it
        raise
    response.headers["Location"] = f"/v1/jobs/{job.id}"
    return RecordingAccepted(recording=entry.id, job=job_out(job))


async def _receive(request: Request, pending: PendingRecording, service: State) -> RecordingFields:
    """Stream the files into the pending recording; the fields are checked once all have come."""
    names: set[str] = set()

    def write(field_name: str, filename: str, chunk: bytes) -> None:
        if field_name not in ("file", "waypoints"):
            raise InvalidRequest(f"'{field_name}' is not a file part.", "Send file parts 'file' and 'waypoints'.")
        name = _WAYPOINTS_FILE if field_name == "waypoints" else filename
        names.add(name)
        if len(names) > service.settings.max_upload_files:
            raise TooLarge(f"More than {service.settings.max_upload_files} files.", "Pack them into one ZIP file.")
        pending.write(name, chunk)

    limit = service.settings.max_upload_bytes + _FORM_BYTES
    fields = await read_multipart(request, limit, write)
    if len(names) > 1 and any(name.lower().endswith(".zip") for name in names):
        raise InvalidRecording("A ZIP file came with other files.", "Put waypoints.csv into the ZIP file.")
    return RecordingFields.model_validate(fields)
