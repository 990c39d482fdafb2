"""An IMU's table in any unit, order and state: seconds, m/s² and rad/s come of it, and problems are reported."""

from dataclasses import replace

import numpy as np
import phone_recordings as phone
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rholoc.errors import InvalidRecording
from rholoc.geometry import FloatArray
from rholoc.recordings import GivenPoses
from rholoc.recordings.imu_normalisation import (
    ImuConvention,
    Samples,
    force_points_up,
    frame_times_s,
    normalise_imu,
    time_unit,
    with_sign_by_poses,
)
from rholoc.reports import WarningKind

TIMES = phone.START_S + np.arange(400) / 100
R, _, RATE, FELT = phone.truth(TIMES)
LINEAR = FELT - np.einsum("nji,j->ni", R, [0, 0, phone.GRAVITY])
PER_SECOND = {"s": 1, "ms": 1e3, "µs": 1e6, "ns": 1e9}


def kinds(warnings: tuple) -> list[WarningKind]:
    return [warning.kind for warning in warnings]


def normalised(
    times: FloatArray = TIMES, felt: FloatArray = FELT, rate: FloatArray = RATE, says: ImuConvention | None = None
) -> tuple:
    return normalise_imu(Samples(times, felt), Samples(times, rate), says or ImuConvention())


