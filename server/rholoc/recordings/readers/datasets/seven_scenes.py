"""7-Scenes, a dataset of a Kinect at 30 frames a second.

::

    frame-000000.color.png    or .jpg
    frame-000000.pose.txt     T_world_camera, 4 × 4, metres; not finite where tracking was lost
    frame-000000.depth.png    mm, 65535 where unknown: of the depth camera, whose intrinsics the dataset's page gives

The colour camera's intrinsics are not in the folder; which way is up is not known.
"""

from pathlib import Path

import numpy as np

from rholoc.errors import InvalidTrajectory
from rholoc.geometry import Camera, FloatArray, is_rotation
from rholoc.recordings.readers._frames import depth_images, untimed_images
from rholoc.recordings.recording import GivenPoses, Recording
from rholoc.recordings.tables.csv_table import read_text

TABLES = ("*.pose.txt", "*.depth.png")
_ROTATION_TOLERANCE = 1e-2
_UNKNOWN_DEPTHS = (0, 65535)
_DEPTH_CAMERA = Camera(640, 480, 585.0, 585.0, 320.0, 240.0)
_COLOUR = (".color.png", ".color.jpg")


def recognises(folder: Path) -> bool:
    """Whether a colour image (``.color.png`` or ``.jpg``) has a pose beside it, by its name."""
    return any(_pose_file(image).is_file() for image in _images(folder))


def read(folder: Path) -> Recording:
    """Read a recording of this format from its folder: poses in metres, not upright; depth; no intrinsics, no times.

    Raises:
        InvalidRecording: an image is broken.
        InvalidTrajectory: a pose is not a 4×4 matrix, or has no rotation.
    """
    images = _images(folder)
    timed = untimed_images(images)
    T = np.array([_read_pose(_pose_file(images[row])) for row in timed.rows])
    known = np.isfinite(T).all(axis=(1, 2))
    T[~known] = np.nan
    depths = [images[row].with_suffix("").with_suffix(".depth.png") for row in timed.rows]
    return Recording(
        timed.frames,
        poses=GivenPoses(known, T) if known.any() else None,
        depth=depth_images(depths, unknown=_UNKNOWN_DEPTHS, camera=_DEPTH_CAMERA),
        warnings=timed.warnings,
    )


def _images(folder: Path) -> list[Path]:
    """Colour images of a folder, by name."""
    return sorted(
        path for path in folder.iterdir() if path.name.lower().endswith(_COLOUR) and not path.name.startswith(".")
    )


def _pose_file(image: Path) -> Path:
    """File of an image's pose, which need not exist."""
    return image.with_suffix("").with_suffix(".pose.txt")


def _read_pose(path: Path) -> FloatArray:
    """T_world_camera (4, 4); NaN without a file. Raises InvalidTrajectory if it is no matrix, or has no rotation."""
    if not path.is_file():
        return np.full((4, 4), np.nan)
    try:
        values = np.array([float(word) for word in read_text(path, InvalidTrajectory).split()])
        T = values.reshape(4, 4)
    except ValueError as error:
        raise InvalidTrajectory(f"{path.name} is not a 4×4 matrix.") from error
    if np.isfinite(T).all() and not is_rotation(T[:3, :3], _ROTATION_TOLERANCE):
        raise InvalidTrajectory(f"{path.name} holds no rotation.")
    return T
