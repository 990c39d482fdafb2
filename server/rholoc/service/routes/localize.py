"""Frame → pose."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Annotated, Any, TypeVar

from fastapi import APIRouter, Depends, Query, Request
from starlette.concurrency import run_in_threadpool

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
from rholoc.geometry.earth import EarthPlace
from rholoc.localization import MOST_FRAMES, AnyLocalizer
from rholoc.maps import CameraLibrary
from rholoc.recordings.frames.image import IMAGE_START_BYTES, begins_like_an_image
from rholoc.service.access import NEEDS_LOCALIZE
from rholoc.service.bodies import PieceListener, media_type, read_body, read_multipart
from rholoc.service.compute import Effort
from rholoc.service.errors import InvalidRequest, UnsupportedMediaType
from rholoc.service.json_bodies import JsonLimits
from rholoc.service.landscape import landscape_of
from rholoc.service.live import ASKER
from rholoc.service.localize import Stopwatch, frame_deadline_s, late_answer, likeliest_places, localize_frame
from rholoc.service.localizers import Localizers, LocalizerSource, MapNotHereError
from rholoc.service.map_choice import MOST_ASKED, MapChoice
from rholoc.service.openapi import BINARY, failures, reference, request_body
from rholoc.service.queries import Frame, effort_of, effort_of_set
from rholoc.service.schemas import (
    DescriptorQuery,
    FramesQuery,
    LandscapeOut,
    LocalizationOut,
    LocalizeOptions,
    PlacesOut,
)
from rholoc.service.settings import Settings
from rholoc.service.several_frames import Frames, localize_frames
from rholoc.service.site_answers import in_site
from rholoc.service.state import Service, State

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
_PARTS = frozenset({"image", "request"})  # of a multipart body
_PARTS_HINT = "Send a file part 'image' and, if you like, a JSON part 'request'."
_NUMBERED_IMAGE = re.compile(r"image(\d{1,2})")  # a part of one with several frames
_FRAMES_MEMBER = re.compile(rb'"frames"\s*:')  # in a JSON body with several frames
_START_BYTES = 2048  # of a JSON body, within which that member begins

_SentFrames = tuple[FramesQuery, dict[int, bytes]]  # the query, and the pictures sent beside it, by number


@dataclass(frozen=True)
class OptionParameters:
    """The options of a request as query parameters; lists are separated by commas."""

    camera: Annotated[str | None, Query(description="a stored camera, instead of fx … lens", examples=["pixel-7"])] = (
        None
    )
    fx: Annotated[float | None, Query(description="focal length, px", examples=[525.5])] = None
    fy: Annotated[float | None, Query(description="px; default: fx", examples=[525.5])] = None
    cx: Annotated[float | None, Query(description="principal point, px", examples=[320.0])] = None
    cy: Annotated[float | None, Query(description="principal point, px", examples=[240.0])] = None
    distortion: Annotated[
        str | None,
        Query(description="k1,k2,p1,p2[,k3[,k4,k5,k6]]; of a fisheye k1,k2,k3,k4", examples=["0.02,-0.05,0,0"]),
    ] = None
    lens: Annotated[
        str | None, Query(description="pinhole, the default; fisheye; or equirectangular", examples=["fisheye"])
    ] = None
    dof: Annotated[str | None, Query(description="auto, 5 or 6", examples=["auto"])] = None
    intrinsics: Annotated[
        str | None, Query(description="'unknown': the focal length is estimated", examples=["unknown"])
    ] = None
    prior_position: Annotated[str | None, Query(description="x,y,z in m, map frame", examples=["1.2,0.4,1.5"])] = None
    prior_heading: Annotated[str | None, Query(description="hx,hy,hz", examples=["1,0,0"])] = None
    prior_quaternion_xyzw: Annotated[str | None, Query(description="x,y,z,w of R_map_camera")] = None
    prior_radius_m: Annotated[float | None, Query(description="m", examples=[0.5])] = None
    prior_radius_deg: Annotated[float | None, Query(description="degrees", examples=[35])] = None
    gravity: Annotated[str | None, Query(description="down in the camera frame: x,y,z", examples=["0,1,0"])] = None
    deadline_ms: Annotated[float | None, Query(description="how long the answer may take", examples=[500])] = None
    max_sigma_m: Annotated[
        float | None, Query(description="the position's greatest standard deviation, m; no pose if it is greater")
    ] = None
    max_sigma_deg: Annotated[float | None, Query(description="the rotation's, degrees; likewise")] = None
    with_matches: Annotated[
        bool | None, Query(description="whether the answer lists the matches that agree with the pose")
    ] = None

    def options(self) -> dict[str, Any]:
        """The same as the fields of :class:`LocalizeOptions`; what was not given is left out."""
        camera = _given(
            name=self.camera,
            fx=self.fx,
            fy=self.fy,
            cx=self.cx,
            cy=self.cy,
            distortion=_numbers("distortion", self.distortion),
            lens=self.lens,
        )
        prior = _given(
            position=_numbers("prior_position", self.prior_position),
            heading=_numbers("prior_heading", self.prior_heading),
            quaternion_xyzw=_numbers("prior_quaternion_xyzw", self.prior_quaternion_xyzw),
            radius_m=self.prior_radius_m,
            radius_deg=self.prior_radius_deg,
        )
        return _given(
            camera=camera or None,
            prior=prior or None,
            dof=int(self.dof) if self.dof is not None and self.dof.isdecimal() else self.dof,
            intrinsics=self.intrinsics,
            gravity=_numbers("gravity", self.gravity),
            deadline_ms=self.deadline_ms,
            max_sigma_m=self.max_sigma_m,
            max_sigma_deg=self.max_sigma_deg,
            with_matches=self.with_matches,
        )


def _given(**values: Any) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}


def _numbers(name: str, text: str | None) -> list[float] | None:
    if text is None:
        return None
    try:
        return [float(part) for part in text.split(",")]
    except ValueError as error:
        raise InvalidRequest(f"{name} is not a list of numbers.", "Separate the numbers by commas.") from error


Options = Annotated[OptionParameters, Depends()]
MapNames = Annotated[
    str | None, Query(description="names separated by commas, or 'all', the default", examples=["all", "hall,kitchen"])
]
SiteName = Annotated[str | None, Query(description="a site, instead of maps: all of its maps", examples=["campus"])]
Latitude = Annotated[
    float | None,
    Query(ge=-90, le=90, description="with `longitude`, instead of maps: those near there, WGS 84", examples=[52.52]),
]
Longitude = Annotated[float | None, Query(ge=-180, le=180, description="degrees east, WGS 84", examples=[13.405])]
Radius = Annotated[
    float, Query(gt=0, le=100_000, description="how far from that place a map's origin may lie, m", examples=[100])
]
_RADIUS_M = 100.0


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
    radius_m: Radius = _RADIUS_M,
) -> LocalizationOut:
    """Asks every map and returns the most confident answer, with the map's name. Of more than five maps it asks those
    that the frame resembles most, by an index over all their views, until an answer is conclusive. The maps are named,
    or those of a site, or those of all sites near a place on Earth; without any of these, all."""
    choice = await _requested_maps(maps, site, _place(latitude, longitude), radius_m, service)
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
    choice = await _named_maps(maps, service)
    with service.held_bodies.hold() as on_piece:
        frame = await _read_single(request, options, service, on_piece, "Places are found for one picture at a time.")
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
        frame = await _read_single(request, options, service, on_piece, "Several frames have no landscape together.")
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


async def _requested_maps(
    maps: str | None, site: str | None, place: EarthPlace | None, radius_m: float, service: State
) -> MapChoice:
    """The maps that a request is for, by their names, their site or where on Earth they are.

    Raises:
        InvalidRequest: it says more than one of them.
        UnknownSite, UnknownMap: there is no such site, or no map of it, or none there.
    """
    if sum(one is not None for one in (maps, site, place)) > 1:
        raise InvalidRequest("The request names its maps in two ways.", "Send one of maps, site, and a place on Earth.")
    if site is not None:
        members = [one.map for one in (await service.threads.database(service.sites.get, site)).maps]
        what = f"No map of the site {site} is here."
    elif place is not None:
        sites = await service.threads.database(service.sites.all)
        near = [name for one in sites.values() for name in one.maps_near(place, radius_m)]
        members = list(dict.fromkeys(near))
        what = f"No site has a map within {radius_m:g} m of there."
    else:
        return await _named_maps(maps, service)
    names = await service.threads.files(_existing, members, service)
    if not names:
        raise UnknownMap(what, "GET /v1/sites lists the sites and their maps.")
    return MapChoice(names, named=False, finder=service.finder, site=site)


def _existing(names: list[str], service: State) -> list[str]:
    """Those names that maps have now."""
    found = []
    for name in names:
        with suppress(UnknownMap):
            found.append(service.library.stat(name).name)
    return found


def _place(latitude_deg: float | None, longitude_deg: float | None) -> EarthPlace | None:
    if latitude_deg is None and longitude_deg is None:
        return None
    if latitude_deg is None or longitude_deg is None:
        raise InvalidRequest("A place on Earth has a latitude and a longitude.", "Send both.")
    return EarthPlace(latitude_deg, longitude_deg)


async def _named_maps(maps: str | None, service: State) -> MapChoice:
    """The maps that a request names."""
    names = list(dict.fromkeys(name.strip() for name in (maps or "all").split(",")))
    if names != ["all"]:
        return MapChoice(names, finder=service.finder)
    present = service.finder.present
    if len(present) <= MOST_ASKED:  # the library itself knows of a map that was published this moment
        present = await service.threads.files(service.library.readable)
    if not present:
        raise UnknownMap("There is no map yet.", "Upload one, or a recording.")
    return MapChoice(present, named=False, finder=service.finder, is_all=True)


async def check_known(names: Iterable[str], service: State) -> None:
    """Refuse an unknown map before a request takes a place in the queue. Known ones cost no wait for a disk.

    Raises:
        InvalidName, UnknownMap: by the library.
    """
    for name in names:
        if not service.library.is_known(name):
            await service.threads.files(service.library.stat, name)


async def _localize(maps: MapChoice, request: Request, service: State, options: OptionParameters) -> LocalizationOut:
    clock = Stopwatch()
    with service.held_bodies.hold() as on_piece:
        sent = await _read(request, options.options(), service, on_piece)
        if isinstance(sent, Frame):
            return await answer_frame(sent, maps, service, clock)
        return await _localize_frames(*sent, maps, service, clock)


async def answer_frame(frame: Frame, maps: MapChoice, service: State, clock: Stopwatch) -> LocalizationOut:
    """The most confident answer of several maps for one frame, by its deadline.

    Raises:
        RholocError: as :func:`rholoc.service.localize.localize_frame`, and Busy.
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


