"""Convert a phone's IMU log to seconds, m/s² and rad/s with one row per time. Pure functions, used by all readers.

Apps, versions and settings deviate from documented units. The numbers take precedence over the documentation, and each
deviation is reported as a warning:
- unit of time: by the sampling interval, since IMUs sample at 2.5 to 2500 Hz;
- g or m/s², with or without gravity: by the norm of the acceleration, which is steady only with gravity;
- degrees or radians: by speeds that no hand reaches, else by consistency with the rotation of gravity;
- Apple's sign, which gravity alone cannot show: by poses that come with the recording.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidRecording
from rholoc.geometry import FloatArray, IntArray
from rholoc.recordings.recording import GivenPoses, Imu
from rholoc.reports import RecordingWarning, WarningKind

STANDARD_GRAVITY = 9.80665  # m/s²
MIN_RATE_HZ = 25.0  # the paper's floor

_PER_SECOND = {"s": 1.0, "ms": 1e3, "µs": 1e6, "ns": 1e9}  # divisors, which are exact: 1e-9 is not
_LONGEST_IMU_INTERVAL_S = 0.4
_SHORTEST_FRAME_INTERVAL_S = 0.002
_LONGEST_FRAME_INTERVAL_S = 4.0
MAX_SPAN_S = 48 * 3600.0  # from the first row of a table to its last
_MAX_DROPPED = 0.05  # maximum share of rows whose time does not advance
_GAP_INTERVALS = 5.0  # a gap is this many usual intervals …
_GAP_S = 0.1  # … and at least this long
_MIN_TO_MEASURE = 20
_STEADY = 0.65  # ratio of the 10th percentile to the median of the acceleration's norm: larger with gravity
_ONE_G_TOLERANCE = 0.15  # of the median norm, in g
_LARGEST = 1e5  # maximum reading in any unit
_FASTEST_TURN = 12.0  # rad/s, maximum 95th percentile of a walking hand
_TURN_WINDOW_S = 0.4
_NOTICEABLE_TURN = 0.05  # rad that gravity must turn between two windows to count …
_MIN_TURNS = 5  # … this often
_DISTINCTLY = 3.0  # degrees must fit this many times better than radians; a wrong sign alone gives 2


@dataclass(frozen=True, eq=False)
class Samples:
    """Logged samples of one sensor: times (M,) and values (M, 3), in any units."""

    times: FloatArray
    values: FloatArray

    @classmethod
    def from_rows(cls, rows: FloatArray) -> Samples:
        """Samples from rows (M, 4) of time, x, y, z."""
        return cls(rows[:, 0], rows[:, 1:])


@dataclass(frozen=True)
class ImuConvention:
    """Documented units of a format.

    Attributes:
        time_unit: one of s, ms, µs, ns.
        in_g: whether the acceleration is in multiples of standard gravity, not m/s².
        includes_gravity: whether it includes gravity's reaction.
        apple_sign: whether the acceleration is negated as in CoreMotion: −1 g upwards at rest.
    """

    time_unit: str = "s"
    in_g: bool = False
    includes_gravity: bool = True
    apple_sign: bool = False


def normalise_imu(
    accelerometer: Samples,
    gyroscope: Samples,
    says: ImuConvention,
    R_camera_imu: FloatArray | None = None,
) -> tuple[Imu, tuple[RecordingWarning, ...]]:
    """Combine both sensors in one table at the gyroscope's times, in seconds, m/s² and rad/s; and warnings.

    Args:
        accelerometer, gyroscope: as logged; their times may differ, and be out of order.
        says: documented units, used unless the numbers contradict them.
        R_camera_imu: (3, 3), or None if unknown.

    Raises:
        InvalidRecording: more than 5 % of the times do not advance, times are implausible in every unit, fewer than two
            readings of the gyroscope lie within the accelerometer's time span, or a value is out of range in any unit.
    """
    _check_range(accelerometer, "accelerometer")
    _check_range(gyroscope, "gyroscope")
    warnings: list[RecordingWarning] = []
    if np.array_equal(accelerometer.times, gyroscope.times):
        accelerometer, gyroscope = _on_clock("IMU", [accelerometer, gyroscope], says.time_unit, warnings)
    else:
        (accelerometer,) = _on_clock("accelerometer", [accelerometer], says.time_unit, warnings)
        (gyroscope,) = _on_clock("gyroscope", [gyroscope], says.time_unit, warnings)
    measured = measure_acceleration(accelerometer.values, says)
    warnings += _convention_warnings(says, measured)
    factor = (STANDARD_GRAVITY if measured.in_g else 1.0) * (-1 if measured.apple_sign else 1)
    accelerometer = replace(accelerometer, values=accelerometer.values * factor)
    if is_in_degrees(gyroscope, accelerometer if measured.includes_gravity else None):
        warnings.append(RecordingWarning(WarningKind.GYROSCOPE_UNIT, "The gyroscope is in degrees a second."))
        gyroscope = replace(gyroscope, values=np.radians(gyroscope.values))
    times, acceleration, rate = _merged(accelerometer, gyroscope)
    return Imu(times, acceleration, rate, measured.includes_gravity, R_camera_imu), tuple(warnings)


def time_unit(times: FloatArray, longest_s: float = _LONGEST_IMU_INTERVAL_S) -> str | None:
    """Unit of times (M,): the one of s, ms, µs and ns that makes their median interval plausible.

    Plausible is more than ``longest_s`` / 1000 and at most ``longest_s`` [s]; intervals of 0 are ignored. None if no
    unit fits, or without two different times.
    """
    steps = np.abs(np.diff(times))
    steps = steps[steps > 0]
    if len(steps) == 0:
        return None
    median = float(np.median(steps))
    for unit, per_second in _PER_SECOND.items():
        if longest_s / 1000 < median / per_second <= longest_s:
            return unit
    return None


def frame_times_s(times: FloatArray, says: str) -> tuple[FloatArray, tuple[RecordingWarning, ...]]:
    """Convert times (N,) of frames to seconds, and warn if they are not in the documented unit ``says``.

    That unit is used if the median interval is then 2 ms to 4 s; else the unit that makes the interval 2 ms to 2 s;
    else ``says`` after all.

    Raises:
        InvalidRecording: the times span more than 48 hours.
    """
    steps = np.abs(np.diff(times)) / _PER_SECOND[says]
    plausible = len(steps) == 0 or _SHORTEST_FRAME_INTERVAL_S < np.median(steps) <= _LONGEST_FRAME_INTERVAL_S
    unit = says if plausible else time_unit(times, 1000 * _SHORTEST_FRAME_INTERVAL_S) or says
    warnings = () if unit == says else (_unit_warning("frames", unit, says),)
    return checked_span(times / _PER_SECOND[unit], "frames"), warnings


def checked_span(times: FloatArray, what: str) -> FloatArray:
    """Return times (M,) [s] unchanged after checking their span: one wrong time could mean years of samples to fill in.

    Raises:
        InvalidRecording: they span more than ``MAX_SPAN_S``.
    """
    span_s = float(np.ptp(times)) if len(times) else 0.0
    if span_s > MAX_SPAN_S:
        raise InvalidRecording(
            f"The times of the {what} span {span_s:.6g} s; {MAX_SPAN_S:g} s is the limit.",
            "One of them is wrong, or several recordings are in one table: record again, or repair it.",
        )
    return times


def advancing_rows(times: FloatArray, what: str) -> tuple[IntArray, tuple[RecordingWarning, ...]]:
    """Rows (K,) whose time exceeds all times (M,) before it, and a warning about the other rows, if any.

    Raises:
        InvalidRecording: more than 5 % of the rows are dropped.
    """
    latest = np.maximum.accumulate(times)
    advances = np.ones(len(times), dtype=np.bool_)
    advances[1:] = times[1:] > latest[:-1]
    dropped = len(times) - int(advances.sum())
    if dropped == 0:
        return np.arange(len(times)), ()
    first = int(np.argmin(advances))
    if dropped > _MAX_DROPPED * len(times):
        raise InvalidRecording(
            f"The times of the {what} do not increase: {dropped} of {len(times)} do not come after those before them, "
            f"the first {times[first]:.6f} s after {latest[first - 1]:.6f} s.",
            "Record again, or repair the table of times.",
        )
    repeated = int(np.sum(times[1:] == latest[:-1]))
    text = f"{dropped} rows of the {what} were ignored: {repeated} repeat a time, {dropped - repeated} go back."
    return np.flatnonzero(advances), (RecordingWarning(WarningKind.REPEATED_TIMES, text),)


def rate_warnings(times: FloatArray, sensor: str) -> tuple[RecordingWarning, ...]:
    """Warnings if a sensor with times (M,) [s] has less than 25 Hz, or gaps. ``sensor`` names it."""
    warnings = []
    steps = np.diff(times)
    if len(steps) and (rate_hz := 1 / float(np.median(steps))) < MIN_RATE_HZ:
        text = (
            f"The {sensor} has {rate_hz:.1f} Hz; below {MIN_RATE_HZ:.0f} Hz the integrated path, the scale and the "
            "time offset suffer."
        )
        warnings.append(RecordingWarning(WarningKind.LOW_IMU_RATE, text))
    gaps = gap_rows(times)
    if len(gaps):
        longest = float(steps[gaps].max())
        text = f"The {sensor} has {len(gaps)} gaps, the longest {longest:.2f} s; the path through them is a guess."
        warnings.append(RecordingWarning(WarningKind.IMU_GAP, text))
    return tuple(warnings)


def gap_rows(times: FloatArray) -> IntArray:
    """Rows of times (M,) [s] followed by a gap: over five median intervals, and over 0.1 s."""
    steps = np.diff(times)
    if len(steps) == 0:
        return np.zeros(0, dtype=np.int64)
    return np.flatnonzero(steps > max(_GAP_INTERVALS * float(np.median(steps)), _GAP_S))


def measure_acceleration(values: FloatArray, says: ImuConvention) -> ImuConvention:
    """Convention ``says`` with ``in_g`` and ``includes_gravity`` as measured from accelerations (M, 3).

    Unchanged with fewer than 20 rows, or if the norms fit neither unit.
    """
    if len(values) < _MIN_TO_MEASURE:
        return says
    low, median = np.percentile(np.linalg.norm(values, axis=1), [10, 50])
    if _is_one(median / STANDARD_GRAVITY):  # no hand accelerates by 1 g half of the time
        return replace(says, in_g=False, includes_gravity=True)
    if low <= _STEADY * median:
        return replace(says, includes_gravity=False)
    return replace(says, in_g=True, includes_gravity=True) if _is_one(median) else says


def is_in_degrees(gyroscope: Samples, accelerometer: Samples | None) -> bool:
    """Whether a gyroscope's samples are in degrees per second, not radians per second.

    They are if as radians their 95th percentile exceeds 12 rad/s, or if as degrees they predict the rotation of gravity
    three times better. The accelerometer's samples must include gravity; None if there are none. False below 20 rows.
    """
    if len(gyroscope.values) < _MIN_TO_MEASURE:
        return False
    if np.percentile(np.linalg.norm(gyroscope.values, axis=1), 95) > _FASTEST_TURN:
        return True
    if accelerometer is None:
        return False
    down, turns = _gravity_turns(accelerometer, gyroscope)
    turning = np.linalg.norm(down[1:] - down[:-1], axis=1) > _NOTICEABLE_TURN
    if turning.sum() < _MIN_TURNS:
        return False
    as_radians, as_degrees = (
        float(
            np.median(np.linalg.norm(Rotation.from_rotvec(-turn).apply(down[:-1][turning]) - down[1:][turning], axis=1))
        )
        for turn in (turns[turning], np.radians(turns[turning]))
    )
    return as_radians > _DISTINCTLY * as_degrees


def force_points_up(imu: Imu, times: FloatArray, R_map_camera: FloatArray) -> bool | None:
    """Whether gravity's reaction points up, given camera rotations (N, 3, 3) at ``times`` (N,) [s].

    With Apple's sign it points down. None if the mounting is unknown, gravity is removed, or the times do not overlap.
    """
    inside = (times >= imu.times[0]) & (times <= imu.times[-1])
    if imu.R_camera_imu is None or not imu.includes_gravity or not inside.any():
        return None
    acceleration = np.column_stack([np.interp(times[inside], imu.times, imu.acceleration[:, i]) for i in range(3)])
    in_map = np.einsum("nij,jk,nk->ni", R_map_camera[inside], imu.R_camera_imu, acceleration)
    return bool(in_map[:, 2].mean() > 0)


def with_sign_by_poses(
    imu: Imu, times: FloatArray, poses: GivenPoses | None
) -> tuple[Imu, tuple[RecordingWarning, ...]]:
    """The IMU, with its acceleration negated and a warning if upright poses at ``times`` (N,) show Apple's sign."""
    if poses is None or force_points_up(imu, times[poses.known], poses.T_map_camera[poses.known, :3, :3]) is not False:
        return imu, ()
    text = "The acceleration points down at rest, against its format; its sign was reversed."
    return replace(imu, acceleration=-imu.acceleration), (RecordingWarning(WarningKind.SIGN, text),)


