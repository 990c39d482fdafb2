"""Maps: listed, uploaded, downloaded, renamed, corrected, merged, deleted."""

from __future__ import annotations

import uuid
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, Body, Query, Request, Response
from fastapi import Path as PathParameter
from fastapi.responses import StreamingResponse
from starlette.concurrency import run_in_threadpool

from rholoc.errors import (
    Busy,
    Conflict,
    DeadlineExceeded,
    InvalidCamera,
    InvalidInput,
    InvalidMap,
    InvalidName,
    MappingFailed,
    NotInstalled,
    RholocError,
    StorageFull,
    TooLarge,
    UnknownCamera,
    UnknownMap,
    UnknownPicture,
    UnknownRecording,
)
from rholoc.exports import ExportFormat, export_map, parse_features
from rholoc.features import get_extractor
from rholoc.geometry import Camera
from rholoc.jobs import JobKind, JobOptions
from rholoc.localization import localizer_of
from rholoc.localization.landscape import presence_of
from rholoc.mapping import forget_recording, levelled, merge_maps, set_floor_plan
from rholoc.maps import (
    MAX_PLAN_BYTES,
    FloorPlan,
    Map,
    MapInfo,
    MapLibrary,
    MapOutline,
    check_map_name,
    check_memory,
    check_usable,
    cloud_to_bytes,
    consistency_m,
    expected_error_m,
    is_coefficient_table,
    map_to_scene,
    read_coefficient_table,
    trust_of,
)
from rholoc.maps.floor_plan import GEOJSON, MEDIA_TYPES
from rholoc.pictures.rendering import Rendering
from rholoc.reports import CoverageReport
from rholoc.service.access.scopes import NEEDS_ADMIN, NEEDS_MAP, NEEDS_READ, request_key
from rholoc.service.errors import InvalidRequest, PreconditionFailed, UnsupportedMediaType
from rholoc.service.http.bodies import declared_length, media_type, read_body, save_body
from rholoc.service.http.files import OpenedFile
from rholoc.service.http.openapi import BINARY, failures, request_body
from rholoc.service.maps.corrections import corrected_map
from rholoc.service.maps.examples import REPORT, sent
from rholoc.service.maps.exports import ExportRequest, is_long
from rholoc.service.maps.job_events import job_out
from rholoc.service.maps.renderings import etag_of
from rholoc.service.routes.intake import counted_job
from rholoc.service.schemas import (
    CORRECTION_EXAMPLES,
    CameraIn,
    CorrectionIn,
    FeatureOut,
    ForgetIn,
    JobOut,
    MapDetail,
    MapList,
    MapPatch,
    MapReportOut,
    MapSummary,
    MapVersions,
    MergeIn,
    PreviousMap,
    UpdateIn,
)
from rholoc.service.state import Service, State
from rholoc.service.threads.compute import Effort
from rholoc.storage.holdings import Kind
from rholoc.trajectory import Scale

router = APIRouter(prefix="/v1/maps", tags=["maps"])
_FAILURES = (UnknownMap, InvalidName, InvalidMap)
_PLAN_CONTENT: dict[str, Any] = {
    kind: {"schema": {"type": "object"}, "example": {"type": "FeatureCollection", "features": []}}
    if kind == GEOJSON
    else {"schema": BINARY}
    for kind in MEDIA_TYPES
}


@router.get("", dependencies=[NEEDS_READ], summary="All maps")
async def list_maps(service: Service) -> MapList:
    """The maps by name; files that cannot be read are listed separately."""
    return await service.threads.files(_list, service.library)


@router.get("/{map_name}", dependencies=[NEEDS_READ], summary="One map", responses=failures(*_FAILURES))
async def get_map(map_name: str, service: Service, response: Response) -> MapDetail:
    """What the map says about itself. `ETag` is for `If-Match` of `PUT`."""
    return await _answered(service, map_name, response)


async def _answered(service: State, name: str, response: Response) -> MapDetail:
    """The description of a map, with its tag in a header."""
    etag = etag_of(await service.threads.files(service.library.stat, name))
    response.headers["ETag"] = etag
    return await service.threads.database(_detail, service, name)


