"""Run a tracker over a recording as a robot would, with delayed answers."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidInput, InvalidRecording
from rholoc.geometry import ByteArray, Camera, FloatArray, Pose, pose_distances
from rholoc.localization import AnyLocalizer, Localization, Prior, Query
from rholoc.recordings import Imu, Recording
from rholoc_client.errors import InvalidTrack
from rholoc_client.models import Camera as ClientCamera
from rholoc_client.tracking import Answer, AnsweredMatches, FollowedTrack, Tracked, TrackOptions, TrackStatus
from rholoc_client.tracking.rigid import inverse

_HEADING_DRIFT_DEG_M = 0.5  # of simulated odometry, typical of visual-inertial odometry
_WANDER = 0.05  # of the drift's direction, per step


class Motion(StrEnum):
    """A tracker's source of motion between answers."""

    ODOMETRY = "odometry"  # poses in a frame of their own
    IMU = "imu"  # acceleration and rotation rate
    PICTURES = "pictures"  # nothing else


@dataclass(frozen=True)
class Outage:
    """Interval without answers, in seconds after the first frame."""

    start_s: float
    stop_s: float


@dataclass(frozen=True, eq=False)
class TrackRun:
    """A tracker's results for N frames.

    Attributes:
        times: (N,) seconds.
        tracked: its output at each frame.
        position_m, rotation_rad: (N,) errors against the truth; NaN without a pose or truth.
        asked: rows of the frames sent to the localizer.
        answer_s: time of each answer.
        frame_s: (N,) computing time of the tracker at each frame.
    """

    times: FloatArray
    tracked: tuple[Tracked, ...]
    position_m: FloatArray
    rotation_rad: FloatArray
    asked: tuple[int, ...]
    answer_s: tuple[float, ...]
    frame_s: FloatArray

    @property
    def T_map_camera(self) -> FloatArray:
        """(N, 4, 4), NaN where there is no pose."""
        nothing = np.full((4, 4), np.nan)
        return np.array([nothing if one.pose is None else one.pose.T_map_camera for one in self.tracked])

    @property
    def sigma_m(self) -> FloatArray:
        """(N,) expected RMS position error of each pose, NaN without a pose."""
        return np.array(
            [
                np.nan if one.covariance is None else np.sqrt(np.trace(np.array(one.covariance)[:3, :3]))
                for one in self.tracked
            ]
        )

    def figures(self) -> dict[str, float | int | None]:
        """Summary figures; errors are over the frames with a pose and known truth."""
        known = np.isfinite(self.position_m)
        tracking = np.array([one.status is TrackStatus.TRACKING for one in self.tracked])
        error_cm = 100 * self.position_m[known & tracking]
        seconds = float(self.times[-1] - self.times[0])
        return {
            "frames": len(self.tracked),
            "seconds": round(seconds, 2),
            "searching": sum(one.status is TrackStatus.SEARCHING for one in self.tracked),
            "lost": sum(one.status is TrackStatus.LOST for one in self.tracked),
            "asked": len(self.asked),
            "asked_per_s": round(len(self.asked) / max(seconds, 1e-9), 2),
            "answers_used": self.tracked[-1].answers,
            "answers_rejected": self.tracked[-1].rejected,
            "resets": self.tracked[-1].reset_counter,
            "median_cm": _figure(error_cm, 0.5),
            "p90_cm": _figure(error_cm, 0.9),
            "worst_cm": _figure(error_cm, 1.0),
            "worst_deg": _figure(np.degrees(self.rotation_rad[known & tracking]), 1.0),
            "within_5cm": _share(error_cm <= 5),
            "within_10cm": _share(error_cm <= 10),
            "tracker_ms_per_frame": round(1e3 * float(np.median(self.frame_s)), 2),
            "answer_ms": round(1e3 * float(np.median(self.answer_s)), 1) if self.answer_s else None,
        }


def drifting_odometry(T_map_camera: FloatArray, drift: float, seed: int) -> FloatArray:
    """Simulated odometry (N, 4, 4) in its own frame, from true poses (N, 4, 4).

    Each step has an error of ``drift`` times its length in a slowly changing direction, so that errors accumulate; the
    heading drifts by half a degree per metre.
    """
    rng = np.random.default_rng(seed)
    side = rng.normal(size=3)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    found = [np.eye(4)]
    for before, now in pairwise(T_map_camera):
        side = side / np.linalg.norm(side) + _WANDER * rng.normal(size=3)
        step = inverse(before) @ now
        length = float(np.linalg.norm(step[:3, 3]))
        step[:3, 3] += drift * length * side / np.linalg.norm(side)
        step[:3, :3] = step[:3, :3] @ Rotation.from_rotvec(np.radians(_HEADING_DRIFT_DEG_M) * length * axis).as_matrix()
        found.append(found[-1] @ step)
    return np.array(found)


def run_tracker(
    localizer: AnyLocalizer,
    recording: Recording,
    camera: Camera,
    motion: Motion,
    options: TrackOptions | None = None,
    odometry: FloatArray | None = None,
    truth: FloatArray | None = None,
    latency_s: float | None = None,
    outages: tuple[Outage, ...] = (),
    advance: Callable[[], None] = lambda: None,
) -> TrackRun:
    """Track a recording's frames in a map.

    Args:
        localizer: of the map; it answers the tracker's queries.
        recording: the frames, and the IMU.
        camera: of the frames.
        motion: the tracker's source of motion.
        options: of the tracker.
        odometry: (N, 4, 4) poses by odometry, NaN where unknown; for ``Motion.ODOMETRY``.
        truth: (N, 4, 4) true poses in the map, NaN where unknown.
        latency_s: delay of an answer after its frame; None for the actual computing time.
        outages: intervals without answers.
        advance: called after each frame.

    Raises:
        InvalidRecording: ``Motion.IMU`` without an IMU, with unknown mounting, or without gravity.
        InvalidInput: odometry has no poses, or the map is not metric.
    """
    try:
        return _run(
            _Run(localizer, camera, motion, options or TrackOptions(), latency_s, outages),
            recording, motion, odometry, truth, advance,
        )  # fmt: skip
    except InvalidTrack as error:
        raise InvalidInput(str(error), "Check the recording's times, and the odometry.") from error


