"""The client's tracker on a map of this machine: it follows moments, and a localizer answers its questions."""

import math
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from rholoc.errors import InvalidInput
from rholoc.geometry import ByteArray, Camera, Pose
from rholoc.localization import AnyLocalizer, Localization, Prior, Query
from rholoc.tracking.moments import Moment, Motion
from rholoc_client.errors import InvalidTrack
from rholoc_client.models import Camera as ClientCamera
from rholoc_client.tracking import Answer, AnsweredMatches, FollowedTrack, Question, Tracked, TrackOptions


@dataclass(frozen=True, eq=False)
class Answered:
    """The localizer's answer about the frame of ``time_s``; None where there was none."""

    time_s: float
    localization: Localization | None


class Answering(Protocol):
    """Source of the localizer's answers, which decides when they arrive. One question is open at a time."""

    def ask(self, time_s: float, answer: Callable[[], Localization]) -> None:
        """Take a question about the frame of ``time_s``; ``answer`` computes the answer, at once or later."""
        ...

    def arrived(self, time_s: float) -> Answered | None:
        """Take out the answer to the open question, if it has arrived by the frame of ``time_s``; else None."""
        ...


class AtOnce:
    """Answers come with the frame that was asked about, so that a run is reproducible."""

    def __init__(self) -> None:
        self._answered: Answered | None = None

    def ask(self, time_s: float, answer: Callable[[], Localization]) -> None:
        """Compute the answer about the frame of ``time_s`` now."""
        self._answered = Answered(time_s, answer())

    def arrived(self, time_s: float) -> Answered | None:
        """Take out the last answer, whatever ``time_s`` is; None if there is none."""
        answered, self._answered = self._answered, None
        return answered


class InBackground:
    """Answers come when a thread has computed them."""

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="localizer")
        self._pending: tuple[float, Future[Localization]] | None = None

    def ask(self, time_s: float, answer: Callable[[], Localization]) -> None:
        """Begin to compute the answer about the frame of ``time_s`` in a thread."""
        self._pending = time_s, self._thread.submit(answer)

    def arrived(self, time_s: float) -> Answered | None:
        """Take out the answer if it is computed, else None. Raises the computation's exception, if any."""
        if self._pending is None or not self._pending[1].done():
            return None
        (asked_s, future), self._pending = self._pending, None
        return Answered(asked_s, future.result())


@dataclass(frozen=True, eq=False)
class Step:
    """Result of tracking one frame.

    Attributes:
        moment: the frame.
        tracked: the tracker's output.
        asked: whether the frame was sent to the localizer.
        answer: answer that arrived at this frame, about it or an earlier one; None if none arrived.
        track_s: computing time of the tracker.
    """

    moment: Moment
    tracked: Tracked
    asked: bool
    answer: Answered | None
    track_s: float

    @property
    def sigma_m(self) -> float:
        """Expected RMS position error [m]; NaN without a pose."""
        covariance = self.tracked.covariance
        return math.nan if covariance is None else math.sqrt(sum(covariance[axis][axis] for axis in range(3)))


def follow(
    localizer: AnyLocalizer,
    camera: Camera,
    motion: Motion,
    moments: Iterable[Moment],
    answering: Answering | None = None,
    options: TrackOptions | None = None,
) -> Iterator[Step]:
    """Track a camera in a map: iterate over the result of each frame.

    Args:
        localizer: of the map; it answers the tracker's questions.
        camera: of the frames.
        motion: the tracker's source of motion.
        moments: the frames in order.
        answering: when answers come; default: at once.
        options: of the tracker.

    Raises:
        InvalidInput: times do not increase, odometry is not rigid motion, or the map is not metric.
    """
    answering = answering or AtOnce()
    track = FollowedTrack(options, ClientCamera(**camera.to_dict()) if motion is Motion.PICTURES else None)
    is_waiting = False
    try:
        for moment in moments:
            begun = time.perf_counter()
            answer = answering.arrived(moment.time_s)
            if answer is not None:
                is_waiting = False
                _take(track, localizer, answer)
            for reading in moment.readings:
                track.imu(*reading)
            image = moment.image if motion is Motion.PICTURES else None
            tracked = track.frame(moment.time_s, moment.T_odom_camera, image)
            track_s = time.perf_counter() - begun
            asked = not is_waiting and track.wants_answer
            if asked:
                is_waiting = True
                answering.ask(moment.time_s, _asking(localizer, camera, moment.image, track.ask()))
                prompt = answering.arrived(moment.time_s)
                if prompt is not None:
                    is_waiting, answer = False, prompt
                    _take(track, localizer, prompt)
                    tracked = track.now()
            yield Step(moment, tracked, asked, answer, track_s)
    except InvalidTrack as error:
        raise InvalidInput(str(error), "Check the recording's times, and the odometry.") from error


def _asking(
    localizer: AnyLocalizer, camera: Camera, image: ByteArray, question: Question
) -> Callable[[], Localization]:
    """Function that localizes an image (H, W, 3) BGR with the question's prior, if it has one."""
    prior, sent = None, question.prior
    if sent is not None:
        pose = Pose.from_quaternion(np.array(sent.position), np.array(sent.quaternion_xyzw))
        prior = Prior(pose, sent.radius_m, float(np.radians(sent.radius_deg)))
    return lambda: localizer.localize(Query.of_picture(image, localizer.extractor, camera, prior=prior))


def _take(track: FollowedTrack, localizer: AnyLocalizer, answered: Answered) -> None:
    """Pass the localizer's answer on to the track, with its inliers as pixels and landmarks, or that there is none."""
    answer, map_ = answered.localization, localizer.map
    said = None if answer is None else answer_of(answer, map_.info.metric)
    if answer is None or said is None:
        track.unanswered()
        return
    matches = AnsweredMatches(answer.inlier_pixels.tolist(), map_.landmarks.positions[answer.inlier_features].tolist())
    track.answered(said, matches)


def answer_of(found: Localization, metric: bool) -> Answer | None:
    """Answer for a track: the pose, if there is one, and the alternatives; None if there is neither."""
    modes = [Answer(one.pose.T_map_camera, one.covariance, one.weight, metric) for one in found.alternatives]
    if found.pose is not None and found.covariance is not None:
        modes.insert(0, Answer(found.pose.T_map_camera, found.covariance, found.recognized, metric))
    return Answer.of_modes(modes, found.localized)
