"""A map's contents for people: reports, pictures, scenes, points, its floor plan."""

import json
from collections.abc import Callable
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, Query, Request, Response
from fastapi import Path as PathParameter
from pydantic import Field
from starlette.concurrency import run_in_threadpool

from rholoc.errors import Busy, InvalidInput, UnknownPicture
from rholoc.mapping.edit.frame_corrections import levelled
from rholoc.maps import Map, MapNames, NamedArea, NamedPoint, cloud_to_bytes, map_to_scene, room_to_bytes
from rholoc.maps.floor_plan import GEOJSON, MEDIA_TYPES
from rholoc.maps.formats.geojson import names_to_geojson
from rholoc.paper.landscape import presence_of
from rholoc.pictures.rendering import Rendering
from rholoc.reports import CoverageReport
from rholoc.service.access.scopes import NEEDS_READ
from rholoc.service.http.files import caching_headers, is_kept, unchanged
from rholoc.service.http.models import EXAMPLES, AnswerModel
from rholoc.service.http.openapi import BINARY, content, declared
from rholoc.service.maps.descriptions import MapReportOut
from rholoc.service.maps.renderings import etag_of
from rholoc.service.routes.maps.library import _FAILURES
from rholoc.service.state import Service, State

Level = Annotated[bool, Query(description="whether a map that is not upright is turned as its `levelling` says")]
router = APIRouter(prefix="/v1/maps", tags=["maps"])


class FeatureOut(AnswerModel):
    """A feature of a map, and where it may be seen from: a truncated cone."""

    feature: int
    position: list[float] = Field(description="of its landmark")
    sigma: float = Field(description="its standard deviation, root mean square of the axes")
    direction: list[float] = Field(
        description="the cone's axis: unit vector from the landmark to where it was seen from"
    )
    half_angle_deg: float = Field(description="between the cone's axis and its edge")
    nearest: float = Field(description="the shortest distance from which it is expected to be seen")
    farthest: float = Field(description="the longest distance from which it is expected to be seen")
    views: list[int] = Field(description="the views that saw it, by number")


NAMES_CONTENT: dict[str, Any] = {
    GEOJSON: {
        "schema": {"type": "object"},
        "example": names_to_geojson(
            MapNames(
                (NamedPoint("charger", (0.2, 3.1, 0.0), "dock", {"volts": 24}),),
                (NamedArea("kitchen", ((0.0, 0.0), (4.0, 0.0), (4.0, 3.0)), "room"),),
            ),
            earth=None,
        ),
    }
}
"""Named points and areas as GeoJSON, for the OpenAPI document."""
_BINARY_TYPE = "application/octet-stream"
_PLAN_CONTENT: dict[str, Any] = {
    kind: {"schema": {"type": "object"}, "example": {"type": "FeatureCollection", "features": []}}
    if kind == GEOJSON
    else {"schema": BINARY}
    for kind in MEDIA_TYPES
}


@router.get("/{map_name}/report", **declared(NEEDS_READ, "A map's own quality report", *_FAILURES))
async def get_report(map_name: str, service: Service) -> MapReportOut:
    """What the map found out about itself while it was built: coverage, residuals, and how consistent it is:
    frames of the same walk, held out, localized in it."""
    info = (await service.maps.get(map_name)).info
    return MapReportOut(map=map_name, map_id=info.id, map_version=info.version, report=info.report)


@router.get(
    "/{map_name}/report.png",
    **declared(
        NEEDS_READ, "A map's own quality report as a picture", *_FAILURES, Busy, also=content("A picture.", "image/png")
    ),
)
async def get_report_picture(map_name: str, request: Request, service: Service) -> Response:
    """A picture of the report: coverage by position and heading, how consistent frames held out are with it, how exact
    the landmarks are.
    """
    return await _rendered(request, service, map_name, Rendering.REPORT, "image/png")


