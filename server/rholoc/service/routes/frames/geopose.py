"""OSCP's GeoPoseProtocol, versions 1 and 2: a picture → a GeoPose."""

import base64
import binascii
import re
from typing import Any

import cv2
import numpy as np
from fastapi import APIRouter, Request, Response
from fastapi.responses import JSONResponse
from pydantic import ConfigDict, Field, model_validator
from starlette.concurrency import run_in_threadpool

from rholoc.errors import (
    Busy,
    DeadlineExceeded,
    InvalidCamera,
    InvalidImage,
    InvalidInput,
    InvalidMap,
    NotFound,
    UnknownMap,
)
from rholoc.geometry import Camera
from rholoc.recordings import camera_of_model
from rholoc.recordings.frames.image_decoding import begins_like_an_image
from rholoc.service.access.scopes import NEEDS_LOCALIZE, OPEN
from rholoc.service.errors import InvalidRequest
from rholoc.service.frames.geoposes import GeoPoseKind, GeoPoseQuaternionOut
from rholoc.service.frames.queries import Frame, effort_of
from rholoc.service.frames.request_models import CameraChoice, LocalizeOptions
from rholoc.service.http.bodies import read_body
from rholoc.service.http.json_bodies import JsonLimits
from rholoc.service.http.models import AnswerModel, RequestModel
from rholoc.service.http.openapi import declared, reference, request_body
from rholoc.service.http.stopwatch import Stopwatch
from rholoc.service.routes.frames.which_maps import Requested
from rholoc.service.state import Service

router = APIRouter(prefix="/geopose", tags=["localization"])

MEDIA_TYPE = "application/vnd.oscp+json"
_VERSION = re.compile(r"version=([0-9.]+)")
_HINT = "Send GeoPoseProtocol 1 or 2, with one picture as base64."
_RAW = {"RGBA32": (4, cv2.COLOR_RGBA2BGR), "RGB24": (3, cv2.COLOR_RGB2BGR), "GRAY8": (1, cv2.COLOR_GRAY2BGR)}


class _OscpModel(RequestModel):
    """Base of the protocol's models: members that are of no use here are ignored."""

    model_config = ConfigDict(extra="ignore", frozen=True)


class OscpCameraParams(_OscpModel):
    """A camera's intrinsics."""

    model: str = Field(default="UNKNOWN_CAMERA", description="by COLMAP's names: PINHOLE, OPENCV, …")
    modelParams: list[float] = Field(default_factory=list, max_length=12)


class OscpCameraReading(_OscpModel):
    """A picture."""

    sensorId: str = ""
    imageFormat: str = Field(default="", description="of raw pixels: RGBA32, RGB24 or GRAY8; a file says it itself")
    size: list[int] = Field(default_factory=list, max_length=2, description="width, height in pixels")
    imageBytes: str = Field(description="a JPEG, PNG or WebP file, or raw pixels, as base64")
    params: OscpCameraParams | None = None


class OscpSensorReadings(_OscpModel):
    """Readings by kind; the newest picture is used."""

    cameraReadings: list[OscpCameraReading] = Field(min_length=1, max_length=10)


class OscpRequest(_OscpModel):
    """A request of GeoPoseProtocol 2; one of version 1 is converted."""

    id: str = Field(max_length=200)
    timestamp: int = Field(description="ms since 1970")
    type: str = "geopose"
    sensorReadings: OscpSensorReadings

    @model_validator(mode="before")
    @classmethod
    def _of_version_1(cls, values: Any) -> Any:
        """A request of version 1 (a list of {sensorId, reading}; intrinsics are the sensor's) as one of version 2;
        others unchanged.
        """
        if not isinstance(values, dict) or not isinstance(values.get("sensorReadings"), list):
            return values
        sensors = {one.get("id"): one for one in values.get("sensors") or () if isinstance(one, dict)}
        readings = []
        for one in values["sensorReadings"]:
            reading = one.get("reading") if isinstance(one, dict) else None
            if isinstance(reading, dict) and "imageBytes" in reading:
                params = sensors.get(one.get("sensorId"), {}).get("params")
                readings.append({"params": params, **reading})
        return {**values, "sensorReadings": {"cameraReadings": readings}}


class OscpAccuracy(AnswerModel):
    """One sigma of a pose, the mean over the axes."""

    position: float = Field(description="m")
    orientation: float = Field(description="degrees")


class OscpAnswer(AnswerModel):
    """The answer of GeoPoseProtocol 1 and 2. The rotation is that of the body: x forward, y left, z up."""

    id: str = Field(description="the request's")
    timestamp: int = Field(description="the request's, ms since 1970")
    accuracy: OscpAccuracy
    type: str = "geopose"
    geopose: GeoPoseQuaternionOut


class _OscpResponse(JSONResponse):
    media_type = MEDIA_TYPE


class OscpStatus(AnswerModel):
    """The service runs."""

    status: str = "running"


@router.get("", **declared(OPEN, "Whether OSCP's GeoPoseProtocol is served"))
async def geopose_status() -> OscpStatus:
    """Always 200 while the process runs."""
    return OscpStatus()