async def _check_unchanged(request: Request, service: State, name: str) -> None:
    """Check `If-Match` and `If-None-Match: *` of a request that replaces a map.

    Raises:
        PreconditionFailed: the map is not the one that the request means, or is there although it must not be.
    """
    wanted, unwanted = request.headers.get("if-match"), request.headers.get("if-none-match")
    if wanted is None and unwanted is None:
        return
    try:
        present = etag_of(await service.threads.files(service.library.stat, name))
    except UnknownMap:
        present = ""
    hint = "GET the map, and send its ETag as If-Match."
    if wanted is not None and not (present and (wanted.strip() == "*" or present in wanted)):
        raise PreconditionFailed(f"The map {name} was changed, or is not there.", hint)
    if unwanted is not None and present and (unwanted.strip() == "*" or present in unwanted):
        raise PreconditionFailed(f"There is already a map {name}.", hint)


@router.put(
    "/{map_name}",
    dependencies=[NEEDS_MAP],
    summary="Upload a map",
    responses={
        **failures(InvalidName, InvalidMap, TooLarge, StorageFull, PreconditionFailed),
        201: {"model": MapDetail, "description": "The map is new."},
    },
    openapi_extra=request_body({"application/octet-stream": {"schema": BINARY}, "text/csv": {"schema": BINARY}}),
)
async def put_map(map_name: str, request: Request, service: Service, response: Response) -> MapDetail:
    """The body is a `.rho` file or a map as CSV (Table 5). It is checked before it replaces the map of that name;
    requests in progress finish on the old map, later ones get the new one. The same file again makes no version. With
    `If-Match` only the map of that `ETag` is replaced, with `If-None-Match: *` none."""
    check_map_name(map_name)
    await _check_unchanged(request, service, map_name)
    arrived = service.settings.data_dir / "uploads" / uuid.uuid4().hex
    files = service.threads.files
    await files(lambda: arrived.parent.mkdir(parents=True, exist_ok=True))
    new = map_name not in await files(service.library.names)
    key, quotas = request_key(request.scope), service.quotas
    await service.threads.database(quotas.check, key, map_name, declared_length(request))
    try:
        await save_body(request, arrived, service.settings.max_upload_bytes)
        async with quotas.counting(key), service.publishing:
            size_bytes = (await files(arrived.stat)).st_size
            await service.threads.database(quotas.check, key, map_name, size_bytes)
            await _check_unchanged(request, service, map_name)
            await service.threads.transfers(_publish, service, map_name, arrived)
            await service.threads.database(quotas.hold, key, Kind.MAP, map_name)
    finally:
        await files(lambda: arrived.unlink(missing_ok=True))
    response.status_code = 201 if new else 200
    return await _answered(service, map_name, response)


@router.patch(
    "/{map_name}",
    dependencies=[NEEDS_MAP],
    summary="Rename a map",
    responses=failures(*_FAILURES, Conflict, InvalidRequest),
)
async def patch_map(map_name: str, change: MapPatch, service: Service) -> MapDetail:
    """The new name must be free. The map stays in its sites."""
    check_map_name(change.name)
    if change.name != map_name:
        await service.threads.database(service.library.rename, map_name, change.name)
        await service.threads.database(service.sites.rename_map, map_name, change.name)
        await service.threads.database(service.quotas.rename_map, map_name, change.name)
    await service.threads.files(service.localizers.forget_missing)
    return await service.threads.database(_detail, service, change.name)


@router.delete(
    "/{map_name}",
    dependencies=[NEEDS_ADMIN],
    status_code=204,
    summary="Delete a map",
    responses=failures(UnknownMap, InvalidName),
)
async def delete_map(map_name: str, service: Service) -> None:
    """For good, with what is kept for it to learn from. Requests in progress still finish on it."""
    await service.threads.database(_delete, service, map_name)
    await service.threads.files(service.localizers.forget_missing)


