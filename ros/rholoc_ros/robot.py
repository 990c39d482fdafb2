"""The localization of a robot, without ROS: pictures wait for their transforms, are tracked, and poses come out."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from rholoc_client import Client
from rholoc_client.errors import RholocClientError
from rholoc_client.models import Camera, Prior
from rholoc_client.tracking import Tracked, Tracker, TrackStatus
from rholoc_client.tracking.rigid import FloatArray, inverse, quaternion_of
from rholoc_ros.correction import Correction
from rholoc_ros.geometry import base_covariance, map_to_odom, planar
from rholoc_ros.odometry import OdometryBuffer
from rholoc_ros.settings import Settings

_WAITING = 30  # pictures
_SETBACK_NS = 1_000_000_000  # a stamp so much earlier than the last one: the clock went back
_HINT_M, _HINT_DEG = (0.5, 10.0), (15.0, 180.0)  # radii of a hint, at three sigma
_SIGMAS = 3.0
OK, WARN, ERROR = 0, 1, 2


class Transforms(Protocol):
    """The tree of transforms."""

    def lookup(self, target: str, source: str, stamp_ns: int) -> FloatArray | None:
        """T_target_source (4, 4) at a stamp; None if it is not known, or not known yet."""
        ...


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture as it arrived.

    Attributes:
        stamp_ns: when it was taken, by its header.
        frame_id: the camera's optical frame.
        content: JPEG or PNG file, or pixels (H, W, 3) BGR or (H, W) grey.
        received_s: when it arrived, on the node's clock.
    """

    stamp_ns: int
    frame_id: str
    content: Any
    received_s: float


@dataclass(frozen=True, eq=False)
class Estimate:
    """A pose of the base: T_map_base (4, 4) and its covariance (6, 6) [m, rad] at a picture's stamp [ns]."""

    stamp_ns: int
    T_map_base: FloatArray
    covariance: FloatArray


@dataclass(frozen=True)
class Diagnosis:
    """State of the localization: one of ``OK``, ``WARN`` and ``ERROR``, a line for people, and values by name."""

    level: int
    message: str
    values: dict[str, str]


@dataclass(frozen=True, eq=False)
class _Hint:
    """Where the base is expected; ``T_map_odom`` is known from the first picture after the hint on."""

    T_map_base: FloatArray
    radius_m: float
    radius_deg: float
    since_ns: int | None = None
    T_map_odom: FloatArray | None = None


