"""Frame → pose."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, replace
from typing import Annotated, Any

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
    TooLarge,
    UnknownCamera,
    UnknownMap,
)
from rholoc.recordings.frames.image import IMAGE_START_BYTES, begins_like_an_image
from rholoc.service.access import NEEDS_LOCALIZE
from rholoc.service.bodies import PieceListener, media_type, read_body, read_multipart
from rholoc.service.errors import InvalidRequest, UnsupportedMediaType
from rholoc.service.json_bodies import JsonLimits
from rholoc.service.localize import Stopwatch, frame_deadline_s, late_answer, localize_frame
from rholoc.service.localizers import Localizers
from rholoc.service.openapi import BINARY, failures, reference, request_body
from rholoc.service.queries import Frame, effort_of, effort_of_set
from rholoc.service.schemas import DescriptorQuery, LocalizationOut, LocalizeOptions
from rholoc.service.settings import Settings
from rholoc.service.state import Service, State

router = APIRouter(prefix="/v1", tags=["localization"])

_FAILURES = failures(
    UnknownMap, UnknownCamera, InvalidName, InvalidRequest, InvalidImage, InvalidCamera, InvalidDescriptors,
    InvalidInput, InvalidMap, TooLarge, UnsupportedMediaType, Busy, DeadlineExceeded,
)  # fmt: skip
_BODY = request_body(
    {
        "image/jpeg": {"schema": BINARY},
        "image/png": {"schema": BINARY},
        "multipart/form-data": {
            "schema": {
                "type": "object",
                "required": ["image"],
                "properties": {"image": BINARY, "request": reference(LocalizeOptions)},
            },
            "encoding": {
                "image": {"contentType": "image/jpeg, image/png"},
                "request": {"contentType": "application/json"},
            },
        },
        "application/json": {
            "schema": reference(DescriptorQuery),
            "example": DescriptorQuery.model_config["json_schema_extra"]["example"],  # type: ignore[index]
        },
    }
)

_LOADING_GRACE_S = 0.5  # for a map that was not in memory, beyond the deadline
_PARTS = frozenset({"image", "request"})  # of a multipart body


@dataclass(frozen=True)
class OptionParameters:
    """The options of a request as query parameters; lists are separated by commas."""

    camera: Annotated[
        str | None, Query(description="a stored camera, instead of fx … distortion", examples=["pixel-7"])
    ] = None
    fx: Annotated[float | None, Query(description="focal length, px", examples=[525.5])] = None
    fy: Annotated[float | None, Query(description="px; default: fx", examples=[525.5])] = None
    cx: Annotated[float | None, Query(description="principal point, px", examples=[320.0])] = None
    cy: Annotated[float | None, Query(description="principal point, px", examples=[240.0])] = None
    distortion: Annotated[str | None, Query(description="k1,k2,p1,p2[,k3[,k4,k5,k6]]", examples=["0.02,-0.05,0,0"])] = (
        None
    )
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


@router.post(
    "/maps/{map_name}/localize",
    dependencies=[NEEDS_LOCALIZE],
    summary="Where a frame was taken, in one map",
    responses=_FAILURES,
    openapi_extra=_BODY,
)
async def localize_in_map(map_name: str, request: Request, service: Service, options: Options) -> LocalizationOut:
    """Send a JPEG or PNG as it is, with options in the query; or multipart, with an `image` and a JSON `request`; or a
    descriptor set as JSON. "No pose" is an answer: `localized` is false and `reason` says why."""
    return await _localize([map_name], request, service, options)


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
    maps: Annotated[str, Query(description="names separated by commas, or 'all'", examples=["all", "hall,kitchen"])],
) -> LocalizationOut:
    """Asks every map and gives the surest answer, with the map's name."""
    names = list(dict.fromkeys(name.strip() for name in maps.split(",")))
    every = names == ["all"]
    if every:
        names = await run_in_threadpool(service.library.readable)
        if not names:
            raise UnknownMap("There is no map yet.", "Upload one, or a recording.")
    return await _localize(names, request, service, options, every)


async def _localize(
    names: list[str], request: Request, service: State, options: OptionParameters, every: bool = False
) -> LocalizationOut:
    clock = Stopwatch()
    with service.held_bodies.hold() as look:
        frame = await _frame(request, options.options(), service, look)
        return await _localize_frame(frame, names, service, clock, every)


