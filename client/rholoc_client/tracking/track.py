"""A track: the belief about a camera's pose over time. No network, no threads, no clock of its own.

Frames, odometry or IMU readings come in, and a pose for every frame goes out. The track says when asking the service
would pay (:attr:`Track.wants_answer`), and takes the answer whenever it comes: since it is about the frame that was
asked about, the belief of that time is corrected, and the steps since are applied again.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from rholoc_client.errors import InvalidTrack
from rholoc_client.models import Localization, Pose, Prior
from rholoc_client.tracking.belief import Belief, OdometryNoise, PoseBelief, Step, alignment, squared_distance
from rholoc_client.tracking.inertial import ImuNoise, ImuReading, InertialBelief
from rholoc_client.tracking.rigid import (
    FloatArray,
    in_degrees,
    in_radians,
    inverse,
    motion_between,
    moved,
    quaternion_of,
    rigid,
)

_GATE = 22.5  # of χ² with six degrees of freedom: a right answer is beyond it once in a thousand times
_UNTENABLE = 6  # after so many answers that contradict a track, and each other, it is given up
_SURE = 0.8  # the probability of the right place from which a track begins
_MISSED = 0.01  # the probability that an answer names other places although it sees the right one
_UNFORESEEN = 0.05  # the least probability that the camera is where no answer has put it yet
_LIKELY = 0.1  # the probability from which a place that an answer names confirms a track that is there
_SAYS_NOTHING = 0.5  # the probability of no place that it names from which an answer is of no use
_HYPOTHESES, _MIN_WEIGHT = 8, 0.01  # how many are kept, and the least probability of one
_MIN_SIGMA_M, _MIN_SIGMA_RAD = 0.005, math.radians(0.2)  # of an answer: no map is more accurate
_MAX_READINGS = 20_000  # of an IMU that wait for a frame
_PATIENT_FAILURES = 6
_LONGEST_WAIT_S = 3.0
_LONGEST_GAP_S = 5.0  # between frames; beyond it a track starts over


class TrackStatus(str, Enum):  # noqa: UP042 - Python 3.10, which robots with Ubuntu 22.04 have, lacks StrEnum
    """How far a pose can be relied on."""

    SEARCHING = "searching"  # no answer yet to begin a track with: there is no pose
    TRACKING = "tracking"  # the pose is as good as its covariance says
    LOST = "lost"  # too long without an answer: the pose is a guess

    __str__ = str.__str__


@dataclass(frozen=True)
class TrackOptions:
    """How a track is kept.

    Attributes:
        odometry: how accurate the odometry is.
        imu: how accurate the IMU is, where there is no odometry.
        answers_per_s: the most questions asked in a second.
        drift_m: the uncertainty gained since the last answer at which asking pays.
        longest_s: the time after which asking pays in any case.
        smoothing_s: a correction is blended in over about this time, so that poses do not jerk; 0: at once.
        jump_m, jump_deg: larger corrections are applied at once, and counted.
        lost_m, lost_deg: one sigma beyond which a pose is lost.
    """

    odometry: OdometryNoise = field(default_factory=OdometryNoise)
    imu: ImuNoise = field(default_factory=ImuNoise)
    answers_per_s: float = 2.0
    drift_m: float = 0.007
    longest_s: float = 5.0
    smoothing_s: float = 0.15
    jump_m: float = 0.10
    jump_deg: float = 5.0
    lost_m: float = 0.5
    lost_deg: float = 20.0

    def __post_init__(self) -> None:
        for name in ("answers_per_s", "drift_m", "longest_s", "jump_m", "jump_deg", "lost_m", "lost_deg"):
            if not 0 < getattr(self, name) < math.inf:
                raise InvalidTrack(f"The option {name} is not a positive number.")
        if not 0 <= self.smoothing_s < math.inf:
            raise InvalidTrack("The option smoothing_s is negative.")


@dataclass(frozen=True, eq=False)
class Tracked:
    """Where a camera is at a frame.

    Attributes:
        time_s: the frame's.
        status: how far the pose can be relied on.
        pose: in the map, or None while searching.
        covariance: 6×6 of the pose, of the position in metres and a small rotation about the map's axes in degrees.
        T_map_odom: 4×4, takes points of odometry's frame to the map; None without odometry.
        T_map_odom_covariance: 6×6 of it, at the origin of odometry's frame; units as of ``covariance``.
        reset_counter: goes up by one whenever the pose jumps: what was derived from earlier poses is void.
        since_answer_s: the age of the frame that the last useful answer was about; None before the first.
        answers: how many answers were useful.
        rejected: how many contradicted the track and were ignored.
    """

    time_s: float
    status: TrackStatus
    pose: Pose | None
    covariance: tuple[tuple[float, ...], ...] | None
    T_map_odom: tuple[tuple[float, ...], ...] | None
    T_map_odom_covariance: tuple[tuple[float, ...], ...] | None
    reset_counter: int
    since_answer_s: float | None
    answers: int
    rejected: int


@dataclass(frozen=True, eq=False)
class Answer:
    """What the service says about one frame.

    Attributes:
        T_map_camera: (4, 4).
        covariance: (6, 6), metres and radians.
        recognized: 0..1, the probability of the right place.
        metric: whether the map's unit of length is the metre.
        alternatives: other poses that the frame may have been taken from, each with its own probability.
        localized: whether the service relies on the pose; where it does not, the pose is the likeliest of several.
    """

    T_map_camera: FloatArray
    covariance: FloatArray
    recognized: float
    metric: bool = True
    alternatives: tuple[Answer, ...] = ()
    localized: bool = True

    @classmethod
    def of(cls, answer: Localization) -> Answer | None:
        """The client's answer; None where there is no pose with a covariance, not even among the alternatives."""
        metric = answer.scale == "metric"
        modes = [
            cls(rigid(one.pose.T_map_camera), in_radians(one.covariance), one.weight, metric)
            for one in answer.alternatives
            if one.covariance is not None
        ]
        if answer.localized and answer.pose is not None and answer.covariance is not None:
            modes.insert(
                0, cls(rigid(answer.pose.T_map_camera), in_radians(answer.covariance), answer.recognized, metric)
            )
        return cls.of_modes(modes, answer.localized)

    @classmethod
    def of_modes(cls, modes: Sequence[Answer], localized: bool) -> Answer | None:
        """An answer that names several poses, the likeliest first; None where there are none."""
        return replace(modes[0], alternatives=tuple(modes[1:]), localized=localized) if modes else None

    @property
    def modes(self) -> tuple[Answer, ...]:
        """The pose and its alternatives, which exclude one another."""
        return (self, *self.alternatives)

    @property
    def inflated_covariance(self) -> FloatArray:
        """The covariance (6, 6), plus what no map is more accurate than."""
        least = np.diag([_MIN_SIGMA_M**2] * 3 + [_MIN_SIGMA_RAD**2] * 3)
        return self.covariance + least


