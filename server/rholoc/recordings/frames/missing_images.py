"""Frames with times but no images."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from rholoc.errors import InvalidRecording
from rholoc.geometry import ByteArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class MissingImages:
    """The times and numbers (N,) of frames without images, see :class:`rholoc.recordings.FrameSource`."""

    times: FloatArray
    numbers: IntArray

    @property
    def timed(self) -> bool:
        """True."""
        return True

    @property
    def size(self) -> tuple[int, int]:
        """(0, 0): unknown."""
        return (0, 0)

    def images(self, rows: Sequence[int]) -> Iterator[ByteArray]:
        """Raise InvalidRecording.

        Raises:
            InvalidRecording: always, at the first step of the iterator.
        """
        raise InvalidRecording("The recording has times of frames, but no images.", "Add its video.")
        yield  # the protocol's images are an iterator
