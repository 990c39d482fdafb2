"""A camera's pose on Earth as OGC GeoPose 1.0."""

import time
from enum import StrEnum

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from rholoc.geometry import R_FORWARD_OPTICAL, FloatArray
from rholoc.maps import SiteOnEarth
from rholoc.service.http.models import AnswerModel


class GeoPoseKind(StrEnum):
    """Encoding of a GeoPose."""

    QUATERNION = "quaternion"  # Basic-Quaternion
    YPR = "ypr"  # Basic-YPR
    ADVANCED = "advanced"


class GeoPosition(AnswerModel):
    """A place, WGS 84."""

    lat: float = Field(description="degrees north")
    lon: float = Field(description="degrees east")
    h: float = Field(description="m above the ellipsoid")


class GeoQuaternion(AnswerModel):
    """A rotation from the camera's body (x forward, y left, z up) to east, north and up at its place."""

    x: float
    y: float
    z: float
    w: float


class GeoAngles(AnswerModel):
    """The rotation of a GeoQuaternion as angles in degrees: about z, the new y, then the new x; 0, 0, 0 looks east."""

    yaw: float = Field(description="counter-clockwise from east")
    pitch: float = Field(description="downwards")
    roll: float


class GeoFrame(AnswerModel):
    """The frame that an advanced GeoPose's rotation refers to: east, north and up at the camera."""

    authority: str = "/geopose/1.0"
    id: str = "LTP-ENU"
    parameters: str = Field(description="longitude=…&latitude=…&height=…")


class GeoPoseQuaternionOut(AnswerModel):
    """GeoPose, Basic-Quaternion."""

    position: GeoPosition
    quaternion: GeoQuaternion


class GeoPoseYprOut(AnswerModel):
    """GeoPose, Basic-YPR."""

    position: GeoPosition
    angles: GeoAngles


class GeoPoseAdvancedOut(AnswerModel):
    """GeoPose, Advanced."""

    frameSpecification: GeoFrame
    quaternion: GeoQuaternion
    validTime: int = Field(description="when it was answered, ms since 1970")


GeoPoseOut = GeoPoseQuaternionOut | GeoPoseYprOut | GeoPoseAdvancedOut


def geopose_of(T_frame_camera: FloatArray, earth: SiteOnEarth, kind: GeoPoseKind) -> GeoPoseOut:
    """GeoPose of a camera (4, 4) in a frame whose pose on Earth is known.

    The rotation is that of the body, x forward, y left, z up, relative to east, north and up at the camera itself.
    """
    place = earth.place(T_frame_camera[:3, 3])
    R_frame_body = T_frame_camera[:3, :3] @ R_FORWARD_OPTICAL.T
    rotation = Rotation.from_matrix(earth.R_enu_of(R_frame_body, place))
    position = GeoPosition(lat=place.latitude_deg, lon=place.longitude_deg, h=place.height_m)
    if kind is GeoPoseKind.YPR:
        yaw, pitch, roll = (float(angle) for angle in np.asarray(rotation.as_euler("ZYX", degrees=True)))
        return GeoPoseYprOut(position=position, angles=GeoAngles(yaw=yaw, pitch=pitch, roll=roll))
    x, y, z, w = rotation.as_quat(canonical=True).tolist()
    quaternion = GeoQuaternion(x=x, y=y, z=z, w=w)
    if kind is GeoPoseKind.QUATERNION:
        return GeoPoseQuaternionOut(position=position, quaternion=quaternion)
    parameters = f"longitude={position.lon:.9f}&latitude={position.lat:.9f}&height={position.h:.4f}"
    frame = GeoFrame(parameters=parameters)
    return GeoPoseAdvancedOut(frameSpecification=frame, quaternion=quaternion, validTime=round(1000 * time.time()))