@router.get(
    "/{map_name}/download",
    dependencies=[NEEDS_READ],
    summary="Download a map",
    response_class=Response,
    responses={
        200: {
            "description": "The file.",
            "content": {form.media_type.partition(";")[0]: {"schema": BINARY} for form in ExportFormat},
        },
        **failures(*_FAILURES, InvalidInput, InvalidRequest, Busy, DeadlineExceeded),
    },
)
async def download_map(
    map_name: str,
    request: Request,
    service: Service,
    format: Annotated[
        ExportFormat, Query(description="the native map, or a form for other programs", examples=["rho"])
    ] = ExportFormat.RHO,
    degree: Annotated[
        int | None, Query(description="of csv: tensor densities are fitted with it; default: the map's own densities")
    ] = None,
    features: Annotated[
        str | None,
        Query(description="of surfaces: whose, as `3,17,40:60`; default: the 500 seen most often", examples=["0:100"]),
    ] = None,
) -> Response:
    """`rho`: the map itself; `csv`: Table 5, which can be uploaded again; `observations`: Table 4; `trajectory`: its
    views as Table 6; `ply`, `vtp`, `gltf`: landmarks and views; `surfaces`: where densities peak, as VTP;
    `colmap`: a text model of cameras, images and points, as ZIP; `nerfstudio`: `transforms.json`; `png`: a picture."""
    await service.threads.files(service.library.stat, map_name)
    headers = {"Content-Disposition": f'attachment; filename="{map_name}{format.ending}"'}
    if format is ExportFormat.RHO and degree is None and features is None:
        headers |= {"Cache-Control": "no-store"}
        return await service.threads.fetches(_opened, service.library, map_name, headers)
    if format is ExportFormat.PNG:
        rendered = await service.renderings.get(map_name, Rendering.PREVIEW)
        return Response(rendered.content, headers=headers, media_type=format.media_type)
    chosen = None if features is None else parse_features(features)
    map_ = await service.map(map_name)
    if is_long(len(map_), format, degree, chosen):
        path = await service.threads.fetches(service.library.path, map_name)
        wanted = ExportRequest(path, map_name, format, degree, chosen)
        return await service.exports.answer(wanted, headers, request.is_disconnected)
    pieces = await service.compute.run(
        lambda: export_map(map_, format, title=map_name, degree=degree, features=chosen), Effort.LARGE
    )
    return StreamingResponse(pieces, headers=headers, media_type=format.media_type)


@router.get(
    "/{map_name}/report",
    dependencies=[NEEDS_READ],
    summary="A map's own quality report",
    responses=failures(*_FAILURES),
)
async def get_report(map_name: str, service: Service) -> MapReportOut:
    """What the map found out about itself while it was built: coverage, residuals, and how consistent it is:
    frames of the same walk, held out, localized in it."""
    info = (await service.map(map_name)).info
    return MapReportOut(map=map_name, map_id=info.id, map_version=info.version, report=info.report)


@router.get(
    "/{map_name}/report.png",
    dependencies=[NEEDS_READ],
    summary="A map's own quality report as a picture",
    response_class=Response,
    responses={
        200: {"description": "A picture.", "content": {"image/png": {"schema": BINARY}}},
        **failures(*_FAILURES, Busy),
    },
)
async def get_report_picture(map_name: str, request: Request, service: Service) -> Response:
    """Coverage by position and heading, how consistent frames held out are with it, how exact the landmarks are."""
    return await _rendered(request, service, map_name, Rendering.REPORT, "image/png")


@router.get(
    "/{map_name}/coverage",
    dependencies=[NEEDS_READ],
    summary="Where a map works",
    response_class=Response,
    responses={
        200: {
            "model": CoverageReport,
            "description": "Landmarks in view, by position and heading.",
            "content": {"application/json": {"example": sent(REPORT.coverage)}},
        },
        **failures(*_FAILURES, Busy),
    },
)
async def get_coverage(map_name: str, request: Request, service: Service) -> Response:
    """How many landmarks a camera like the map's sees from places on a grid around the walk, in each of twelve
    directions. `sufficient` of them are enough to expect a pose."""
    return await _rendered(request, service, map_name, Rendering.COVERAGE, "application/json")


