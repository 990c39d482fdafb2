"""Recordings: uploaded as a stream, mapped by a job."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fastapi import APIRouter, Request, Response
from fastapi.responses import JSONResponse
from starlette.concurrency import run_in_threadpool

from rholoc.errors import InvalidRecording, TooLarge
from rholoc.jobs import JobKind, JobOptions, PendingRecording
from rholoc.maps import DensityKind
from rholoc.recordings import (
    START_BYTES,
    ZIP_SUFFIX,
    check_archive,
    check_file_name,
    check_file_start,
)
from rholoc.service.access import NEEDS_MAP, NEEDS_READ
from rholoc.service.bodies import media_type, read_multipart
from rholoc.service.errors import InvalidRequest, UnsupportedMediaType, UnsupportedVersion
from rholoc.service.intake import UPLOAD_FAILURES, RecordingFields, checked_options
from rholoc.service.job_events import job_out
from rholoc.service.openapi import BINARY, failures, request_body
from rholoc.service.routes.uploads import begin_upload
from rholoc.service.schemas import RecordingAccepted, RecordingList, RecordingOut
from rholoc.service.state import Service, State
from rholoc.service.tus import RESUMABLE
from rholoc.trajectory import PoseMethod

router = APIRouter(prefix="/v1/recordings", tags=["recordings"])

_WAYPOINTS_FILE = "waypoints.csv"
_FORM_BYTES = 2**20  # what the multipart form may take beside its files


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
        "waypoints": {**BINARY, "description": "waypoints.csv: name[,time or frame],x,y,z; not beside a ZIP file"},
    }
    return {"type": "object", "required": ["file", "map"], "properties": {**files, **inlined}}


@router.get("", dependencies=[NEEDS_READ], summary="All recordings")
async def list_recordings(service: Service) -> RecordingList:
    """Those that are stored whole, the newest first."""
    entries = await run_in_threadpool(service.recordings.list)
    return RecordingList(
        recordings=[
            RecordingOut(id=one.id, files=list(one.files), size_bytes=one.size_bytes, created=one.created)
            for one in entries
        ]
    )


@router.post(
    "",
    dependencies=[NEEDS_MAP],
    status_code=202,
    response_model=RecordingAccepted,
    summary="Upload a recording and map it",
    responses={
        **failures(*UPLOAD_FAILURES, UnsupportedMediaType, UnsupportedVersion),
        201: {"description": "A resumable upload has begun; PATCH its bytes to the address in `Location`."},
    },
    openapi_extra=request_body(
        {"multipart/form-data": {"schema": _form_schema(), "example": {"map": "testsite", "features": "gray"}}}
    ),
)
async def upload_recording(request: Request, service: Service) -> Response:
    """Multipart: one or more parts `file`, and the field `map`. An upload that breaks off leaves nothing behind. The
    answer names the mapping job, whose address is in `Location` too; ask there how it goes on.

    With the header `Tus-Resumable` instead: the beginning of a resumable upload (tus 1.0), with `Upload-Length` and,
    in `Upload-Metadata`, `filename` and the fields."""
    if RESUMABLE in request.headers:
        return await begin_upload(request, service)
    if media_type(request) != "multipart/form-data":
        raise UnsupportedMediaType(
            "A recording must be sent as multipart/form-data.", "curl -F file=@walk.mp4 -F map=hall"
        )
    pending = await run_in_threadpool(service.recordings.begin, service.settings.max_upload_bytes)
    try:
        fields, options = await _receive(request, pending, service)
        entry = await run_in_threadpool(pending.commit)
    finally:
        await run_in_threadpool(pending.abort)
    try:
        job = await run_in_threadpool(service.jobs.submit, entry.id, fields.map, options)
    except Exception:
        await run_in_threadpool(service.recordings.delete, entry.id)  # no job would ever read it
        raise
    accepted = RecordingAccepted(recording=entry.id, job=job_out(job))
    return JSONResponse(accepted.model_dump(mode="json"), 202, {"Location": f"/v1/jobs/{job.id}"})


async def _receive(request: Request, pending: PendingRecording, service: State) -> tuple[RecordingFields, JobOptions]:
    """Stream the files into the pending recording; the fields are checked once all have come."""
    starts: dict[str, bytes] = {}  # of each file, as far as it has come

    def write(field_name: str, filename: str, chunk: bytes) -> None:
        if field_name not in ("file", "waypoints"):
            raise InvalidRequest(f"'{field_name}' is not a file part.", "Send file parts 'file' and 'waypoints'.")
        name = _WAYPOINTS_FILE if field_name == "waypoints" else filename
        start = starts.setdefault(name, b"")
        if len(starts) > service.settings.max_upload_files:
            raise TooLarge(f"More than {service.settings.max_upload_files} files.", "Pack them into one ZIP file.")
        if len(start) < START_BYTES and chunk:
            starts[name] = start = (start + chunk)[:START_BYTES]
            if len(start) == START_BYTES:
                check_file_start(name, start)
        pending.write(name, chunk)

    limit = service.settings.max_upload_bytes + _FORM_BYTES
    fields = RecordingFields.model_validate(
        await read_multipart(request, limit, service.settings.max_upload_files, write)
    )
    options = await checked_options(fields, service)
    await run_in_threadpool(_check_files, starts, pending, service.settings.max_upload_files)
    return fields, options


def _check_files(starts: Mapping[str, bytes], pending: PendingRecording, max_files: int) -> None:
    """Refuse files that are together no recording. Raises InvalidRecording, TooLarge."""
    for name, start in starts.items():
        if len(start) < START_BYTES:
            check_file_start(name, start)
    zips = [name for name in starts if name.lower().endswith(ZIP_SUFFIX)]
    if zips and len(starts) > 1:
        raise InvalidRecording("A ZIP file was sent with other files.", "Put waypoints.csv into the ZIP file.")
    if len(starts) == 1:
        check_file_name(*starts)
    if zips:
        check_archive(pending.path(*zips), max_files=max_files)
