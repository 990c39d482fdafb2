"""Frames of a camera whose intrinsics change, as by autofocus, as frames of one camera."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rholoc.geometry import ByteArray, Camera, FloatArray, IntArray
from rholoc.recordings.frames.unified_pictures import resampled
from rholoc.recordings.recording import FrameSource, Recording

_STEADY = 0.002  # relative change of logged focal lengths, up to which they count as constant …
_STEADY_PX = 1.0  # … and of the principal point
_MAX_OFF_CENTRE = 0.1  # of a plausible principal point, as a share of the image's longer side
_FOCALS = (0.3, 4.0)  # plausible focal lengths, in multiples of the longer side


@dataclass(frozen=True, eq=False)
class SteadyFrames:
    """Another source's frames resampled to one camera, see :class:`rholoc.recordings.FrameSource`.

    Attributes:
        source: N frames.
        cameras: N cameras of these.
        common: the camera of the resampled frames.
    """

    source: FrameSource
    cameras: tuple[Camera, ...]
    common: Camera

    @property
    def times(self) -> FloatArray:
        """(N,) seconds, or rows."""
        return self.source.times

    @property
    def timed(self) -> bool:
        """Whether the times were measured."""
        return self.source.timed

    @property
    def numbers(self) -> IntArray:
        """Numbers (N,) of the source's frames."""
        return self.source.numbers

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.common.width, self.common.height

    def images(self, rows: Sequence[int]) -> Iterator[ByteArray]:
        """Iterate over the images (H, W, 3) BGR of the rows, which must increase, resampled to the common camera.

        Raises InvalidRecording if a frame cannot be decoded.
        """
        for row, image in zip(rows, self.source.images(rows), strict=True):
            yield resampled(image, self.cameras[row], self.common)


def with_logged_intrinsics(recording: Recording) -> Recording:
    """The recording with the median of its logged intrinsics as its camera, its frames resampled to it if they change.

    Changes are more than 0.2 % of a focal length or 1 px of the principal point. Without changes, a camera that the
    recording has stays; with them, its distortion does. Unchanged where intrinsics were not logged for every frame, or
    are implausible: a focal length not 0.3 to 4 × the longer side, or a principal point 0.1 × it off the centre.
    """
    logged, (width, height) = recording.frame_intrinsics, recording.frames.size
    if logged is None or not np.isfinite(logged).all() or 0 in (width, height):
        return recording
    middle = np.median(logged, axis=0)
    focals = middle[:2] / max(width, height)
    off_centre = np.abs(middle[2:] / max(width, height) - np.array([width, height]) / 2 / max(width, height))
    if not (_FOCALS[0] < focals.min() <= focals.max() < _FOCALS[1] and off_centre.max() < _MAX_OFF_CENTRE):
        return recording
    base = recording.camera or Camera(width, height, *middle.tolist())
    changes = np.abs(logged - middle) > (*(_STEADY * middle[:2]), _STEADY_PX, _STEADY_PX)
    if not changes.any():
        return replace(recording, camera=base)
    common, *cameras = (
        replace(base, fx=fx, fy=fy, cx=cx, cy=cy) for fx, fy, cx, cy in np.vstack([middle, logged]).tolist()
    )
    return replace(recording, camera=common, frames=SteadyFrames(recording.frames, tuple(cameras), common))