@router.post(
    "",
    openapi_extra=request_body(
        {kind: {"schema": reference(OscpRequest)} for kind in ("application/json", MEDIA_TYPE)}
    ),
    **declared(
        NEEDS_LOCALIZE, "Where a picture was taken, by OSCP's GeoPoseProtocol", NotFound, UnknownMap, InvalidImage,
        InvalidCamera, InvalidInput, InvalidMap, Busy, DeadlineExceeded,
    ),
    response_model=OscpAnswer,
    response_class=_OscpResponse,
)  # fmt: skip
async def find_geopose(request: Request, service: Service, requested: Requested) -> Response:
    """Versions 1 and 2 are told apart by the body. The maps are chosen as for `/v1/localize`; only those with a place
    on Earth, their own or their site's, can answer. A picture without a pose is 404, which the protocol leaves open."""
    clock = Stopwatch()
    version = _accepted(request)
    settings = service.settings
    maps = await requested.choice(service)
    with service.held_bodies.hold() as on_piece:
        limits = JsonLimits.of_options(settings.max_request_bytes * 4 // 3)  # base64
        body = await read_body(request, limits.length, limits.measured(on_piece))
        wanted = await run_in_threadpool(OscpRequest.model_validate_json, body)
        frame = await run_in_threadpool(_frame, wanted)
        answer = await service.frames.localize(frame, maps, clock)
    if not answer.localized:
        why = answer.diagnosis.message if answer.diagnosis else "The picture was not recognized."
        raise NotFound(why, answer.diagnosis.hint if answer.diagnosis else "Send another picture.")
    if not isinstance(answer.geopose, GeoPoseQuaternionOut) or answer.covariance is None:
        raise NotFound(f"The map {answer.map} has no place on Earth.", "Give it one: POST …/corrections, kind earth.")
    sigmas = np.sqrt(np.diag(answer.covariance))
    said = OscpAnswer(
        id=wanted.id,
        timestamp=wanted.timestamp,
        accuracy=OscpAccuracy(position=float(sigmas[:3].mean()), orientation=float(sigmas[3:].mean())),
        geopose=answer.geopose,
    )
    return Response(said.model_dump_json(), media_type=f"{MEDIA_TYPE};version={version}")


def _accepted(request: Request) -> str:
    """The protocol's version that the client accepts, by its header: "1", "2", "1.0" or "2.0"; "2.0" if it says
    nothing. Raises InvalidRequest for another version.
    """
    asked = _VERSION.search(request.headers.get("accept", ""))
    version = "2.0" if asked is None else asked[1]
    if version not in ("1.0", "2.0", "1", "2"):
        raise InvalidRequest(f"GeoPoseProtocol {version[:10]} is not served.", f"Accept {MEDIA_TYPE};version=2.0.")
    return version


def _frame(wanted: OscpRequest) -> Frame:
    """The frame to localize: the last picture, encoded as PNG if it is raw, with its intrinsics, or none for the map's.

    Raises:
        InvalidImage: the picture is not base64, or raw pixels of an unknown format or another size.
        InvalidCamera: its intrinsics are impossible, incomplete, without a size, or of an unsupported model.
    """
    reading = wanted.sensorReadings.cameraReadings[-1]
    try:
        image = base64.b64decode(reading.imageBytes, validate=True)
    except (binascii.Error, ValueError) as error:
        raise InvalidImage("The picture's imageBytes are not base64.", _HINT) from error
    if not begins_like_an_image(image):
        image = _encoded(image, reading)
    options = LocalizeOptions(camera=_camera(reading), geopose=GeoPoseKind.QUATERNION)
    return Frame(options, image=image, effort=effort_of(image))


def _encoded(pixels: bytes, reading: OscpCameraReading) -> bytes:
    """Raw pixels as a PNG. Raises InvalidImage for an unknown format or a wrong length."""
    channels, conversion = _RAW.get(reading.imageFormat.upper(), (0, 0))
    width, height = reading.size if len(reading.size) == 2 else (0, 0)
    if not channels or min(width, height) < 1 or len(pixels) != width * height * channels:
        text = f"The picture is neither a file nor {reading.imageFormat[:20] or 'raw'} pixels of its size."
        raise InvalidImage(text, _HINT)
    shape = (height, width, channels) if channels > 1 else (height, width)
    raw = np.frombuffer(pixels, dtype=np.uint8).reshape(shape)
    return cv2.imencode(".png", cv2.cvtColor(raw, conversion), [cv2.IMWRITE_PNG_COMPRESSION, 0])[1].tobytes()


def _camera(reading: OscpCameraReading) -> CameraChoice:
    """The reading's intrinsics; empty, which stands for the map's, if it has none. Raises InvalidCamera."""
    params = reading.params
    if params is None or params.model == "UNKNOWN_CAMERA" or not params.modelParams:
        return CameraChoice()
    if len(reading.size) != 2:
        raise InvalidCamera("The picture's size is missing.", "Send size: [width, height], which intrinsics belong to.")
    try:
        camera: Camera | None = camera_of_model(params.model, (reading.size[0], reading.size[1]), params.modelParams)
    except IndexError as error:
        raise InvalidCamera(f"{params.model[:40]} has too few modelParams.", "Send them as COLMAP has them.") from error
    if camera is None:
        raise InvalidCamera(f"The camera model {params.model[:40]} is not supported.", "Use PINHOLE or OPENCV.")
    return CameraChoice.model_validate(camera.to_dict())