async def _read_single(
    request: Request, options: OptionParameters, service: State, on_piece: PieceListener, refusal: str
) -> Frame:
    """One picture or descriptor set; several frames are refused with the message ``refusal``."""
    frame = await _read(request, options.options(), service, on_piece)
    if not isinstance(frame, Frame):
        raise InvalidRequest(refusal, "Send one picture.")
    return frame


async def _read(
    request: Request, options: dict[str, Any], service: State, on_piece: PieceListener
) -> Frame | _SentFrames:
    """The frame, or the frames, of a request's body."""
    settings = service.settings
    kind, max_bytes = media_type(request), settings.max_request_bytes
    if kind.startswith("image/"):  # which format it really is, its bytes say
        image = await read_body(request, max_bytes, _image_listener(on_piece))
        effort = await run_in_threadpool(effort_of, image)
        return Frame(LocalizeOptions.model_validate(options), image=image, effort=effort)
    if kind == "application/json":
        body = await read_body(request, max_bytes, _json_listener(settings, on_piece))
        if _has_frames(body):
            return await _frames_query(body, service), {}
        effort = effort_of_set(body)
        service.compute.check_room(effort)
        query = await run_in_threadpool(DescriptorQuery.model_validate_json, body)
        return Frame(query, features=query.features, effort=effort)
    if kind == "multipart/form-data":
        return await _read_multipart(request, options, service, on_piece)
    raise UnsupportedMediaType(
        f"A body of type '{kind}' cannot be read.",
        "Send image/jpeg, image/png, multipart/form-data or application/json as Content-Type.",
    )


