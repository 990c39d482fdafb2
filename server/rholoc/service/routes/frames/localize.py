"""Frame → pose."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Annotated, TypeVar

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
    RholocError,
    StorageUnavailable,
    TooLarge,
    UnknownCamera,
    UnknownMap,
    UnknownSite,
)
from rholoc.localization import AnyLocalizer
from rholoc.maps import CameraLibrary
from rholoc.service.access.scopes import NEEDS_LOCALIZE
from rholoc.service.caller import ASKER
from rholoc.service.errors import InvalidRequest, UnsupportedMediaType
from rholoc.service.frames.answers import LocalizationOut, PlacesOut, late_answer
from rholoc.service.frames.landscape import LandscapeOut, landscape_of
from rholoc.service.frames.localizers import Localizers, LocalizerSource, MapNotHereError
from rholoc.service.frames.map_choice import MapChoice
from rholoc.service.frames.queries import Frame
from rholoc.service.frames.requests import DescriptorQuery, FramesQuery, LocalizeOptions
from rholoc.service.frames.several_frames import Frames, localize_frames
from rholoc.service.frames.single_frame import likeliest_places, localize_frame
from rholoc.service.frames.site_answers import in_site
from rholoc.service.frames.stopwatch import Stopwatch, frame_deadline_s
from rholoc.service.http.openapi import BINARY, failures, reference, request_body
from rholoc.service.routes.frames.reading import OptionParameters, Options, read_frame, read_frames
from rholoc.service.routes.frames.which_maps import (
    RADIUS_M,
    Latitude,
    Longitude,
    MapNames,
    Radius,
    SiteName,
    check_known,
    named_maps,
    place_on_earth,
    requested_maps,
)
from rholoc.service.state import Service, State
from rholoc.service.threads.compute import Effort

router = APIRouter(prefix="/v1", tags=["localization"])

_FAILURES = failures(
    UnknownMap, UnknownSite, UnknownCamera, InvalidName, InvalidRequest, InvalidImage, InvalidCamera,
    InvalidDescriptors, InvalidInput, InvalidMap, TooLarge, UnsupportedMediaType, Busy, DeadlineExceeded,
)  # fmt: skip
_BODY = request_body(
    {
        "image/jpeg": {"schema": BINARY},
        "image/png": {"schema": BINARY},
        "multipart/form-data": {
            "schema": {
                "type": "object",
                "required": ["image"],
                "properties": {
                    "image": BINARY,
                    "request": {"anyOf": [reference(LocalizeOptions), reference(FramesQuery)]},
                },
            },
            "encoding": {
                "image": {"contentType": "image/jpeg, image/png"},
                "request": {"contentType": "application/json"},
            },
        },
        "application/json": {
            "schema": {"anyOf": [reference(DescriptorQuery), reference(FramesQuery)]},
            "example": DescriptorQuery.model_config["json_schema_extra"]["example"],  # type: ignore[index]
        },
    }
)

T = TypeVar("T")

_FETCHING_S = 1.0  # for a map among several that is not on this machine; then it is passed over
_LOADING_GRACE_S = 0.5  # for a map that was not in memory, beyond the deadline


@router.post(
    "/maps/{map_name}/localize",
    dependencies=[NEEDS_LOCALIZE],
    summary="Where a frame was taken, in one map",
    responses=_FAILURES,
    openapi_extra=_BODY,
)
async def localize_in_map(map_name: str, request: Request, service: Service, options: Options) -> LocalizationOut:
    """Send a JPEG or PNG as it is, with options in the query; or multipart, with an `image` and a JSON `request`; or a
    descriptor set as JSON. "No pose" is an answer: `localized` is false and `reason` says why.

    Several frames whose poses relative to each other are known get one answer: send JSON with 2 to 10 `frames`, their
    pictures within or as parts `image0`, `image1`, … beside the `request` of a multipart body."""
    return await _localize(MapChoice([map_name]), request, service, options)


@router.post(
    "/localize",
    dependencies=[NEEDS_LOCALIZE],
    summary="Where a frame was taken, in the best of several maps",
    responses=_FAILURES,
    openapi_extra=_BODY,
)
async def localize_in_maps(
    request: Request,
    service: Service,
    options: Options,
    maps: MapNames = None,
    site: SiteName = None,
    latitude: Latitude = None,
    longitude: Longitude = None,
    radius_m: Radius = RADIUS_M,
) -> LocalizationOut:
    """Asks every map and returns the most confident answer, with the map's name. Of more than five maps it asks those
    that the frame resembles most, by an index over all their views, until an answer is conclusive. The maps are named,
    or those of a site, or those of all sites near a place on Earth; without any of these, all."""
    choice = await requested_maps(maps, site, place_on_earth(latitude, longitude), radius_m, service)
    return await _localize(choice, request, service, options)


@router.post(
    "/places",
    dependencies=[NEEDS_LOCALIZE],
    summary="Which views of several maps a picture is most like, without a pose",
    responses=_FAILURES,
    openapi_extra=_BODY,
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
    with service.held_bodies.hold() as on_piece:
        frame = await read_frame(request, options, service, on_piece, "Places are found for one picture at a time.")
        await check_known(choice.names if choice.named else (), service)
        settings = service.settings
        return await _compute(
            service,
            lambda localizers: likeliest_places(frame, choice, localizers, settings, clock, limit),
            frame.effort,
            choice.named,
        )


@router.post(
    "/maps/{map_name}/landscape",
    dependencies=[NEEDS_LOCALIZE],
    summary="What the densities say around a frame's pose",
    responses=_FAILURES,
    openapi_extra=_BODY,
)
async def see_landscape(map_name: str, request: Request, service: Service, options: Options) -> LandscapeOut:
    """The product of the densities of what the frame shows, over positions around its pose, and the paths of ascents to
    it. One picture or descriptor set is sent as for a pose; it takes a few times as long."""
    clock = Stopwatch()
    await check_known([map_name], service)
    with service.held_bodies.hold() as on_piece:
        frame = await read_frame(request, options, service, on_piece, "Several frames have no landscape together.")
        cameras, settings = service.cameras, service.settings
        return await _compute(
            service,
            lambda localizers: landscape_of(_with_stored(frame, cameras), map_name, localizers, settings, clock),
            Effort.LARGE,
        )


def _with_stored(frame: Frame, cameras: CameraLibrary) -> Frame:
    """The frame with the stored camera that its request names. Raises UnknownCamera."""
    name = frame.options.camera.name
    return frame if name is None else replace(frame, stored=cameras.get(name).camera)


class _RequestLocalizers:
    """The localizers for one request, which keep what prevented a map from being fetched for it."""

    def __init__(self, localizers: Localizers) -> None:
        self._localizers = localizers
        self.refused: dict[str, RholocError] = {}

    def get(self, name: str) -> AnyLocalizer:
        if name in self.refused:
            raise self.refused[name]
        return self._localizers.get(name)


async def _compute(service: State, work: Callable[[LocalizerSource], T], effort: Effort, needs_all: bool = True) -> T:
    """The result of ``work`` in a compute thread; it begins again whenever it lacks a map that has to be fetched first.

    Args:
        service: which computes.
        work: given the localizers.
        effort: of the work.
        needs_all: whether a map that is not fetched soon is waited for, or passed over.
    """
    localizers, patience_s = _RequestLocalizers(service.localizers), None if needs_all else _FETCHING_S
    while True:
        try:
            return await service.compute.run(lambda: work(localizers), effort)
        except MapNotHereError as missing:
            name = missing.name
        try:
            async with asyncio.timeout(patience_s):
                await service.threads.fetches(service.localizers.fetch, name)
        except RholocError as error:
            localizers.refused[name] = error
        except TimeoutError:
            hint = "It is being fetched: try again soon."
            localizers.refused[name] = StorageUnavailable(f"The map {name} is not on this server yet.", hint)


async def _localize(maps: MapChoice, request: Request, service: State, options: OptionParameters) -> LocalizationOut:
    clock = Stopwatch()
    with service.held_bodies.hold() as on_piece:
        sent = await read_frames(request, options.options(), service, on_piece)
        if isinstance(sent, Frame):
            return await answer_frame(sent, maps, service, clock)
        return await _localize_frames(*sent, maps, service, clock)


async def answer_frame(frame: Frame, maps: MapChoice, service: State, clock: Stopwatch) -> LocalizationOut:
    """The most confident answer of several maps for one frame, by its deadline.

    Raises:
        RholocError: as :func:`rholoc.service.frames.single_frame.localize_frame`, and Busy.
    """
    settings, cameras = service.settings, service.cameras
    listener = service.learner.listener(ASKER.get())

    def localize(localizers: LocalizerSource) -> LocalizationOut:
        return localize_frame(_with_stored(frame, cameras), maps, localizers, settings, clock, listener)

    return await _answer_by_deadline(
        localize,
        maps,
        service,
        clock,
        frame_deadline_s(frame.options.deadline_ms, settings),
        frame.effort,
        None if frame.options.prior is None else frame.options.prior.position,
    )


async def _localize_frames(
    query: FramesQuery, images: dict[int, bytes], maps: MapChoice, service: State, clock: Stopwatch
) -> LocalizationOut:
    cameras = [query.camera, *(one.camera for one in query.frames if one.camera is not None)]
    named = {camera.name for camera in cameras if camera.name is not None}
    settings, deadline_s = service.settings, frame_deadline_s(query.deadline_ms, service.settings)

    def localize(localizers: LocalizerSource) -> LocalizationOut:
        stored = {name: service.cameras.get(name).camera for name in named}
        frames = Frames.of(query, images, stored)
        return localize_frames(frames, maps, localizers, settings, clock, deadline_s)

    return await _answer_by_deadline(localize, maps, service, clock, deadline_s, Effort.LARGE)


async def _answer_by_deadline(
    localize: Callable[[LocalizerSource], LocalizationOut],
    maps: MapChoice,
    service: State,
    clock: Stopwatch,
    deadline_s: float,
    effort: Effort,
    expected: Sequence[float] | None = None,
) -> LocalizationOut:
    """The answer that a thread finds, or at the deadline the answer that it was too late.

    ``expected``: the prior's position.
    """
    await check_known(maps.names if maps.named else (), service)

    def localize_in_site(localizers: LocalizerSource) -> LocalizationOut:
        return in_site(localize(localizers), service.sites, maps.site)

    try:
        async with asyncio.timeout(deadline_s - clock.elapsed_s):
            answer = await _compute(service, localize_in_site, effort, maps.named)
    except (TimeoutError, DeadlineExceeded):
        answer = await _late_answer(maps.first, service, clock)
    service.metrics.localization(answer.map, answer.reason, answer.timings_ms)
    service.live.note(answer, expected)
    return answer


async def _late_answer(name: str, service: State, clock: Stopwatch) -> LocalizationOut:
    """The answer at the deadline, while a thread is still working on the frame or has not begun."""
    try:
        async with asyncio.timeout(_LOADING_GRACE_S):
            localizer = await service.threads.files(service.localizers.get, name)
    except (TimeoutError, MapNotHereError, StorageUnavailable):
        raise DeadlineExceeded("The deadline passed while the map was being loaded.", "Try again.") from None
    return late_answer(name, localizer, clock)
