"""Pictures of several cameras, sizes or orientations as frames of one camera."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from rholoc.errors import InvalidImage, InvalidRecording
from rholoc.geometry import ByteArray, Camera, FloatArray, IntArray
from rholoc.recordings.frames.image import read_image

_MAX_EXTENT = 1.8  # tangent of the angle off the axis up to which a wide lens is kept: 61°
_SHRINKING = 1.5  # factor from which a picture is averaged down before it is resampled
_MAPS = 4  # resampling maps of distorted cameras in memory


@dataclass(frozen=True, eq=False)
class UnifiedPictures:
    """Picture files resampled to one pinhole camera when they are read, see :class:`rholoc.recordings.FrameSource`.

    Beyond a picture's edge its border pixels are repeated, which adds no corners.

    Attributes:
        paths: N files.
        cameras: N cameras, of the pictures as they are stored. Their focal lengths may be known up to one factor.
        common: the camera of the frames.
        numbers: (N,) int64.
        times: (N,) seconds, or rows.
        timed: whether the times were measured.
        focal_px: the common camera's focal length where it follows from EXIF; None where it is given, or nominal.
    """

    paths: tuple[Path, ...]
    cameras: tuple[Camera, ...]
    common: Camera
    numbers: IntArray
    times: FloatArray
    timed: bool
    focal_px: float | None = None

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.common.width, self.common.height

    def images(self, rows: Sequence[int]) -> Iterator[ByteArray]:
        """The frames (H, W, 3) BGR of the rows, which must increase.

        Raises:
            InvalidRecording: a file is broken, or has changed since.
        """
        for row in rows:
            path, camera = self.paths[row], self.cameras[row]
            try:
                image = read_image(path)
            except InvalidImage as error:
                raise InvalidRecording(f"{path.name}: {error.message}", "Leave that picture out.") from error
            if image.shape[1::-1] != (camera.width, camera.height):
                raise InvalidRecording(f"{path.name} is not of {camera.width}×{camera.height} pixels any more.")
            yield resampled(image, camera, self.common)


def common_camera(cameras: Sequence[Camera]) -> Camera:
    """Pinhole camera that shows what all ``cameras`` show, at their median focal length.

    Its principal point is the middle of its image.
    """
    focal = float(np.median([camera.focal for camera in cameras]))
    extents = np.array([_extent(camera) for camera in set(cameras)]).max(axis=0)
    width, height = (round(2 * focal * min(extent, _MAX_EXTENT)) for extent in extents)
    return Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)


def resampled(image: ByteArray, camera: Camera, common: Camera) -> ByteArray:
    """The image (H, W, 3) or (H, W) of a camera as another camera at the same place shows it."""
    if camera == common:
        return image
    shrunk = common.focal / camera.focal
    if shrunk < 1 / _SHRINKING:
        size = round(camera.width * shrunk), round(camera.height * shrunk)
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        camera = camera.resized(*size)
    horizontal, vertical = _maps(camera, common)
    found = cv2.remap(image, horizontal, vertical, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found, dtype=np.uint8)


@lru_cache(_MAPS)
def _maps(camera: Camera, common: Camera) -> tuple[ByteArray, ByteArray]:
    """Where each pixel of the common camera lies in the camera's image, in OpenCV's fixed-point form."""
    size = common.width, common.height
    found = cv2.initUndistortRectifyMap(
        camera.matrix, np.array(camera.distortion), np.eye(3), common.matrix, size, cv2.CV_16SC2
    )
    return found[0], found[1]  # type: ignore[return-value]


def _extent(camera: Camera) -> FloatArray:
    """(2,) the furthest that the image reaches from its axis, horizontally and vertically, on the plane z = 1."""
    across, down = np.linspace(-0.5, camera.width - 0.5, 9), np.linspace(-0.5, camera.height - 0.5, 9)
    edge = np.concatenate(
        [np.column_stack([across, np.full(9, place)]) for place in (down[0], down[-1])]
        + [np.column_stack([np.full(9, place), down]) for place in (across[0], across[-1])]
    )
    return np.asarray(np.abs(camera.undistort(edge)).max(axis=0))
