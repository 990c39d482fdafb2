"""Coordinates of national grids and heights above the sea as places on the ellipsoid of WGS 84, by ``pyproj``."""

from __future__ import annotations

import re
import warnings

import numpy as np

from rholoc.errors import InvalidInput, NotInstalled
from rholoc.geometry.arrays import FloatArray
from rholoc.geometry.earth import EarthPlace

_CODE = re.compile(r"EPSG:\d{4,6}(\+\d{4,6})?", re.IGNORECASE)
_CODE_HINT = "Give a grid's EPSG code, and after a plus sign that of heights above the sea: EPSG:25833+7837."
_ORDER_HINT = "Check the code, and the order: easting, northing, height."
_ROUNDS = 3  # each gains five digits of the height


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
        for _ in range(0 if system.is_compound else _ROUNDS):  # z becomes the height above the system's own ellipsoid
            z = z + coordinates[:, 2] - found[2]
            found = ways.transformers[0].transform(x, y, z, errcheck=True)
    except ProjError as error:
        raise InvalidInput(f"A point is outside {crs}.", _ORDER_HINT) from error
    return [EarthPlace(latitude, longitude, height) for longitude, latitude, height in np.transpose(found).tolist()]
