"""Features of a recording's frames, extracted while another step decodes the video, so that it is decoded only once."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import cv2

from rholoc.features import Extractor, FeatureSet
from rholoc.geometry import ByteArray, IntArray
from rholoc.recordings import FrameSource, Look, look_at
from rholoc.trajectory import Trajectory

_PICTURE_PX = 240  # the longer side of a small picture
_PICTURE_QUALITY = 70  # of its JPEG


class Shown(NamedTuple):
    """Features, appearance statistics and small JPEG of a frame; the JPEG is empty if pictures are not kept."""

    features: FeatureSet
    look: Look
    picture: bytes


class FrameFeatures:
    """Features, appearance statistics and optional small pictures of a recording's frames.

    Frames passed to :meth:`show` are cached, about 70 kB each; others are decoded on demand.
    """

    def __init__(self, frames: FrameSource, extractor: Extractor, pictures: bool = False) -> None:
        self._frames = frames
        self._extractor = extractor
        self._pictures = pictures
        self._shown: dict[int, Shown] = {}

    def show(self, row: int, image: ByteArray) -> None:
        """Extract and cache the features of the frame at ``row``. Thread-safe."""
        self._shown[row] = self._extracted(image)

    def of(self, rows: Sequence[int]) -> Iterator[Shown]:
        """Iterate over the frames at ``rows`` (ascending). Cached features are used up; at the end the whole cache is
        dropped.

        Raises:
            InvalidRecording: a frame cannot be decoded.
        """
        images = self._frames.images([row for row in rows if row not in self._shown])
        for row in rows:
            shown = self._shown.pop(row, None)
            yield self._extracted(next(images)) if shown is None else shown
        self._shown.clear()

    def of_keyframes(self, trajectory: Trajectory, keyframes: IntArray) -> Iterator[Shown]:
        """Iterate over the frames in rows ``keyframes`` (ascending) of the trajectory, with rolling shutter removed
        from their features.

        Raises:
            InvalidRecording: a frame cannot be decoded.
        """
        shown = self.of(trajectory.rows[keyframes].tolist())
        for k, one in zip(keyframes.tolist(), shown, strict=True):
            yield one._replace(features=trajectory.at_once(k, one.features))

    def _extracted(self, image: ByteArray) -> Shown:
        """Features with colours, appearance and, if pictures are kept, JPEG of an image (H, W, 3) BGR."""
        picture = small_picture(image) if self._pictures else b""
        return Shown(self._extractor.extract(image).coloured(image), look_at(image), picture)


def small_picture(image: ByteArray) -> bytes:
    """JPEG of an image (H, W, 3) BGR, reduced to 240 px on its longer side; never enlarged."""
    scale = min(1.0, _PICTURE_PX / max(image.shape[:2]))
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return bytes(cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _PICTURE_QUALITY])[1])
