"""The IMU between waypoints in one least-squares problem: better than leg by leg."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, G, V, X
from test_dead_reckoning import STOPS, walk, waypoints

from rholoc.errors import MappingFailed
from rholoc.geometry import FloatArray, pose_distances, pose_matrix
from rholoc.recordings import GRAVITY, Imu
from rholoc.trajectory import inertial_adjustment
from rholoc.trajectory.dead_reckoning import integrate_between_waypoints
from rholoc.trajectory.inertial_adjustment import adjust_between_waypoints


def _biased(imu: Imu, seed: int) -> Imu:
    """The readings of a worse IMU: biases and noise as a phone's."""
    rng = np.random.default_rng(seed)
    return replace(
        imu,
        acceleration=imu.acceleration + rng.normal(0, 0.05, 3) + rng.normal(0, 0.03, imu.acceleration.shape),
        angular_velocity=imu.angular_velocity + rng.normal(0, 0.004, 3) + rng.normal(0, 0.003, (len(imu.times), 3)),
    )


def _errors(found: FloatArray, path: FloatArray, R: FloatArray) -> tuple[float, float]:
    """Median errors, metres and degrees."""
    moved, turned = pose_distances(found, pose_matrix(R, path))
    return float(np.median(moved)), float(np.degrees(np.median(turned)))


@pytest.mark.parametrize("seed", range(4))
def test_all_of_the_walk_at_once_is_better_than_leg_by_leg(seed: int) -> None:
    imu, path, R = walk()
    rows = np.flatnonzero((imu.times >= STOPS[0]) & (imu.times <= STOPS[-1]))[::40]
    at, measured = imu.times[rows], waypoints((0, 1, 2, 3))
    worse = _biased(imu, seed)
    adjusted = _errors(adjust_between_waypoints(worse, measured, at), path[rows], R[rows])
    by_leg = _errors(integrate_between_waypoints(worse, measured, at), path[rows], R[rows])
    assert adjusted[0] < min(0.03, 1.2 * by_leg[0])
    assert adjusted[1] < 1.5


def test_poses_come_in_the_order_of_their_times() -> None:
    imu, path, _ = walk()
    at = np.array([2.0, 3.0, 3.0004, 8.0, 15.0])
    found = adjust_between_waypoints(imu, waypoints((0, 1, 2, 3)), at)
    expected = np.column_stack([np.interp(at, imu.times, path[:, axis]) for axis in range(3)])
    assert np.linalg.norm(found[:, :3, 3] - expected, axis=1).max() < 0.03


def test_a_gap_is_said() -> None:
    imu, _, _ = walk()
    kept = (imu.times < 8.0) | (imu.times > 8.7)
    broken = replace(
        imu,
        times=imu.times[kept],
        acceleration=imu.acceleration[kept],
        angular_velocity=imu.angular_velocity[kept],
    )
    with pytest.raises(MappingFailed, match="gap between"):
        adjust_between_waypoints(broken, waypoints((0, 1, 2, 3)), np.array([2.0, 3.0]))


def test_the_nearest_of_increasing_times() -> None:
    times = np.array([0.0, 1.0, 2.0, 4.0])
    assert inertial_adjustment._nearest(times, np.array([-3.0, 0.4, 0.6, 1.0, 2.9, 3.1, 9.0])).tolist() == [
        0, 0, 1, 1, 2, 3, 3,
    ]  # fmt: skip