class Robot:
    """The localization of one robot. Not safe to share between threads.

    Args:
        settings: the parameters.
        transforms: the tree of transforms.
        make_tracker: begin a track with a camera; None: the map's own.
    """

    def __init__(
        self, settings: Settings, transforms: Transforms, make_tracker: Callable[[Camera | None], Tracker]
    ) -> None:
        self._settings = settings
        self._transforms = transforms
        self._make_tracker = make_tracker
        self._tracker: Tracker | None = None
        self._camera: Camera | None = None
        self._waiting: deque[Picture] = deque(maxlen=_WAITING)
        self._odometry = OdometryBuffer()
        self._correction = Correction(settings.limits)
        self._hint: _Hint | None = None
        self._tracked: Tracked | None = None
        self._last: tuple[Picture, FloatArray | None] | None = None  # the last picture, and its T_odom_base
        self._answers = 0
        self._problem = ""
        self._dropped = 0
        self._newest: Picture | None = None

    def camera(self, camera: Camera) -> None:
        """Take in the pictures' intrinsics; others than before begin a new track."""
        if camera != self._camera:
            self._camera = camera
            if self._tracker is not None:
                self.restart()

    def odometry(self, stamp_ns: int, T_odom_base: FloatArray) -> None:
        """Take in a pose (4, 4) by odometry, where it does not come from the transforms."""
        self._odometry.add(stamp_ns, T_odom_base)

    def imu(self, stamp_ns: int, frame_id: str, acceleration_m_s2: FloatArray, rate_rad_s: FloatArray) -> None:
        """Take in a reading of an IMU, in the axes of its own frame."""
        if self._tracker is None or self._newest is None:
            return
        T_camera_imu = self._transforms.lookup(self._newest.frame_id, frame_id, stamp_ns)
        if T_camera_imu is None:
            return
        R = T_camera_imu[:3, :3]
        try:
            self._tracker.imu(stamp_ns * 1e-9, R @ acceleration_m_s2, R @ rate_rad_s)
        except RholocClientError as error:
            self._problem = str(error)

    def picture(self, picture: Picture) -> None:
        """Take in a picture; :meth:`poll` tracks it once its transforms are known."""
        if self._newest is not None and picture.stamp_ns < self._newest.stamp_ns - _SETBACK_NS:
            self.restart()
        self._newest = picture
        self._waiting.append(picture)

    def hint(self, T_map_base: FloatArray, covariance: FloatArray) -> None:
        """Begin a new track near a pose (4, 4) with a covariance (6, 6) [m, rad].

        Raises:
            ValueError: the covariance is not finite.
        """
        if not np.isfinite(covariance).all():
            raise ValueError("Its covariance is not finite.")
        self.restart()
        sigmas = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        radius_m = float(np.clip(_SIGMAS * sigmas[:3].max(), *_HINT_M))
        self._hint = _Hint(T_map_base, radius_m, float(np.clip(_SIGMAS * math.degrees(sigmas[3:].max()), *_HINT_DEG)))

    def restart(self) -> None:
        """Forget the track and search again, without an expectation."""
        old, self._tracker = self._tracker, None
        if old is not None:  # its open question is waited for elsewhere
            threading.Thread(target=old.close, daemon=True).start()
        self._waiting.clear()
        self._hint = self._tracked = self._last = None
        self._answers, self._problem = 0, ""

    def complain(self, problem: str) -> None:
        """Note a problem for the next diagnosis."""
        self._problem = problem

    def poll(self, now_s: float) -> list[Estimate]:
        """Track the pictures with known transforms, in order; the poses to publish."""
        estimates = []
        while self._waiting:
            picture = self._waiting[0]
            outcome = self._moment(picture)
            if isinstance(outcome, str):
                if now_s - picture.received_s < self._settings.wait_s:
                    break
                self._problem = outcome
                self._dropped += 1
            self._waiting.popleft()
            if not isinstance(outcome, str):
                estimate = self._track(picture, *outcome)
                estimates += [] if estimate is None else [estimate]
        return estimates

    def map_to_odom(self, now_s: float) -> FloatArray | None:
        """T_map_odom (4, 4) to broadcast now; None: broadcast nothing."""
        tracked = self._tracked
        target: FloatArray | None = None
        T_odom_base: FloatArray = np.eye(4)
        if self._last is not None and self._last[1] is not None and self._is_current(now_s):
            T_odom_base = self._last[1]
            if tracked is not None and tracked.status is TrackStatus.TRACKING and tracked.T_map_odom is not None:
                target = np.asarray(tracked.T_map_odom)
        if target is not None and self._settings.planar:
            target = map_to_odom(planar(target @ T_odom_base), planar(T_odom_base))
            T_odom_base = planar(T_odom_base)
        return self._correction.step(now_s, target, T_odom_base)

    def diagnose(self, now_s: float) -> Diagnosis:
        """State of the localization, and the last problem since the diagnosis before."""
        problem, self._problem = self._problem, ""
        tracked, error = self._tracked, None if self._tracker is None else self._tracker.last_error
        values = {"pictures dropped": str(self._dropped), "last error": "" if error is None else str(error)}
        if tracked is not None:
            values |= {
                "status": tracked.status.value,
                "reset counter": str(tracked.reset_counter),
                "answers used": str(tracked.answers),
                "answers rejected": str(tracked.rejected),
                "seconds since answer": "" if tracked.since_answer_s is None else f"{tracked.since_answer_s:.2f}",
            }
        if tracked is not None and tracked.covariance is not None:
            values["position sigma [m]"] = f"{math.sqrt(max(tracked.covariance[i][i] for i in range(3))):.3f}"
        is_tracking = tracked is not None and tracked.status is TrackStatus.TRACKING
        if problem:
            return Diagnosis(WARN if is_tracking else ERROR, problem, values)
        if self._newest is None or now_s - self._newest.received_s > self._settings.silent_after_s:
            return Diagnosis(WARN, "No pictures arrive: check the image topic and its quality of service.", values)
        if tracked is None or tracked.status is TrackStatus.SEARCHING:
            return Diagnosis(WARN, "Searching: no pose is published until the place is recognized.", values)
        if tracked.status is TrackStatus.LOST:
            return Diagnosis(WARN, "Lost: no pose is published until the place is recognized again.", values)
        return Diagnosis(OK, "Localized.", values)

    def localize_once(self, client: Client) -> tuple[str, Estimate | None]:
        """Localize the newest picture alone, without the track. Blocks; safe in another thread.

        Returns:
            A line for people, and the pose; None where there is none.
        """
        picture, camera = self._newest, self._camera
        if picture is None:
            return "No picture has arrived.", None
        T_camera_base = self._transforms.lookup(picture.frame_id, self._settings.base_frame, picture.stamp_ns)
        if T_camera_base is None:
            return self._unknown(picture), None
        try:
            answer = client.localize(self._settings.map_name, picture.content, camera=camera)
        except RholocClientError as error:
            return str(error), None
        if not answer.localized or answer.pose is None or answer.covariance is None:
            return answer.diagnosis.message if answer.diagnosis else answer.reason or "No pose.", None
        T_map_camera = np.asarray(answer.pose.T_map_camera)
        estimate = _estimate(picture.stamp_ns, T_map_camera, T_camera_base, answer.covariance)
        x, y, z = estimate.T_map_base[:3, 3]
        return f"{x:.3f} {y:.3f} {z:.3f} m, recognized {answer.recognized:.2f}", estimate

    def _moment(self, picture: Picture) -> tuple[FloatArray, FloatArray | None] | str:
        """T_base_camera and T_odom_base at a picture, or what is missing."""
        settings = self._settings
        if settings.use_camera_info and self._camera is None:
            return self._problem or "No camera_info arrives: remap it, or set use_camera_info to false."
        T_base_camera = self._transforms.lookup(settings.base_frame, picture.frame_id, picture.stamp_ns)
        if T_base_camera is None:
            return self._unknown(picture)
        if settings.odometry == "none":
            return T_base_camera, None
        if settings.odometry == "tf":
            T_odom_base = self._transforms.lookup(settings.odom_frame, settings.base_frame, picture.stamp_ns)
        else:
            T_odom_base = self._odometry.at(picture.stamp_ns)
        if T_odom_base is None:
            return f"No odometry at the picture's stamp ({settings.odometry}): check the clocks, or raise wait_s."
        return T_base_camera, T_odom_base

    def _unknown(self, picture: Picture) -> str:
        return f"No transform from {self._settings.base_frame} to {picture.frame_id}: publish the camera's mounting."

    def _track(self, picture: Picture, T_base_camera: FloatArray, T_odom_base: FloatArray | None) -> Estimate | None:
        if self._last is not None and picture.stamp_ns <= self._last[0].stamp_ns:
            self._dropped += 1
            return None
        if self._tracker is None:
            self._tracker = self._make_tracker(self._camera)
        tracker = self._tracker
        T_odom_camera = None if T_odom_base is None else T_odom_base @ T_base_camera
        tracker.expect(self._expected(picture.stamp_ns, T_base_camera, T_odom_base))
        try:
            tracked = tracker.track(picture.stamp_ns * 1e-9, picture.content, T_odom_camera)
        except RholocClientError as error:
            self._problem = str(error)
            return None
        self._last, self._tracked = (picture, T_odom_base), tracked
        is_new, self._answers = tracked.answers > self._answers, tracked.answers
        if tracked.status is not TrackStatus.TRACKING or tracked.pose is None or tracked.covariance is None:
            return None
        self._hint = None
        if self._settings.pose_at_answers_only and not is_new:
            return None
        T_map_camera = np.asarray(tracked.pose.T_map_camera)
        return _estimate(picture.stamp_ns, T_map_camera, inverse(T_base_camera), tracked.covariance)

    def _expected(self, stamp_ns: int, T_base_camera: FloatArray, T_odom_base: FloatArray | None) -> Prior | None:
        """The hint as a prior on a picture's camera; it moves with odometry and ends after a time."""
        hint, T_odom = self._hint, np.eye(4) if T_odom_base is None else T_odom_base
        if hint is None:
            return None
        if hint.since_ns is None or hint.T_map_odom is None:
            hint = _Hint(
                hint.T_map_base, hint.radius_m, hint.radius_deg, stamp_ns, map_to_odom(hint.T_map_base, T_odom)
            )
        assert hint.since_ns is not None
        assert hint.T_map_odom is not None
        self._hint = hint if stamp_ns - hint.since_ns <= self._settings.hint_s * 1e9 else None
        if self._hint is None:
            return None
        T = hint.T_map_odom @ T_odom @ T_base_camera
        (x, y, z), (hx, hy, hz) = T[:3, 3].tolist(), T[:3, 2].tolist()
        return Prior((x, y, z), (hx, hy, hz), hint.radius_m, hint.radius_deg, quaternion_of(T[:3, :3]))

    def _is_current(self, now_s: float) -> bool:
        return self._last is not None and now_s - self._last[0].received_s <= self._settings.silent_after_s


def _estimate(
    stamp_ns: int, T_map_camera: FloatArray, T_camera_base: FloatArray, covariance: tuple[tuple[float, ...], ...]
) -> Estimate:
    T_map_base = T_map_camera @ T_camera_base
    return Estimate(stamp_ns, T_map_base, base_covariance(covariance, T_map_camera, T_map_base))
