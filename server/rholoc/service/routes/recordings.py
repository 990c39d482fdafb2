"""Recordings: uploaded as a stream, mapped by a job."""

from collections.abc import Mapping
from contextlib import AsyncExitStack
from dataclasses import asdict
from typing import Any

from fastapi import APIRouter, Request, Response
from fastapi.responses import JSONResponse
from pydantic import Field
from starlette.concurrency import run_in_threadpool

from rholoc.errors import (
    InvalidRecording,
    InvalidWaypoints,
    StorageFull,
    TooLarge,
    UnknownPicture,
    UnknownRecording,
)
from rholoc.jobs import JobOptions
from rholoc.library.recording_notes import RecordedWaypoint, corrected_waypoints, read_notes, read_thumbnail
from rholoc.library.recordings import PendingRecording
from rholoc.recordings import (
    START_BYTES,
    ZIP_SUFFIXES,
    check_archive,
    check_file_name,
    check_file_start,
)
from rholoc.service.access.keys import Scope
from rholoc.service.access.scopes import NEEDS_MAP, NEEDS_READ, granted_key, request_key
from rholoc.service.errors import InvalidRequest, UnsupportedMediaType, UnsupportedVersion
from rholoc.service.http.bodies import declared_length, media_type, read_multipart
from rholoc.service.http.models import AnswerModel, Number, RequestModel, Vector3
from rholoc.service.http.openapi import BINARY, content, declared, request_body
from rholoc.service.http.tus import RESUMABLE
from rholoc.service.libraries import NotedRecording
from rholoc.service.maps.job_events import JobOut, begun, job_out
from rholoc.service.routes.intake import UPLOAD_FAILURES, RecordingFields, checked_options
from rholoc.service.routes.uploads import begin_upload
from rholoc.service.state import Service, State
from rholoc.storage.holdings_table import Kind


class RecordingContent(AnswerModel):
    """What a job read from a recording."""

    length_s: float | None
    frames: int
    width: int = Field(description="of a frame, px")
    height: int
    format: str = Field(description="how it is laid out")
    imu: bool = Field(description="whether it has an IMU's table")


class RecordingOut(AnswerModel):
    """A stored recording."""

    id: str
    files: list[str]
    size_bytes: int
    created: float = Field(description="s since the epoch")
    content: RecordingContent | None = Field(description="null until a job has read it")
    thumbnail: bool = Field(description="whether there is a small picture of it that this client may see")


class WaypointIn(RequestModel):
    """A measured point of a recording."""

    name: str
    position: Vector3 = Field(description="m")
    time_s: Number | None = Field(
        default=None, description="when the camera was there, s on the recording's clock; default: found by the order"
    )
    sigma_m: Number = Field(default=0.02, description="how well the camera was held to it, m: 0.001 to 1")


class WaypointsIn(RequestModel):
    """Waypoints that replace a recording's own, in the order of the walk."""

    waypoints: list[WaypointIn] = Field(max_length=1000, description="three or more")


class RecordingDetail(RecordingOut):
    """A stored recording with its waypoints."""

    waypoints: tuple[RecordedWaypoint, ...] = Field(description="as corrected, else as a job read them from it")
    corrected: bool = Field(description="whether they replace the recording's own")


class RecordingList(AnswerModel):
    """All stored recordings, the newest first."""

    recordings: list[RecordingOut]


class RecordingAccepted(AnswerModel):
    """A completed upload, and the mapping job that it started."""

    recording: str = Field(description="the recording's id")
    job: JobOut


router = APIRouter(prefix="/v1/recordings", tags=["recordings"])

_WAYPOINTS_FILE = "waypoints.csv"
_FORM_BYTES = 2**20  # what the multipart form may take beside its files


