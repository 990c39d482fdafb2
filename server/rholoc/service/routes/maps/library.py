"""Maps: listed, uploaded, downloaded, renamed, corrected, merged, deleted."""

from typing import Annotated

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import StreamingResponse

from rholoc.errors import (
    Busy,
    Conflict,
    DeadlineExceeded,
    InvalidInput,
    InvalidMap,
    InvalidName,
    StorageFull,
    TooLarge,
    UnknownMap,
)
from rholoc.exports import ExportFormat, export_map, parse_features
from rholoc.maps import (
    check_map_name,
)
from rholoc.pictures.rendering import Rendering
from rholoc.service.access.scopes import NEEDS_ADMIN, NEEDS_MAP, NEEDS_READ, request_key
from rholoc.service.errors import PreconditionFailed
from rholoc.service.http.bodies import declared_length, saved_body
from rholoc.service.http.models import RequestModel
from rholoc.service.http.openapi import BINARY, content, declared, request_body
from rholoc.service.maps.descriptions import MapDetail, MapList, MapVersions
from rholoc.service.maps.exports import ExportRequest, is_long
from rholoc.service.maps.renderings import etag_of
from rholoc.service.state import Service, State
from rholoc.service.threads.compute import Effort
from rholoc.storage.holdings_table import Kind


class MapPatch(RequestModel):
    """What may be changed of a map: its name."""

    name: str


router = APIRouter(prefix="/v1/maps", tags=["maps"])
_FAILURES = (UnknownMap, InvalidName, InvalidMap)


@router.get("", **declared(NEEDS_READ, "All maps"))
async def list_maps(service: Service) -> MapList:
    """The maps by name; files that cannot be read are listed separately."""
    return await service.maps.list()


@router.get("/{map_name}", **declared(NEEDS_READ, "One map", *_FAILURES))
async def get_map(map_name: str, service: Service, response: Response) -> MapDetail:
    """What the map says about itself. `ETag` is for `If-Match` of `PUT`."""
    return await _answered(service, map_name, response)


async def _answered(service: State, name: str, response: Response) -> MapDetail:
    """The description of a map; sets the header ``ETag``."""
    response.headers["ETag"] = etag_of(await service.maps.stat(name))
    return await service.maps.detail(name)


async def _check_unchanged(request: Request, service: State, name: str) -> None:
    """Check `If-Match` and `If-None-Match` of a request that replaces a map; nothing without them. Raises
    PreconditionFailed: the map is not the one that the request means, or is there although it must not be.
    """
    wanted, unwanted = request.headers.get("if-match"), request.headers.get("if-none-match")
    if wanted is None and unwanted is None:
        return
    try:
        present = etag_of(await service.maps.stat(name))
    except UnknownMap:
        present = ""
    hint = "GET the map, and send its ETag as If-Match."
    if wanted is not None and not (present and (wanted.strip() == "*" or present in wanted)):
        raise PreconditionFailed(f"The map {name} was changed, or is not there.", hint)
    if unwanted is not None and present and (unwanted.strip() == "*" or present in unwanted):
        raise PreconditionFailed(f"There is already a map {name}.", hint)


@router.put(
    "/{map_name}",
    openapi_extra=request_body({"application/octet-stream": {"schema": BINARY}, "text/csv": {"schema": BINARY}}),
    **declared(
        NEEDS_MAP,
        "Upload a map",
        InvalidName,
        InvalidMap,
        TooLarge,
        StorageFull,
        PreconditionFailed,
        also={201: {"model": MapDetail, "description": "The map is new."}},
    ),
)
async def put_map(map_name: str, request: Request, service: Service, response: Response) -> MapDetail:
    """The body is a `.rho` file or a map as CSV (Table 5). It is checked before it replaces the map of that name;
    requests in progress finish on the old map, later ones get the new one. The same file again makes no version. With
    `If-Match` only the map of that `ETag` is replaced, with `If-None-Match: *` none."""
    check_map_name(map_name)
    await _check_unchanged(request, service, map_name)
    new = map_name not in await service.maps.names()
    key, quotas = request_key(request.scope), service.quotas
    await quotas.check(key, map_name, declared_length(request))
    folder, max_bytes = service.settings.data_dir / "uploads", service.settings.max_upload_bytes
    async with saved_body(request, folder, max_bytes) as body, quotas.counting(key), service.maps.publishing:
        await quotas.check(key, map_name, body.size_bytes)
        await _check_unchanged(request, service, map_name)
        await service.maps.publish(map_name, body.path)
        await quotas.hold(key, Kind.MAP, map_name)
    response.status_code = 201 if new else 200
    return await _answered(service, map_name, response)


