"""A request's body and query → a frame, or several."""

import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import asdict, dataclass, replace
from typing import Annotated, Any

from fastapi import Depends, Query, Request
from starlette.concurrency import run_in_threadpool

from rholoc.localization import MAX_FRAMES
from rholoc.recordings.frames.image_decoding import IMAGE_START_BYTES, begins_like_an_image, not_an_image
from rholoc.service.errors import InvalidRequest, UnsupportedMediaType
from rholoc.service.frames.queries import Frame, effort_of, effort_of_set
from rholoc.service.frames.request_models import DescriptorQuery, FramesQuery, LocalizeOptions
from rholoc.service.frames.several_frames import Frames
from rholoc.service.http.bodies import PieceListener, media_type, read_body, read_multipart
from rholoc.service.http.json_bodies import JsonLimits
from rholoc.service.settings import Settings
from rholoc.service.state import State
from rholoc.service.threads.compute import Effort

READ_BY_HAND = (LocalizeOptions, DescriptorQuery, FramesQuery)
"""The models of bodies that are not parsed by the framework."""

_PARTS_HINT = "Send a file part 'image' and, if you like, a JSON part 'request'."
_FRAMES_HINT = "Send a JSON part 'request', and pictures as file parts 'image0', 'image1', …"
_LISTS = ("distortion", "prior_position", "prior_heading", "prior_quaternion_xyzw", "gravity")  # of numbers
_OF_CAMERA = ("fx", "fy", "cx", "cy", "distortion", "lens")
_NUMBERED_IMAGE = re.compile(r"image(\d{1,2})")  # a part of one with several frames


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

    geopose: Annotated[
        str | None,
        Query(description="quaternion, ypr or advanced: the answer has a GeoPose", examples=["quaternion"]),
    ] = None

    def options(self) -> dict[str, Any]:
        """The given options as fields of :class:`LocalizeOptions`. Raises InvalidRequest for a list not of numbers."""
        given = {name: value for name, value in asdict(self).items() if value is not None}
        given |= {name: _numbers(name, given[name]) for name in _LISTS if name in given}
        camera = {name: given.pop(name) for name in _OF_CAMERA if name in given}
        if "camera" in given:
            camera["name"] = given.pop("camera")
        prior = {name.removeprefix("prior_"): given.pop(name) for name in [*given] if name.startswith("prior_")}
        if given.get("dof", "").isdecimal():
            given["dof"] = int(given["dof"])
        return {**given, **({"camera": camera} if camera else {}), **({"prior": prior} if prior else {})}


