"""``camera.json``: intrinsics and mounting of the recording device."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rholoc.errors import InvalidCamera
from rholoc.geometry import Camera, FloatArray, Lens, is_rotation
from rholoc.recordings.tables.csv_table import read_json, shortened

_MAX_BYTES = 2**20
_MAX_READOUT_S = 0.2
_INTRINSICS = ("width", "height", "fx", "fy", "cx", "cy")
_MODELS = ("model", "camera_model", "distortion_model")  # where other programs name the lens, and phones themselves …
_WIDE_MODELS = ("fisheye", "equidistant", "kannala", "equirectangular", "spherical", "omni")  # … parts of lenses' names


@dataclass(frozen=True, eq=False)
class CameraFile:
    """The content of ``camera.json``; every part of it is optional.

    Attributes:
        camera: the intrinsics, or None.
        fps: frames a second, for image folders without a table of times, or None.
        R_camera_imu: (3, 3), or None.
        gravity_included: whether gravity's reaction is part of the IMU's acceleration.
        readout_s: how long a rolling shutter takes from the top row of a frame to the bottom row, in seconds, or None.
    """

    camera: Camera | None = None
    fps: float | None = None
    R_camera_imu: FloatArray | None = None
    gravity_included: bool = True
    readout_s: float | None = None


def read_camera_json(path: Path) -> CameraFile:
    """Read ``camera.json``.

    Raises:
        InvalidCamera: missing, not JSON, over 1 MiB, a part of the intrinsics is missing, or a value is impossible.
    """
    values = read_json(path, InvalidCamera, _MAX_BYTES)
    if not isinstance(values, dict):
        raise InvalidCamera(f"{path.name} does not hold a JSON object.", _hint())
    gravity_included = values.get("gravity_included", True)
    if not isinstance(gravity_included, bool):
        raise InvalidCamera(f"{path.name}: gravity_included is neither true nor false.")
    rotation, readout_s = _rotation(values, path), _readout_s(values, path)
    return CameraFile(_camera(values, path), _fps(values, path), rotation, gravity_included, readout_s)


def write_camera_json(path: Path, description: CameraFile) -> None:
    """Write ``camera.json``, the inverse of :func:`read_camera_json`."""
    values: dict[str, Any] = {"gravity_included": description.gravity_included}
    if description.camera is not None:
        values |= description.camera.to_dict()
    if description.fps is not None:
        values["fps"] = description.fps
    if description.R_camera_imu is not None:
        values["R_camera_imu"] = description.R_camera_imu.tolist()
    if description.readout_s is not None:
        values["readout_s"] = description.readout_s
    path.write_text(json.dumps(values, indent=2) + "\n", encoding="utf-8")


def _hint() -> str:
    """Hint for people: the members of the intrinsics."""
    return f"The intrinsics are {', '.join(_INTRINSICS)} and distortion (a list), all numbers, and lens (a name)."


def _camera(values: dict[str, Any], path: Path) -> Camera | None:
    """The intrinsics, None without fx, fy, cx and cy (unless a panorama). Raises InvalidCamera, naming ``path``."""
    _refuse_other_models(values, path)
    given = [name for name in _INTRINSICS if values.get(name) is not None]
    is_panorama = values.get("lens") == Lens.EQUIRECTANGULAR
    if not is_panorama and not {"fx", "fy", "cx", "cy"} & set(given):
        return None
    needed = _INTRINSICS[:2] if is_panorama else _INTRINSICS
    if not set(needed) <= set(given):
        missing = ", ".join(name for name in needed if name not in given)
        raise InvalidCamera(f"{path.name} has no {missing}.", _hint())
    try:
        return Camera.from_dict(values)
    except InvalidCamera:
        raise
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidCamera(
            f"{path.name}: a part of the intrinsics is not a number, or there is no such lens.", _hint()
        ) from error


def _refuse_other_models(values: dict[str, Any], path: Path) -> None:
    """Raise InvalidCamera if a lens other than a pinhole is named as other programs do, and ``lens`` is missing."""
    for name in _MODELS:
        model = values.get(name)
        if isinstance(model, str) and not values.get("lens") and any(one in model.lower() for one in _WIDE_MODELS):
            lenses = ", ".join(lens.value for lens in Lens)
            raise InvalidCamera(
                f"{path.name}: {name} is {shortened(repr(model))}, which is not read.", f"Give its lens: {lenses}."
            )


def _fps(values: dict[str, Any], path: Path) -> float | None:
    """Frames a second; None if not given. Raises InvalidCamera, naming ``path``."""
    fps = values.get("fps")
    if fps is None:
        return None
    if isinstance(fps, bool) or not isinstance(fps, int | float) or not 0 < fps < 10_000:
        raise InvalidCamera(f"{path.name}: {shortened(repr(fps))} is not a number of frames a second.")
    return float(fps)


def _readout_s(values: dict[str, Any], path: Path) -> float | None:
    """Read-out time [s], up to 0.2; None if it is 0 or not given. Raises InvalidCamera, naming ``path``."""
    readout_s = values.get("readout_s")
    if readout_s is None:
        return None
    if isinstance(readout_s, bool) or not isinstance(readout_s, int | float) or not 0 <= readout_s <= _MAX_READOUT_S:
        given = shortened(repr(readout_s))
        raise InvalidCamera(f"{path.name}: a read-out time of {given} s is not possible.", "Leave it out if unknown.")
    return float(readout_s) or None


def _rotation(values: dict[str, Any], path: Path) -> FloatArray | None:
    """R_camera_imu (3, 3); None if not given. Raises InvalidCamera, naming ``path``."""
    rows = values.get("R_camera_imu")
    if rows is None:
        return None
    try:
        R = np.array(rows, dtype=np.float64)
    except (TypeError, ValueError):
        R = np.zeros(0)
    if not is_rotation(R):
        raise InvalidCamera(f"{path.name}: R_camera_imu is not a 3×3 rotation matrix.", "Leave it out if unknown.")
    return R
