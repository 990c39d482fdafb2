"""Places on Earth: a local east–north–up frame, and latitude and longitude, on the ellipsoid of WGS 84."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rholoc.geometry.arrays import FloatArray

_A_M = 6_378_137.0
_FLATTENING = 1 / 298.257223563
_E2 = _FLATTENING * (2 - _FLATTENING)
_ROUNDS = 6  # of the iteration for the latitude: each gains two digits and more


@dataclass(frozen=True)
class EarthPlace:
    """A place on Earth.

    Attributes:
        latitude_deg: north of the equator.
        longitude_deg: east of Greenwich, -180 to 180.
        height_m: above the ellipsoid.
    """

    latitude_deg: float
    longitude_deg: float
    height_m: float = 0.0


def enu_of(place: EarthPlace, origin: EarthPlace) -> FloatArray:
    """Metres (3,) east, north and up of ``place`` from ``origin``, in the origin's tangent frame."""
    return np.asarray(_R_ecef_enu(origin).T @ (_ecef(place) - _ecef(origin)))


def place_at(enu: FloatArray, origin: EarthPlace) -> EarthPlace:
    """The place that lies so many metres (3,) to the east, to the north and up of an origin."""
    x, y, z = _ecef(origin) + _R_ecef_enu(origin) @ enu
    across = math.hypot(x, y)
    latitude = math.atan2(z, across * (1 - _E2))
    height = 0.0
    for _ in range(_ROUNDS):
        normal = _normal_m(latitude)
        height = across * math.cos(latitude) + (z + _E2 * normal * math.sin(latitude)) * math.sin(latitude) - normal
        latitude = math.atan2(z + _E2 * normal * math.sin(latitude), across)
    return EarthPlace(math.degrees(latitude), math.degrees(math.atan2(y, x)), height)


def R_enu_enu(place: EarthPlace, origin: EarthPlace) -> FloatArray:
    """Rotation (3, 3) from east, north, up at ``origin`` to those at ``place``: they differ by Earth's curvature."""
    return np.asarray(_R_ecef_enu(place).T @ _R_ecef_enu(origin))


def _normal_m(latitude: float) -> float:
    """Length [m] of the ellipsoid's normal at a latitude [rad] down to its axis."""
    return _A_M / math.sqrt(1 - _E2 * math.sin(latitude) ** 2)


def _ecef(place: EarthPlace) -> FloatArray:
    """Position (3,) [m] in the Earth-centred, Earth-fixed frame."""
    latitude, longitude = math.radians(place.latitude_deg), math.radians(place.longitude_deg)
    normal = _normal_m(latitude)
    across = (normal + place.height_m) * math.cos(latitude)
    up = (normal * (1 - _E2) + place.height_m) * math.sin(latitude)
    return np.array([across * math.cos(longitude), across * math.sin(longitude), up])


def _R_ecef_enu(origin: EarthPlace) -> FloatArray:
    """Rotation (3, 3) whose columns are east, north and up in the Earth-centred frame."""
    latitude, longitude = math.radians(origin.latitude_deg), math.radians(origin.longitude_deg)
    sin_lat, cos_lat, sin_lon, cos_lon = (
        math.sin(latitude),
        math.cos(latitude),
        math.sin(longitude),
        math.cos(longitude),
    )
    return np.array(
        [
            [-sin_lon, -sin_lat * cos_lon, cos_lat * cos_lon],
            [cos_lon, -sin_lat * sin_lon, cos_lat * sin_lon],
            [0.0, cos_lat, sin_lat],
        ]
    )