def _run(
    run: _Run,
    recording: Recording,
    motion: Motion,
    odometry: FloatArray | None,
    truth: FloatArray | None,
    advance: Callable[[], None],
) -> TrackRun:
    run.warm_up(next(recording.frames.images([0])))
    times = recording.frames.times
    readings = _readings(recording.imu) if motion is Motion.IMU else iter(())
    reading = next(readings, None)
    tracked, frame_s = [], []
    for row, image in enumerate(recording.frames.images(range(len(times)))):
        while reading is not None and reading[0] <= times[row]:
            run.track.imu(*reading)
            reading = next(readings, None)
        T_odom_camera = None if odometry is None or np.isnan(odometry[row]).any() else odometry[row]
        said, taken_s = run.frame(row, float(times[row] - times[0]), float(times[row]), image, T_odom_camera)
        tracked.append(said)
        frame_s.append(taken_s)
        advance()
    position_m, rotation_rad = np.full((2, len(times)), np.nan)
    for row, said in enumerate(tracked):
        if said.pose is not None and truth is not None and np.isfinite(truth[row]).all():
            position_m[row], rotation_rad[row] = pose_distances(np.array(said.pose.T_map_camera), truth[row])
    return TrackRun(
        times, tuple(tracked), position_m, rotation_rad, tuple(run.asked), tuple(run.answer_s), np.array(frame_s)
    )


class _Run:
    """A tracker, and the localizer with delayed answers."""

    def __init__(
        self,
        localizer: AnyLocalizer,
        camera: Camera,
        motion: Motion,
        options: TrackOptions,
        latency_s: float | None,
        outages: tuple[Outage, ...],
    ) -> None:
        self._localizer, self._camera, self._latency_s, self._outages = localizer, camera, latency_s, outages
        self._follows = motion is Motion.PICTURES
        self.track = FollowedTrack(options, ClientCamera(**camera.to_dict()) if self._follows else None)
        self.asked: list[int] = []
        self.answer_s: list[float] = []
        self._pending: tuple[float, Localization | None] | None = None

    def frame(
        self, row: int, since_first_s: float, time_s: float, image: ByteArray, T_odom_camera: FloatArray | None
    ) -> tuple[Tracked, float]:
        """The tracker's output at a frame, and its computing time [s]."""
        begun = time.perf_counter()
        if self._pending is not None and self._pending[0] <= time_s:
            self._take(self._pending[1])
            self._pending = None
        said = self.track.frame(time_s, T_odom_camera, image if self._follows else None)
        taken_s = time.perf_counter() - begun
        if self._pending is None and self.track.wants_answer:
            question = self.track.ask()
            prior = None
            if question.prior is not None:
                sent = question.prior
                assert sent.quaternion_xyzw is not None
                pose = Pose.from_quaternion(np.array(sent.position), np.array(sent.quaternion_xyzw))
                prior = Prior(pose, sent.radius_m, float(np.radians(sent.radius_deg)))
            self.asked.append(row)
            asked = time.perf_counter()
            out = any(outage.start_s <= since_first_s < outage.stop_s for outage in self._outages)
            answer = None if out else self._answer(image, prior)
            self.answer_s.append(time.perf_counter() - asked)
            self._pending = (time_s + (self.answer_s[-1] if self._latency_s is None else self._latency_s), answer)
        return said, taken_s

    def warm_up(self, image: ByteArray) -> None:
        """Build the map's index, which a running service has already."""
        self._answer(image, None)

    def _answer(self, image: ByteArray, prior: Prior | None) -> Localization:
        localizer = self._localizer
        return localizer.localize(Query.of_picture(image, localizer.extractor, self._camera, prior=prior))

    def _take(self, answer: Localization | None) -> None:
        if answer is None or answer.pose is None or answer.covariance is None:
            self.track.unanswered()
            return
        map_ = self._localizer.map
        matches = AnsweredMatches(
            answer.inlier_pixels.tolist(), map_.landmarks.positions[answer.inlier_features].tolist()
        )
        said = Answer(answer.pose.T_map_camera, answer.covariance, answer.recognized, map_.info.metric)
        self.track.answered(said, matches)


def _readings(imu: Imu | None) -> Iterator[tuple[float, FloatArray, FloatArray]]:
    """Times, accelerations and rates in the camera's axes."""
    if imu is None:
        raise InvalidRecording("The recording has no IMU.", "Use --motion pictures.")
    if imu.R_camera_imu is None or not imu.includes_gravity:
        raise InvalidRecording(
            "The IMU's axes in the camera are not known, or it leaves gravity out.",
            "Give R_camera_imu in camera.json, or use --motion pictures.",
        )
    acceleration, rate = imu.acceleration @ imu.R_camera_imu.T, imu.angular_velocity @ imu.R_camera_imu.T
    yield from zip(imu.times.tolist(), acceleration, rate, strict=True)


def _figure(values: FloatArray, quantile: float) -> float | None:
    return round(float(np.quantile(values, quantile)), 2) if len(values) else None


def _share(flags: FloatArray) -> float | None:
    return round(float(flags.mean()), 4) if len(flags) else None