def _has_frames(body: bytes) -> bool:
    """Whether a JSON body holds several frames: that member must begin near its start."""
    return _FRAMES_MEMBER.search(body, 0, _START_BYTES) is not None


def _json_listener(settings: Settings, on_piece: PieceListener) -> PieceListener:
    """A listener that refuses a JSON body as soon as it exceeds the limits of one frame, or of several where it holds
    several, and passes the pieces to ``on_piece``.

    Raises:
        TooLarge: from the listener.
    """
    one = JsonLimits.of_features(settings.max_request_bytes, settings.max_features).measured()
    several = _limits_of_several(settings).measured(on_piece)
    start = b""

    def listen(piece: bytes) -> None:
        nonlocal start
        start += piece[: max(0, _START_BYTES - len(start))]
        several(piece)
        if not _has_frames(start):
            one(piece)

    return listen


def _limits_of_several(settings: Settings) -> JsonLimits:
    return JsonLimits.of_features(settings.max_request_bytes, MOST_FRAMES * settings.max_features)


async def _frames_query(body: bytes, service: State) -> FramesQuery:
    _limits_of_several(service.settings).check(body)
    service.compute.check_room(Effort.LARGE)
    return await run_in_threadpool(FramesQuery.model_validate_json, body)


def _image_listener(on_piece: PieceListener) -> PieceListener:
    """A listener that refuses, by its first bytes, a body that is not an image, and passes the pieces to ``on_piece``.

    Raises:
        InvalidImage: from the listener.
    """
    start = b""

    def listen(piece: bytes) -> None:
        nonlocal start
        if len(start) < IMAGE_START_BYTES:
            start += piece[:IMAGE_START_BYTES]
            if len(start) >= IMAGE_START_BYTES and not begins_like_an_image(start):
                raise InvalidImage("This is not an image that can be read.", "Send a whole JPEG, PNG or WebP file.")
        on_piece(piece)

    return listen