@router.post(
    "/{map_name}/restore",
    dependencies=[NEEDS_MAP],
    summary="Restore a map that was replaced",
    responses=failures(*_FAILURES, Conflict),
)
async def restore_map(
    map_name: str,
    service: Service,
    number: Annotated[int, Query(ge=1, le=1000, description="which of its `versions`; 1 was replaced last")] = 1,
) -> MapDetail:
    """The map that was last replaced under this name takes its place again, and the present one is kept in turn:
    restoring twice changes nothing. `number` chooses an earlier one."""
    await service.threads.transfers(service.library.restore, map_name, number)
    return await service.threads.database(_detail, service, map_name)


@router.get(
    "/{map_name}/versions",
    dependencies=[NEEDS_READ],
    summary="The maps that a map replaced",
    responses=failures(*_FAILURES),
)
async def list_versions(map_name: str, service: Service) -> MapVersions:
    """The maps that can be restored: the last five that were replaced under this name, the latest first."""
    return await service.threads.database(_versions, service.library, map_name)


@router.post(
    "/{map_name}/corrections",
    dependencies=[NEEDS_MAP],
    summary="Correct a map",
    responses=failures(*_FAILURES, InvalidInput, InvalidRequest, Conflict, Busy, StorageFull),
)
async def correct_map(
    map_name: str, wanted: Annotated[CorrectionIn, Body(openapi_examples=CORRECTION_EXAMPLES)], service: Service
) -> MapDetail:
    """The map's next version: with another origin, north, upright, axis or scale, aligned with a floor plan, without a
    region or a piece of its walk, or with names. If the frame moves, poses are in the new frame from then on, moved by
    exactly what `corrections` says. The previous version can be restored."""
    map_ = await service.map(map_name)
    corrected = await service.compute.run(lambda: corrected_map(map_, wanted), Effort.LARGE)
    await service.threads.transfers(service.library.replace, map_name, corrected)
    return await service.threads.database(_detail, service, map_name)


@router.put(
    "/{map_name}/plan",
    dependencies=[NEEDS_MAP],
    summary="Keep a floor plan with a map",
    responses=failures(*_FAILURES, InvalidInput, InvalidRequest, UnsupportedMediaType, TooLarge, Conflict, StorageFull),
    openapi_extra=request_body({kind: {"schema": BINARY} for kind in MEDIA_TYPES}),
)
async def put_plan(
    map_name: str,
    request: Request,
    service: Service,
    x: Annotated[float, Query(description="where its lower left corner lies, m, map frame")] = 0.0,
    y: Annotated[float, Query(description="where its lower left corner lies, m, map frame")] = 0.0,
    turn_deg: Annotated[float, Query(description="how far its lower edge is turned from the map's x towards y")] = 0.0,
    m_per_unit: Annotated[float, Query(gt=0, description="how long a pixel is, or a metre of GeoJSON")] = 1.0,
) -> MapDetail:
    """The body is a picture (PNG, JPEG, WebP) or GeoJSON. This makes the map's next version; the previous one can be
    restored. The plan moves with the map when its frame is corrected."""
    kind = media_type(request)
    if kind not in MEDIA_TYPES:
        raise UnsupportedMediaType(f"A floor plan cannot be {kind or 'nothing'}.", f"Send {', '.join(MEDIA_TYPES)}.")
    await service.threads.files(service.library.stat, map_name)
    content = await read_body(request, MAX_PLAN_BYTES)
    plan = FloorPlan(kind, (x, y), turn_deg, m_per_unit)
    return await service.threads.transfers(_planned, service, map_name, content, plan)


@router.get(
    "/{map_name}/plan",
    dependencies=[NEEDS_READ],
    summary="A map's floor plan",
    response_class=Response,
    responses={
        200: {"description": "The file.", "content": _PLAN_CONTENT},
        **failures(*_FAILURES, UnknownPicture),
    },
)
async def get_plan(map_name: str, request: Request, service: Service) -> Response:
    """As it was sent; `plan` of the map says where it lies."""
    etag = etag_of(await service.threads.files(service.library.stat, map_name), "plan")
    if _is_kept(request, etag):
        return _unchanged(etag)
    map_ = await service.map(map_name)
    if map_.info.plan is None:
        raise UnknownPicture(f"The map {map_name} has no floor plan.", "Send one with PUT.")
    return Response(map_.plan, media_type=map_.info.plan.media_type, headers=_caching(etag))


