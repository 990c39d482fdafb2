"""Frame → pose."""

from typing import Annotated, Any

from fastapi import APIRouter, Query, Request

from rholoc.errors import (
    Busy,
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
from rholoc.service.access.scopes import NEEDS_LOCALIZE
from rholoc.service.errors import UnsupportedMediaType
from rholoc.service.frames.answer_models import LocalizationOut, PlacesOut
from rholoc.service.frames.landscape import LandscapeOut
from rholoc.service.frames.map_choice import MapChoice
from rholoc.service.frames.request_models import DescriptorQuery, FramesQuery, LocalizeOptions
from rholoc.service.http.models import EXAMPLES
from rholoc.service.http.openapi import BINARY, declared, reference, request_body
from rholoc.service.http.stopwatch import Stopwatch
from rholoc.service.routes.frames.reading import Options, read_frame, read_frames
from rholoc.service.routes.frames.which_maps import MapNames, Requested, named_maps
from rholoc.service.state import Service

router = APIRouter(prefix="/v1", tags=["localization"])

_FAILURES = (
    UnknownMap, UnknownSite, UnknownCamera, InvalidName, InvalidImage, InvalidCamera,
    InvalidDescriptors, InvalidInput, InvalidMap, TooLarge, UnsupportedMediaType, Busy, DeadlineExceeded,
)  # fmt: skip


def _multipart(images: str, request: dict[str, str], required: list[str]) -> dict[str, Any]:
    """OpenAPI of a multipart body with parts called ``images``, JPEG or PNG, and JSON of the schema ``request``."""
    return {
        "schema": {"type": "object", "required": required, "properties": {images: BINARY, "request": request}},
        "encoding": {images: {"contentType": "image/jpeg, image/png"}, "request": {"contentType": "application/json"}},
    }


_BODY = request_body(
    {
        "image/jpeg": {"schema": BINARY},
        "image/png": {"schema": BINARY},
        "multipart/form-data": _multipart("image", reference(LocalizeOptions), ["image"]),
        "application/json": {
            "schema": reference(DescriptorQuery),
            "example": EXAMPLES["DescriptorQuery"],
        },
    }
)
_FRAMES_BODY = request_body(
    {
        "multipart/form-data": _multipart("image0", reference(FramesQuery), ["request"]),
        "application/json": {"schema": reference(FramesQuery)},
    }
)


@router.post(
    "/maps/{map_name}/localize",
    openapi_extra=_BODY,
    **declared(NEEDS_LOCALIZE, "Where a frame was taken, in one map", *_FAILURES),
)
async def localize_in_map(map_name: str, request: Request, service: Service, options: Options) -> LocalizationOut:
    """The pose of one frame. Send a JPEG or PNG as it is, with options in the query; or multipart, with an `image` and
    a JSON `request`; or a descriptor set as JSON. "No pose" is an answer: `localized` is false and `reason` says why.
    """
    clock = Stopwatch()
    async with read_frame(request, options, service) as frame:
        return await service.frames.localize(frame, MapChoice([map_name]), clock)


@router.post(
    "/localize",
    openapi_extra=_BODY,
    **declared(NEEDS_LOCALIZE, "Where a frame was taken, in the best of several maps", *_FAILURES),
)
async def localize_in_maps(
    request: Request, service: Service, options: Options, requested: Requested
) -> LocalizationOut:
    """Asks every map and returns the most confident answer, with the map's name. Of more than five maps it asks those
    that the frame resembles most, by an index over all their views, until an answer is conclusive. The maps are named,
    or those of a site, or those of all sites near a place on Earth; without any of these, all."""
    clock = Stopwatch()
    maps = await requested.choice(service)
    async with read_frame(request, options, service) as frame:
        return await service.frames.localize(frame, maps, clock)


@router.post(
    "/maps/{map_name}/localize/frames",
    openapi_extra=_FRAMES_BODY,
    **declared(NEEDS_LOCALIZE, "Where several frames were taken, in one map", *_FAILURES),
)
async def localize_frames_in_map(map_name: str, request: Request, service: Service) -> LocalizationOut:
    """2 to 10 frames whose poses relative to each other are known get one answer: send JSON, with pictures within as
    base64; or multipart, with parts `image0`, `image1`, … and a JSON `request`. `pose` is the first frame's."""
    clock = Stopwatch()
    async with read_frames(request, service) as frames:
        return await service.frames.localize_together(frames, MapChoice([map_name]), clock)


@router.post(
    "/localize/frames",
    openapi_extra=_FRAMES_BODY,
    **declared(NEEDS_LOCALIZE, "Where several frames were taken, in the best of several maps", *_FAILURES),
)
async def localize_frames_in_maps(request: Request, service: Service, requested: Requested) -> LocalizationOut:
    """2 to 10 frames, sent as to one map. Of many maps it asks those that the first frame resembles most."""
    clock = Stopwatch()
    maps = await requested.choice(service)
    async with read_frames(request, service) as frames:
        return await service.frames.localize_together(frames, maps, clock)


@router.post(
    "/places",
    openapi_extra=_BODY,
    **declared(NEEDS_LOCALIZE, "Which views of several maps a picture is most like, without a pose", *_FAILURES),
)
async def find_places(
    request: Request,
    service: Service,
    options: Options,
    maps: MapNames = None,
    limit: Annotated[int, Query(ge=1, le=100, description="how many views at most", examples=[10])] = 10,
) -> PlacesOut:
    """Place recognition: fast, and useful where a pose is not needed or cannot be found. One picture or descriptor set
    is sent as for a pose."""
    clock = Stopwatch()
    choice = await named_maps(maps, service)
    async with read_frame(request, options, service) as frame:
        return await service.frames.places(frame, choice, clock, limit)


@router.post(
    "/maps/{map_name}/landscape",
    openapi_extra=_BODY,
    **declared(NEEDS_LOCALIZE, "What the densities say around a frame's pose", *_FAILURES),
)
async def see_landscape(map_name: str, request: Request, service: Service, options: Options) -> LandscapeOut:
    """The product of the densities of what the frame shows, over positions around its pose, and the paths of ascents to
    it; around the likeliest place if there is no pose, with `localized` false. One picture or descriptor set is sent as
    for a pose; it takes a few times as long."""
    clock = Stopwatch()
    await service.frames.check_known([map_name])
    async with read_frame(request, options, service) as frame:
        return await service.frames.landscape(frame, map_name, clock)