@dataclass(frozen=True, eq=False)
class _Hypothesis:
    """A belief, the number of answers that it is based on, and its probability."""

    belief: PoseBelief | InertialBelief
    answers: int
    weight: float

    def advanced(self, motion: Step | ImuReading) -> _Hypothesis:
        if isinstance(self.belief, InertialBelief):
            return replace(self, belief=self.belief.advanced(motion)) if isinstance(motion, ImuReading) else self
        return replace(self, belief=self.belief.advanced(motion)) if isinstance(motion, Step) else self

    def agrees(self, answer: Answer) -> bool:
        return squared_distance(self.belief, answer.T_map_camera, answer.inflated_covariance) < _GATE

    def corrected(self, answer: Answer) -> _Hypothesis:
        belief = self.belief.corrected(answer.T_map_camera, answer.inflated_covariance)
        return replace(self, belief=belief, answers=self.answers + 1)


@dataclass(frozen=True, eq=False)
class Question:
    """The belief at the time of a question.

    Attributes:
        time_s: of the frame.
        prior: where its pose is expected, or None.
        hypotheses: as of the track.
    """

    time_s: float
    prior: Prior | None
    hypotheses: tuple[_Hypothesis, ...]


@dataclass
class _Pace:
    """When the next answer may be asked for."""

    answers_per_s: float
    due_s: tuple[float, ...] = ()
    waiting_until_s: float = -math.inf
    failures: int = 0

    def allows(self, time_s: float, in_haste: bool) -> bool:
        """Whether a question may be asked. ``in_haste``, two may follow each other at once; then none for as long as
        both would have taken."""
        if time_s < self.waiting_until_s or (len(self.due_s) == 2 and time_s < self.due_s[0] + 2 / self.answers_per_s):
            return False
        return in_haste or not self.due_s or time_s >= self.due_s[-1] + 1 / self.answers_per_s

    def asked(self, time_s: float) -> None:
        self.due_s = (*self.due_s, time_s)[-2:]

    def came(self, of_use: bool, time_s: float) -> None:
        """Record how a question turned out: after several failures in a row, questions become rarer."""
        self.failures = 0 if of_use else self.failures + 1
        if self.failures > _PATIENT_FAILURES:
            wait_s = min(_LONGEST_WAIT_S, 2 ** (self.failures - _PATIENT_FAILURES) / self.answers_per_s)
            self.waiting_until_s = time_s + wait_s