@router.patch("/{map_name}", **declared(NEEDS_MAP, "Rename a map", *_FAILURES, Conflict))
async def patch_map(map_name: str, change: MapPatch, service: Service) -> MapDetail:
    """Renames the map. The new name must be free. The map stays in its sites."""
    check_map_name(change.name)
    if change.name != map_name:
        await service.maps.rename(map_name, change.name)
        await service.sites.rename_map(map_name, change.name)
        await service.quotas.rename_map(map_name, change.name)
    await service.frames.forget_missing()
    return await service.maps.detail(change.name)


@router.delete("/{map_name}", status_code=204, **declared(NEEDS_ADMIN, "Delete a map", UnknownMap, InvalidName))
async def delete_map(map_name: str, service: Service) -> None:
    """Deletes the map for good, with what is kept for it to learn from. Requests in progress still finish on it."""
    await service.maps.delete(map_name)
    await service.frames.forget_missing()


@router.get(
    "/{map_name}/download",
    **declared(
        NEEDS_READ,
        "Download a map",
        *_FAILURES,
        InvalidInput,
        Busy,
        DeadlineExceeded,
        also=content("The file.", *(form.media_type.partition(";")[0] for form in ExportFormat)),
    ),
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
    await service.maps.stat(map_name)
    headers = {"Content-Disposition": f'attachment; filename="{map_name}{format.ending}"'}
    if format is ExportFormat.RHO and degree is None and features is None:
        headers |= {"Cache-Control": "no-store"}
        return await service.maps.open(map_name, headers)
    if format is ExportFormat.PNG:
        rendered = await service.renderings.get(map_name, Rendering.PREVIEW)
        return Response(rendered.content, headers=headers, media_type=format.media_type)
    chosen = None if features is None else parse_features(features)
    map_ = await service.maps.get(map_name)
    if is_long(len(map_), format, degree, chosen):
        path = await service.maps.path(map_name)
        wanted = ExportRequest(path, map_name, format, degree, chosen)
        return await service.exports.answer(wanted, headers, request.is_disconnected)
    pieces = await service.frames.compute.run(
        lambda: export_map(map_, format, title=map_name, degree=degree, features=chosen), Effort.LARGE
    )
    return StreamingResponse(pieces, headers=headers, media_type=format.media_type)


@router.post("/{map_name}/restore", **declared(NEEDS_MAP, "Restore a map that was replaced", *_FAILURES, Conflict))
async def restore_map(
    map_name: str,
    service: Service,
    number: Annotated[int, Query(ge=1, le=1000, description="which of its `versions`; 1 was replaced last")] = 1,
) -> MapDetail:
    """The map that was last replaced under this name takes its place again, and the present one is kept in turn:
    restoring twice changes nothing. `number` chooses an earlier one."""
    await service.maps.restore(map_name, number)
    return await service.maps.detail(map_name)


@router.get("/{map_name}/versions", **declared(NEEDS_READ, "The maps that a map replaced", *_FAILURES))
async def list_versions(map_name: str, service: Service) -> MapVersions:
    """The maps that can be restored: the last five that were replaced under this name, the latest first."""
    return await service.maps.versions(map_name)