@router.get(
    "/{map_name}/coverage",
    **declared(
        NEEDS_READ,
        "Where a map works",
        *_FAILURES,
        Busy,
        also={
            200: {
                "model": CoverageReport,
                "description": "Landmarks in view, by position and heading.",
                "content": {"application/json": {"example": EXAMPLES["MapReportOut"]["report"]["coverage"]}},
            }
        },
    ),
)
async def get_coverage(map_name: str, request: Request, service: Service) -> Response:
    """How many landmarks a camera like the map's sees from places on a grid around the walk, in each of twelve
    directions. `sufficient` of them are enough to expect a pose."""
    return await _rendered(request, service, map_name, Rendering.COVERAGE, "application/json")


@router.get(
    "/{map_name}/names",
    **declared(
        NEEDS_READ,
        "A map's named points and areas as GeoJSON",
        *_FAILURES,
        also={
            200: {
                "description": "A FeatureCollection.",
                "content": NAMES_CONTENT,
            }
        },
    ),
)
async def get_names(map_name: str, request: Request, service: Service) -> Response:
    """Named points and areas as GeoJSON: longitude, latitude and height of WGS 84 in a map with a place on Earth, its
    own or its site's; else metres of the map, and the collection says `"frame": "map"`.
    """

    by_site = await service.sites.earth_of(map_name)

    def names(map_: Map) -> tuple[bytes, str]:
        collection = names_to_geojson(map_.info.names, map_.info.earth or by_site)
        return json.dumps(collection, ensure_ascii=False).encode(), GEOJSON

    return await _made(request, service, map_name, names, "names", by_site)


@router.get(
    "/{map_name}/plan",
    **declared(
        NEEDS_READ,
        "A map's floor plan",
        *_FAILURES,
        UnknownPicture,
        also={200: {"description": "The file.", "content": _PLAN_CONTENT}},
    ),
)
async def get_plan(map_name: str, request: Request, service: Service) -> Response:
    """The floor plan's file as it was sent; `plan` of the map says where it lies."""

    def plan(map_: Map) -> tuple[bytes, str]:
        if map_.info.plan is None:
            raise UnknownPicture(f"The map {map_name} has no floor plan.", "Send one with PUT.")
        return map_.plan, map_.info.plan.media_type

    return await _made(request, service, map_name, plan, "plan")


@router.get(
    "/{map_name}/scene",
    **declared(
        NEEDS_READ, "A map for a 3-D view", *_FAILURES, also=content("Landmarks and views.", "application/octet-stream")
    ),
)
async def get_scene(
    map_name: str,
    request: Request,
    service: Service,
    landmarks: Annotated[
        int | None, Query(ge=1, description="at most so many, evenly chosen; default: all", examples=[1500])
    ] = None,
    level: Level = False,
) -> Response:
    """Landmarks and views. Little-endian: two uint32, the numbers F of landmarks and K of views; F × 4 float32: x, y,
    z, standard deviation; K × 7 float32: x, y, z, heading, the number of the walk (views of one number follow one
    another; of pictures in no order each has its own); where the map knows its colours or second positions, F × 3
    uint8: red, green, blue; where it knows second positions of the views, K × 3 float32 of them (NaN: none). Lengths in
    metres, or in the map's unit if it is not metric.
    """

    def scene(map_: Map) -> tuple[bytes, str]:
        return map_to_scene(map_, landmarks, levelled(map_) if level else None), _BINARY_TYPE

    return await _made(request, service, map_name, scene, "scene", landmarks, level)


@router.get(
    "/{map_name}/features/{feature}",
    **declared(NEEDS_READ, "A feature of a map, and where it may be seen from", *_FAILURES, InvalidInput),
)
async def get_feature(
    map_name: str,
    feature: Annotated[int, PathParameter(ge=0, description="its number, from 0", examples=[100])],
    service: Service,
) -> FeatureOut:
    """One landmark of the map. Features are numbered as in `…/scene`, where all of them are asked for. Lengths in the
    map's unit. 422 if there is no such feature, or the map does not remember who saw it.
    """
    return await run_in_threadpool(_feature, await service.maps.get(map_name), feature)