@pytest.mark.parametrize("says", PER_SECOND)
@pytest.mark.parametrize("unit", PER_SECOND)
@pytest.mark.parametrize("in_g", [False, True])
@pytest.mark.parametrize("in_degrees", [False, True])
def test_units_are_what_the_numbers_show(unit: str, says: str, in_g: bool, in_degrees: bool) -> None:
    felt = FELT / phone.GRAVITY if in_g else FELT
    rate = np.degrees(RATE) if in_degrees else RATE
    imu, warnings = normalised(TIMES * PER_SECOND[unit], felt, rate, ImuConvention(time_unit=says))
    np.testing.assert_allclose(imu.times, TIMES, rtol=1e-12)
    np.testing.assert_allclose(imu.acceleration, FELT, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(imu.angular_velocity, RATE, rtol=1e-9, atol=1e-12)
    expected = [WarningKind.TIME_UNIT] * (unit != says) + [WarningKind.ACCELERATION_UNIT] * in_g
    assert kinds(warnings) == expected + [WarningKind.GYROSCOPE_UNIT] * in_degrees


def test_degrees_that_no_hand_turns_by_are_degrees_without_gravity_too() -> None:
    imu, warnings = normalised(felt=LINEAR, rate=np.degrees(RATE), says=ImuConvention(includes_gravity=False))
    np.testing.assert_allclose(imu.angular_velocity, RATE)
    assert kinds(warnings) == [WarningKind.GYROSCOPE_UNIT]


def test_a_gyroscope_with_the_wrong_sign_is_not_in_degrees() -> None:
    imu, warnings = normalised(rate=-RATE)
    np.testing.assert_array_equal(imu.angular_velocity, -RATE)
    assert warnings == ()


def test_at_rest_nothing_shows_degrees() -> None:
    rest = np.tile([0.0, 0.0, phone.GRAVITY], (400, 1))
    tremor = 0.01 * np.sin(np.arange(1200)).reshape(400, 3)
    imu, warnings = normalised(felt=rest, rate=tremor)
    np.testing.assert_array_equal(imu.angular_velocity, tremor)
    assert warnings == ()


@pytest.mark.parametrize("said", [False, True])
@pytest.mark.parametrize("included", [False, True])
def test_gravity_included_or_removed(said: bool, included: bool) -> None:
    imu, warnings = normalised(felt=FELT if included else LINEAR, says=ImuConvention(includes_gravity=said))
    assert imu.includes_gravity is included
    assert kinds(warnings) == [WarningKind.GRAVITY] * (said != included)


def test_a_sensor_that_warms_up_has_gravity_all_the_same() -> None:
    felt = FELT.copy()
    felt[:60] = 0
    imu, warnings = normalised(felt=felt)
    assert imu.includes_gravity
    assert warnings == ()


def test_apples_sign_is_turned_round_where_the_format_has_it() -> None:
    imu, warnings = normalised(felt=-FELT / phone.GRAVITY, says=ImuConvention(in_g=True, apple_sign=True))
    np.testing.assert_allclose(imu.acceleration, FELT)
    assert warnings == ()


def test_poses_tell_the_sign() -> None:
    imu, _ = normalised()
    mounted = replace(imu, R_camera_imu=phone.R_PORTRAIT_CAMERA_IMU)
    R_map_camera = R @ phone.R_PORTRAIT_CAMERA_IMU.T
    assert force_points_up(imu, TIMES, R_map_camera) is None
    assert force_points_up(replace(mounted, includes_gravity=False), TIMES, R_map_camera) is None
    assert force_points_up(mounted, TIMES + 100, R_map_camera) is None
    T_map_camera = np.tile(np.eye(4), (len(TIMES), 1, 1))
    T_map_camera[:, :3, :3] = R_map_camera
    poses = GivenPoses(TIMES[300] > TIMES, T_map_camera)
    assert with_sign_by_poses(mounted, TIMES, poses) == (mounted, ())
    turned = replace(mounted, acceleration=-mounted.acceleration)
    back, warnings = with_sign_by_poses(turned, TIMES, poses)
    np.testing.assert_array_equal(back.acceleration, mounted.acceleration)
    assert kinds(warnings) == [WarningKind.SIGN]
    assert with_sign_by_poses(turned, TIMES, None) == (turned, ())


def test_sensors_with_times_of_their_own_come_to_the_gyroscopes() -> None:
    later = TIMES[:-20:2] + 0.103
    imu, warnings = normalise_imu(Samples(later, phone.truth(later)[3]), Samples(TIMES, RATE), ImuConvention())
    assert imu.times[0] >= later[0]
    assert imu.times[-1] <= later[-1]
    np.testing.assert_allclose(imu.acceleration, phone.truth(imu.times)[3], atol=0.02)
    np.testing.assert_allclose(imu.angular_velocity, phone.truth(imu.times)[2], atol=1e-6)
    assert warnings == ()


def test_a_slow_sensor_is_reported_and_what_suffers() -> None:
    _, warnings = normalised(TIMES[::5], FELT[::5], RATE[::5])
    assert kinds(warnings) == [WarningKind.LOW_IMU_RATE]
    assert "20.0 Hz" in warnings[0].text
    assert "scale" in warnings[0].text
    _, warnings = normalised(TIMES[::4], FELT[::4], RATE[::4])  # 25 Hz: the least that will do
    assert warnings == ()


def test_gaps_are_reported_with_the_longest() -> None:
    kept = np.r_[0:100, 115:200, 260:400]
    _, warnings = normalised(TIMES[kept], FELT[kept], RATE[kept])
    assert kinds(warnings) == [WarningKind.IMU_GAP]
    assert "2 gaps, the longest 0.61 s" in warnings[0].text


def test_repeated_and_backward_times_are_left_out_and_reported() -> None:
    times = TIMES.copy()
    times[50] = times[49]
    times[100] = times[97]
    imu, warnings = normalised(times)
    assert len(imu.times) == 398
    assert np.all(np.diff(imu.times) > 0)
    assert kinds(warnings) == [WarningKind.REPEATED_TIMES]
    assert "1 repeat a time, 1 go back" in warnings[0].text


@pytest.mark.parametrize(
    ("times", "complaint"),
    [
        (np.concatenate([TIMES[200:], TIMES[:200]]), "200 of 400 do not come after"),
        (TIMES[::-1], "399 of 400"),
        (np.full(400, 7.0), "are implausible"),
        (np.arange(400) * 1e13, "are implausible"),
    ],
)
def test_times_that_no_unit_explains_are_refused(times: FloatArray, complaint: str) -> None:
    with pytest.raises(InvalidRecording, match=complaint):
        normalised(times)


def test_sensors_with_times_of_their_own_are_told_apart() -> None:
    later = TIMES + 0.001
    kept = np.r_[0:100, 150:400]
    _, warnings = normalise_imu(Samples(later[::5], FELT[::5]), Samples(TIMES[kept], RATE[kept]), ImuConvention())
    assert [(warning.kind, warning.text.split()[1]) for warning in warnings] == [
        (WarningKind.LOW_IMU_RATE, "accelerometer"),
        (WarningKind.IMU_GAP, "gyroscope"),
    ]


def test_sensors_without_a_common_time_are_refused() -> None:
    with pytest.raises(InvalidRecording, match="do not overlap in time"):
        normalise_imu(Samples(TIMES + 100, FELT), Samples(TIMES, RATE), ImuConvention())


@given(rate_hz=st.floats(2.6, 2400), unit=st.sampled_from(sorted(PER_SECOND)), start_s=st.floats(-1e5, 2e9))
def test_the_unit_of_time_follows_from_the_interval(rate_hz: float, unit: str, start_s: float) -> None:
    assert time_unit((start_s + np.arange(50) / rate_hz) * PER_SECOND[unit]) == unit


def test_times_of_frames_have_units_too() -> None:
    times = 3.0 + np.arange(9) / 1.5  # slower than any IMU
    seconds, warnings = frame_times_s(times * 1e3, "s")
    np.testing.assert_allclose(seconds, times)
    assert kinds(warnings) == [WarningKind.TIME_UNIT]
    seconds, warnings = frame_times_s(np.array([5.0]), "ms")
    assert seconds.tolist() == [0.005]
    assert warnings == ()


@pytest.mark.parametrize("interval_s", [1 / 240, 1 / 30, 0.5, 3.0])
@pytest.mark.parametrize("says", PER_SECOND)
def test_frames_in_the_unit_that_is_said_are_believed(interval_s: float, says: str) -> None:
    times = 7.0 + np.arange(9) * interval_s
    seconds, warnings = frame_times_s(times * PER_SECOND[says], says)
    np.testing.assert_allclose(seconds, times)
    assert warnings == ()
