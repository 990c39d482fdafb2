"""A phone's simulated walk without pictures: points on a room's walls as the camera would follow and describe them.

What stands in for the pictures is what the front end makes of them, a :class:`rholoc.trajectory.visual.flow.Flow` and
feature sets; everything behind it is the real thing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rholoc.features import Channel, FeatureSet
from rholoc.geometry import BoolArray, ByteArray, Camera, FloatArray, IntArray
from rholoc.progress import ProgressListener, silent
from rholoc.recordings import Imu, Recording, Waypoint
from rholoc.simulation import PHONE_CAMERA, Walk, make_walk, measure_imu, measure_waypoints
from rholoc.trajectory import PoseMethod, Trajectory, estimate
from rholoc.trajectory.visual.flow import Flow

DELAY_S = 0.03  # between the clocks of camera and IMU
SECONDS = 30.0
RATE_HZ = 5.0
NOISE_PX = 0.3
_CORNERS, _FEATURES = 500, 700  # on all walls; the camera sees about a sixth of them
_WALLS_M = np.array([[-2.5, 5.5], [-2.0, 5.0], [-1.4, 1.6]])  # of the room, along each axis of the map
_ROOM_SEED = 6


def followed(times: FloatArray, size: tuple[int, int], pixels: FloatArray, seen: BoolArray) -> Flow:
    """The flow of points (P,) at pixels (N, P, 2) of N frames, where they are seen (N, P).

    A point that comes into view again is another corner, as it would be in a video.
    """
    frames, points = seen.shape
    appears = seen & ~np.concatenate([np.zeros((1, points), np.bool_), seen[:-1]])
    number = np.cumsum(appears, axis=0) + np.arange(points) * (frames + 1)
    tracks = [np.sort(number[n, seen[n]]) for n in range(frames)]
    places = [pixels[n, seen[n]][np.argsort(number[n, seen[n]])] for n in range(frames)]
    motion = np.zeros(frames)
    for n in range(1, frames):
        both = seen[n] & seen[n - 1]
        moved = np.linalg.norm(pixels[n, both] - pixels[n - 1, both], axis=1)
        motion[n] = float(np.median(moved)) / max(size) if both.any() else 0.05
    starts = np.concatenate([[0], np.cumsum([len(some) for some in tracks])])
    blank = seen.sum(axis=1) == 0
    return Flow(
        times,
        size,
        starts,
        np.concatenate(tracks).astype(np.int64),
        np.concatenate(places),
        motion,
        np.where(blank, 1.0, 100.0),
        np.full(frames, 120.0),
        np.where(blank, 2.0, 50.0),
    )


@dataclass(frozen=True, eq=False)
class Frames:
    """Frames of which only the times matter."""

    times: FloatArray
    size: tuple[int, int]

    @property
    def timed(self) -> bool:
        return True

    @property
    def numbers(self) -> IntArray:
        return np.arange(len(self.times))

    def images(self, rows: Sequence[int]) -> Iterator[ByteArray]:
        raise AssertionError("no image is needed")


@dataclass(frozen=True, eq=False)
class SyntheticWalk:
    """A walk through a room with points on its walls.

    Attributes:
        seed: of the walk and of all noise.
        camera: that takes the pictures.
        blank: seconds, start and end of spans in which the camera sees nothing.
        other_room_from_s: from which on it sees other things on the walls.
    """

    seed: int = 0
    camera: Camera = PHONE_CAMERA
    blank: tuple[tuple[float, float], ...] = ()
    other_room_from_s: float = np.inf
    times: FloatArray = field(default_factory=lambda: np.arange(0.0, SECONDS, 1 / RATE_HZ))

    @cached_property
    def walk(self) -> Walk:
        return make_walk(1, SECONDS, self.seed)

    @cached_property
    def T_map_camera(self) -> FloatArray:
        return self.walk.T_map_camera(self.times)

    @cached_property
    def imu(self) -> Imu:
        return measure_imu(self.walk, SECONDS, time_offset_s=DELAY_S, seed=self.seed)

    @cached_property
    def waypoints(self) -> tuple[Waypoint, ...]:
        return measure_waypoints(self.walk, SECONDS, seed=self.seed)

    @cached_property
    def flow(self) -> Flow:
        pixels, seen = self._project(_points(self._twice(_CORNERS), 1), np.random.default_rng([self.seed, 1]))
        return followed(self.times, (self.camera.width, self.camera.height), pixels, seen)

    @cached_property
    def features(self) -> list[FeatureSet]:
        """Of all frames."""
        rng = np.random.default_rng([self.seed, 2])
        count = self._twice(_FEATURES)
        pixels, seen = self._project(_points(count, 2), rng)
        descriptors = np.random.default_rng(_ROOM_SEED).integers(0, 100, (count, 128))
        sets = []
        for places, visible in zip(pixels, seen, strict=True):
            rows = np.flatnonzero(visible)
            disturbed = np.clip(descriptors[rows] + rng.integers(-8, 9, (len(rows), 128)), 0, 255).astype(np.uint8)
            zeros = np.zeros(len(rows), np.float32)
            channels = np.full(len(rows), Channel.SIFT, np.uint8)
            sets.append(FeatureSet(places[rows].astype(np.float32), channels, disturbed, zeros, zeros))
        return sets

    def recording(self, **changes: object) -> Recording:
        """The walk as a recording with IMU and waypoints; ``changes`` are of its members."""
        frames = Frames(self.times, (self.camera.width, self.camera.height))
        whole = Recording(frames, "walk", Path("walk"), self.camera, self.imu, self.waypoints)
        return replace(whole, **changes)  # type: ignore[arg-type]

    def track_corners(
        self,
        frames: Frames,
        progress: ProgressListener = silent,
        show: object = None,
        camera: object = None,
        may_be_film: bool = True,
    ) -> Flow:
        """Stands in for :func:`rholoc.trajectory.visual.flow.track_corners`."""
        return self.flow

    def keyframe_features(self, *_: object) -> SyntheticFeatures:
        """Stands in for the class of :mod:`rholoc.trajectory.visual.keyframe_features`."""
        return SyntheticFeatures(self.features)

    def _twice(self, count: int) -> int:
        """As many points, and as many again for the other room."""
        return count if np.isinf(self.other_room_from_s) else 2 * count

    def _project(self, points: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, BoolArray]:
        """Pixels (N, P, 2) of points (P, 3) with noise, and which are in view (N, P)."""
        pixels = np.zeros((len(self.times), len(points), 2))
        seen = np.zeros((len(self.times), len(points)), np.bool_)
        for n, (time, T) in enumerate(zip(self.times.tolist(), self.T_map_camera, strict=True)):
            inside = (points - T[:3, 3]) @ T[:3, :3]
            pixels[n] = self.camera.project(inside) + rng.normal(0, NOISE_PX, (len(points), 2))
            dark = any(start <= time < end for start, end in self.blank)
            here = (np.arange(len(points)) >= len(points) // 2) == (time >= self.other_room_from_s)
            here |= np.isinf(self.other_room_from_s)
            seen[n] = (inside[:, 2] > 0.2) & self.camera.contains(pixels[n]) & here & (not dark)
        return pixels, seen


@dataclass(frozen=True, eq=False)
class SyntheticFeatures:
    """The features of all frames of a walk."""

    every: list[FeatureSet]

    def __enter__(self) -> SyntheticFeatures:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def foresee(self, row: int, image: object, motion: float, sharpness: float) -> None:
        """Nothing is extracted."""

    def of(self, rows: IntArray, progress: ProgressListener = silent) -> list[FeatureSet]:
        """Of some."""
        return [self.every[row] for row in rows.tolist()]

    of_set = of


def _points(count: int, seed: int) -> FloatArray:
    """Points (P, 3) on the four walls of the room, metres."""
    rng = np.random.default_rng([_ROOM_SEED, seed])
    points = rng.uniform(_WALLS_M[:, 0], _WALLS_M[:, 1], (count, 3))
    wall = rng.integers(0, 2, count)
    points[np.arange(count), wall] = _WALLS_M[wall, rng.integers(0, 2, count)]
    return points


def estimated(walk: SyntheticWalk, recording: Recording, method: PoseMethod = PoseMethod.VISUAL_INERTIAL) -> Trajectory:
    """A recording's trajectory, its front end replaced by the walk's and its child process by a call."""

    def call(function: Callable[..., Any], *args: Any, progress: ProgressListener, stage: object) -> Any:
        return function(*args, progress)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(estimate, "track_corners", walk.track_corners)
        patched.setattr(estimate, "KeyframeFeatures", walk.keyframe_features)
        patched.setattr(estimate, "run_in_child", call)
        return estimate.estimate_trajectory(recording, method)
