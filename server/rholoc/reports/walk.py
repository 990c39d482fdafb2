"""Report on a walk, with advice for the next one."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

from pydantic import Field


class WarningKind(StrEnum):
    """Kind of a problem of a usable recording."""

    TIME_UNIT = "time_unit"  # times are in another unit than the format says
    ACCELERATION_UNIT = "acceleration_unit"  # in g where m/s² is expected, or the other way round
    GRAVITY = "gravity"  # removed where it should be included, or the other way round
    SIGN = "sign"  # the acceleration has Apple's sign where it should not
    GYROSCOPE_UNIT = "gyroscope_unit"  # degrees where radians are expected
    LOW_IMU_RATE = "low_imu_rate"
    IMU_GAP = "imu_gap"
    FRAME_GAP = "frame_gap"
    REPEATED_TIMES = "repeated_times"  # rows or frames whose time does not advance; they are ignored
    FRAME_COUNT = "frame_count"  # the video and its table of times, or its index, differ
    NO_OVERLAP = "no_overlap"  # the IMU does not cover the frames
    SCALE_UNKNOWN = "scale_unknown"  # the poses' unit of length is not stated
    CAMERA_UNSUPPORTED = "camera_unsupported"  # intrinsics of a model that is not pinhole
    NOT_USED = "not_used"  # something in the recording that is ignored
    NO_IMAGES = "no_images"  # times of frames without the frames


@dataclass(frozen=True)
class RecordingWarning:
    """One problem of a recording.

    Attributes:
        kind: a :class:`WarningKind`, or one that a later version knows.
        text: one line that says what the problem is and what suffers.
    """

    kind: Annotated[WarningKind | str, Field(union_mode="left_to_right")]
    text: str


class AdviceKind(StrEnum):
    """Kind of advice."""

    TOO_FAST = "too_fast"
    TOO_DARK = "too_dark"
    TOO_LITTLE_TEXTURE = "too_little_texture"
    PAUSES_MISSING = "pauses_missing"
    NO_LOOP = "no_loop"


@dataclass(frozen=True)
class Advice:
    """One thing to do better.

    Attributes:
        kind: what was lacking: an :class:`AdviceKind`, or one that a later version knows.
        text: one line that says what to do, with the figure.
        figure: what was measured.
        limit: what it was measured against.
    """

    kind: Annotated[AdviceKind | str, Field(union_mode="left_to_right")]
    text: str
    figure: float
    limit: float


@dataclass(frozen=True)
class WalkFigures:
    """Figures of a walk; None if not measured.

    Attributes:
        turn_deg_s: the turning speed, degrees a second, that is exceeded in a tenth of the walk.
        brightness: the median over frames of their mean grey level, 0 to 255.
        bare_share: the share of frames that show too few corners.
        pauses: how many of the waypoints were rested at, where there are waypoints and an IMU.
        waypoints: how many waypoints there are.
        nearest_return: how near the second half of the walk comes to the first, as a share of the distance walked in
            between; small where the walk closes a loop, 1 where it is straight. None for pictures without times.
    """

    turn_deg_s: float | None = None
    brightness: float | None = None
    bare_share: float | None = None
    pauses: int | None = None
    waypoints: int = 0
    nearest_return: float | None = None


@dataclass(frozen=True)
class CoachingReport:
    """A mapping job's report on one recording.

    Attributes:
        recording: its name.
        figures: what was measured of the walk.
        warnings: problems of the recording.
        advice: what to do better next time; none for a good walk.
    """

    recording: str
    figures: WalkFigures
    warnings: tuple[RecordingWarning, ...] = ()
    advice: tuple[Advice, ...] = ()