def test_a_camera_rests_well_inside_its_pauses_between_the_waypoints(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every tenth of a second, a fifth of a second away from a pause's ends; short ones are passed over."""
    spans = np.array([[0.0, 1.25], [3.0, 3.75], [5.0, 5.39], [8.0, 9.15]])
    monkeypatch.setattr(inertial_adjustment, "pauses", lambda imu: spans)
    imu, _, _ = walk()
    found = inertial_adjustment._resting(imu, np.array([0.55, 4.0, 8.75]))
    expected = [0.6, 0.7, 0.8, 0.9, 1.0, 3.2, 3.3, 3.4, 3.5, 8.2, 8.3, 8.4, 8.5, 8.6, 8.7]
    np.testing.assert_allclose(found, expected)


def test_a_perfect_imu_and_waypoints_give_the_perfect_walk() -> None:
    imu, path, R = walk()
    exact = replace(
        imu,
        acceleration=imu.acceleration - [0.03, -0.02, 0.02],
        angular_velocity=imu.angular_velocity - [0.002, -0.001, 0.001],
    )
    rows = np.flatnonzero((imu.times >= STOPS[0]) & (imu.times <= STOPS[-1]))[::100]
    found = adjust_between_waypoints(exact, waypoints((0, 1, 2, 3)), imu.times[rows])
    np.testing.assert_allclose(found[:, :3, 3], path[rows], atol=2e-3)
    np.testing.assert_allclose(found[:, :3, :3], R[rows], atol=2e-3)


def test_steady_biases_are_found() -> None:
    """As large as a phone's: the walk does not show them."""
    imu, path, R = walk()
    worse = replace(
        imu,
        acceleration=np.add(imu.acceleration, [0.07, -0.05, 0.06]),
        angular_velocity=np.add(imu.angular_velocity, [0.01, -0.008, 0.012]),
    )
    rows = np.flatnonzero((imu.times >= STOPS[0]) & (imu.times <= STOPS[-1]))[::100]
    found = adjust_between_waypoints(worse, waypoints((0, 1, 2, 3)), imu.times[rows])
    moved_m, turned_deg = _errors(found, path[rows], R[rows])
    assert moved_m < 0.01
    assert turned_deg < 0.6


def test_a_waypoint_that_is_wrong_does_not_bend_the_walk() -> None:
    imu, path, _ = walk()
    measured = waypoints((0, 1, 2, 3))
    x, y, z = measured[2].position
    measured[2] = replace(measured[2], position=(x, y, z + 1.0))
    rows = np.flatnonzero((imu.times >= STOPS[0]) & (imu.times <= STOPS[-1]))[::100]
    found = adjust_between_waypoints(imu, measured, imu.times[rows])
    assert np.median(np.linalg.norm(found[:, :3, 3] - path[rows], axis=1)) < 0.15


def test_what_each_measurement_between_waypoints_is_worth(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the solver fails the walk leg by leg is given; what it was given is looked at here."""
    given: list[tuple[gtsam.NonlinearFactorGraph, gtsam.Values]] = []

    class Fails:
        def __init__(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, parameters: object) -> None:
            given.append((graph, values))

        def optimize(self) -> None:
            raise RuntimeError("singular")

    monkeypatch.setattr(gtsam, "LevenbergMarquardtOptimizer", Fails)
    monkeypatch.setattr(inertial_adjustment, "pauses", lambda imu: np.array([[10.7, 11.25]]))
    imu, _, _ = walk()
    measured = [replace(one, sigma_m=0.03) for one in waypoints((0, 1, 2, 3))]
    at = np.array([2.0, 3.0, 3.0004, 3.005, 8.0])
    found = adjust_between_waypoints(imu, measured, at)
    np.testing.assert_array_equal(found, integrate_between_waypoints(imu, measured, at))
    ((graph, values),) = given
    factors: dict[tuple[int, ...], list[gtsam.NonlinearFactor]] = {}
    for i in range(graph.size()):
        factors.setdefault(tuple(sorted(graph.at(i).keys())), []).append(graph.at(i))
    times = [1.0, 2.0, 3.0, 3.005, 6.0, 8.0, 10.9, 11.0, 16.0]  # what is not a millisecond apart is one
    count = len(times)
    assert sum(values.exists(X(k)) for k in range(count + 1)) == count
    for k in range(count - 1):
        (moved,) = factors[tuple(sorted([X(k), V(k), X(k + 1), V(k + 1), B(k), B(k + 1), G(0)]))]
        assert moved.preintegratedMeasurements().deltaTij() == pytest.approx(times[k + 1] - times[k])
    (bias,), (gravity,) = factors[B(0),], factors[G(0),]
    np.testing.assert_allclose(bias.noiseModel().sigmas(), np.repeat([0.1, 0.02], 3))
    level = GRAVITY * np.radians(0.5)
    np.testing.assert_allclose(gravity.noiseModel().sigmas(), [level, level, 0.05])
    np.testing.assert_allclose(values.atVector(G(0)), [0, 0, -GRAVITY])
    resting = [k for k in range(count) if (V(k),) in factors]
    assert [times[k] for k in resting] == [1.0, 6.0, 10.9, 11.0, 16.0]
    for k in resting:
        rest = factors[V(k),][0]
        np.testing.assert_allclose(rest.noiseModel().sigmas(), 0.05)
        np.testing.assert_allclose(rest.unwhitenedError(values), values.atVector(V(k)))
    for waypoint, k in zip(measured, (0, 4, 7, 8), strict=True):
        (place,) = factors[X(k),]
        np.testing.assert_allclose(
            place.unwhitenedError(values), values.atPose3(X(k)).translation() - waypoint.position, atol=1e-9
        )
        off_m = gtsam.Pose3(values.atPose3(X(k)).rotation(), np.add(waypoint.position, [0.3, 0.0, 0.0]))
        moved_away = gtsam.Values(values)
        moved_away.update(X(k), off_m)
        squared = 0.3**2 / (0.03**2 + 0.02**2)  # of the waypoint, and between camera and IMU
        assert place.error(moved_away) == pytest.approx(4.5 * np.log1p(squared / 9))
