"""Exports of 3D Scanner App (iPhone, "All data").

::

    frame_00000.jpg     the picture, on its side as ARKit has it
    frame_00000.json    intrinsics (3×3, row by row), cameraPoseARFrame (4×4, row by row), time [s]
    depth_00000.png     LiDAR depth [mm], 16 bit
    conf_00000.png      confidence of each depth: 0, 1, 2

``cameraPoseARFrame`` is ARKit's: T_world_camera of a camera that looks along −z with y up, world y up, in metres. The
focal length changes from picture to picture. Frames without a picture are left out.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from rholoc.errors import InvalidCamera, InvalidRecording, InvalidTrajectory
from rholoc.geometry import Camera, FloatArray, is_rotation
from rholoc.recordings.frames.depth import MILLIMETRE_M
from rholoc.recordings.frames.image_decoding import image_size
from rholoc.recordings.readers._apple import opencv_camera, z_up
from rholoc.recordings.readers._frames import depth_images, timed_images
from rholoc.recordings.recording import GivenPoses, PoseKind, Recording, RecordingFormat
from rholoc.recordings.tables.csv_table import read_json

TABLES = ("frame_*.json", "depth_*.png", "conf_*.png", "info.json")
_ROTATION_TOLERANCE = 1e-3


def recognises(folder: Path) -> bool:
    """Whether there is a picture whose JSON file has this app's pose."""
    pictures = sorted(folder.glob("frame_*.jpg"))
    return bool(pictures) and _has_pose(pictures[0].with_suffix(".json"))


def read(folder: Path) -> Recording:
    """Read the folder.

    Raises:
        InvalidRecording: a picture or its JSON file is broken or missing, or times go back.
        InvalidCamera: intrinsics are broken.
        InvalidTrajectory: a pose is broken.
    """
    pictures = sorted(folder.glob("frame_*.jpg"))
    described = [_described(picture) for picture in pictures]
    times = np.array([_time_s(values, picture) for values, picture in zip(described, pictures, strict=True)])
    cameras = [_camera(values, picture) for values, picture in zip(described, pictures, strict=True)]
    timed = timed_images(pictures, times, cameras)
    T_world_camera = np.array([_pose(described[row], pictures[row]) for row in timed.rows])
    depths: list[Path | None] = [_beside(pictures[row], "depth", ".png") for row in timed.rows]
    return Recording(
        name=folder.resolve().name,
        path=folder,
        frames=timed.frames,
        camera=timed.camera,
        poses=GivenPoses(
            np.ones(len(timed.rows), dtype=np.bool_), z_up(opencv_camera(T_world_camera)), kind=PoseKind.ODOMETRY
        ),
        format=RecordingFormat.SCANNER_APP,
        depth=depth_images(depths, MILLIMETRE_M, camera=_depth_camera(timed.camera, depths, cameras[0])),
        warnings=timed.warnings,
    )


def _beside(picture: Path, kind: str, suffix: str) -> Path:
    return picture.with_name(picture.stem.replace("frame", kind, 1) + suffix)


def _has_pose(path: Path) -> bool:
    try:
        values = read_json(path) if path.is_file() else None
    except InvalidRecording:
        return False
    return isinstance(values, dict) and "cameraPoseARFrame" in values


def _described(picture: Path) -> dict[str, Any]:
    path = picture.with_suffix(".json")
    values = read_json(path) if path.is_file() else None
    if not isinstance(values, dict):
        raise InvalidRecording(f"{picture.name} has no {path.name} beside it.", "Export all data again.")
    return values


def _numbers(values: dict[str, Any], name: str, shape: tuple[int, int]) -> FloatArray | None:
    try:
        found = np.array(values.get(name), dtype=np.float64).reshape(shape)
    except (TypeError, ValueError):
        return None
    return found if np.isfinite(found).all() else None


def _time_s(values: dict[str, Any], picture: Path) -> float:
    time = values.get("time")
    if isinstance(time, bool) or not isinstance(time, int | float) or not np.isfinite(time):
        raise InvalidRecording(f"{picture.stem}.json has no time.", "Export all data again.")
    return float(time)


def _camera(values: dict[str, Any], picture: Path) -> Camera:
    K = _numbers(values, "intrinsics", (3, 3))
    if K is None:
        raise InvalidCamera(f"The intrinsics in {picture.stem}.json are not 3×3 numbers.")
    return Camera(*image_size(picture), K[0, 0], K[1, 1], K[0, 2], K[1, 2])


def _pose(values: dict[str, Any], picture: Path) -> FloatArray:
    T = _numbers(values, "cameraPoseARFrame", (4, 4))
    if T is None or not is_rotation(T[:3, :3], _ROTATION_TOLERANCE):
        raise InvalidTrajectory(f"cameraPoseARFrame in {picture.stem}.json is not a pose.")
    return T


def _depth_camera(common: Camera | None, depths: list[Path | None], first: Camera) -> Camera | None:
    """Intrinsics of the depth images: the pictures' own, at their size."""
    path = next((path for path in depths if path is not None and path.is_file()), None)
    return None if path is None or common is None else first.resized(*image_size(path))