def _feature(map_: Map, feature: int) -> FeatureOut:
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
    **declared(
        NEEDS_READ,
        "Further points of the room",
        *_FAILURES,
        also=content("Points in colour.", "application/octet-stream"),
    ),
)
async def get_points(map_name: str, request: Request, service: Service) -> Response:
    """Points of the reconstruction that are not landmarks, for people to see the room. Little-endian: one uint32, the
    number P; P × 3 float32: x, y, z; P × 3 uint8: red, green, blue. Lengths in metres."""
    return await _made(request, service, map_name, lambda map_: (cloud_to_bytes(map_), _BINARY_TYPE), "points")


@router.get(
    "/{map_name}/room",
    **declared(
        NEEDS_READ,
        "The surfaces of a map's room",
        *_FAILURES,
        also=content("A mesh in colour.", "application/octet-stream"),
    ),
)
async def get_room(map_name: str, request: Request, service: Service, level: Level = False) -> Response:
    """Surfaces for people to see, drawn after a map is published; nothing uses them to localize. Little-endian: two
    uint32, the numbers V and Q; V × 3 float32: x, y, z; Q × 4 uint32: the vertices of each quadrilateral,
    counter-clockwise as seen from the free side; V × 3 uint8: red, green, blue. Lengths in metres."""

    def room(map_: Map) -> tuple[bytes, str]:
        return room_to_bytes(map_, levelled(map_) if level else None), _BINARY_TYPE

    return await _made(request, service, map_name, room, "room", level)


@router.get(
    "/{map_name}/views/{view}/picture.jpg",
    **declared(
        NEEDS_READ,
        "A small picture of one of a map's views",
        *_FAILURES,
        UnknownPicture,
        also=content("A picture.", "image/jpeg"),
    ),
)
async def get_view_picture(
    map_name: str,
    view: Annotated[int, PathParameter(ge=0, description="the view by number in the map, from 0")],
    request: Request,
    service: Service,
) -> Response:
    """The picture of a view, if the map keeps pictures and this server's setting `keep_pictures` is on."""

    def picture(map_: Map) -> tuple[bytes, str]:
        pictures = map_.views.known_pictures if service.settings.keep_pictures else ()
        if view >= len(pictures) or not pictures[view]:
            raise UnknownPicture(
                f"The map {map_name} has no picture of its view {view}.",
                "Maps keep and show pictures where RHOLOC_KEEP_PICTURES=1 is set while they are made, and later.",
            )
        return pictures[view], "image/jpeg"

    return await _made(request, service, map_name, picture, "picture", view)


@router.get(
    "/{map_name}/preview.png",
    **declared(NEEDS_READ, "A map from above", *_FAILURES, Busy, also=content("A picture.", "image/png")),
)
async def get_preview(map_name: str, request: Request, service: Service) -> Response:
    """A picture of landmarks, the walk and waypoints."""
    return await _rendered(request, service, map_name, Rendering.PREVIEW, "image/png")


async def _made(
    request: Request, service: State, name: str, make: Callable[[Map], tuple[bytes, str]], *parts: object
) -> Response:
    """Response with the content and media type that ``make`` returns for a map; 304 if the browser has it. ``parts``
    distinguish its ETag from those of other responses of the map. Raises InvalidName, UnknownMap, InvalidMap.
    """
    etag = etag_of(await service.maps.stat(name), *parts)
    if is_kept(request, etag):
        return unchanged(etag)
    content, media_type = await run_in_threadpool(make, await service.maps.get(name))
    return Response(content, media_type=media_type, headers=caching_headers(etag))


async def _rendered(request: Request, service: State, name: str, kind: Rendering, media_type: str) -> Response:
    """Response with a rendering of a map; 304 if the browser has it. Raises InvalidName, UnknownMap, InvalidMap,
    StorageFull, Busy.
    """
    etag = etag_of(await service.maps.stat(name), kind)
    if is_kept(request, etag):
        return unchanged(etag)
    rendered = await service.renderings.get(name, kind)
    return Response(rendered.content, media_type=media_type, headers=caching_headers(rendered.etag))