def interpolated(samples: Samples, times: FloatArray) -> FloatArray:
    """Values (N, 3) at ``times`` (N,), linear between the samples, constant beyond them."""
    return np.column_stack([np.interp(times, samples.times, samples.values[:, axis]) for axis in range(3)])


def _check_range(samples: Samples, sensor: str) -> None:
    """Raise InvalidRecording, naming ``sensor``, if a value is above 1e5."""
    largest = float(np.abs(samples.values).max(initial=0.0))
    if largest > _LARGEST:
        raise InvalidRecording(f"The {sensor} reads {largest:.3g}, which is out of range in any unit.")


def _is_one(length_g: float) -> bool:
    """Whether an acceleration [g] is about 1 g."""
    return abs(length_g - 1) < _ONE_G_TOLERANCE


def _on_clock(what: str, sensors: list[Samples], says: str, warnings: list[RecordingWarning]) -> list[Samples]:
    """Sensors with shared times converted to seconds, without rows that do not advance; appends to ``warnings``. Raises
    InvalidRecording for implausible times, a span over two days, or many times that go back.
    """
    times = sensors[0].times
    unit = time_unit(times)
    if unit is None and len(times) >= _MIN_TO_MEASURE:
        raise InvalidRecording(
            f"The times of the {what} are implausible in seconds, ms, µs and ns.",
            "They must advance by the time between two samples.",
        )
    unit = unit or says
    if unit != says:
        warnings.append(_unit_warning(what, unit, says))
    times = checked_span(times / _PER_SECOND[unit], what)
    rows, dropped = advancing_rows(times, what)
    warnings += [*dropped, *rate_warnings(times[rows], what)]
    return [Samples(times[rows], samples.values[rows]) for samples in sensors]