@router.delete(
    "/{map_name}/plan",
    dependencies=[NEEDS_MAP],
    summary="Remove a map's floor plan",
    responses=failures(*_FAILURES, Conflict, StorageFull),
)
async def delete_plan(map_name: str, service: Service) -> MapDetail:
    """The map itself does not move."""
    return await service.threads.transfers(_planned, service, map_name, b"", None)


@router.post(
    "/{map_name}/update",
    dependencies=[NEEDS_MAP],
    status_code=202,
    summary="Learn a recording into a map",
    responses=failures(
        *_FAILURES, UnknownRecording, UnknownCamera, InvalidCamera, InvalidInput, InvalidRequest, StorageFull
    ),
)
async def update_map(map_name: str, wanted: UpdateIn, request: Request, service: Service, response: Response) -> JobOut:
    """A job localizes the recording in the map and learns it; `Location` is the job's address. When it is done, the
    map's next version replaces the present one; a recording of another place changes nothing."""
    await service.threads.files(_check_learns, service.library, map_name)
    await service.threads.database(service.cameras.named_in, wanted.camera)
    options = JobOptions(
        kind=JobKind.UPDATE,
        poses=wanted.poses,
        camera=wanted.camera,
        pictures=service.settings.keep_pictures,
        priority=wanted.priority,
    )
    submit = partial(service.jobs.submit, wanted.recording, map_name, options)
    job = await counted_job(service, request, map_name, submit)
    response.headers["Location"] = f"/v1/jobs/{job.id}"
    return job_out(job)


@router.post(
    "/{map_name}/merge",
    dependencies=[NEEDS_MAP],
    summary="Merge another map into a map's frame",
    responses=failures(*_FAILURES, InvalidInput, InvalidRequest, MappingFailed, Conflict, Busy, StorageFull),
)
async def merge_map(map_name: str, wanted: MergeIn, request: Request, service: Service) -> MapDetail:
    """The merged map is published as `into`; both maps stay, unless `into` is one of them."""
    into = check_map_name(wanted.into)
    a = await service.map(map_name)
    b = await service.map(wanted.other)
    key, quotas = request_key(request.scope), service.quotas
    new = into not in await service.threads.files(service.library.names)
    await service.threads.database(quotas.check, key, into if new else None)
    merged = await service.compute.run(lambda: merge_maps(a, b), Effort.LARGE)
    async with quotas.counting(key):
        await service.threads.database(quotas.check, key, into if new else None)
        await service.threads.transfers(_publish_merged, service.library, {map_name: a, wanted.other: b}, into, merged)
        if new:
            await service.threads.database(quotas.hold, key, Kind.MAP, into)
    return await service.threads.database(_detail, service, into)


@router.post(
    "/{map_name}/forget",
    dependencies=[NEEDS_MAP],
    summary="Forget a recording",
    responses=failures(*_FAILURES, InvalidInput, InvalidRequest, Conflict, Busy, StorageFull),
)
async def forget_source(map_name: str, wanted: ForgetIn, service: Service) -> MapDetail:
    """Makes the map's next version, without what it learned from the recording: an id or a name in `sources`."""
    map_ = await service.map(map_name)
    left = await service.compute.run(lambda: forget_recording(map_, wanted.source), Effort.LARGE)
    await service.threads.transfers(service.library.replace, map_name, left)
    return await service.threads.database(_detail, service, map_name)


