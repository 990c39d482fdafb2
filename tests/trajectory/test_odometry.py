"""odometry.csv: read, made into steps, and adjusted together with what the pictures show."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from synthetic_walk import SyntheticWalk, estimated

from rholoc.errors import InvalidRecording, InvalidTrajectory
from rholoc.geometry import FloatArray, align_poses, pose_matrix
from rholoc.recordings import Odometry
from rholoc.recordings.tables.own_tables import read_odometry_csv
from rholoc.trajectory import PoseMethod, Scale, Trajectory
from rholoc.trajectory.inertial.odometry import odometry_steps

POSE, VELOCITY = "timestamp,x,y,z,qx,qy,qz,qw", "timestamp,vx,vy,vz,wx,wy,wz"


def written(folder: Path, text: str) -> Path:
    path = folder / "odometry.csv"
    path.write_text(text)
    return path


def drifting(walk: SyntheticWalk, factor: float = 1.0) -> Odometry:
    """What wheels report: a little too much or too little of each step, in a frame of their own."""
    times = np.arange(walk.times[0], walk.times[-1], 0.05)
    T = walk.walk.T_map_camera(times)
    steps = np.linalg.inv(T[:-1]) @ T[1:]
    rng = np.random.default_rng(4)
    way = np.linalg.norm(steps[:, :3, 3], axis=1)
    sigma_m, sigma_rad = np.hypot(0.03 * way, 3e-4), np.full(len(way), 5e-4)
    steps[:, :3, 3] = factor * (steps[:, :3, 3] + sigma_m[:, None] * rng.normal(size=(len(way), 3)))
    steps[:, :3, :3] @= Rotation.from_rotvec(sigma_rad[:, None] * rng.normal(size=(len(way), 3))).as_matrix()
    found = [np.eye(4)]
    for step in steps:
        found.append(found[-1] @ step)
    return Odometry(times, np.array(found), np.append(0, sigma_m), np.append(0, sigma_rad))


def true_poses(walk: SyntheticWalk, found: Trajectory) -> FloatArray:
    return walk.T_map_camera[found.rows]


# -- the table -------------------------------------------------------------------------------------------------------


def test_poses_and_their_sigmas_are_read(tmp_path: Path) -> None:
    rows = "10,1,2,3,0,0,0,1,0.01,0.5\n10.5,1,2,4,0,0,1,0,0.02,1\n"
    found = read_odometry_csv(written(tmp_path, f"{POSE},sigma_m,sigma_deg\n{rows}"))
    assert found.times.tolist() == [10, 10.5]
    np.testing.assert_allclose(found.T_odom_camera[1], pose_matrix(np.diag([-1.0, -1.0, 1.0]), np.array([1, 2, 4])))
    assert found.sigma_m.tolist() == [0.01, 0.02]
    np.testing.assert_allclose(found.sigma_rad, np.radians([0.5, 1]))


def test_without_sigmas_they_grow_with_the_way(tmp_path: Path) -> None:
    found = read_odometry_csv(written(tmp_path, f"{POSE}\n0,0,0,0,0,0,0,1\n1,0,0,2,0,0,0,1\n2,0,0,2,0,0,0,1\n"))
    assert found.sigma_m[1] == pytest.approx(0.04, rel=1e-2)
    assert found.sigma_rad[1] == pytest.approx(np.radians(2), rel=1e-2)
    assert 0 < found.sigma_m[2] <= 1e-3


def test_each_sigma_may_be_given_without_the_other(tmp_path: Path) -> None:
    rows = ("0,0,0,0,0,0,0,1", "1,0,0,2,0,0,0,1")
    usual = read_odometry_csv(written(tmp_path, "\n".join([POSE, *rows])))
    metres, degrees = (
        read_odometry_csv(written(tmp_path, "\n".join([f"{POSE},{name}", *(f"{row},0.5" for row in rows)])))
        for name in ("sigma_m", "sigma_deg")
    )
    np.testing.assert_array_equal([metres.sigma_m, degrees.sigma_rad], [[0.5] * 2, np.radians([0.5] * 2)])
    np.testing.assert_array_equal([degrees.sigma_m, metres.sigma_rad], [usual.sigma_m, usual.sigma_rad])


def test_velocities_in_the_cameras_axes_are_integrated(tmp_path: Path) -> None:
    """A quarter of a circle of radius 1 m to the right, in a second."""
    times, rate = np.linspace(0, 1, 101), np.pi / 2
    lines = [f"{time},0,0,{rate},0,{rate},0" for time in times]
    found = read_odometry_csv(written(tmp_path, "\n".join([VELOCITY, *lines])))
    np.testing.assert_allclose(found.T_odom_camera[-1, :3, 3], [1, 0, 1], atol=0.01)
    np.testing.assert_allclose(found.T_odom_camera[-1, :3, 2], [1, 0, 0], atol=1e-9)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("timestamp,x,y,z\n0,0,0,0\n", "neither poses nor velocities"),
        (f"{POSE}\n", "no rows"),
        (f"{POSE}\n1,0,0,0,0,0,0,1\n0,0,0,0,0,0,0,1\n", "time 0"),
        (f"{VELOCITY}\n0,0,0,0,0,0,nan\n", "'nan'"),
        (f"{VELOCITY},sigma_m,sigma_deg\n0,0,0,0,0,0,0,1,1\n1,0,0,0,0,0,0,0,1\n", "sigma that is not positive"),
    ],
)
def test_broken_odometry_is_reported(tmp_path: Path, text: str, complaint: str) -> None:
    with pytest.raises(InvalidRecording, match=complaint) as caught:
        read_odometry_csv(written(tmp_path, text))
    assert "odometry.csv" in caught.value.message


def test_a_quaternion_that_is_none_is_reported(tmp_path: Path) -> None:
    with pytest.raises(InvalidTrajectory, match=r"odometry\.csv"):
        read_odometry_csv(written(tmp_path, f"{POSE}\n0,0,0,0,0,0,0,0\n"))


# -- steps -----------------------------------------------------------------------------------------------------------


def test_steps_lie_between_moments_that_the_odometry_covers() -> None:
    times = np.array([0.0, 1, 2, 3, 6, 7])  # nothing between 3 and 6
    T = np.tile(np.eye(4), (6, 1, 1))
    T[:, 0, 3] = 2 * times
    odometry = Odometry(times, T, np.full(6, 0.3), np.full(6, 0.04))
    found = list(odometry_steps(odometry, np.array([-1.0, 0.5, 2.5, 6.2, 6.7, 8])))
    assert [one[0] for one in found] == [1, 3]
    assert found[0][1][0, 3] == pytest.approx(4)
    assert found[0][2] == pytest.approx(0.3 * np.sqrt(2))
    assert found[0][3] == pytest.approx(0.04 * np.sqrt(2))
    assert found[1][1][0, 3] == pytest.approx(1)


def test_a_single_row_makes_no_step() -> None:
    one = Odometry(np.zeros(1), np.eye(4)[None], np.zeros(1), np.zeros(1))
    assert list(odometry_steps(one, np.array([-1.0, 0.0, 1.0]))) == []


# -- walks -----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def walk() -> SyntheticWalk:
    """Its first ten seconds."""
    return SyntheticWalk(times=np.arange(0.0, 10.0, 0.2))


@pytest.mark.slow
def test_odometry_makes_pictures_metric(walk: SyntheticWalk) -> None:
    bare = walk.recording(imu=None, waypoints=())
    found = estimated(walk, replace(bare, odometry=drifting(walk)), PoseMethod.VISUAL)
    assert found.scale is Scale.METRIC
    assert found.report.scale.startswith("Odometry fixes the scale to 1.")
    alignment = align_poses(found.T_map_camera, true_poses(walk, found))
    assert alignment.scale == pytest.approx(1.0, abs=0.02)
    off_m = np.linalg.norm(alignment.points(found.T_map_camera[:, :3, 3]) - true_poses(walk, found)[:, :3, 3], axis=1)
    assert np.median(off_m) < 0.03


@pytest.mark.slow
def test_odometry_of_another_walk_leaves_the_scale_open(walk: SyntheticWalk) -> None:
    shuffled = drifting(walk)
    order = np.random.default_rng(0).permutation(len(shuffled.times))
    shuffled = replace(shuffled, T_odom_camera=shuffled.T_odom_camera[order])
    bare = walk.recording(imu=None, waypoints=())
    found = estimated(walk, replace(bare, odometry=shuffled), PoseMethod.VISUAL)
    assert found.scale is Scale.ARBITRARY
    assert found.report.scale is not None
    assert "Odometry leaves the scale open" in found.report.scale


@pytest.mark.slow
def test_odometry_holds_a_walk_whose_accelerometer_does_not(walk: SyntheticWalk) -> None:
    bare = walk.recording(waypoints=())
    found = estimated(walk, replace(bare, odometry=drifting(walk)))
    alone = estimated(walk, bare)
    assert found.scale is Scale.METRIC

    def size_off(one: Trajectory) -> float:
        return abs(align_poses(one.T_map_camera, true_poses(walk, one)).scale - 1)

    assert size_off(found) < max(0.01, size_off(alone))


@pytest.mark.slow
def test_odometry_in_feet_is_doubted_where_the_accelerometer_knows_better(walk: SyntheticWalk) -> None:
    wrong = replace(walk.recording(waypoints=()), odometry=drifting(walk, 3.28))
    found = estimated(walk, wrong)
    assert align_poses(found.T_map_camera, true_poses(walk, found)).scale == pytest.approx(1.0, abs=0.05)
    assert found.report.scale is not None
    assert "Odometry says that the walk is 3." in found.report.scale
