"""Run a tracker over a recording as a robot would, with delayed answers."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.geometry import Camera, FloatArray, pose_distances
from rholoc.localization import AnyLocalizer, Localization, Query
from rholoc.recordings import Recording
from rholoc.tracking.follow import Answered, follow
from rholoc.tracking.moments import Motion, film_times, recorded_moments
from rholoc.tracking.users import Tally
from rholoc_client.tracking import Tracked, TrackOptions, TrackStatus
from rholoc_client.tracking.rigid import inverse

_HEADING_DRIFT_DEG_M = 0.5  # of simulated odometry, typical of visual-inertial odometry
_WANDER = 0.05  # of the drift's direction, per step


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
        sigma_m: (N,) expected RMS position error of each pose, NaN without a pose.
        asked: rows of the frames sent to the localizer.
        answer_s: time of each answer.
        tally: counts of its steps.
    """

    times: FloatArray
    tracked: tuple[Tracked, ...]
    position_m: FloatArray
    rotation_rad: FloatArray
    sigma_m: FloatArray
    asked: tuple[int, ...]
    answer_s: tuple[float, ...]
    tally: Tally

    @property
    def T_map_camera(self) -> FloatArray:
        """(N, 4, 4), NaN where there is no pose."""
        nothing = np.full((4, 4), np.nan)
        return np.array([nothing if one.pose is None else one.pose.T_map_camera for one in self.tracked])

    def figures(self) -> dict[str, float | int | None]:
        """Summary figures; errors are over the frames with a pose and known truth."""
        known = np.isfinite(self.position_m)
        tracking = np.array([one.status is TrackStatus.TRACKING for one in self.tracked])
        error_cm = 100 * self.position_m[known & tracking]
        return {
            **self.tally.figures(),
            "median_cm": _figure(error_cm, 0.5),
            "p90_cm": _figure(error_cm, 0.9),
            "worst_cm": _figure(error_cm, 1.0),
            "worst_deg": _figure(np.degrees(self.rotation_rad[known & tracking]), 1.0),
            "within_5cm": _share(error_cm <= 5),
            "within_10cm": _share(error_cm <= 10),
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
    answering = _Delayed(latency_s, outages)
    localizer.localize(Query.of_picture(next(recording.frames.images([0])), localizer.extractor, camera))  # warm up
    moments = recorded_moments(recording, motion, odometry)
    tally, asked, sigma_m, tracked = Tally(), [], [], []
    for row, step in enumerate(follow(localizer, camera, motion, moments, answering, options)):
        tally.take(step)
        asked += [row] * step.asked
        sigma_m.append(step.sigma_m)
        tracked.append(step.tracked)
        advance()
    position_m, rotation_rad = np.full((2, len(tracked)), np.nan)
    for row, said in enumerate(tracked):
        if said.pose is not None and truth is not None and np.isfinite(truth[row]).all():
            position_m[row], rotation_rad[row] = pose_distances(np.array(said.pose.T_map_camera), truth[row])
    return TrackRun(
        film_times(recording), tuple(tracked), position_m, rotation_rad, np.array(sigma_m), tuple(asked),
        tuple(answering.answer_s), tally,
    )  # fmt: skip


class _Delayed:
    """Answers that arrive a latency after their frame; none in an outage."""

    def __init__(self, latency_s: float | None, outages: tuple[Outage, ...]) -> None:
        self._latency_s, self._outages = latency_s, outages
        self._first_s: float | None = None
        self._pending: tuple[float, Answered] | None = None
        self.answer_s: list[float] = []

    def ask(self, time_s: float, answer: Callable[[], Localization]) -> None:
        begun = time.perf_counter()
        since_first_s = time_s - (time_s if self._first_s is None else self._first_s)
        out = any(outage.start_s <= since_first_s < outage.stop_s for outage in self._outages)
        answered = Answered(time_s, None if out else answer())
        self.answer_s.append(time.perf_counter() - begun)
        self._pending = time_s + (self.answer_s[-1] if self._latency_s is None else self._latency_s), answered

    def arrived(self, time_s: float) -> Answered | None:
        self._first_s = time_s if self._first_s is None else self._first_s
        if self._pending is None or self._pending[0] > time_s:
            return None
        (_, answered), self._pending = self._pending, None
        return answered


def _figure(values: FloatArray, quantile: float) -> float | None:
    return round(float(np.quantile(values, quantile)), 2) if len(values) else None


def _share(flags: FloatArray) -> float | None:
    return round(float(flags.mean()), 4) if len(flags) else None
