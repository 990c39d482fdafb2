"""What a visitor of a site needs, and nothing else: where one may walk, what has a name, and where the camera is."""

from typing import Annotated

import numpy as np
from fastapi import APIRouter, Depends, Request, Response
from pydantic import Field
from starlette.concurrency import run_in_threadpool

from rholoc.errors import Busy as TooBusy
from rholoc.errors import (
    DeadlineExceeded,
    InvalidCamera,
    InvalidDescriptors,
    InvalidImage,
    InvalidInput,
    InvalidMap,
    InvalidName,
    TooLarge,
    UnknownCamera,
    UnknownMap,
    UnknownSite,
)
from rholoc.geometry import FloatArray
from rholoc.maps import Map, SiteMap, room_to_bytes
from rholoc.service.access.scopes import NEEDS_VISIT, request_key
from rholoc.service.errors import Forbidden, UnsupportedMediaType
from rholoc.service.frames.answer_models import LocalizationOut
from rholoc.service.http.models import AnswerModel
from rholoc.service.http.openapi import BINARY, content, declared, request_body
from rholoc.service.http.stopwatch import Stopwatch
from rholoc.service.routes.frames.reading import Options, read_frame
from rholoc.service.routes.frames.which_maps import RequestedMaps
from rholoc.service.state import Service

_STEP_M = 0.15  # between positions of a walk that are told


class HerePointOut(AnswerModel):
    """A place of a site with a name."""

    name: str
    floor: str
    position: list[float] = Field(description="x, y, z in m, in the site's frame")


class HereRoomOut(AnswerModel):
    """A map of a site that has a place in it."""

    map: str
    floor: str
    T_site_map: list[list[float]] = Field(description="4×4, takes points of the map to the site's frame")
    room: int = Field(description="how many vertices its surfaces have; 0 where none are drawn")
    walked: list[list[list[float]]] = Field(
        description="the walks: lists of positions x, y, z in m, in the site's frame"
    )


class HereOut(AnswerModel):
    """A site as a visitor sees it."""

    site: str
    rooms: list[HereRoomOut]
    points: list[HerePointOut] = Field(description="places to be led to")


class HerePoseOut(AnswerModel):
    """Where the camera is, or why that is not known."""

    localized: bool
    floor: str | None
    position: list[float] | None = Field(description="x, y, z in m, in the site's frame")
    heading: list[float] | None = Field(description="the optical axis, unit length, in the site's frame")
    sigma_m: float | None = Field(description="one sigma of x and y (root mean square), m; null where not known")
    message: str | None = Field(description="one sentence: why there is no pose, and what to try")


def visitor(site: str, request: Request) -> str:
    """The name of the site, if the request's key, or no key, may visit it.

    Raises:
        Forbidden: the key is for another site.
    """
    key = request_key(request.scope)
    if key is not None and key.site not in ("", site):
        raise Forbidden("This link is for another site.", "Open the link or the code of this one.")
    return site


router = APIRouter(prefix="/v1/here", tags=["sites"])
Visited = Annotated[str, Depends(visitor)]
_FAILURES = (UnknownSite, InvalidName, InvalidInput, InvalidMap)


@router.get("/{site}", **declared(NEEDS_VISIT, "A site for its visitors", *_FAILURES))
async def get_here(site: Visited, service: Service) -> HereOut:
    """The maps that have a place in the site, where walks led through them, and their named points and areas."""
    members = (await service.sites.get(site)).maps
    present = set(await service.maps.existing([one.map for one in members]))
    rooms, points = [], []
    for member in members:
        if member.pose is not None and member.map in present:
            map_ = await service.maps.get(member.map)
            rooms.append(await run_in_threadpool(_room, member, map_))
            points += _points(member, map_)
    return HereOut(site=site, rooms=rooms, points=sorted(points, key=lambda point: point.name))


