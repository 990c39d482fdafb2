"""What a phone hands in: frames with their times, and what else was measured on the way."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from rholoc.geometry import BoolArray, ByteArray, Camera, FloatArray, IntArray


class FrameSource(Protocol):
    """The frames of a recording; images are decoded only when asked for."""

    @property
    def times(self) -> FloatArray:
        """(N,) float64, seconds on the recording's clock, increasing."""
        ...

    @property
    def numbers(self) -> IntArray:
        """(N,) int64, the frames' numbers as users know them: in a video 0..N-1, in a folder the file's own."""
        ...

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        ...

    def images(self, rows: Sequence[int]) -> Iterator[ByteArray]:
        """The images (H, W, 3) BGR of the given rows 0..N-1, which must increase.

        Raises:
            InvalidRecording: a frame cannot be decoded.
        """
        ...


@dataclass(frozen=True, eq=False)
class Imu:
    """The IMU's table (the paper's Table 3), in the IMU's own axes.

    Attributes:
        times: (M,) float64, seconds on the recording's clock, increasing.
        acceleration: (M, 3) m/s². At rest it reads +9.81 upwards if ``includes_gravity``, else 0.
        angular_velocity: (M, 3) rad/s.
        includes_gravity: whether gravity's reaction is part of the acceleration.
        R_camera_imu: (3, 3), takes vectors of the IMU's axes to the camera frame, or None where unknown.
    """

    times: FloatArray
    acceleration: FloatArray
    angular_velocity: FloatArray
    includes_gravity: bool
    R_camera_imu: FloatArray | None


@dataclass(frozen=True)
class Waypoint:
    """A measured point of the walk: the camera's place at a time, metres in the map frame."""

    name: str
    time: float
    position: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class GivenPoses:
    """Poses that came with the recording, for some or all of its frames.

    Attributes:
        known: (N,) bool, whether the frame in this row has a pose.
        T_map_camera: (N, 4, 4), NaN where unknown.
    """

    known: BoolArray
    T_map_camera: FloatArray


@dataclass(frozen=True, eq=False)
class Recording:
    """A walk through a place.

    ``camera`` is None where the intrinsics are unknown; the trajectory's structure from motion then estimates them.
    """

    name: str
    path: Path
    frames: FrameSource
    camera: Camera | None = None
    imu: Imu | None = None
    waypoints: tuple[Waypoint, ...] = ()
    poses: GivenPoses | None = None
