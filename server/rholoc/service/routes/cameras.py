"""Named cameras: intrinsics that requests refer to by name."""

from typing import Any

from fastapi import APIRouter, Response
from pydantic import Field

from rholoc.errors import InvalidCamera, InvalidInput, InvalidName, RholocError, StorageFull, UnknownCamera
from rholoc.geometry import Camera, Lens
from rholoc.library.cameras import CameraProfile
from rholoc.service.access.scopes import NEEDS_MAP, NEEDS_READ
from rholoc.service.http.models import AnswerModel, Number, RequestModel, SizePx
from rholoc.service.http.openapi import declared
from rholoc.service.state import Service


class CameraProfileIn(RequestModel):
    """A camera to store: its intrinsics, and how accurate they are."""

    width: SizePx
    height: SizePx
    fx: Number
    fy: Number
    cx: Number
    cy: Number
    distortion: list[Number] = Field(default_factory=list, max_length=8)
    lens: Lens = Field(default=Lens.PINHOLE, description="how the camera projects")
    calibration: dict[str, Any] = Field(
        default_factory=dict, description="how it was calibrated: rms_px, sigmas, views, …"
    )


class CameraProfileOut(CameraProfileIn):
    """A stored camera."""

    name: str


class CameraList(AnswerModel):
    """All stored cameras, by name; files that cannot be read are listed separately."""

    cameras: list[CameraProfileOut]
    unreadable: dict[str, str] = Field(description="names of camera files that cannot be read, and why")


router = APIRouter(prefix="/v1/cameras", tags=["cameras"])


@router.get("", **declared(NEEDS_READ, "All cameras"))
async def list_cameras(service: Service) -> CameraList:
    """The stored cameras by name; files that cannot be read are listed separately."""
    found: list[CameraProfileOut] = []
    unreadable: dict[str, str] = {}
    for name in await service.cameras.names():
        try:
            found.append(_out(name, await service.cameras.get(name)))
        except UnknownCamera:
            continue  # deleted meanwhile
        except RholocError as error:
            unreadable[name] = error.message
    return CameraList(cameras=found, unreadable=unreadable)


@router.get("/{camera}", **declared(NEEDS_READ, "One camera", UnknownCamera, InvalidName, InvalidCamera))
async def get_camera(camera: str, service: Service) -> CameraProfileOut:
    """The camera's intrinsics, and how accurate they are."""
    return _out(camera, await service.cameras.get(camera))


@router.put(
    "/{camera}",
    **declared(
        NEEDS_MAP,
        "Store a camera",
        InvalidName,
        InvalidCamera,
        InvalidInput,
        StorageFull,
        also={201: {"model": CameraProfileOut, "description": "The camera is new."}},
    ),
)
async def put_camera(camera: str, given: CameraProfileIn, service: Service, response: Response) -> CameraProfileOut:
    """Stores a camera under the name, replacing any of that name. Requests that name it use it from then on; maps keep
    the camera that they were made with.
    """
    new = camera not in await service.cameras.names()
    profile = CameraProfile(Camera.from_dict(given.model_dump(exclude={"calibration"})), given.calibration)
    await service.cameras.put(camera, profile)
    response.status_code = 201 if new else 200
    return _out(camera, profile)


@router.delete("/{camera}", status_code=204, **declared(NEEDS_MAP, "Delete a camera", UnknownCamera, InvalidName))
async def delete_camera(camera: str, service: Service) -> None:
    """Deletes the camera for good; maps that were made with it keep it."""
    await service.cameras.delete(camera)


def _out(name: str, profile: CameraProfile) -> CameraProfileOut:
    return CameraProfileOut(name=name, calibration=profile.calibration, **profile.camera.to_dict())
