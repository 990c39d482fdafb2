"""Named cameras: intrinsics that requests refer to by name."""

from __future__ import annotations

from fastapi import APIRouter, Response

from rholoc.errors import InvalidCamera, InvalidInput, InvalidName, RholocError, StorageFull, UnknownCamera
from rholoc.geometry import Camera
from rholoc.maps import CameraLibrary, CameraProfile
from rholoc.service.access.scopes import NEEDS_MAP, NEEDS_READ
from rholoc.service.errors import InvalidRequest
from rholoc.service.http.openapi import failures
from rholoc.service.schemas import CameraList, CameraProfileIn, CameraProfileOut
from rholoc.service.state import Service

router = APIRouter(prefix="/v1/cameras", tags=["cameras"])


@router.get("", dependencies=[NEEDS_READ], summary="All cameras")
async def list_cameras(service: Service) -> CameraList:
    """The stored cameras by name; files that cannot be read are listed separately."""
    return await service.threads.database(_list, service.cameras)


@router.get(
    "/{camera}",
    dependencies=[NEEDS_READ],
    summary="One camera",
    responses=failures(UnknownCamera, InvalidName, InvalidCamera, InvalidRequest),
)
async def get_camera(camera: str, service: Service) -> CameraProfileOut:
    """Its intrinsics, and how accurate they are."""
    return await service.threads.database(_profile, service.cameras, camera)


@router.put(
    "/{camera}",
    dependencies=[NEEDS_MAP],
    summary="Store a camera",
    responses={
        **failures(InvalidName, InvalidCamera, InvalidInput, InvalidRequest, StorageFull),
        201: {"model": CameraProfileOut, "description": "The camera is new."},
    },
)
async def put_camera(camera: str, given: CameraProfileIn, service: Service, response: Response) -> CameraProfileOut:
    """Requests that name it use it from then on; maps keep the camera that they were made with."""
    new = camera not in await service.threads.database(service.cameras.names)
    profile = CameraProfile(Camera.from_dict(given.model_dump(exclude={"calibration"})), given.calibration)
    await service.threads.database(service.cameras.put, camera, profile)
    response.status_code = 201 if new else 200
    return _out(camera, profile)


@router.delete(
    "/{camera}",
    dependencies=[NEEDS_MAP],
    status_code=204,
    summary="Delete a camera",
    responses=failures(UnknownCamera, InvalidName),
)
async def delete_camera(camera: str, service: Service) -> None:
    """For good; maps that were made with it keep it."""
    await service.threads.database(service.cameras.delete, camera)


def _list(cameras: CameraLibrary) -> CameraList:
    found: list[CameraProfileOut] = []
    unreadable: dict[str, str] = {}
    for name in cameras.names():
        try:
            found.append(_profile(cameras, name))
        except UnknownCamera:
            continue  # deleted meanwhile
        except RholocError as error:
            unreadable[name] = error.message
    return CameraList(cameras=found, unreadable=unreadable)


def _profile(cameras: CameraLibrary, name: str) -> CameraProfileOut:
    return _out(name, cameras.get(name))


def _out(name: str, profile: CameraProfile) -> CameraProfileOut:
    return CameraProfileOut(name=name, calibration=profile.calibration, **profile.camera.to_dict())