def _numbers(name: str, text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError as error:
        raise InvalidRequest(f"{name} is not a list of numbers.", "Separate the numbers by commas.") from error


Options = Annotated[OptionParameters, Depends()]


@asynccontextmanager
async def read_frame(request: Request, options: OptionParameters, service: State) -> AsyncIterator[Frame]:
    """Yield the picture or descriptor set of a request, with its options; its memory is counted until the end of the
    block.

    Raises:
        InvalidRequest, ValidationError, UnsupportedMediaType, TooLarge, InvalidImage, Busy: the body is not a frame, or
            there is no room.
        UnknownCamera, InvalidCamera: the request names a stored camera that there is not, or that is damaged.
    """
    settings, kind = service.settings, media_type(request)
    max_bytes = settings.max_request_bytes
    with service.held_bodies.hold() as on_piece:
        if kind.startswith("image/"):  # which format it really is, its bytes say
            image = await read_body(request, max_bytes, _image_listener(on_piece))
            frame = Frame(LocalizeOptions.model_validate(options.options()), image=image)
        elif kind == "application/json":
            limits = JsonLimits.of_features(max_bytes, settings.max_features)
            body = await read_body(request, max_bytes, limits.measured(on_piece))
            effort = effort_of_set(body)
            service.frames.compute.check_room(effort)
            query = await run_in_threadpool(DescriptorQuery.model_validate_json, body)
            frame = Frame(query, features=query.features, effort=effort)
        elif kind == "multipart/form-data":
            text, files = await _read_parts(request, settings, on_piece)
            if files.keys() != {"image"}:
                raise InvalidRequest("The multipart body is not a file 'image' and a 'request'.", _PARTS_HINT)
            JsonLimits.of_options(settings.max_json_bytes).check(text)
            given = LocalizeOptions.model_validate_json(text) if text else None
            frame = Frame(given or LocalizeOptions.model_validate(options.options()), image=files["image"])
        else:
            raise _unsupported(kind)
        if frame.image is not None:
            frame = replace(frame, effort=await run_in_threadpool(effort_of, frame.image))
        named = frame.options.camera.name
        yield frame if named is None else replace(frame, stored=(await service.cameras.get(named)).camera)


@asynccontextmanager
async def read_frames(request: Request, service: State) -> AsyncIterator[Frames]:
    """Yield the frames of a request, sent as JSON or multipart. Raises InvalidRequest, ValidationError,
    UnsupportedMediaType, TooLarge, InvalidImage, Busy, UnknownCamera, InvalidCamera.
    """
    settings, kind = service.settings, media_type(request)
    limits = JsonLimits.of_features(settings.max_request_bytes, MAX_FRAMES * settings.max_features)
    images: dict[int, bytes] = {}
    with service.held_bodies.hold() as on_piece:
        if kind == "application/json":
            text = await read_body(request, settings.max_request_bytes, limits.measured(on_piece))
        elif kind == "multipart/form-data":
            text, files = await _read_parts(request, settings, on_piece)
            limits.check(text)
            for name, content in files.items():
                if (number := _NUMBERED_IMAGE.fullmatch(name)) is None:
                    raise InvalidRequest(f"The multipart body has a part '{name}'.", _FRAMES_HINT)
                images[int(number[1])] = content
        else:
            raise _unsupported(kind)
        service.frames.compute.check_room(Effort.LARGE)
        query = await run_in_threadpool(FramesQuery.model_validate_json, text)
        chosen = [query.camera, *(one.camera for one in query.frames if one.camera is not None)]
        named = {camera.name for camera in chosen if camera.name is not None}
        stored = {name: (await service.cameras.get(name)).camera for name in named}
        yield await run_in_threadpool(Frames.of, query, images, stored)


async def _read_parts(request: Request, settings: Settings, on_piece: PieceListener) -> tuple[bytes, dict[str, bytes]]:
    """The part ``request`` of a multipart body (empty if missing), and its other files. Raises InvalidRequest."""
    files: dict[str, bytearray] = {}

    def keep(field_name: str, _filename: str, chunk: bytes) -> None:
        files.setdefault(field_name, bytearray()).extend(chunk)

    fields = await read_multipart(request, settings.max_request_bytes, MAX_FRAMES + 1, keep, on_piece)
    text = bytes(files.pop("request", b"")) or fields.pop("request", "").encode()
    if fields:
        raise InvalidRequest(f"The multipart body has a part '{min(fields)}'.", _PARTS_HINT)
    return text, {name: bytes(content) for name, content in files.items()}


def _unsupported(kind: str) -> UnsupportedMediaType:
    return UnsupportedMediaType(
        f"A body of type '{kind}' cannot be read.",
        "Send a picture (image/jpeg, image/png), multipart/form-data or application/json, as the route takes it.",
    )


def _image_listener(on_piece: PieceListener) -> PieceListener:
    """A listener that refuses, by its first bytes, a body that is not an image, and passes the pieces to ``on_piece``.
    Raises InvalidImage: from the listener.
    """
    start = b""

    def listen(piece: bytes) -> None:
        nonlocal start
        if len(start) < IMAGE_START_BYTES:
            start += piece[:IMAGE_START_BYTES]
            if len(start) >= IMAGE_START_BYTES and not begins_like_an_image(start):
                raise not_an_image()
        on_piece(piece)

    return listen
