"""A request's body and query → a frame, or several."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Depends, Query, Request
from starlette.concurrency import run_in_threadpool

from rholoc.errors import InvalidImage
from rholoc.localization import MOST_FRAMES
from rholoc.recordings.frames.image import IMAGE_START_BYTES, begins_like_an_image
from rholoc.service.errors import InvalidRequest, UnsupportedMediaType
from rholoc.service.frames.queries import Frame, effort_of, effort_of_set
from rholoc.service.frames.requests import DescriptorQuery, FramesQuery, LocalizeOptions
from rholoc.service.http.bodies import PieceListener, media_type, read_body, read_multipart
from rholoc.service.http.json_bodies import JsonLimits
from rholoc.service.settings import Settings
from rholoc.service.state import State
from rholoc.service.threads.compute import Effort

READ_BY_HAND = (LocalizeOptions, DescriptorQuery, FramesQuery)
"""The models of bodies that are not parsed by the framework."""

_PARTS = frozenset({"image", "request"})  # of a multipart body
_PARTS_HINT = "Send a file part 'image' and, if you like, a JSON part 'request'."
_NUMBERED_IMAGE = re.compile(r"image(\d{1,2})")  # a part of one with several frames
_FRAMES_MEMBER = re.compile(rb'"frames"\s*:')  # in a JSON body with several frames
_START_BYTES = 2048  # of a JSON body, within which that member begins

SentFrames = tuple[FramesQuery, dict[int, bytes]]  # the query, and the pictures sent beside it, by number


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


async def read_frame(
    request: Request, options: OptionParameters, service: State, on_piece: PieceListener, refusal: str
) -> Frame:
    """One picture or descriptor set; several frames are refused with the message ``refusal``."""
    frame = await read_frames(request, options.options(), service, on_piece)
    if not isinstance(frame, Frame):
        raise InvalidRequest(refusal, "Send one picture.")
    return frame


async def read_frames(
    request: Request, options: dict[str, Any], service: State, on_piece: PieceListener
) -> Frame | SentFrames:
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
) -> Frame | SentFrames:
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
