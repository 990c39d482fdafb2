"""A map's description as JSON."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from typing import Any

import numpy as np

from rholoc.errors import InvalidInput, InvalidMap
from rholoc.geometry import Camera
from rholoc.maps.map import DensityKind, MapInfo

_TYPES: dict[str, type] = {
    "id": str,
    "version": int,
    "features": str,
    "metric": bool,
    "upright": bool,
    "created": str,
    "sources": list,
    "waypoints": list,
    "report": dict,
}


def info_to_json(info: MapInfo) -> str:
    """The description as JSON text; NumPy's numbers become Python's, numbers that are not finite become null."""
    return json.dumps(_plain(asdict(info)), ensure_ascii=False, allow_nan=False, separators=(",", ":"), sort_keys=True)


def info_from_json(text: str) -> MapInfo:
    """The description that :func:`info_to_json` wrote; members that are not known are left out.

    Raises:
        InvalidMap: not JSON, a member is missing or of another type, or the camera is absurd.
    """
    try:
        values = json.loads(text)
        wrong = [name for name, kind in _TYPES.items() if type(values[name]) is not kind]
        if wrong:
            raise InvalidMap(f"The map's description is broken: {', '.join(wrong)}.")
        members = {name: values[name] for name in _TYPES}
        members["sources"], members["waypoints"] = tuple(values["sources"]), tuple(values["waypoints"])
        return MapInfo(density=DensityKind(values["density"]), camera=_camera(values["camera"]), **members)
    except KeyError as error:
        raise InvalidMap(f"The map's description has no {error}.") from error
    except (ValueError, TypeError, AttributeError, InvalidInput, RecursionError) as error:
        raise InvalidMap(f"The map's description is broken: {error}.") from error


def _camera(values: dict[str, Any]) -> Camera:
    return Camera(**values | {"distortion": tuple(values["distortion"])})


def _plain(value: Any) -> Any:
    match value:
        case dict():
            return {str(key): _plain(item) for key, item in value.items()}
        case list() | tuple():
            return [_plain(item) for item in value]
        case np.ndarray():
            return _plain(value.tolist())
        case np.generic():
            return _plain(value.item())
        case float() if not math.isfinite(value):
            return None
        case _:
            return value