@dataclass
class _Standing:
    """The state that changes with the answers."""

    reset_counter: int = 0
    last_answer_s: float | None = None
    used: int = 0
    rejected: int = 0
    settled: bool = False
    contradicted: int = 0  # times in a row
    variance_m2: float = 0.0  # of the position, right after the last answer


class Track:
    """The pose of one camera over time.

    Until one place is sure, every place that answers name is a hypothesis: odometry carries all of them on, and the
    next answer makes those that agree with it likelier. Of two rooms that look alike, the right one wins by walking,
    and nothing is claimed before. From then on, answers correct the hypothesis that won; one rival is kept beside it,
    in case they turn out to contradict it.

    Times are seconds on any one clock, which must go forward.
    """

    def __init__(self, options: TrackOptions | None = None) -> None:
        self.options = options or TrackOptions()
        self._hypotheses: tuple[_Hypothesis, ...] = ()
        self._time_s: float | None = None
        self._T_odom_camera: FloatArray | None = None
        self._has_odometry = False
        self._readings: deque[tuple[float, FloatArray, FloatArray]] = deque()
        self._last_reading: tuple[float, FloatArray, FloatArray] | None = None
        self._imu_s: float | None = None
        self._question: Question | None = None
        self._since: list[Step | ImuReading] = []
        self._offset: FloatArray = np.zeros(6)
        self._pace = _Pace(self.options.answers_per_s)
        self._standing = _Standing()

    def imu(self, time_s: float, acceleration_m_s2: FloatArray, rate_rad_s: FloatArray) -> None:
        """Take in a reading of an IMU, in the camera's axes: x right, y down, z forward.

        Args:
            time_s: when it was read, on the frames' clock.
            acceleration_m_s2: (3,); at rest the reaction to gravity, 9.81 upwards.
            rate_rad_s: (3,) the angular velocity.

        Raises:
            InvalidTrack: its time is not after the last reading's, or a vector is not three finite numbers.
        """
        _check_time(time_s, self._imu_s, "reading")
        acceleration, rate = (np.asarray(one, dtype=np.float64) for one in (acceleration_m_s2, rate_rad_s))
        if not all(one.shape == (3,) and np.isfinite(one).all() for one in (acceleration, rate)):
            raise InvalidTrack("An IMU reading must have three finite numbers for each sensor.")
        self._imu_s = time_s
        self._readings.append((time_s, acceleration, rate))
        if len(self._readings) > _MAX_READINGS:
            self._readings.popleft()

    def frame(self, time_s: float, T_odom_camera: FloatArray | None = None) -> Tracked:
        """Take in a frame, and say where the camera is.

        Args:
            time_s: when it was taken.
            T_odom_camera: (4, 4) the camera's pose in odometry's own frame; None where odometry does not know.

        Raises:
            InvalidTrack: the time is not after the last frame's, or the pose is no rigid motion.
        """
        _check_time(time_s, self._time_s, "frame")
        if T_odom_camera is not None:
            try:
                T_odom_camera = rigid(T_odom_camera)
            except ValueError as error:
                raise InvalidTrack(f"Odometry: {error}") from error
            self._has_odometry = True
        duration_s = 0.0 if self._time_s is None else time_s - self._time_s
        if duration_s > _LONGEST_GAP_S:
            self._start_over()
        elif self._time_s is not None:
            self._advance(duration_s, T_odom_camera)
        self._drop_readings(time_s)
        self._time_s, self._T_odom_camera = time_s, T_odom_camera
        if self.options.smoothing_s > 0:
            self._offset = self._offset * math.exp(-duration_s / self.options.smoothing_s)
        return self.now()

    def now(self) -> Tracked:
        """Where the camera was at the last frame, by everything known now."""
        standing, time_s = self._standing, self._time_s
        if time_s is None:
            raise InvalidTrack("There is no frame yet.")
        since_s = None if standing.last_answer_s is None else time_s - standing.last_answer_s
        counted = (standing.reset_counter, since_s, standing.used, standing.rejected)
        main = self._main
        if main is None or not standing.settled:
            return Tracked(time_s, TrackStatus.SEARCHING, None, None, None, None, *counted)
        belief = replace(main.belief, T_map_camera=moved(main.belief.T_map_camera, self._offset))
        status = TrackStatus.LOST if self._is_lost(belief) else TrackStatus.TRACKING
        T_map_odom = covariance = None
        if self._T_odom_camera is not None:
            T_map_odom, covariance = alignment(belief, self._T_odom_camera)
        return Tracked(
            time_s,
            status,
            _pose_of(belief.T_map_camera),
            _rows(in_degrees(belief.covariance)),
            None if T_map_odom is None else _rows(T_map_odom),
            None if covariance is None else _rows(in_degrees(covariance)),
            *counted,
        )

    @property
    def wants_answer(self) -> bool:
        """Whether asking about the last frame pays: there is no pose, or it has become too uncertain."""
        standing, options = self._standing, self.options
        if not self.may_ask:
            return False
        assert self._time_s is not None
        if self._main is None or not standing.settled or standing.contradicted or standing.last_answer_s is None:
            return True
        gained = float(np.trace(self._main.belief.covariance[:3, :3])) - standing.variance_m2
        return gained > options.drift_m**2 or self._time_s - standing.last_answer_s > options.longest_s

    @property
    def may_ask(self) -> bool:
        """Whether a question may be asked: none is open, and the rate allows it."""
        if self._time_s is None or self._question is not None:
            return False
        # With an IMU, the first two answers must be some time apart, because they give the velocity.
        in_haste = not self._standing.settled and (self._main is None or self._has_odometry)
        return self._pace.allows(self._time_s, in_haste)

    def check_time(self, time_s: float) -> None:
        """Refuse a frame's time that is not after the last one's. Raises InvalidTrack."""
        _check_time(time_s, self._time_s, "frame")

    def ask(self) -> Question:
        """Record that the last frame is being asked about; one question at a time."""
        assert self._time_s is not None
        assert self._question is None
        self._question = Question(self._time_s, self._prior(), self._hypotheses)
        self._since = []
        self._pace.asked(self._time_s)
        return self._question

    def unanswered(self) -> None:
        """Record that there was no pose, or that the service did not answer."""
        self._question = None
        assert self._time_s is not None
        self._pace.came(False, self._time_s)

    def answered(
        self, answer: Answer | None, since: list[Step] | None = None, T_odom_camera: FloatArray | None = None
    ) -> None:
        """Take in the answer to the question.

        Args:
            answer: None where there is no pose.
            since: the camera's steps from the question's frame to the last one, if they only became known now.
            T_odom_camera: with ``since``: the camera's pose (4, 4) at the last frame by odometry, or None.

        Raises:
            InvalidTrack: the map has no scale, which odometry and IMU need.
        """
        question, time_s = self._question, self._time_s
        if question is None or time_s is None:
            return  # the track that asked ended at a gap between frames
        if answer is None:
            self.unanswered()
            return
        if not answer.metric and (self._has_odometry or self._imu_s is not None):
            self._question = None
            raise InvalidTrack("The map's scale is unknown, so odometry in metres cannot be used with it.")
        main = self._main if self._standing.settled else None
        before = None if main is None else moved(main.belief.T_map_camera, self._offset)
        steps: list[Step | ImuReading] = self._since if since is None else [*since]
        if since is not None:
            self._T_odom_camera = T_odom_camera
            self._has_odometry = self._has_odometry or T_odom_camera is not None
        judged = self._judged if self._standing.settled else self._weighed
        hypotheses, of_use = judged(question, answer)
        self._question = None
        for step in steps:
            hypotheses = tuple(one.advanced(step) for one in hypotheses)
        self._hypotheses = hypotheses
        self._pace.came(of_use, time_s)
        self._blend_in(before)

    @property
    def _main(self) -> _Hypothesis | None:
        """The likeliest hypothesis; the one that the track follows, once it is settled."""
        return self._hypotheses[0] if self._hypotheses else None

    def _weighed(self, question: Question, answer: Answer) -> tuple[tuple[_Hypothesis, ...], bool]:
        """The hypotheses after an answer, at the question's time, likeliest first, while none is sure.

        By Bayes: an answer names each of its places with a probability, and with the rest of it says nothing.
        """
        says_nothing = max(0.0, 1.0 - sum(one.recognized for one in answer.modes))
        unknown = max(_UNFORESEEN, 1.0 - sum(one.weight for one in question.hypotheses))
        left, found = list(answer.modes), []
        for one in question.hypotheses:
            if self._is_lost(one.belief):
                continue
            mode = next((mode for mode in left if one.agrees(mode)), None)
            likelihood = says_nothing + max(_MISSED, 0.0 if mode is None else mode.recognized)
            found.append(replace(one if mode is None else one.corrected(mode), weight=one.weight * likelihood))
            if mode is not None:
                left.remove(mode)
        found += [replace(self._hypothesis(mode), weight=unknown * mode.recognized) for mode in left]
        total = sum(one.weight for one in found) + unknown * says_nothing
        likely = sorted((replace(one, weight=one.weight / total) for one in found), key=lambda one: -one.weight)
        kept = tuple(one for one in likely if one.weight >= _MIN_WEIGHT)[:_HYPOTHESES]
        if not kept:
            return (), False
        main = kept[0]
        knows_motion = self._has_odometry and not isinstance(main.belief, InertialBelief)
        if main.weight >= _SURE and (knows_motion or main.answers >= 2):
            self._standing.settled, kept = True, (main,)
        of_use = says_nothing < _SAYS_NOTHING
        if of_use:
            self._follow(main, question.time_s)
        return kept, of_use

    def _judged(self, question: Question, answer: Answer) -> tuple[tuple[_Hypothesis, ...], bool]:
        """The hypotheses after an answer, at the question's time, and whether the answer was useful."""
        standing = self._standing
        main, rival = (*question.hypotheses, None)[:2]
        assert main is not None
        expected = next((one for one in answer.modes if one.recognized >= _LIKELY and main.agrees(one)), None)
        if expected is not None:
            followed = main.corrected(expected)
            self._follow(followed, question.time_s)
            return (followed,), True
        if not answer.localized:
            return question.hypotheses, False
        rival = rival.corrected(answer) if rival is not None and rival.agrees(answer) else self._hypothesis(answer)
        lost = self._is_lost(main.belief) and answer.recognized >= _SURE
        untenable = standing.contradicted + 1 >= _UNTENABLE
        if lost or untenable or rival.answers > min(main.answers, 2):
            self._follow(rival, question.time_s)
            standing.reset_counter += 1
            self._offset = np.full(6, np.nan)  # earlier poses are void
            return (rival,), True
        standing.rejected += 1
        standing.contradicted += 1
        return (main, rival), False

    def _follow(self, main: _Hypothesis, time_s: float) -> None:
        """Record an answer that the track accepts."""
        standing = self._standing
        standing.last_answer_s, standing.contradicted = time_s, 0
        standing.used += 1
        standing.variance_m2 = float(np.trace(main.belief.covariance[:3, :3]))

    def _hypothesis(self, answer: Answer) -> _Hypothesis:
        if self._imu_s is not None and not self._has_odometry:
            inertial = InertialBelief.at(answer.T_map_camera, answer.inflated_covariance, self.options.imu)
            return _Hypothesis(inertial, 1, answer.recognized)
        belief = PoseBelief.at(answer.T_map_camera, answer.inflated_covariance, self.options.odometry)
        return _Hypothesis(belief, 1, answer.recognized)

    def _blend_in(self, before: FloatArray | None) -> None:
        """Apply a correction over time if it is small, else at once."""
        jumped = bool(np.isnan(self._offset).any())
        if self._main is None or before is None or jumped:
            self._offset = np.zeros(6)
            return
        offset = motion_between(self._main.belief.T_map_camera, before)
        apart_m, turned_deg = float(np.linalg.norm(offset[:3])), math.degrees(float(np.linalg.norm(offset[3:])))
        if apart_m > self.options.jump_m or turned_deg > self.options.jump_deg:
            self._standing.reset_counter += self._standing.settled
            offset = np.zeros(6)
        self._offset = offset if self.options.smoothing_s > 0 else np.zeros(6)

    def _advance(self, duration_s: float, T_odom_camera: FloatArray | None) -> None:
        assert self._time_s is not None
        known = T_odom_camera is not None and self._T_odom_camera is not None
        T_before_now = inverse(self._T_odom_camera) @ T_odom_camera if known else None  # type: ignore[arg-type, operator]
        motions: list[Step | ImuReading] = [Step(duration_s, T_before_now)]
        motions += self._read(self._time_s, self._time_s + duration_s)
        for motion in motions:
            self._hypotheses = tuple(one.advanced(motion) for one in self._hypotheses)
        if self._question is not None:
            self._since += motions

    def _read(self, start_s: float, end_s: float) -> list[ImuReading]:
        """The IMU's readings in an interval; the last one is held until its end."""
        found, at_s = [], start_s
        while self._readings and self._readings[0][0] <= end_s:
            time_s, acceleration, rate = self._readings.popleft()
            if time_s > at_s:
                _, last_acceleration, last_rate = self._last_reading or (time_s, acceleration, rate)
                found.append(ImuReading(time_s - at_s, (acceleration + last_acceleration) / 2, (rate + last_rate) / 2))
                at_s = time_s
            self._last_reading = (time_s, acceleration, rate)
        if self._last_reading is not None and end_s > at_s:
            found.append(ImuReading(end_s - at_s, self._last_reading[1], self._last_reading[2]))
        return found

    def _drop_readings(self, time_s: float) -> None:
        while self._readings and self._readings[0][0] <= time_s:
            self._last_reading = self._readings.popleft()

    def _start_over(self) -> None:
        """Forget everything, after a long gap."""
        standing = self._standing
        standing.reset_counter += standing.settled
        standing.settled, standing.contradicted = False, 0
        self._hypotheses, self._question = (), None
        self._since, self._offset = [], np.zeros(6)

    def _is_lost(self, belief: Belief) -> bool:
        sigmas = np.sqrt(np.diag(belief.covariance))
        return bool(sigmas[:3].max() > self.options.lost_m or math.degrees(sigmas[3:].max()) > self.options.lost_deg)

    def _prior(self) -> Prior | None:
        """Where the frame's pose is expected; None while the track is in doubt, so that the answer is independent."""
        if self._main is None or not self._standing.settled or self._standing.contradicted:
            return None
        belief = self._main.belief
        if self._is_lost(belief):
            return None
        sigmas = np.sqrt(np.diag(belief.covariance))
        pose = _pose_of(belief.T_map_camera)
        return pose.as_prior(0.3 + 3 * float(sigmas[:3].max()), 10 + 3 * math.degrees(float(sigmas[3:].max())))


def _check_time(time_s: float, last_s: float | None, what: str) -> None:
    if not math.isfinite(time_s):
        raise InvalidTrack(f"The time of a {what} is not a finite number.")
    if last_s is not None and time_s <= last_s:
        raise InvalidTrack(f"The time of a {what}, {time_s:.6f} s, is not after the last one's, {last_s:.6f} s.")


def _pose_of(T: FloatArray) -> Pose:
    x, y, z = T[:3, 3].tolist()
    hx, hy, hz = T[:3, 2].tolist()
    return Pose((x, y, z), (hx, hy, hz), _roll_deg(T), quaternion_of(T[:3, :3]), _rows(T))


def _roll_deg(T: FloatArray) -> float:
    """The rotation about the heading against a camera whose x axis is horizontal, degrees."""
    heading = T[:3, 2]
    level = np.cross(heading, (0.0, 0.0, 1.0))
    if np.linalg.norm(level) < 1e-6:  # it looks straight up or down
        return 0.0
    level /= np.linalg.norm(level)
    return math.degrees(math.atan2(float(T[:3, 0] @ np.cross(heading, level)), float(T[:3, 0] @ level)))


def _rows(matrix: FloatArray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in matrix.tolist())
