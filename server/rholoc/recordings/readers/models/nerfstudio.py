"""nerfstudio's ``transforms.json``, also written by Instant NGP and several scanning apps.

::

    transforms.json   camera_model, fl_x, fl_y, cx, cy, w, h, k1, k2, p1, p2, k3, of OPENCV_FISHEYE k1, k2, k3, k4
                      frames: [{"file_path": "images/frame_00001.png", "transform_matrix": 4×4}]

``transform_matrix`` is T_world_camera of a camera that looks along −z with y up; pixel (0.5, 0.5) is the centre of the
top-left one. Each frame may have its own intrinsics instead. ``applied_transform`` (3×4), which turned the original
world into this one, is undone. The unit of length is not stated.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np

from rholoc.errors import InvalidCamera, InvalidImage, InvalidRecording, InvalidTrajectory
from rholoc.geometry import Camera, FloatArray, Lens, is_rotation
from rholoc.recordings.readers._apple import opencv_camera
from rholoc.recordings.readers._camera_models import lens_of_model, unsupported
from rholoc.recordings.readers._frames import listed_file, untimed_images
from rholoc.recordings.readers._orientation import as_shown, stored_size
from rholoc.recordings.readers.models.colmap import SCALE_WARNING
from rholoc.recordings.recording import GivenPoses, Recording
from rholoc.recordings.tables.csv_table import read_json
from rholoc.reports import RecordingWarning

TABLES = ("transforms.json",)
_FILE = "transforms.json"
_LENSES = {"PERSPECTIVE": Lens.PINHOLE}  # names that only nerfstudio has
_COEFFICIENTS = {Lens.PINHOLE: ("k1", "k2", "p1", "p2", "k3"), Lens.FISHEYE: ("k1", "k2", "k3", "k4")}
_ROTATION_TOLERANCE = 1e-2
_LARGEST = 1e9


def recognises(folder: Path) -> bool:
    """Whether there is a ``transforms.json``."""
    return (folder / _FILE).is_file()


def read(folder: Path) -> Recording:
    """Read a recording of this format from its folder: poses of unknown scale, ``applied_transform`` undone.

    The camera is None, with a warning, if its model is not supported.

    Raises:
        InvalidRecording: ``transforms.json`` is broken, or an image is broken or missing.
        InvalidCamera: the intrinsics are broken.
        InvalidTrajectory: a pose is not a 4×4 matrix with a rotation in it.
    """
    values = _read_json(folder / _FILE)
    listed = values["frames"]
    paths = [_image(folder, frame) for frame in listed]
    cameras, warnings = _cameras(values, listed, paths)
    cameras, T_stored_shown = as_shown(paths, cameras)
    timed = untimed_images(paths, cameras)
    T_world_stored = opencv_camera(np.array([_pose(frame) for frame in listed]))
    T_map_camera = np.linalg.inv(_applied_transform(values)) @ T_world_stored @ T_stored_shown
    return Recording(
        timed.frames,
        camera=timed.camera,
        poses=GivenPoses(np.ones(len(paths), dtype=np.bool_), T_map_camera[timed.rows], metric=False),
        warnings=(*timed.warnings, SCALE_WARNING, *warnings),
    )


def _read_json(path: Path) -> dict[str, Any]:
    values = read_json(path)
    frames = values.get("frames") if isinstance(values, dict) else None
    if not isinstance(frames, list) or not frames or not all(isinstance(frame, dict) for frame in frames):
        raise InvalidRecording(f"{path.name} lists no frames.", "It needs 'frames', each with its transform_matrix.")
    return dict(values)


def _image(folder: Path, frame: dict[str, Any]) -> Path:
    name = frame.get("file_path")
    if not isinstance(name, str):
        raise InvalidRecording(f"{_FILE}: a frame has no file_path.")
    path = listed_file(folder, name)
    endings = (path.with_name(path.name + ending) for ending in (".png", ".jpg"))
    return path if path.suffix else next((ended for ended in endings if ended.is_file()), path)


def _pose(frame: dict[str, Any]) -> FloatArray:
    """The frame's transform (4, 4), in Nerfstudio's axes. Raises InvalidTrajectory."""
    try:
        T = np.array(frame.get("transform_matrix"), dtype=np.float64)
    except (TypeError, ValueError):
        T = np.zeros(0)
    if T.shape != (4, 4) or not np.isfinite(T).all() or not is_rotation(T[:3, :3], _ROTATION_TOLERANCE):
        raise InvalidTrajectory(f"{_FILE}: the transform_matrix of {frame['file_path']} is not a pose.")
    return T


def _applied_transform(values: dict[str, Any]) -> FloatArray:
    """Transform (4, 4) applied to the original world; the identity if none is stated. Raises InvalidTrajectory."""
    try:
        given = np.array(values.get("applied_transform", np.eye(4)[:3]), dtype=np.float64)
    except (TypeError, ValueError):
        given = np.zeros(0)
    is_transform = given.shape in ((3, 4), (4, 4)) and np.isfinite(given).all()
    if not is_transform or not is_rotation(given[:3, :3], _ROTATION_TOLERANCE):
        raise InvalidTrajectory(f"{_FILE}: applied_transform is not a pose.", "Leave it out, or give 3×4 numbers.")
    return np.vstack([given[:3], [0, 0, 0, 1]])


def _cameras(
    values: dict[str, Any], frames: list[dict[str, Any]], paths: list[Path]
) -> tuple[list[Camera] | None, tuple[RecordingWarning, ...]]:
    """Camera of each frame; None, with warnings, if one is unknown or of an unsupported model. Raises InvalidCamera."""
    cameras = []
    for frame, path in zip(frames, paths, strict=True):
        camera, warnings = _camera({**values, **frame}, _size(path))
        if camera is None:
            return None, warnings
        cameras.append(camera)
    return cameras, ()


def _size(path: Path) -> tuple[int, int]:
    try:
        return stored_size(path)
    except (InvalidImage, OSError) as error:
        raise InvalidRecording(f"The image {path.name} is missing or broken.", "Leave it out of the list.") from error


def _number(values: dict[str, Any], name: str) -> float:
    """The member ``name`` as a float; NaN if missing. Raises InvalidCamera if it is not a number, or its absolute value
    is 1e9 or more.
    """
    if name not in values:
        return math.nan
    value = values[name]
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < _LARGEST:
        raise InvalidCamera(f"{_FILE}: {name} is not a number that a camera can have.")
    return float(value)


def _camera(values: dict[str, Any], size: tuple[int, int]) -> tuple[Camera | None, tuple[RecordingWarning, ...]]:
    model = str(values.get("camera_model", "OPENCV_FISHEYE" if values.get("is_fisheye") else "OPENCV")).upper()
    lens = _LENSES.get(model) or lens_of_model(model)
    if lens is None:
        return None, (unsupported(model),)
    if lens is Lens.EQUIRECTANGULAR:
        return Camera.panorama(*size), ()
    width, height = (_number(values, name) for name in ("w", "h"))
    width, height = (width, height) if width > 0 and height > 0 else size
    fx, angle = _number(values, "fl_x"), _number(values, "camera_angle_x")
    if not math.isfinite(fx) and 0 < angle < math.pi:
        fx = width / (2 * math.tan(angle / 2))
    if not math.isfinite(fx):
        return None, ()
    fy, cx, cy = (_number(values, name) for name in ("fl_y", "cx", "cy"))
    camera = Camera(
        int(width),
        int(height),
        fx,
        fy if math.isfinite(fy) else fx,
        (cx if math.isfinite(cx) else width / 2) - 0.5,
        (cy if math.isfinite(cy) else height / 2) - 0.5,
        _distortion(values, lens),
        lens,
    )
    return camera, ()


def _distortion(values: dict[str, Any], lens: Lens) -> tuple[float, ...]:
    found = tuple(_number({name: 0.0} | values, name) for name in _COEFFICIENTS[lens])
    if lens is Lens.PINHOLE and not found[4]:
        found = found[:4]
    return found if any(found) else ()
