"""Users of a track's steps: counts, Table 6, messages."""

from collections import Counter
from typing import Protocol

import numpy as np

from rholoc.geometry import Camera
from rholoc.maps import Map, TrajectoryTable
from rholoc.tracking.follow import Step
from rholoc.tracking.pose_messages import PoseMessages
from rholoc_client.tracking import TrackStatus
from rholoc_client.tracking.rigid import in_radians


class StepUser(Protocol):
    """Takes in the steps of a track, one after the other."""

    def take(self, step: Step) -> None:
        """Take in a step."""
        ...


class Tally:
    """Counts of a track's steps."""

    def __init__(self) -> None:
        self._counts: Counter[TrackStatus] = Counter()
        self._track_s: list[float] = []
        self._first_s: float | None = None
        self._asked = 0
        self._last: Step | None = None

    def take(self, step: Step) -> None:
        """Add a step to the counts."""
        self._first_s = step.moment.time_s if self._first_s is None else self._first_s
        self._counts[step.tracked.status] += 1
        self._track_s.append(step.track_s)
        self._asked += step.asked
        self._last = step

    def figures(self) -> dict[str, float | int | None]:
        """Summary of all steps by name: frames, seconds, states, questions, answers, resets; None where undefined."""
        last, first_s = self._last, self._first_s
        seconds = 0.0 if last is None or first_s is None else last.moment.time_s - first_s
        return {
            "frames": self._counts.total(),
            "seconds": round(seconds, 2),
            "searching": self._counts[TrackStatus.SEARCHING],
            "lost": self._counts[TrackStatus.LOST],
            "asked": self._asked,
            "asked_per_s": round(self._asked / max(seconds, 1e-9), 2) if seconds else None,
            "answers_used": 0 if last is None else last.tracked.answers,
            "answers_rejected": 0 if last is None else last.tracked.rejected,
            "resets": 0 if last is None else last.tracked.reset_counter,
            "tracker_ms_per_frame": round(1e3 * float(np.median(self._track_s)), 2) if self._track_s else None,
        }


class TableOfTrack:
    """Table 6 of a track: a row for each frame at which it was not searching or lost.

    Attributes:
        rows: time, frame's number, T_map_camera (4, 4) and expected position error of each.
    """

    def __init__(self) -> None:
        self.rows: list[tuple[float, int, np.ndarray, float]] = []

    def take(self, step: Step) -> None:
        """Add a row for the step if it is tracking."""
        if step.tracked.status is TrackStatus.TRACKING and step.tracked.pose is not None:
            T_map_camera = np.array(step.tracked.pose.T_map_camera)
            self.rows.append((step.moment.time_s, step.moment.number, T_map_camera, step.sigma_m))

    def table(self) -> TrajectoryTable:
        """The rows so far as a table; confidences are NaN and inliers 0."""
        count = len(self.rows)
        return TrajectoryTable(
            times=np.array([time_s for time_s, _, _, _ in self.rows], dtype=np.float64),
            frames=np.array([number for _, number, _, _ in self.rows], dtype=np.int64),
            T_map_camera=np.reshape([T for _, _, T, _ in self.rows], (-1, 4, 4)).astype(np.float64),
            confidences=np.full(count, np.nan),
            inliers=np.zeros(count, dtype=np.int64),
            expected_errors_m=np.array([sigma_m for _, _, _, sigma_m in self.rows], dtype=np.float64),
        )


class MessagesOfTrack:
    """Writes steps as messages: poses while tracking, nothing while searching or lost but the status and the pictures.

    Args:
        messages: writer of the messages.
        map_: map, the landmarks of which are written first.
        camera: camera of the pictures; None leaves out the pictures.
    """

    def __init__(self, messages: PoseMessages, map_: Map, camera: Camera | None = None) -> None:
        self._messages, self._map, self._camera = messages, map_, camera
        self._is_begun = False

    def take(self, step: Step) -> None:
        """Write the step's messages; with the first one the map's landmarks."""
        time_s, tracked = step.moment.time_s, step.tracked
        if not self._is_begun:
            landmarks, self._is_begun = self._map.landmarks, True
            self._messages.room(time_s, landmarks.positions, landmarks.known_colours)
        if self._camera is not None:
            self._messages.picture(time_s, step.moment.image, self._camera)
        self._messages.status(time_s, tracked.status.value)
        if step.answer is not None and step.answer.localization is not None:
            found = step.answer.localization
            self._messages.belief(time_s, found.recognized, found.confidence)
        if tracked.status is TrackStatus.TRACKING and tracked.pose is not None and tracked.covariance is not None:
            T_map_odom = None if tracked.T_map_odom is None else np.array(tracked.T_map_odom)
            T_map_camera = np.array(tracked.pose.T_map_camera)
            self._messages.pose(time_s, T_map_camera, in_radians(tracked.covariance), T_map_odom)