@router.get(
    "/{site}/rooms/{map_name}",
    **declared(
        NEEDS_VISIT,
        "The surfaces of a room, for a site's visitors",
        *_FAILURES,
        UnknownMap,
        also=content("A mesh in colour.", "application/octet-stream"),
    ),
)
async def get_here_room(site: Visited, map_name: str, service: Service) -> Response:
    """The room of a map of this site, in the format of `GET /v1/maps/{map_name}/room`; empty if none was drawn."""
    if (await service.sites.get(site)).member(map_name) is None:
        raise UnknownMap(f"The site {site} has no map {map_name[:64]}.", "GET /v1/here/{site} names its maps.")
    map_ = await service.maps.get(map_name)
    return Response(await run_in_threadpool(room_to_bytes, map_), media_type="application/octet-stream")


@router.post(
    "/{site}/localize",
    openapi_extra=request_body({"image/jpeg": {"schema": BINARY}, "image/png": {"schema": BINARY}}),
    **declared(
        NEEDS_VISIT, "Where a visitor's camera is", *_FAILURES, UnknownMap, UnknownCamera, InvalidImage, InvalidCamera,
        InvalidDescriptors, TooLarge, UnsupportedMediaType, TooBusy, DeadlineExceeded,
    ),
)  # fmt: skip
async def localize_here(site: Visited, request: Request, service: Service, options: Options) -> HerePoseOut:
    """The pose of one picture in the site. Send a JPEG or PNG. It is not kept; nothing is learned from it."""
    clock = Stopwatch()
    maps = await RequestedMaps(site=site).choice(service)
    async with read_frame(request, options, service) as frame:
        answer = await service.frames.localize(frame, maps, clock, private=True)
    return _here(answer)


def _room(member: SiteMap, map_: Map) -> HereRoomOut:
    """A placed map and its walks, in the site's frame."""
    T = _matrix(member)
    walks = [map_.views.positions[rows].astype(np.float64) for rows in map_.views.by_walk]
    return HereRoomOut(
        map=member.map,
        floor=member.floor,
        T_site_map=T.tolist(),
        room=len(map_.room),
        walked=[_thinned(walk @ T[:3, :3].T + T[:3, 3]).round(2).tolist() for walk in walks],
    )


def _thinned(positions: FloatArray) -> FloatArray:
    """Positions (N, 3) without those within 0.15 m of the last one kept."""
    kept: list[FloatArray] = []
    for position in positions:
        if not kept or np.linalg.norm(position - kept[-1]) >= _STEP_M:
            kept.append(position)
    return np.array(kept).reshape(-1, 3)


def _points(member: SiteMap, map_: Map) -> list[HerePointOut]:
    """Named points, and areas at their middle and the views' median height, in the site's frame."""
    T, names = _matrix(member), map_.info.names
    height = float(np.median(map_.views.positions[:, 2])) if len(map_.views) else 0.0
    places = [(point.name, np.array(point.position)) for point in names.points]
    places += [(area.name, np.array([*np.mean(area.outline, axis=0), height])) for area in names.areas]
    return [
        HerePointOut(name=name, floor=member.floor, position=(T[:3, :3] @ place + T[:3, 3]).round(3).tolist())
        for name, place in places
    ]


def _matrix(member: SiteMap) -> FloatArray:
    assert member.pose is not None
    return member.pose.matrix


def _here(answer: LocalizationOut) -> HerePoseOut:
    """The pose in the site, or a text on why there is none."""
    found, why = answer.site, answer.diagnosis
    if found is None:
        unplaced = None if answer.pose is None else "This room has no place on the plan yet."
        said = unplaced if why is None else f"{why.message} {why.hint}"
        return HerePoseOut(localized=False, floor=None, position=None, heading=None, sigma_m=None, message=said)
    sigma_m = None
    if found.covariance is not None:
        sigma_m = float(np.sqrt(max(0.0, np.trace(np.array(found.covariance)[:2, :2]) / 2)))
    return HerePoseOut(
        localized=True,
        floor=found.floor,
        position=found.position,
        heading=found.heading,
        sigma_m=sigma_m,
        message=None,
    )