@router.get(
    "/{map_name}/scene",
    dependencies=[NEEDS_READ],
    summary="A map for a 3-D view",
    response_class=Response,
    responses={
        200: {"description": "Landmarks and views.", "content": {"application/octet-stream": {"schema": BINARY}}},
        **failures(*_FAILURES),
    },
)
async def get_scene(
    map_name: str,
    request: Request,
    service: Service,
    landmarks: Annotated[
        int | None, Query(ge=1, description="at most so many, evenly chosen; default: all", examples=[1500])
    ] = None,
    level: Annotated[
        bool, Query(description="whether a map that is not upright is turned as its `levelling` says")
    ] = False,
) -> Response:
    """Little-endian: two uint32, the numbers F of landmarks and K of views; F × 4 float32: x, y, z, standard deviation;
    K × 7 float32: x, y, z, heading, the number of the recording; where the map knows its colours, F × 3 uint8: red,
    green, blue. Lengths in metres."""
    etag = etag_of(await service.threads.files(service.library.stat, map_name), "scene", landmarks, level)
    if _is_kept(request, etag):
        return _unchanged(etag)
    map_ = await service.map(map_name)
    rotation = await run_in_threadpool(levelled, map_) if level else None
    scene = await run_in_threadpool(map_to_scene, map_, landmarks, rotation)
    return Response(scene, media_type="application/octet-stream", headers=_caching(etag))


@router.get(
    "/{map_name}/features/{feature}",
    dependencies=[NEEDS_READ],
    summary="A feature of a map, and where it may be seen from",
    responses=failures(*_FAILURES, InvalidInput, InvalidRequest),
)
async def get_feature(
    map_name: str,
    feature: Annotated[int, PathParameter(ge=0, description="its number, from 0", examples=[100])],
    service: Service,
) -> FeatureOut:
    """Features are numbered as in `…/scene`, where all of them are asked for. Lengths in the map's unit."""
    return await service.threads.files(_feature, service.library, map_name, feature)


def _feature(library: MapLibrary, name: str, feature: int) -> FeatureOut:
    map_ = library.get(name)
    if feature >= len(map_):
        raise InvalidInput(f"The map has no feature {feature}.", f"Its features are 0 to {len(map_) - 1}.")
    views = np.unique(map_.observations.views[map_.observations.features == feature])
    if len(views) == 0:
        raise InvalidInput(f"The map does not remember who saw feature {feature}.", "Build it from a recording.")
    presence = presence_of(map_, feature)
    least, most = presence.reach
    return FeatureOut(
        feature=feature,
        position=map_.landmarks.positions[feature].round(4).tolist(),
        sigma=float(np.sqrt(np.trace(map_.landmarks.covariances[feature]) / 3)),
        direction=presence.direction[0].round(4).tolist(),
        half_angle_deg=float(np.degrees(presence.half_angle[0])),
        nearest=float(least[0]),
        farthest=float(most[0]),
        views=views.tolist(),
    )


@router.get(
    "/{map_name}/points",
    dependencies=[NEEDS_READ],
    summary="Further points of the room",
    response_class=Response,
    responses={
        200: {"description": "Points in colour.", "content": {"application/octet-stream": {"schema": BINARY}}},
        **failures(*_FAILURES),
    },
)
async def get_points(map_name: str, request: Request, service: Service) -> Response:
    """Points of the reconstruction that are not landmarks, for people to see the room. Little-endian: one uint32, the
    number P; P × 3 float32: x, y, z; P × 3 uint8: red, green, blue. Lengths in metres."""
    etag = etag_of(await service.threads.files(service.library.stat, map_name), "points")
    if _is_kept(request, etag):
        return _unchanged(etag)
    map_ = await service.map(map_name)
    points = await run_in_threadpool(cloud_to_bytes, map_)
    return Response(points, media_type="application/octet-stream", headers=_caching(etag))


@router.get(
    "/{map_name}/views/{view}/picture.jpg",
    dependencies=[NEEDS_READ],
    summary="A small picture of one of a map's views",
    response_class=Response,
    responses={
        200: {"description": "A picture.", "content": {"image/jpeg": {"schema": BINARY}}},
        **failures(*_FAILURES, UnknownPicture),
    },
)
async def get_view_picture(
    map_name: str,
    view: Annotated[int, PathParameter(ge=0, description="the view by number in the map, from 0")],
    request: Request,
    service: Service,
) -> Response:
    """What the camera saw there, if the map keeps pictures and this server's setting `keep_pictures` is on."""
    etag = etag_of(await service.threads.files(service.library.stat, map_name), "picture", view)
    if _is_kept(request, etag):
        return _unchanged(etag)
    map_ = await service.map(map_name)
    pictures = map_.views.known_pictures if service.settings.keep_pictures else ()
    if view >= len(pictures) or not pictures[view]:
        raise UnknownPicture(
            f"The map {map_name} has no picture of its view {view}.",
            "Maps keep pictures where RHOLOC_KEEP_PICTURES=1 was set when they were made, and show them where it is.",
        )
    return Response(pictures[view], media_type="image/jpeg", headers=_caching(etag))


