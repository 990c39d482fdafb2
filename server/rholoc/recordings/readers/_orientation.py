"""Pictures with an EXIF orientation, for the readers of programs that ignore it.

COLMAP, Metashape, nerfstudio and kapture know the pictures as they are stored. Frames are pictures as they are shown,
and their cameras turn with them.
"""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidImage, InvalidRecording
from rholoc.geometry import Camera, FloatArray, Lens, pose_matrix
from rholoc.recordings.frames.image_decoding import exif_orientation, image_size

_QUARTER_TURNS = {1: 0, 3: 2, 6: 1, 8: 3}  # by EXIF orientation: clockwise, from the stored picture to the shown one


def as_shown(paths: Sequence[Path], cameras: Sequence[Camera] | None) -> tuple[list[Camera] | None, FloatArray]:
    """Turn the cameras of stored pictures to the pictures as they are shown.

    A camera that has the shape of the picture as it is shown, and not of the stored one, stays: its program turned the
    picture itself.

    Args:
        paths: N files; missing and broken ones count as not turned.
        cameras: each stored picture's camera; None if the intrinsics are unknown.

    Returns:
        The cameras of the shown pictures, and T_stored_shown (N, 4, 4) of the camera frames.

    Raises:
        InvalidRecording: a picture is mirrored.
    """
    known = [None] * len(paths) if cameras is None else cameras
    quarters = [_quarter_turns(path, camera) for path, camera in zip(paths, known, strict=True)]
    R_stored_shown = Rotation.from_rotvec(np.outer(quarters, [0, 0, -np.pi / 2])).as_matrix().round()
    shown = None if cameras is None else [one.turned(turns) for one, turns in zip(cameras, quarters, strict=True)]
    return shown, pose_matrix(R_stored_shown, np.zeros((len(paths), 3)))


def stored_size(path: Path) -> tuple[int, int]:
    """Width and height of a picture [px] as it is stored. Raises InvalidImage if it has no image header."""
    width, height = image_size(path)
    return (height, width) if exif_orientation(path) >= 5 else (width, height)  # 5 to 8 swap the sides


def _quarter_turns(path: Path, camera: Camera | None) -> int:
    """Clockwise quarter turns from the picture as ``camera`` knows it to the picture as it is shown: 0 to 3.

    Raises InvalidRecording if the picture is mirrored.
    """
    orientation = 1
    with suppress(InvalidImage, OSError):  # reported where the picture is read
        orientation = exif_orientation(path)
    if orientation == 1 or (camera is not None and camera.lens is Lens.EQUIRECTANGULAR):
        return 0
    if orientation not in _QUARTER_TURNS:
        raise InvalidRecording(f"{path.name} is mirrored by its EXIF orientation.", "Save it without that.")
    turns = _QUARTER_TURNS[orientation]
    if camera is not None and turns % 2 == 1:
        width, height = image_size(path)
        if width != height and (camera.width > camera.height) == (width > height):
            return 0
    return turns