def _form_schema() -> dict[str, Any]:
    """OpenAPI schema of the upload's form: its fields without references and without null, which no form can send."""
    schema = RecordingFields.model_json_schema()
    inlined = {}
    for name, field in schema["properties"].items():
        kinds = [one for one in field.pop("anyOf", [field]) if one.get("type") != "null"]
        named = schema["$defs"].get(kinds[0].pop("$ref", "").rpartition("/")[2], {})
        inlined[name] = {"type": "string"} | {key: named[key] for key in ("enum",) if key in named} | kinds[0] | field
    files = {
        "file": {
            "type": "array",
            "items": BINARY,
            "description": "a video, a ZIP file, or the files of a recording's folder",
        },
        "waypoints": {**BINARY, "description": "waypoints.csv: name[,time or frame],x,y,z; not beside a ZIP file"},
    }
    return {"type": "object", "required": ["file", "map"], "properties": {**files, **inlined}}


@router.get("", **declared(NEEDS_READ, "All recordings"))
async def list_recordings(request: Request, service: Service) -> RecordingList:
    """The recordings that are completely uploaded, the newest first."""
    return await run_in_threadpool(_list, await service.recordings.list(), _may_see(request))


@router.get("/{recording}", **declared(NEEDS_READ, "One recording", UnknownRecording))
async def get_recording(recording: str, request: Request, service: Service) -> RecordingDetail:
    """What the recording holds, and its waypoints: as corrected, else as a job read them from it."""
    return _detail(await service.recordings.get(recording), _may_see(request))


@router.get(
    "/{recording}/thumbnail.jpg",
    **declared(
        NEEDS_MAP,
        "A small picture of a recording",
        UnknownRecording,
        UnknownPicture,
        also=content("A picture.", "image/jpeg"),
    ),
)
async def get_thumbnail(recording: str, service: Service) -> Response:
    """A frame from the recording's beginning, as JPEG, once a job has read it."""
    _, notes = await service.recordings.get(recording)
    picture = read_thumbnail(notes)
    if picture is None:
        raise UnknownPicture("There is no picture of the recording yet.", "Wait until a job has read it.")
    return Response(picture, media_type="image/jpeg", headers={"Cache-Control": "private, max-age=86400"})


@router.put(
    "/{recording}/waypoints",
    **declared(NEEDS_MAP, "Correct a recording's waypoints", UnknownRecording, InvalidWaypoints, StorageFull),
)
async def put_waypoints(recording: str, wanted: WaypointsIn, request: Request, service: Service) -> RecordingDetail:
    """Stores corrected waypoints, which replace the recording's own whenever it is mapped from then on. The recording's
    files and existing maps stay as they are.
    """
    given = tuple(_recorded(one) for one in wanted.waypoints)
    return _detail(await service.recordings.correct(recording, given), _may_see(request))


@router.delete("/{recording}/waypoints", **declared(NEEDS_MAP, "Take back corrected waypoints", UnknownRecording))
async def delete_waypoints(recording: str, request: Request, service: Service) -> RecordingDetail:
    """Deletes corrected waypoints: the recording is mapped with its own again."""
    return _detail(await service.recordings.correct(recording, None), _may_see(request))


@router.post(
    "/{recording}/jobs",
    status_code=202,
    **declared(NEEDS_MAP, "Map a stored recording again", UnknownRecording, *UPLOAD_FAILURES),
)
async def map_again(
    recording: str, wanted: RecordingFields, request: Request, service: Service, response: Response
) -> JobOut:
    """Begins a job that maps the recording again: with other options, corrected waypoints, fewer frames, or as another
    map. `Location` is the job's address.
    """
    options = await checked_options(wanted, service)
    key = request_key(request.scope)
    job = await service.jobs.begin(key, wanted.map, lambda jobs: jobs.submit(recording, wanted.map, options))
    return begun(job, response)