def _unit_warning(what: str, unit: str, says: str) -> RecordingWarning:
    """Warning that the times of ``what`` are in ``unit``, not in the documented one, ``says``."""
    return RecordingWarning(WarningKind.TIME_UNIT, f"The times of the {what} are in {unit}, not in {says}.")


def _convention_warnings(says: ImuConvention, measured: ImuConvention) -> list[RecordingWarning]:
    """A warning for each difference of the measured convention from the documented one, ``says``."""
    warnings = []
    if measured.in_g != says.in_g:
        unit = "g" if measured.in_g else "m/s²"
        warnings.append(RecordingWarning(WarningKind.ACCELERATION_UNIT, f"The acceleration is in {unit}."))
    if measured.includes_gravity != says.includes_gravity:
        text = (
            "The acceleration includes gravity."
            if measured.includes_gravity
            else "The acceleration is without gravity: the IMU cannot tell which way is up."
        )
        warnings.append(RecordingWarning(WarningKind.GRAVITY, text))
    return warnings


def _gravity_turns(accelerometer: Samples, gyroscope: Samples) -> tuple[FloatArray, FloatArray]:
    """Unit direction of the acceleration (K + 1, 3) in windows of 0.4 s, and the gyroscope's rotation vectors
    (K, 3) between the windows, in its angular unit. K = 0 if the sensors overlap by less than 0.8 s.
    """
    first, last = max(accelerometer.times[0], gyroscope.times[0]), min(accelerometer.times[-1], gyroscope.times[-1])
    edges = np.arange(first, last, _TURN_WINDOW_S)
    if len(edges) < 3:
        return np.zeros((1, 3)), np.zeros((0, 3))
    down = np.diff(interpolated(_integral(accelerometer), edges), axis=0)
    down = down / np.maximum(np.linalg.norm(down, axis=1, keepdims=True), 1e-9)
    middles = edges[:-1] + _TURN_WINDOW_S / 2
    return down, np.diff(interpolated(_integral(gyroscope), middles), axis=0)


def _integral(samples: Samples) -> Samples:
    """Values integrated over time, from 0 at the first sample."""
    steps = samples.values[1:] * np.diff(samples.times)[:, None]
    return Samples(samples.times, np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)]))


def _merged(accelerometer: Samples, gyroscope: Samples) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times (M,), accelerations and rates (M, 3) at the gyroscope's times within the accelerometer's. Raises
    InvalidRecording if these are fewer than two.
    """
    if np.array_equal(accelerometer.times, gyroscope.times):
        return gyroscope.times, accelerometer.values, gyroscope.values
    inside = (gyroscope.times >= accelerometer.times[0]) & (gyroscope.times <= accelerometer.times[-1])
    if inside.sum() < 2:
        (first, last), (first_rate, last_rate) = accelerometer.times[[0, -1]], gyroscope.times[[0, -1]]
        raise InvalidRecording(
            "Accelerometer and gyroscope do not overlap in time: "
            f"{first:.3f}–{last:.3f} s and {first_rate:.3f}–{last_rate:.3f} s.",
            "Both must use the same clock.",
        )
    times = gyroscope.times[inside]
    return times, interpolated(accelerometer, times), gyroscope.values[inside]
