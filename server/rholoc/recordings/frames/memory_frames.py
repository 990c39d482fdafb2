"""Frames without files: pictures in memory, and times without pictures."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rholoc.errors import InvalidRecording
from rholoc.geometry import ByteArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class MemoryFrames:
    """Pictures of one size as a :class:`FrameSource`, numbered from 0.

    Attributes:
        pictures: (H, W, 3) BGR or (H, W) grey each.
        frames_per_second: the first is at 0 s.
    """

    timed: ClassVar[bool] = True  # the rate is given

    pictures: Sequence[ByteArray]
    frames_per_second: float = 30.0

    @property
    def times(self) -> FloatArray:
        """(N,) seconds."""
        return np.arange(len(self.pictures)) / self.frames_per_second

    @property
    def numbers(self) -> IntArray:
        """Numbers (N,): 0..N-1."""
        return np.arange(len(self.pictures))

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, pixels."""
        height, width = self.pictures[0].shape[:2]
        return width, height

    def images(self, rows: Sequence[int]) -> Iterator[ByteArray]:
        """Iterate over the pictures of the given rows."""
        return (self.pictures[row] for row in rows)


@dataclass(frozen=True, eq=False)
class MissingImages:
    """The times and numbers (N,) of frames without images, see :class:`rholoc.recordings.FrameSource`."""

    timed: ClassVar[bool] = True

    times: FloatArray
    numbers: IntArray

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