@router.get(
    "/{map_name}/preview.png",
    dependencies=[NEEDS_READ],
    summary="A map from above",
    response_class=Response,
    responses={
        200: {"description": "A picture.", "content": {"image/png": {"schema": BINARY}}},
        **failures(*_FAILURES, Busy),
    },
)
async def get_preview(map_name: str, request: Request, service: Service) -> Response:
    """Landmarks, the walk, waypoints."""
    return await _rendered(request, service, map_name, Rendering.PREVIEW, "image/png")


async def _rendered(request: Request, service: State, name: str, kind: Rendering, media_type: str) -> Response:
    """A rendering, or 304 where the browser has it."""
    etag = await service.threads.files(service.renderings.etag, name, kind)
    if _is_kept(request, etag):
        return _unchanged(etag)
    rendered = await service.renderings.get(name, kind)
    return Response(rendered.content, media_type=media_type, headers=_caching(rendered.etag))


def _caching(etag: str) -> dict[str, str]:
    """A browser may cache the answer, and revalidates it before each use."""
    return {"ETag": etag, "Cache-Control": "private, no-cache"}


def _is_kept(request: Request, etag: str) -> bool:
    """Whether the browser already has this version."""
    kept = {tag.strip().removeprefix("W/") for tag in request.headers.get("if-none-match", "").split(",")}
    return etag in kept or "*" in kept


def _unchanged(etag: str) -> Response:
    return Response(status_code=304, headers=_caching(etag))


def _planned(service: State, name: str, content: bytes, plan: FloorPlan | None) -> MapDetail:
    service.library.replace(name, set_floor_plan(service.library.get(name), content, plan))
    return _detail(service, name)


def _delete(service: State, name: str) -> None:
    with suppress(InvalidMap):  # one that cannot be read has no id; the sweep forgets its queries
        service.queries.delete(service.library.get(name).info.id)
    service.library.delete(name)


def _check_learns(library: MapLibrary, name: str) -> None:
    check_memory(library.get(name), f"The map {name}")


def _publish_merged(library: MapLibrary, parts: Mapping[str, Map], into: str, merged: Map) -> None:
    """Publish a merged map, unless it would replace one of its parts that has changed meanwhile."""
    if into in parts and library.get(into) is not parts[into]:
        raise Conflict(f"The map {into} was changed in the meantime.", "Merge again.")
    library.put(into, merged)


def _list(library: MapLibrary) -> MapList:
    maps: list[MapSummary] = []
    unreadable: dict[str, str] = {}
    for name in library.names():
        try:
            maps.append(MapSummary.model_validate(_summary(library, name)))
        except UnknownMap:
            continue  # deleted meanwhile
        except RholocError as error:
            unreadable[name] = error.message
    return MapList(maps=maps, unreadable=unreadable)


def _summary(library: MapLibrary, name: str) -> dict[str, object]:
    return _summary_of(name, library.outline(name), library.stat(name).size_bytes)


def _summary_of(name: str, outline: MapOutline, size_bytes: int) -> dict[str, object]:
    info = outline.info
    trust = trust_of(info)
    return {
        "name": name,
        "id": info.id,
        "version": info.version,
        "density": info.density,
        "features": info.features,
        "scale": Scale.METRIC if info.metric else Scale.ARBITRARY,
        "upright": info.upright,
        "created": info.created,
        "landmarks": outline.landmarks,
        "views": outline.views,
        "size_bytes": size_bytes,
        "trusted": trust.trusted,
        "trust_reason": trust.reason,
        "expected_error_m": expected_error_m(info),
        "consistency_m": consistency_m(info),
        "camera": _camera(info.camera),
        "labels": info.labels,
    }


