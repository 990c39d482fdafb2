"""Maps changed: corrected, taught, merged; recordings forgotten; floor plans."""

from typing import Annotated

from fastapi import APIRouter, Body, Query, Request, Response
from fastapi.openapi.models import Example
from pydantic import Field

from rholoc.errors import (
    Busy,
    Conflict,
    InvalidCamera,
    InvalidInput,
    MappingFailed,
    StorageFull,
    TooLarge,
    UnknownCamera,
    UnknownRecording,
)
from rholoc.jobs import JobKind, JobOptions, JobPriority
from rholoc.mapping.edit.correcting import set_names
from rholoc.mapping.edit.sources import forget_recording
from rholoc.mapping.learn.merging import merge_maps
from rholoc.maps import MAX_PLAN_BYTES, Map, check_map_name, check_memory
from rholoc.maps.floor_plan import ARCHIVE, GEOJSON, MEDIA_TYPES
from rholoc.maps.formats.geojson import MAX_GEOJSON_BYTES, names_from_geojson
from rholoc.maps.formats.plan_files import PlanPlacement, level_of_archive, read_plan
from rholoc.service.access.scopes import NEEDS_MAP, request_key
from rholoc.service.errors import UnsupportedMediaType
from rholoc.service.http.bodies import media_type, read_body
from rholoc.service.http.models import CAMERA_TEXT, EXAMPLES, RequestModel
from rholoc.service.http.openapi import BINARY, declared, request_body
from rholoc.service.maps.corrections import CorrectionIn, corrected_map
from rholoc.service.maps.descriptions import MapDetail
from rholoc.service.maps.job_events import JobOut, begun
from rholoc.service.routes.maps.contents import NAMES_CONTENT
from rholoc.service.routes.maps.library import _FAILURES
from rholoc.service.state import Service
from rholoc.service.threads.compute import Effort
from rholoc.storage.holdings_table import Kind
from rholoc.trajectory import PoseMethod

router = APIRouter(prefix="/v1/maps", tags=["maps"])
Level = Annotated[
    str | None, Query(description="of an IMDF archive: its level by name, ordinal or id; default: the only one")
]
_FAILURES_OF_CHANGES = (*_FAILURES, InvalidInput, Conflict, Busy, StorageFull)
_FAILURES_OF_FILES = (*_FAILURES_OF_CHANGES, UnsupportedMediaType, TooLarge)
_ARCHIVE_BODY = {ARCHIVE: {"schema": BINARY}}
_CORRECTIONS: dict[str, Example] = {kind: {"value": value} for kind, value in EXAMPLES["CorrectionIn"].items()}


class UpdateIn(RequestModel):
    """A stored recording for a map to learn."""

    recording: str = Field(description="the recording's id")
    poses: PoseMethod | None = Field(
        default=None, description="where frame poses come from; default: its own, else each frame is localized"
    )
    camera: str | None = Field(
        default=None,
        description=CAMERA_TEXT,
    )
    priority: JobPriority = Field(
        default=JobPriority.NORMAL, description="how soon its turn comes, among jobs submitted within a day"
    )


class MergeIn(RequestModel):
    """Another map to merge with, and the name of the merged one."""

    other: str = Field(description="the map whose frame is given up")
    into: str = Field(description="the name of the merged map; a map of that name is replaced")


class ForgetIn(RequestModel):
    """A recording for a map to forget."""

    source: str = Field(description="its id or name in the map's sources")


@router.post(
    "/{map_name}/corrections",
    **declared(NEEDS_MAP, "Correct a map", *_FAILURES_OF_CHANGES),
)
async def correct_map(
    map_name: str, wanted: Annotated[CorrectionIn, Body(openapi_examples=_CORRECTIONS)], service: Service
) -> MapDetail:
    """The map's next version: with another origin, north, upright, axis or scale, aligned with a floor plan, without a
    region or a piece of its walk, or with names. If the frame moves, poses are in the new frame from then on, moved by
    exactly what `corrections` says. The previous version can be restored."""
    map_ = await service.maps.get(map_name)
    corrected = await service.frames.compute.run(lambda: corrected_map(map_, wanted), Effort.LARGE)
    await service.maps.replace(map_name, corrected)
    return await service.maps.detail(map_name, corrected)


@router.put(
    "/{map_name}/names",
    openapi_extra=request_body({**NAMES_CONTENT, **_ARCHIVE_BODY}),
    **declared(NEEDS_MAP, "Set a map's named points and areas by GeoJSON", *_FAILURES_OF_FILES),
)
async def put_names(map_name: str, request: Request, service: Service, level: Level = None) -> MapDetail:
    """The body is a FeatureCollection of points and polygons, or an IMDF archive. `name` and `kind` of their properties
    are kept, and others as `fields`; they replace the names that the map has. Coordinates are of WGS 84 in a map with a
    place on Earth; a collection with `"frame": "map"` has metres of the map. This makes the map's next version."""
    kind = media_type(request)
    if kind not in (GEOJSON, "application/json", ARCHIVE):
        raise UnsupportedMediaType(f"Names cannot be {kind or 'nothing'}.", f"Send {GEOJSON} or {ARCHIVE}.")
    map_ = await service.maps.get(map_name)
    earth = map_.info.earth or await service.sites.earth_of(map_name)
    body = await read_body(request, MAX_GEOJSON_BYTES)

    def named() -> Map:
        content = level_of_archive(body, level) if kind == ARCHIVE else body
        return set_names(map_, names_from_geojson(content, earth))

    changed = await service.frames.compute.run(named, Effort.LARGE)
    await service.maps.replace(map_name, changed)
    return await service.maps.detail(map_name, changed)


