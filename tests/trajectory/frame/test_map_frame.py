"""From a reconstruction's own frame to the map's: its origin, what is up, what fixes the scale, what is doubted."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.errors import MappingFailed
from rholoc.geometry import FloatArray, Pose, Similarity, angles_between, rotation_from_heading
from rholoc.recordings import Waypoint
from rholoc.trajectory import Scale
from rholoc.trajectory.frame.map_frame import (
    MapFrame,
    ScaleMeasurement,
    ScaleSource,
    frame_of_first_camera,
    frame_of_waypoints,
    up_by_gravity,
    up_by_pictures,
)
from rholoc.trajectory.frame.upright import Up, rotation_to_upright, up_without_roll
from rholoc.trajectory.frame.waypoint_alignment import UpMeasurement

TIMES = np.linspace(0.0, 30.0, 91)
TURNED = Rotation.from_euler("xyz", [0.4, -0.3, 0.9]).as_matrix()
UP = UpMeasurement(TURNED @ [0.0, 0.0, 1.0], 0.3)


def true_walk() -> FloatArray:
    """(N, 4, 4) of cameras that look about level along a bent path, upright and in metres."""
    angle = TIMES / 6
    positions = np.column_stack([3 * np.cos(angle), 2 * np.sin(angle), 1.4 + 0.2 * np.sin(3 * angle)])
    headings = np.column_stack([np.cos(angle + 0.5), np.sin(angle + 0.5), 0.1 * np.sin(angle)])
    headings /= np.linalg.norm(headings, axis=1)[:, None]
    return np.array([Pose.from_heading(x, h, 0.0).T_map_camera for x, h in zip(positions, headings, strict=True)])


def reconstructed(scale: float = 1.0) -> FloatArray:
    """The same in a frame that is turned, shifted and scaled."""
    return Similarity(scale, TURNED, np.array([1.0, -2.0, 0.5])).poses(true_walk())


def waypoints(*rows: int, off: FloatArray | None = None) -> tuple[Waypoint, ...]:
    places = true_walk()[list(rows), :3, 3] + (0.0 if off is None else off)
    return tuple(Waypoint(f"W{row}", TIMES[row], tuple(place)) for row, place in zip(rows, places, strict=True))


def felt(sigma: float) -> ScaleMeasurement:
    return ScaleMeasurement(ScaleSource.ACCELEROMETER, 1.0, sigma, is_adjusted=True)


def first(up: UpMeasurement | None, sigma: float | None, scale: float = 1.0) -> MapFrame:
    return frame_of_first_camera(reconstructed(scale), up, "why", 4.0, [] if sigma is None else [felt(sigma)])


@pytest.mark.parametrize("sigma", [None, 0.02, 0.2])
def test_the_first_camera_is_the_origin_and_looks_along_x(sigma: float | None) -> None:
    found = first(UP, sigma)
    T = found.similarity.poses(reconstructed())
    np.testing.assert_allclose(T[0, :3, 3], 0, atol=1e-9)
    assert T[0, 1, 2] == pytest.approx(0, abs=1e-9)
    assert T[0, 0, 2] > 0.9
    np.testing.assert_allclose(T[:, 2, 2], true_walk()[:, 2, 2], atol=1e-9)  # level is what was level
    metric = sigma == 0.02
    assert found.scale is (Scale.METRIC if metric else Scale.ARBITRARY)
    assert found.similarity.scale == pytest.approx(1.0 if metric else 0.25)
    assert found.upright
    assert {None: "Nothing measured", 0.02: "to 2.0%", 0.2: "open (20%)"}[sigma] in found.why_scale


@pytest.mark.parametrize(
    ("depth_sigma", "imu_sigma", "by", "sigma"),
    [(0.01, None, "Depth pictures fix the scale to 1.0%", 0.01), (0.01, 0.05, "Depth", 0.01), (0.03, 0.02, "The", 0)],
)
def test_the_most_certain_measurement_fixes_the_scale(
    depth_sigma: float, imu_sigma: float | None, by: str, sigma: float
) -> None:
    depth = ScaleMeasurement(ScaleSource.DEPTH, 1.04, depth_sigma)
    scales = [depth] if imu_sigma is None else [felt(imu_sigma), depth]
    found = frame_of_first_camera(reconstructed(), UP, "", 4.0, scales)
    assert found.why_scale.startswith(by)
    assert found.scale is Scale.METRIC
    assert found.similarity.scale == (1.04 if by.startswith("Depth") else 1.0)
    assert found.scale_sigma == sigma
    assert not found.doubts


def test_measurements_of_the_scale_that_contradict_each_other_are_a_doubt() -> None:
    depth = ScaleMeasurement(ScaleSource.DEPTH, 0.6, 0.01)
    found = frame_of_first_camera(reconstructed(), UP, "", 4.0, [felt(0.02), depth])
    assert found.doubts == ("The accelerometer says that the walk is 1.67 times as large.",)
    by_waypoints = frame_of_waypoints(TIMES, reconstructed(), [waypoints(0, 25, 50, 80)], UP, "", [depth])
    assert by_waypoints.doubts == ("Depth pictures say that the walk is 0.60 times as large.",)


def test_depth_pictures_that_contradict_the_pictures_fix_no_scale() -> None:
    found = frame_of_first_camera(reconstructed(), UP, "", 4.0, [ScaleMeasurement(ScaleSource.DEPTH, 1.0, 0.3)])
    assert found.scale is Scale.ARBITRARY
    assert found.why_scale.startswith("Depth pictures leave the scale open (30%): they contradict the pictures.")


def test_without_up_the_first_camera_is_held_level() -> None:
    found = first(None, None)
    assert not found.upright
    R = found.similarity.rotation @ reconstructed()[0, :3, :3]
    np.testing.assert_allclose(R[:, 1], [0, 0, -1], atol=1e-9)
    np.testing.assert_allclose(R[:, 2], [1, 0, 0], atol=1e-9)


def test_what_gravity_and_pictures_say_of_up() -> None:
    gravity, why = up_by_gravity()
    np.testing.assert_array_equal(gravity.direction, [0, 0, 1])
    assert "gravity" in why
    pictures, why = up_by_pictures(reconstructed()[:, :3, :3])
    np.testing.assert_allclose(pictures.direction, UP.direction, atol=1e-6)
    assert why.startswith("By the no-roll prior")
    none, why = up_by_pictures(Rotation.random(40, random_state=0).as_matrix())
    assert none is None
    assert "does not hold" in why


@pytest.mark.parametrize("scale", [1.0, 0.3])
def test_waypoints_fix_place_scale_and_up(scale: float) -> None:
    found = frame_of_waypoints(TIMES, reconstructed(scale), [waypoints(0, 25, 50, 80)], UP, "Measured.")
    np.testing.assert_allclose(found.similarity.poses(reconstructed(scale)), true_walk(), atol=1e-5)
    assert (found.scale, found.upright, found.doubts) == (Scale.METRIC, True, ())
    assert found.tilt_deg == pytest.approx(0, abs=1e-4)
    assert found.why_scale == "The waypoints fix the scale."
    assert [waypoint.name for waypoint in found.waypoints] == ["W0", "W25", "W50", "W80"]
    unknown = frame_of_waypoints(TIMES, reconstructed(scale), [waypoints(0, 25, 50, 80)], None, "Unknown.")
    assert (unknown.upright, unknown.tilt_deg) == (False, None)


@pytest.mark.parametrize(("tilt_deg", "upright"), [(5, True), (14.5, True), (15.5, False), (40, False)])
def test_up_and_the_waypoints_may_differ_by_a_little(tilt_deg: float, upright: bool) -> None:
    tilted = UpMeasurement(TURNED @ Rotation.from_euler("x", tilt_deg, degrees=True).apply([0.0, 0, 1]), 0.3)
    found = frame_of_waypoints(TIMES, reconstructed(), [waypoints(0, 25, 50, 80)], tilted, "Measured.")
    assert found.tilt_deg == pytest.approx(tilt_deg, abs=0.1)
    assert found.upright is upright
    assert ("was left there" in found.why_up) is not upright


@pytest.mark.parametrize(
    ("scale", "sigma", "doubted"),
    [
        (0.8, 0.01, True),
        (1.14, 0.01, False),
        (1.17, 0.01, True),
        (1.22, 0.06, False),
        (1.22, 0.05, True),
        (1.5, 0.11, False),
        (1.5, 0.099, True),
    ],
)
def test_an_accelerometer_that_is_sure_of_another_scale_is_heard(scale: float, sigma: float, doubted: bool) -> None:
    found = frame_of_waypoints(TIMES, reconstructed(scale), [waypoints(0, 25, 50, 80)], UP, "", [felt(sigma)])
    assert any(f"{scale:.2f} times as large" in doubt for doubt in found.doubts) is doubted
    assert ("times as large" in found.why_scale) is doubted


def test_of_several_choices_of_pauses_the_best_is_taken_and_a_close_second_is_doubted() -> None:
    right = waypoints(0, 25, 50, 80)
    wrong = tuple(replace(waypoint, time=TIMES[row]) for waypoint, row in zip(right, (0, 25, 60, 85), strict=True))
    close = tuple(replace(waypoint, time=waypoint.time + 0.01) for waypoint in right)
    clear = frame_of_waypoints(TIMES, reconstructed(), [wrong, right], None, "")
    assert clear.waypoints == right
    assert clear.doubts == ()
    ambiguous = frame_of_waypoints(TIMES, reconstructed(), [close, right], None, "")
    assert "Other pauses" in ambiguous.doubts[0]


def test_waypoints_that_no_choice_fits_fail() -> None:
    strange = waypoints(0, 25, 50, 80, off=5.0 * np.random.default_rng(0).normal(size=(4, 3)))
    with pytest.raises(MappingFailed):
        frame_of_waypoints(TIMES, reconstructed(), [strange], UP, "")
    with pytest.raises(MappingFailed, match="No pauses"):
        frame_of_waypoints(TIMES, reconstructed(), [], UP, "")


@pytest.mark.parametrize(("sigma", "metric"), [(0.09, True), (0.11, False)])
def test_a_scale_known_to_a_tenth_is_a_scale(sigma: float, metric: bool) -> None:
    assert (first(UP, sigma).scale is Scale.METRIC) is metric


def test_a_camera_that_looks_straight_up_has_any_heading() -> None:
    """Its frame is a rotation all the same, upright and with the camera at its origin."""
    T = np.tile(np.eye(4), (2, 1, 1))  # z ahead is up
    T[:, :3, 3] = [1.0, 2.0, 3.0]
    found = frame_of_first_camera(T, UpMeasurement(np.array([0.0, 0, 1]), 0.3), "", 2.0).similarity
    np.testing.assert_allclose(found.rotation @ found.rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(found.rotation[2], [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(found.points(T[:1, :3, 3]), 0, atol=1e-12)
    assert found.scale == 0.5


def test_how_well_up_is_known() -> None:
    assert up_by_gravity()[0].sigma_deg == 0.3
    pictures, why = up_by_pictures(reconstructed()[:, :3, :3])
    assert pictures.sigma_deg == 1.5
    spread = np.linalg.svd(reconstructed()[:, :3, 0], compute_uv=False) / np.sqrt(len(TIMES))
    assert f"spread {np.degrees(np.arcsin(spread[1])):.0f}°" in why


def _cameras(turn_deg: float, roll_deg: float) -> FloatArray:
    rng = np.random.default_rng(0)
    yaw = np.radians(rng.uniform(-turn_deg, turn_deg, 60))
    pitch = np.radians(rng.uniform(-30, 10, 60))
    headings = np.column_stack([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)])
    rolls = np.radians(rng.normal(0, roll_deg, 60)) if roll_deg else np.zeros(60)
    return np.stack([rotation_from_heading(h, float(r)) for h, r in zip(headings, rolls, strict=True)])


def test_up_of_cameras_that_do_not_roll() -> None:
    frame = Rotation.random(rng=np.random.default_rng(2)).as_matrix()
    up = up_without_roll(frame @ _cameras(60, 1.0))
    angle_deg = np.degrees(angles_between(up.direction, frame[:, 2]))
    assert angle_deg < 0.5
    assert up.holds
    np.testing.assert_allclose(rotation_to_upright(up.direction) @ up.direction, [0, 0, 1], atol=1e-12)


def test_rolling_cameras_do_not_tell_up() -> None:
    assert not up_without_roll(_cameras(60, 10.0)).holds


def test_cameras_that_do_not_turn_do_not_tell_up() -> None:
    assert not up_without_roll(_cameras(3, 0.0)).holds


@pytest.mark.parametrize("up", [[0.3, -0.2, 0.8], [0.0, 5.0, 0.0], [0.1, -3.0, 0.2], [2.0, 0, 0]])
def test_up_of_any_length_is_turned_to_the_z_axis(up: list[float]) -> None:
    R = rotation_to_upright(np.array(up))
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1)
    np.testing.assert_allclose(R @ up, [0, 0, np.linalg.norm(up)], atol=1e-12)
    assert R[0, 1] == pytest.approx(0) or abs(up[1]) > 0.85 * np.linalg.norm(up)  # x stays across y, while it can


@pytest.mark.parametrize(
    ("roll_deg", "turn_deg", "holds"),
    [
        (2.9, 40.0, True),
        (3.1, 40.0, False),
        (0.1, 15.1, True),
        (0.1, 14.9, False),
        (2.9, 15.5, True),
        (4.0, 90.0, False),
    ],
)
def test_the_prior_holds_for_cameras_that_turn_and_do_not_roll(roll_deg: float, turn_deg: float, holds: bool) -> None:
    assert Up(np.array([0.0, 0, 1]), roll_deg, turn_deg).holds is holds


@pytest.mark.parametrize(("turn_deg", "roll_deg"), [(20.0, 0.0), (30.0, 2.0)])
def test_roll_and_turn_are_root_mean_squares(turn_deg: float, roll_deg: float) -> None:
    """Cameras half of which look to the left by so much, and half to the right; likewise rolled."""
    yaw = np.tile([turn_deg, -turn_deg], 20)
    roll = np.repeat([roll_deg, -roll_deg], 20)
    R = Rotation.from_euler("zy", np.column_stack([roll, yaw]), degrees=True).as_matrix()
    found = up_without_roll(R)
    np.testing.assert_allclose(found.direction, [0, -1, 0], atol=0.02)  # y points down
    assert found.turn_deg == pytest.approx(turn_deg, rel=0.01)
    assert found.roll_deg == pytest.approx(roll_deg, rel=0.02, abs=1e-5)