def _detail(service: State, name: str) -> MapDetail:
    library, settings = service.library, service.settings
    detail = _detail_of(name, library.get(name), library.stat(name).size_bytes, library.previous(name))
    here = {
        "live": settings.live,
        "keeps_failures": settings.keep_failures,
        "pictures": detail.pictures and settings.keep_pictures,
    }
    return detail.model_copy(update=here)


def _detail_of(name: str, map_: Map, size_bytes: int, before: MapInfo | None) -> MapDetail:
    bounds, rotation = None, levelled(map_)
    outline = MapOutline(map_.info, len(map_), len(map_.views))
    if len(map_):
        bounds = [map_.landmarks.positions.min(axis=0).tolist(), map_.landmarks.positions.max(axis=0).tolist()]
    fields = {
        "sources": map_.info.sources,
        "waypoints": map_.info.waypoints,
        "bounds_m": bounds,
        "previous": None if before is None else _previous(1, before),
        "names": map_.info.names,
        "corrections": map_.info.corrections,
        "plan": map_.info.plan,
        "points": len(map_.cloud),
        "pictures": map_.views.pictures is not None,
        "levelling": None if rotation is None else rotation.tolist(),
    }
    return MapDetail.model_validate({**_summary_of(name, outline, size_bytes), **fields})


def _versions(library: MapLibrary, name: str) -> MapVersions:
    library.stat(name)
    return MapVersions(versions=[_previous(number, info) for number, info in library.versions(name).items()])


def _previous(number: int, info: MapInfo) -> PreviousMap:
    return PreviousMap(number=number, id=info.id, version=info.version, created=info.created)


def _camera(camera: Camera) -> CameraIn:
    return CameraIn(**camera.to_dict())


def _opened(library: MapLibrary, name: str, headers: dict[str, str]) -> OpenedFile:
    try:
        return OpenedFile(library.path(name), headers, ExportFormat.RHO.media_type)
    except FileNotFoundError:
        library.stat(name)  # which says that there is no such map; else it came back meanwhile
        raise Conflict(f"The map {name} was replaced in the meantime.", "Try again.") from None


def _publish(service: State, name: str, arrived: Path) -> None:
    """Put a file into the library, if the service can do with it everything that it does with maps."""

    def check(map_: Map) -> None:
        _check_features(map_)
        _rehearse(map_, name, arrived.stat().st_size, service.settings.min_recognized)

    if is_coefficient_table(arrived):
        map_ = read_coefficient_table(arrived, f"{name}.csv")
        check(map_)
        service.library.put(name, map_)
    else:
        if arrived.stat().st_size > service.settings.max_map_bytes:
            limit = service.settings.max_map_bytes
            raise TooLarge(f"The map's file is longer than {limit} bytes.", "Split it, or raise RHOLOC_MAX_MAP_BYTES.")
        service.library.put_file(name, arrived, check)


def _check_features(map_: Map) -> None:
    hint = "Build the map with one of this version's extractors."
    try:
        extractor = get_extractor(map_.info.features)
    except NotInstalled as error:
        raise InvalidMap(error.message, error.hint) from error
    except InvalidInput as error:
        raise InvalidMap(error.message, hint) from error
    if (
        map_.descriptors.values.shape[1] != extractor.descriptor_bytes
        or not np.isin(map_.landmarks.channels, extractor.channels).all()
    ):
        raise InvalidMap(f"The map's descriptors are not '{extractor.name}' features.", hint)


def _rehearse(map_: Map, name: str, size_bytes: int, min_recognized: float) -> None:
    """Do with a map what requests for it will need, so that a map that fails is refused.

    Raises:
        InvalidMap: something of it cannot be done.
    """
    check_usable(map_)
    try:
        _detail_of(name, map_, size_bytes, None).model_dump_json()
        info = map_.info
        MapReportOut(map=name, map_id=info.id, map_version=info.version, report=info.report).model_dump_json()
        localizer_of(map_, min_recognized)
    except RholocError as error:
        raise InvalidMap(f"The map cannot be used: {error.message}", error.hint) from error
    except (ValueError, TypeError, ArithmeticError, LookupError, RecursionError) as error:
        raise InvalidMap(f"The map cannot be used: {error}.", "Build it again, or take another copy.") from error
