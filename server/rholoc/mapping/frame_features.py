"""The features of a recording's frames, extracted while another step has them decoded: a video is not decoded again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rholoc.features import Extractor, FeatureSet
from rholoc.geometry import ByteArray
from rholoc.recordings import FrameSource, Look, look_at


class FrameFeatures:
    """What frames show: their features by one extractor, and their looks.

    Frames that were passed to :meth:`show` are remembered, about 70 kB each; others are decoded when asked for.
    """

    def __init__(self, frames: FrameSource, extractor: Extractor) -> None:
        self._frames = frames
        self._extractor = extractor
        self._shown: dict[int, tuple[FeatureSet, Look]] = {}

    def show(self, row: int, image: ByteArray) -> None:
        """Extract and remember the features of the frame at ``row``; may be called from several threads."""
        self._shown[row] = self._extracted(image)

    def of(self, rows: Sequence[int]) -> Iterator[tuple[FeatureSet, Look]]:
        """The features and the look of each frame in ``rows``, which increase; what was remembered is forgotten.

        Raises:
            InvalidRecording: a frame cannot be decoded.
        """
        images = self._frames.images([row for row in rows if row not in self._shown])
        for row in rows:
            shown = self._shown.pop(row, None)
            yield self._extracted(next(images)) if shown is None else shown
        self._shown.clear()

    def _extracted(self, image: ByteArray) -> tuple[FeatureSet, Look]:
        return self._extractor.extract(image).coloured(image), look_at(image)
