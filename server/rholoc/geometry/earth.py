"""Places on Earth: a local east–north–up frame, latitude and longitude (WGS 84), and national grids."""

import math
import re
import warnings
from dataclasses import dataclass

import numpy as np

from rholoc.errors import InvalidInput, NotInstalled
from rholoc.geometry.arrays import FloatArray

_A_M = 6_378_137.0
_FLATTENING = 1 / 298.257223563
_E2 = _FLATTENING * (2 - _FLATTENING)
_ROUNDS = 6  # of the iteration for the latitude: each gains two digits and more
_CODE_HINT = "Give a grid's EPSG code, and after a plus sign that of heights above the sea: EPSG:25833+7837."
_ORDER_HINT = "Check the code, and the order: easting, northing, height."
_HEIGHT_ROUNDS = 3  # each gains five digits of the height


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
    """Place at ``enu`` (3,) metres east, north and up in the tangent frame of ``origin``; inverse of :func:`enu_of`."""
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


_CODE = re.compile(r"EPSG:\d{4,6}(\+\d{4,6})?", re.IGNORECASE)


def places_in(crs: str, coordinates: FloatArray) -> list[EarthPlace]:
    """Places on Earth by their coordinates in a reference system.

    The conversion is the most accurate that PROJ knows there. If it needs a file that is absent, it fails.

    Args:
        crs: EPSG code of the system, ``EPSG:25833``: heights are metres above the ellipsoid of WGS 84. With a vertical
            system, ``EPSG:25833+7837``, they are heights of that, in its unit.
        coordinates: (N, 3) easting, northing (in a geographic system longitude, latitude) and height.

    Raises:
        NotInstalled: ``pyproj`` is absent.
        InvalidInput: there is no such system, the points are outside it, or a file of PROJ is absent.
    """
    try:
        from pyproj import CRS, Transformer
        from pyproj.exceptions import CRSError, ProjError
        from pyproj.transformer import AreaOfInterest, TransformerGroup
    except ImportError as error:
        raise NotInstalled("Coordinates of national grids need pyproj.", "pip install 'rholoc[grids]'.") from error
    try:
        system = CRS.from_user_input(crs.upper() if _CODE.fullmatch(crs) else "")
        flat = system.sub_crs_list[0] if system.is_compound else system
        if not flat.is_projected and not flat.is_geographic:
            raise CRSError("neither a grid nor a geographic system")
    except CRSError as error:
        raise InvalidInput(f"'{crs[:40]}' is no grid that PROJ knows.", _CODE_HINT) from error
    x, y, z = coordinates.T
    try:
        east, north = Transformer.from_crs(flat, "EPSG:4326", always_xy=True).transform(x[0], y[0], errcheck=True)
        there = AreaOfInterest(east, north, east, north)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of files that are absent, which is an error below
            ways = TransformerGroup(system.to_3d(), "EPSG:4979", True, there, allow_ballpark=False)
        if not ways.best_available:
            absent = next(one.short_name for one in ways.unavailable_operations[0].grids if not one.available)
            hint = f"pyproj sync --file {absent} fetches it; with PROJ_NETWORK=ON PROJ does so itself."
            raise InvalidInput(f"{crs} needs PROJ's file {absent}, which is not on this machine.", hint)
        if not ways.transformers:
            raise InvalidInput(f"PROJ knows no way from {crs} at {north:.2f}, {east:.2f} to WGS 84.", _ORDER_HINT)
        found = ways.transformers[0].transform(x, y, z, errcheck=True)
        for _ in range(
            0 if system.is_compound else _HEIGHT_ROUNDS
        ):  # z becomes the height above the system's own ellipsoid
            z = z + coordinates[:, 2] - found[2]
            found = ways.transformers[0].transform(x, y, z, errcheck=True)
    except ProjError as error:
        raise InvalidInput(f"A point is outside {crs}.", _ORDER_HINT) from error
    return [EarthPlace(latitude, longitude, height) for longitude, latitude, height in np.transpose(found).tolist()]
