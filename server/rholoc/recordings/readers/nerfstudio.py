"""nerfstudio's ``transforms.json``, also written by Instant NGP and several scanning apps.

::

    transforms.json   camera_model, fl_x, fl_y, cx, cy, w, h, k1, k2, p1, p2
                      frames: [{"file_path": "images/frame_00001.png", "transform_matrix": 4×4}]

``transform_matrix`` is T_world_camera of a camera that looks along −z with y up; pixel (0.5, 0.5) is the centre of the
top-left one. Each frame may have its own intrinsics instead. The unit of length is not stated.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from rholoc.errors import InvalidCamera, InvalidRecording, InvalidTrajectory
from rholoc.geometry import Camera, FloatArray, is_rotation
from rholoc.recordings.readers._apple import opencv_camera
from rholoc.recordings.readers._frames import listed_file, untimed_images
from rholoc.recordings.readers.colmap import SCALE_WARNING
from rholoc.recordings.recording import GivenPoses, Recording, RecordingFormat
from rholoc.recordings.tables.csv_table import read_json
from rholoc.reports import RecordingWarning, WarningKind

_FILE = "transforms.json"
_PINHOLE = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE")
_ROTATION_TOLERANCE = 1e-2
_LARGEST = 1e9
_INTRINSICS = ("fl_x", "fl_y", "cx", "cy")


def recognises(folder: Path) -> bool:
    """Whether there is a ``transforms.json``."""
    return (folder / _FILE).is_file()


def read(folder: Path) -> Recording:
    """Read the folder.

    Raises:
        InvalidRecording: ``transforms.json`` or an image is broken.
        InvalidCamera: the intrinsics are broken.
        InvalidTrajectory: a pose is not a 4×4 matrix with a rotation in it.
    """
    values = _read_json(folder / _FILE)
    listed = values["frames"]
    paths = [_image(folder, frame) for frame in listed]
    timed = untimed_images(paths)
    chosen = [listed[row] for row in timed.rows]
    T_map_camera = opencv_camera(np.array([_pose(frame) for frame in chosen]))
    camera, warnings = _camera({**chosen[0], **values}, timed.frames.size)
    per_frame = np.array([[_number(frame, name) for name in _INTRINSICS] for frame in chosen]) - [0, 0, 0.5, 0.5]
    return Recording(
        name=folder.resolve().name,
        path=folder,
        frames=timed.frames,
        camera=camera,
        poses=GivenPoses(np.ones(len(chosen), dtype=np.bool_), T_map_camera, metric=False),
        format=RecordingFormat.NERFSTUDIO,
        frame_intrinsics=per_frame if np.isfinite(per_frame).any() else None,
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
    try:
        T = np.array(frame.get("transform_matrix"), dtype=np.float64)
    except (TypeError, ValueError):
        T = np.zeros(0)
    if T.shape != (4, 4) or not np.isfinite(T).all() or not is_rotation(T[:3, :3], _ROTATION_TOLERANCE):
        raise InvalidTrajectory(f"{_FILE}: the transform_matrix of {frame['file_path']} is not a pose.")
    return T


def _number(values: dict[str, Any], name: str) -> float:
    """A number, NaN where there is none.

    Raises:
        InvalidCamera: it is something else, or far too large.
    """
    if name not in values:
        return math.nan
    value = values[name]
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < _LARGEST:
        raise InvalidCamera(f"{_FILE}: {name} is not a number that a camera can have.")
    return float(value)


def _camera(values: dict[str, Any], size: tuple[int, int]) -> tuple[Camera | None, tuple[RecordingWarning, ...]]:
    model = str(values.get("camera_model", "OPENCV")).upper()
    if model not in _PINHOLE:
        text = f"The camera's model is {model}, which is not supported: its intrinsics are ignored."
        return None, (RecordingWarning(WarningKind.CAMERA_UNSUPPORTED, text),)
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
        _distortion(values),
    )
    return camera.fitted(*size), ()


def _distortion(values: dict[str, Any]) -> tuple[float, ...]:
    k1, k2, p1, p2, k3 = (_number({name: 0.0} | values, name) for name in ("k1", "k2", "p1", "p2", "k3"))
    if k3:
        return k1, k2, p1, p2, k3
    return (k1, k2, p1, p2) if any((k1, k2, p1, p2)) else ()