async def _localize_frame(
    frame: Frame, names: list[str], service: State, clock: Stopwatch, every: bool
) -> LocalizationOut:
    if frame.options.camera.name is not None:
        profile = await run_in_threadpool(service.cameras.get, frame.options.camera.name)
        frame = replace(frame, stored=profile.camera)
    for name in [] if every else names:
        service.library.stat(name)  # an unknown map is refused before it takes a place in the queue
    deadline_s = frame_deadline_s(frame, service.settings)
    try:
        async with asyncio.timeout(deadline_s - clock.elapsed_s):
            answer = await service.compute.run(
                lambda: localize_frame(frame, names, service.localizers, service.settings, clock, every), frame.effort
            )
    except (TimeoutError, DeadlineExceeded):
        answer = await _late_answer(names[0], service.localizers, clock)
    service.metrics.localization(answer.reason)
    return answer


async def _late_answer(name: str, localizers: Localizers, clock: Stopwatch) -> LocalizationOut:
    """The answer at the deadline, while a thread is still at work on the frame, or none has begun."""
    try:
        async with asyncio.timeout(_LOADING_GRACE_S):
            return late_answer(name, await run_in_threadpool(localizers.get, name), clock)
    except TimeoutError:
        raise DeadlineExceeded("The deadline passed while the map was being loaded.", "Try again.") from None


async def _frame(request: Request, options: dict[str, Any], service: State, look: PieceListener) -> Frame:
    settings = service.settings
    kind, max_bytes = media_type(request), settings.max_request_bytes
    if kind.startswith("image/"):  # what it really is, its bytes tell
        image = await read_body(request, max_bytes, _refusing_others(look))
        effort = await run_in_threadpool(effort_of, image)
        return Frame(LocalizeOptions.model_validate(options), image=image, effort=effort)
    if kind == "application/json":
        measured = JsonLimits.of_features(max_bytes, settings.max_features).measured(look)
        body = await read_body(request, max_bytes, measured)
        effort = effort_of_set(body)
        service.compute.check_room(effort)
        query = await run_in_threadpool(DescriptorQuery.model_validate_json, body)
        return Frame(query, features=query.features, effort=effort)
    if kind == "multipart/form-data":
        return await _multipart_frame(request, options, settings, look)
    raise UnsupportedMediaType(
        f"A body of type '{kind}' cannot be read.",
        "Send image/jpeg, image/png, multipart/form-data or application/json as Content-Type.",
    )


def _refusing_others(look: PieceListener) -> PieceListener:
    """Refuses a picture by its first bytes, before the others come; shows ``look`` each piece too.

    Raises:
        InvalidImage: by the call: it is none.
    """
    start = b""

    def listen(piece: bytes) -> None:
        nonlocal start
        if len(start) < IMAGE_START_BYTES:
            start += piece[:IMAGE_START_BYTES]
            if len(start) >= IMAGE_START_BYTES and not begins_like_an_image(start):
                raise InvalidImage("This is not an image that can be read.", "Send a whole JPEG, PNG or WebP file.")
        look(piece)

    return listen


async def _multipart_frame(request: Request, options: dict[str, Any], settings: Settings, look: PieceListener) -> Frame:
    files: dict[str, bytearray] = {}

    def keep(field_name: str, _filename: str, chunk: bytes) -> None:
        files.setdefault(field_name, bytearray()).extend(chunk)

    fields = await read_multipart(request, settings.max_request_bytes, len(_PARTS), keep, look)
    strange = (files.keys() | fields.keys()) - _PARTS
    if strange or "image" not in files:
        raise InvalidRequest(
            f"The multipart body has a part '{min(strange)}'."
            if strange
            else "The multipart body has no file 'image'.",
            "Send a file part 'image' and, if you like, a JSON part 'request'.",
        )
    text = bytes(files.get("request", b"")) or fields.get("request", "").encode()
    JsonLimits.of_options(settings.max_json_bytes).check(text)
    parsed = LocalizeOptions.model_validate_json(text) if text else LocalizeOptions.model_validate(options)
    image = bytes(files["image"])
    return Frame(parsed, image=image, effort=await run_in_threadpool(effort_of, image))