async def _read_multipart(
    request: Request, options: dict[str, Any], service: State, on_piece: PieceListener
) -> Frame | _SentFrames:
    settings, files = service.settings, dict[str, bytearray]()

    def keep(field_name: str, _filename: str, chunk: bytes) -> None:
        files.setdefault(field_name, bytearray()).extend(chunk)

    fields = await read_multipart(request, settings.max_request_bytes, MOST_FRAMES + 1, keep, on_piece)
    text = bytes(files.get("request", b"")) or fields.get("request", "").encode()
    numbered = {int(match[1]): name for name in files if (match := _NUMBERED_IMAGE.fullmatch(name))}
    parts = files.keys() | fields.keys()
    if numbered and "image" not in parts:
        _refuse_unknown(parts - _PARTS - set(numbered.values()))
        query = await _frames_query(text, service)
        return query, {number: bytes(files[name]) for number, name in numbered.items()}
    _refuse_unknown(parts - _PARTS)
    if "image" not in files:
        raise InvalidRequest("The multipart body has no file 'image'.", _PARTS_HINT)
    JsonLimits.of_options(settings.max_json_bytes).check(text)
    parsed = LocalizeOptions.model_validate_json(text) if text else LocalizeOptions.model_validate(options)
    image = bytes(files["image"])
    return Frame(parsed, image=image, effort=await run_in_threadpool(effort_of, image))


def _refuse_unknown(parts: set[str]) -> None:
    if parts:
        raise InvalidRequest(f"The multipart body has a part '{min(parts)}'.", _PARTS_HINT)