@router.put(
    "/{map_name}/plan",
    openapi_extra=request_body({**{kind: {"schema": BINARY} for kind in MEDIA_TYPES}, **_ARCHIVE_BODY}),
    **declared(NEEDS_MAP, "Keep a floor plan with a map", *_FAILURES_OF_FILES),
)
async def put_plan(
    map_name: str,
    request: Request,
    service: Service,
    x: Annotated[float | None, Query(description="where its lower left corner lies, m, map frame")] = None,
    y: Annotated[float | None, Query(description="where its lower left corner lies, m, map frame")] = None,
    turn_deg: Annotated[
        float | None, Query(description="how far its lower edge is turned from the map's x towards y")
    ] = None,
    m_per_unit: Annotated[
        float | None, Query(gt=0, description="how long a pixel is, or a metre of GeoJSON; default: 1")
    ] = None,
    level: Level = None,
) -> MapDetail:
    """The body is a picture (PNG, JPEG, WebP), GeoJSON, or a ZIP archive: of IMDF, or of a `map_server` yaml with its
    picture. Without `x`, `y` and `turn_deg` the plan lies where its yaml says, or in a map with a place on Earth where
    its longitude and latitude say, else at the origin. This makes the map's next version; the previous one can be
    restored. The plan moves with the map when its frame is corrected."""
    kind = media_type(request)
    if kind not in (*MEDIA_TYPES, ARCHIVE):
        raise UnsupportedMediaType(
            f"A floor plan cannot be {kind or 'nothing'}.", f"Send {', '.join([*MEDIA_TYPES, ARCHIVE])}."
        )
    earth = (await service.maps.get(map_name)).info.earth or await service.sites.earth_of(map_name)
    body = await read_body(request, MAX_PLAN_BYTES)
    placement = PlanPlacement(x, y, turn_deg, m_per_unit)
    content, plan = await service.frames.compute.run(
        lambda: read_plan(body, kind, level, placement, earth), Effort.LARGE
    )
    planned = await service.maps.keep_plan(map_name, content, plan)
    return await service.maps.detail(map_name, planned)


@router.delete(
    "/{map_name}/plan", **declared(NEEDS_MAP, "Remove a map's floor plan", *_FAILURES, Conflict, StorageFull)
)
async def delete_plan(map_name: str, service: Service) -> MapDetail:
    """Removes the floor plan; the map itself does not move."""
    planned = await service.maps.keep_plan(map_name, b"", None)
    return await service.maps.detail(map_name, planned)


@router.post(
    "/{map_name}/update",
    status_code=202,
    **declared(
        NEEDS_MAP,
        "Learn a recording into a map",
        *_FAILURES,
        UnknownRecording,
        UnknownCamera,
        InvalidCamera,
        InvalidInput,
        StorageFull,
    ),
)
async def update_map(map_name: str, wanted: UpdateIn, request: Request, service: Service, response: Response) -> JobOut:
    """A job localizes the recording in the map and learns it; `Location` is the job's address. When it is done, the
    map's next version replaces the present one; a recording of another place changes nothing."""
    check_memory(await service.maps.get(map_name), f"The map {map_name}")
    await service.cameras.named_in(wanted.camera)
    options = JobOptions(
        kind=JobKind.UPDATE,
        poses=wanted.poses,
        camera=wanted.camera,
        pictures=service.settings.keep_pictures,
        priority=wanted.priority,
    )
    key = request_key(request.scope)
    job = await service.jobs.begin(key, map_name, lambda jobs: jobs.submit(wanted.recording, map_name, options))
    return begun(job, response)


@router.post(
    "/{map_name}/merge",
    **declared(
        NEEDS_MAP,
        "Merge another map into a map's frame",
        *_FAILURES,
        InvalidInput,
        MappingFailed,
        Conflict,
        Busy,
        StorageFull,
    ),
)
async def merge_map(map_name: str, wanted: MergeIn, request: Request, service: Service) -> MapDetail:
    """The merged map is published as `into`; both maps stay, unless `into` is one of them."""
    into = check_map_name(wanted.into)
    a = await service.maps.get(map_name)
    b = await service.maps.get(wanted.other)
    key, quotas = request_key(request.scope), service.quotas
    new = into not in await service.maps.names()
    await quotas.check(key, into if new else None)
    merged = await service.frames.compute.run(lambda: merge_maps(a, b), Effort.LARGE)
    async with quotas.counting(key):
        await quotas.check(key, into if new else None)
        await service.maps.publish_merged({map_name: a, wanted.other: b}, into, merged)
        if new:
            await quotas.hold(key, Kind.MAP, into)
    return await service.maps.detail(into, merged)


@router.post(
    "/{map_name}/forget",
    **declared(NEEDS_MAP, "Forget a recording", *_FAILURES, InvalidInput, Conflict, Busy, StorageFull),
)
async def forget_source(map_name: str, wanted: ForgetIn, service: Service) -> MapDetail:
    """Makes the map's next version, without what it learned from the recording: an id or a name in `sources`."""
    map_ = await service.maps.get(map_name)
    left = await service.frames.compute.run(lambda: forget_recording(map_, wanted.source), Effort.LARGE)
    await service.maps.replace(map_name, left)
    return await service.maps.detail(map_name, left)
