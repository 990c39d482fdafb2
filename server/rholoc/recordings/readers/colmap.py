"""A COLMAP model as text, beside its images.

::

    images/                    or the folder itself
    sparse/0/cameras.txt       CAMERA_ID MODEL WIDTH HEIGHT PARAMS…       or sparse/, or the folder itself
    sparse/0/images.txt        IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then a line of points

Poses are of the world in the camera; pixel (0.5, 0.5) is the centre of the top-left one. The unit of length is not
stated.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rholoc.errors import InvalidCamera, InvalidRecording
from rholoc.geometry import Camera, FloatArray
from rholoc.recordings.readers._frames import listed_file, untimed_images
from rholoc.recordings.recording import GivenPoses, Recording, RecordingFormat
from rholoc.recordings.tables.csv_table import read_text
from rholoc.recordings.tables.pose_table import poses_from_rows
from rholoc.reports import RecordingWarning, WarningKind

SCALE_WARNING = RecordingWarning(
    WarningKind.SCALE_UNKNOWN, "The poses' unit of length is not stated: a map from them is not metric."
)

# Places of fx, fy, cx, cy among a model's parameters, and of k1, k2, p1, p2, …; None stands for zero.
_MODELS: dict[str, tuple[tuple[int, ...], tuple[int | None, ...]]] = {
    "SIMPLE_PINHOLE": ((0, 0, 1, 2), ()),
    "PINHOLE": ((0, 1, 2, 3), ()),
    "SIMPLE_RADIAL": ((0, 0, 1, 2), (3, None, None, None)),
    "RADIAL": ((0, 0, 1, 2), (3, 4, None, None)),
    "OPENCV": ((0, 1, 2, 3), (4, 5, 6, 7)),
    "FULL_OPENCV": ((0, 1, 2, 3), (4, 5, 6, 7, 8, 9, 10, 11)),
}


@dataclass(frozen=True, eq=False)
class _Image:
    """A line of images.txt: tx ty tz qx qy qz qw of the world in the camera."""

    name: str
    camera: str
    pose: list[float]


def recognises(folder: Path) -> bool:
    """Whether there is a model as text."""
    return _model(folder) is not None


def read(folder: Path) -> Recording:
    """Read the folder; images that the model does not place are ignored.

    Raises:
        InvalidRecording: the model or an image is broken.
        InvalidCamera: the most used camera is broken.
        InvalidTrajectory: a pose is broken.
    """
    model = _model(folder)
    assert model is not None
    images = _read_images(model / "images.txt")
    cameras = _read_cameras(model / "cameras.txt")
    source = folder / "images" if (folder / "images").is_dir() else folder
    paths = [listed_file(source, image.name) for image in images]
    timed = untimed_images(paths)
    placed = [images[row] for row in timed.rows]
    T_camera_map = poses_from_rows(np.array([image.pose for image in placed]), "images.txt")
    used = [image.camera for image in placed]
    camera, warnings = _camera(cameras, max(set(used), key=used.count), timed.frames.size)
    return Recording(
        name=folder.resolve().name,
        path=folder,
        frames=timed.frames,
        camera=camera,
        poses=GivenPoses(np.ones(len(placed), dtype=np.bool_), np.linalg.inv(T_camera_map), metric=False),
        format=RecordingFormat.COLMAP,
        frame_intrinsics=_per_frame(cameras, used),
        warnings=(*timed.warnings, SCALE_WARNING, *warnings),
    )


def _model(folder: Path) -> Path | None:
    for place in (folder / "sparse" / "0", folder / "sparse", folder):
        if (place / "cameras.txt").is_file() and (place / "images.txt").is_file():
            return place
    return None


def _read_images(path: Path) -> list[_Image]:
    lines = [line for line in read_text(path).splitlines() if not line.startswith("#")]
    images = []
    for line in lines[::2]:  # every other line lists points, and may be empty
        parts = line.split(maxsplit=9)
        if not parts:
            continue
        try:
            qw, qx, qy, qz, tx, ty, tz = (float(part) for part in parts[1:8])
            images.append(_Image(parts[9].strip(), parts[8], [tx, ty, tz, qx, qy, qz, qw]))
        except (ValueError, IndexError) as error:
            raise InvalidRecording(f"{path.name}: '{line[:60]}' is not a valid image line.") from error
    if not images:
        raise InvalidRecording(f"{path.name} lists no images.")
    return images


def _read_cameras(path: Path) -> dict[str, list[str]]:
    """The fields after the identifier, by identifier."""
    rows = (line.split() for line in read_text(path).splitlines() if line.strip() and not line.startswith("#"))
    return {row[0]: row[1:] for row in rows}


def _intrinsics(fields: list[str]) -> tuple[tuple[int, int], list[float], tuple[float, ...]] | None:
    """Size, fx, fy, cx, cy and distortion of a camera's fields; None where the model is not supported.

    Raises:
        InvalidCamera: the fields are broken.
    """
    try:
        model, width, height = fields[0], int(fields[1]), int(fields[2])
        values = [float(field) for field in fields[3:]]
        if model not in _MODELS:
            return None
        pinhole, distortion = _MODELS[model]
        fx, fy, cx, cy = (values[place] for place in pinhole)
        coefficients = tuple(0.0 if place is None else values[place] for place in distortion)
    except (ValueError, IndexError) as error:
        raise InvalidCamera(f"cameras.txt: '{' '.join(fields)[:60]}' is not a camera.") from error
    return (width, height), [fx, fy, cx - 0.5, cy - 0.5], coefficients


def _camera(
    cameras: dict[str, list[str]], used: str, size: tuple[int, int]
) -> tuple[Camera | None, tuple[RecordingWarning, ...]]:
    if used not in cameras:
        raise InvalidCamera(f"cameras.txt has no camera {used}, which images.txt uses.")
    found = _intrinsics(cameras[used])
    if found is None:
        text = f"The camera's model is {cameras[used][0]}, which is not supported: its intrinsics are ignored."
        return None, (RecordingWarning(WarningKind.CAMERA_UNSUPPORTED, text),)
    (width, height), (fx, fy, cx, cy), distortion = found
    return Camera(width, height, fx, fy, cx, cy, distortion).fitted(*size), ()


def _per_frame(cameras: dict[str, list[str]], used: list[str]) -> FloatArray | None:
    """fx, fy, cx, cy of each frame where the model has several cameras, else None."""
    if len(set(used)) == 1:
        return None
    known = {camera: _intrinsics(cameras[camera]) for camera in set(used) if camera in cameras}
    rows = [known.get(camera) for camera in used]
    return np.array([[np.nan] * 4 if row is None else row[1] for row in rows])