@router.post(
    "",
    status_code=202,
    response_model=RecordingAccepted,
    openapi_extra=request_body(
        {"multipart/form-data": {"schema": _form_schema(), "example": {"map": "testsite", "features": "gray"}}}
    ),
    **declared(
        NEEDS_MAP,
        "Upload a recording and map it",
        *UPLOAD_FAILURES,
        UnsupportedMediaType,
        UnsupportedVersion,
        also={201: {"description": "A resumable upload has begun; PATCH its bytes to the address in `Location`."}},
    ),
)
async def upload_recording(request: Request, service: Service) -> Response:
    """Multipart: one or more parts `file`, and the field `map`. An upload that breaks off leaves nothing behind. The
    answer holds the mapping job, whose address is also in `Location`: ask there for its progress.

    With the header `Tus-Resumable` it creates a resumable upload (tus 1.0) instead, with `Upload-Length` and, in
    `Upload-Metadata`, `filename` and the fields."""
    if RESUMABLE in request.headers:
        return await begin_upload(request, service)
    if media_type(request) != "multipart/form-data":
        raise UnsupportedMediaType(
            "A recording must be sent as multipart/form-data.", "curl -F file=@walk.mp4 -F map=hall"
        )
    key, quotas = request_key(request.scope), service.quotas
    await quotas.check(key, size_bytes=declared_length(request))
    pending = await service.recordings.begin(service.settings.max_upload_bytes)
    async with AsyncExitStack() as in_the_end:
        in_the_end.push_async_callback(run_in_threadpool, pending.abort)
        fields, options = await _receive(request, pending, service)
        await in_the_end.enter_async_context(quotas.counting(key))
        await quotas.check(key, None, pending.size_bytes, fields.map)
        entry, job = await service.recordings.commit(pending, fields.map, options)
        await quotas.hold(key, Kind.RECORDING, entry.id, entry.size_bytes)
        await quotas.hold_job(key, job.id, fields.map)
    accepted = RecordingAccepted(recording=entry.id, job=job_out(job))
    return JSONResponse(accepted.model_dump(mode="json"), 202, {"Location": f"/v1/jobs/{job.id}"})


def _may_see(request: Request) -> bool:
    """Whether the client may see pictures of recordings: its key has the scope MAP."""
    return granted_key(request)[0].allows(Scope.MAP)


def _list(found: list[NotedRecording], may_see: bool) -> RecordingList:
    return RecordingList(recordings=[RecordingOut.model_validate(_shown(one, may_see)) for one in found])


def _shown(found: NotedRecording, may_see: bool) -> dict[str, object]:
    entry, files = found
    notes = read_notes(files)
    return {
        "id": entry.id,
        "files": list(entry.files),
        "size_bytes": entry.size_bytes,
        "created": entry.created,
        "content": notes and {**asdict(notes), "length_s": notes.length_s},
        "thumbnail": may_see and read_thumbnail(files) is not None,
    }


def _detail(found: NotedRecording, may_see: bool) -> RecordingDetail:
    _, files = found
    notes = read_notes(files)
    given = corrected_waypoints(files, notes)
    own = () if notes is None else notes.waypoints
    fields = {"waypoints": own if given is None else given, "corrected": given is not None}
    return RecordingDetail.model_validate({**_shown(found, may_see), **fields})


def _recorded(waypoint: WaypointIn) -> RecordedWaypoint:
    x, y, z = waypoint.position
    return RecordedWaypoint(waypoint.name, (x, y, z), waypoint.time_s, waypoint.sigma_m)


async def _receive(request: Request, pending: PendingRecording, service: State) -> tuple[RecordingFields, JobOptions]:
    """Stream the request's files into the pending recording; returns its fields, checked once everything has arrived.
    Raises InvalidRequest, TooLarge, InvalidRecording, ValidationError, InvalidName, InvalidInput,
    UnknownCamera, UnknownMap, InvalidMap.
    """
    starts: dict[str, bytes] = {}  # the first bytes of each file, as far as they have arrived

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
    """Refuse files, by name and first bytes, that do not make a recording. Raises InvalidRecording, TooLarge."""
    for name, start in starts.items():
        if len(start) < START_BYTES:
            check_file_start(name, start)
    zips = [name for name in starts if name.lower().endswith(ZIP_SUFFIXES)]
    if zips and len(starts) > 1:
        raise InvalidRecording("A ZIP file was sent with other files.", "Put waypoints.csv into the ZIP file.")
    if len(starts) == 1:
        check_file_name(*starts)
    if zips:
        check_archive(pending.path(*zips), max_files=max_files)
