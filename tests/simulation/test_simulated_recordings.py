"""What is written reads back, and is the same each time."""

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from rholoc.errors import Cancelled
from rholoc.geometry import Pose
from rholoc.recordings import GRAVITY, check_waypoints_fix_frame, read_recording
from rholoc.simulation import (
    PHONE_CAMERA,
    ImuErrors,
    Light,
    Scene,
    make_blank_wall,
    make_walk,
    measure_imu,
    measure_waypoints,
    simulate_recording,
)
from rholoc.simulation.scene import Box, DrawOrder, Face, Paint
from rholoc.simulation.walk import PAUSE_S

CAMERA = PHONE_CAMERA.resized(160, 120)
SECONDS = 0.7


@pytest.fixture(scope="module")
def folder(sparse_site: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("simulated") / "walk"
    simulate_recording(folder, scene=sparse_site, seconds=SECONDS, camera=CAMERA)
    return folder


def test_a_simulated_recording_reads_back(folder: Path) -> None:
    recording = read_recording(folder)
    assert recording.poses is None  # the truth is not handed in
    assert recording.camera == CAMERA
    assert recording.frames.size == (160, 120)
    np.testing.assert_allclose(recording.frames.times, np.arange(21) / 30, atol=1e-6)
    assert recording.imu.includes_gravity
    np.testing.assert_allclose(np.diff(recording.imu.times), 0.01, atol=1e-6)
    assert recording.waypoints == ()  # fewer than three are reached
    images = list(recording.frames.images(range(21)))
    assert len(images) == 21
    assert images[0].std() > 20


def test_the_video_keeps_time_by_itself(folder: Path) -> None:
    capture = cv2.VideoCapture(str(folder / "video.mp4"))
    times = []
    while capture.read()[0]:
        times.append(capture.get(cv2.CAP_PROP_POS_MSEC) / 1000)
    np.testing.assert_allclose(times, np.arange(21) / 30, atol=1e-6)


def test_the_truth_is_table_6(folder: Path) -> None:
    with (folder / "truth.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0])[:7] == ["timestamp", "x", "y", "z", "hx", "hy", "hz"]
    assert [float(rows[0][key]) for key in "xyz"] == [0.0, 0.0, 0.0]
    last = {key: float(value) for key, value in rows[-1].items()}
    pose = Pose.from_quaternion(
        np.array([last["x"], last["y"], last["z"]]), np.array([last[k] for k in ("qx", "qy", "qz", "qw")])
    )
    np.testing.assert_allclose(pose.heading, [last["hx"], last["hy"], last["hz"]], atol=1e-5)
    assert last["frame"] == 20


def test_the_same_arguments_give_the_same_recording(sparse_site: Scene, folder: Path, tmp_path: Path) -> None:
    simulate_recording(tmp_path / "again", scene=sparse_site, seconds=SECONDS, camera=CAMERA)
    for name in ("video.mp4", "frames.csv", "imu.csv", "camera.json", "truth.csv"):
        assert (tmp_path / "again" / name).read_bytes() == (folder / name).read_bytes(), name


def test_progress_is_reported_and_may_stop_the_work(tmp_path: Path) -> None:
    heard: list[float] = []

    def listen(fraction: float) -> None:
        heard.append(fraction)
        if fraction > 0.4:
            raise Cancelled("Enough.")

    with pytest.raises(Cancelled):
        simulate_recording(
            tmp_path / "walk", scene=make_blank_wall(), seconds=0.3, camera=CAMERA, light=Light.DIM, progress=listen
        )
    assert heard == sorted(heard)
    assert len(heard) == 4


def test_a_rolling_shutter_reads_one_row_after_the_other(sparse_site: Scene, tmp_path: Path) -> None:
    """The middle rows are what a global shutter sees; those above and below are as they were before, or are after."""
    readout_s = 0.03
    for name, shutter in (("rolling", readout_s), ("global", 0.0)):
        simulate_recording(tmp_path / name, scene=sparse_site, seconds=3.4, fps=5.0, camera=CAMERA, readout_s=shutter)
    rolling, instant = (read_recording(tmp_path / name) for name in ("rolling", "global"))
    assert rolling.readout_s == pytest.approx(readout_s)
    assert instant.readout_s is None
    pictures = [np.array(list(recording.frames.images(range(7, 17))), np.int32) for recording in (rolling, instant)]
    apart = np.abs(pictures[0] - pictures[1]).mean(axis=(0, 2, 3))  # (120,), a row's, on the way
    assert apart[48:72].mean() < 0.7 * apart[:24].mean()
    assert apart[48:72].mean() < 0.7 * apart[96:].mean()


GRAY = Paint(np.full((8, 8, 3), 128, np.uint8))


def make_box(centre: tuple[float, float, float], yaw: float = 0.0) -> Box:
    paints = dict.fromkeys(("x+", "y+", "x-", "y-", "z+", "z-"), GRAY)
    return Box(np.array(centre), np.array([1.0, 0.8, 0.6]), yaw, paints)


@pytest.mark.parametrize("inside", [False, True])
def test_faces_look_away_from_the_box_or_into_the_room(inside: bool) -> None:
    box = make_box((1.0, 2.0, 3.0), yaw=0.3)
    for face in box.faces(inside):
        outwards = face.points(np.array(0.5), np.array(0.5)) - box.centre
        assert (outwards @ face.normal > 0) != inside


def test_upright_faces_have_their_top_row_on_top() -> None:
    for name, face in zip(("x+", "y+", "x-", "y-"), make_box((0, 0, 0)).faces()[:4], strict=True):
        assert isinstance(face, Face), name
        assert face.down[2] < 0


def test_boxes_are_painted_back_to_front() -> None:
    boxes = tuple(make_box((x, 0.0, 0.0), yaw=0.2 * x) for x in (6.0, 2.0, 4.0))
    assert DrawOrder(boxes)(np.array([0.0, 0.0, 0.0])) == [0, 2, 1]
    assert DrawOrder(boxes)(np.array([9.0, 0.0, 0.0])) == [1, 2, 0]


def test_boxes_of_the_test_site_do_not_overlap_and_stand_in_the_room(site: Scene) -> None:
    low, high = site.room.corners.min(axis=0), site.room.corners.max(axis=0)
    samples = np.random.default_rng(0).uniform(-0.499, 0.499, (200, 3))
    for i, box in enumerate(site.boxes):
        points = box.centre + (samples * box.size) @ box.axes
        assert (points >= low - 1e-9).all(), i
        assert (points <= high + 1e-9).all(), i
        for j, other in enumerate(site.boxes):
            if i != j:
                inside = (np.abs((points - other.centre) @ other.axes.T) < 0.5 * other.size - 1e-6).all(axis=1)
                assert not inside.any(), (i, j)


def test_the_walks_keep_clear_of_the_furniture(site: Scene) -> None:
    for number in (1, 2, 3):
        positions = make_walk(number).positions(np.linspace(0, 30, 301))
        for box in site.boxes:
            outside = np.abs((positions - box.centre) @ box.axes.T) - 0.5 * box.size
            assert np.linalg.norm(np.maximum(outside, 0), axis=1).min() > 0.3


def test_boxes_block_the_view_behind_them(site: Scene) -> None:
    scene = Scene(site.room, (make_box((2.0, 0.0, 0.0)),))
    ends = np.array([[4.0, 0, 0], [1.4, 0, 0], [4.0, 3.0, 0], [4.0, 0, 2.0]])
    assert scene.blocked(np.zeros(3), ends).tolist() == [True, False, False, False]


WALK_S = 30.0
PERFECT = ImuErrors(0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("number", [1, 2, 3])
def test_walks_are_those_of_a_careful_person(number: int) -> None:
    walk = make_walk(number, WALK_S)
    times = np.linspace(0, WALK_S, 3001)
    speed = np.linalg.norm(np.gradient(walk.positions(times), times, axis=0), axis=1)
    turning_deg_s = np.degrees(np.linalg.norm(walk.angular_velocities(times), axis=1))
    roll_deg = np.degrees([Pose(T).roll for T in walk.T_map_camera(times[::10])])
    assert speed.max() < 0.55
    assert turning_deg_s.max() < 45
    assert np.sqrt(np.mean(roll_deg**2)) < 0.5
    assert np.abs(walk.accelerations(times)).max() < 3


def test_the_first_walk_starts_at_the_origin_and_the_second_beside_it() -> None:
    first, second = make_walk(1), make_walk(2)
    np.testing.assert_allclose(first.positions(np.zeros(1)), 0, atol=1e-12)
    way = first.positions(np.linspace(0, WALK_S, 600))
    off = [np.linalg.norm(way - p, axis=1).min() for p in second.positions(np.linspace(0, WALK_S, 60))]
    assert 0.1 < np.median(off) < 0.5


def test_waypoints_lie_on_the_path_where_the_walker_stands_still() -> None:
    walk = make_walk(1, WALK_S)
    waypoints = measure_waypoints(walk, WALK_S)
    assert [w.name for w in waypoints] == ["START", "W1", "W2", "W3", "E"]
    assert waypoints[0].position == (0.0, 0.0, 0.0)
    check_waypoints_fix_frame(waypoints)
    for waypoint in waypoints:
        around = walk.positions(waypoint.time + np.linspace(-0.3, 0.3, 7) * PAUSE_S)
        assert np.linalg.norm(around - waypoint.position, axis=1).max() < 0.04
    assert len(measure_waypoints(walk, 10.0)) == 2


def test_acceleration_integrates_to_the_path() -> None:
    walk = make_walk(1, WALK_S)
    imu = measure_imu(walk, WALK_S, rate_hz=400.0, errors=PERFECT)
    assert imu.R_camera_imu is not None
    R_map_imu = walk.rotations(imu.times) @ imu.R_camera_imu
    acceleration = np.einsum("nij,nj->ni", R_map_imu, imu.acceleration) - (0, 0, GRAVITY)
    start = walk.positions(np.array([-1e-4, 0.0, 1e-4]))
    velocity = (start[2] - start[0]) / 2e-4 + cumulative_trapezoid(acceleration, imu.times, axis=0, initial=0)
    position = start[1] + cumulative_trapezoid(velocity, imu.times, axis=0, initial=0)
    for time in (1.0, 5.0, 15.0, 29.0):
        i = int(np.searchsorted(imu.times, time))
        np.testing.assert_allclose(position[i], walk.positions(imu.times[i : i + 1])[0], atol=0.01)


def test_angular_velocity_integrates_to_the_rotation() -> None:
    walk = make_walk(2, WALK_S)
    imu = measure_imu(walk, WALK_S, rate_hz=400.0, errors=PERFECT)
    assert imu.R_camera_imu is not None
    middle = 0.5 * (imu.angular_velocity[1:] + imu.angular_velocity[:-1])
    R = Rotation.from_matrix(walk.rotations(imu.times[:1])[0] @ imu.R_camera_imu)
    for step in Rotation.from_rotvec(middle * np.diff(imu.times)[:, None]):
        R = R * step
    end = Rotation.from_matrix(walk.rotations(imu.times[-1:])[0] @ imu.R_camera_imu)
    assert np.degrees((R.inv() * end).magnitude()) < 0.05


def test_imu_errors_and_time_offset() -> None:
    walk = make_walk(1, WALK_S)
    true, read = measure_imu(walk, 5.0, errors=PERFECT), measure_imu(walk, 5.0)
    rest = read.acceleration - true.acceleration
    assert np.abs(rest.mean(axis=0)).max() < 0.2
    assert rest.std(axis=0) == pytest.approx(ImuErrors().accelerometer_noise_m_s2, rel=0.15)
    late = measure_imu(walk, 5.0, errors=PERFECT, time_offset_s=0.1)
    np.testing.assert_allclose(late.angular_velocity[10:], true.angular_velocity[:-10], atol=1e-9)
    again = measure_imu(walk, 5.0)
    np.testing.assert_array_equal(again.acceleration, read.acceleration)
