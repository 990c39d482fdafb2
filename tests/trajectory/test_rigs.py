"""Pictures by cameras of a rig: readers know their mounting, and the walk is metric by it."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.geometry import ByteArray, Camera, FloatArray, Pose, align_poses, pose_matrix
from rholoc.recordings import Recording, RecordingFormat, read_recording
from rholoc.recordings.frame_slice import select_frames
from rholoc.reports import WarningKind
from rholoc.simulation import PHONE_CAMERA, Renderer, Scene, make_walk
from rholoc.trajectory import PoseMethod, Scale
from rholoc.trajectory.chosen_keyframes import _chosen_moments
from rholoc.trajectory.estimate import estimate_trajectory

MOMENTS, SENSORS = 3, ("left", "right")
SMALL = Camera(64, 48, 60.0, 61.0, 31.5, 23.5)
T_LEFT_RIGHT = pose_matrix(Rotation.from_euler("y", 5, degrees=True).as_matrix(), np.array([0.2, 0.01, 0.0]))
T_BODY_LEFT = pose_matrix(Rotation.from_euler("xyz", [90, 3, -90], degrees=True).as_matrix(), np.array([0.1, 0.0, 0.3]))
MOUNTED = {"left": T_BODY_LEFT, "right": T_BODY_LEFT @ T_LEFT_RIGHT}
Pictures = Callable[[str, int], ByteArray]


def shade(sensor: str, moment: int) -> ByteArray:
    """A picture whose brightness says which it is."""
    return np.full((48, 64, 3), 20 * moment + (100 if sensor == "right" else 10), np.uint8)


def write_kapture(folder: Path, pictures: Pictures, camera: Camera, moments: int = MOMENTS) -> None:
    """Nanoseconds as time stamps; the rig's transforms take the rig to the sensor."""
    sensors = folder / "sensors"
    model = f"PINHOLE, {camera.width}, {camera.height}, {camera.fx}, {camera.fy}, {camera.cx + 0.5}, {camera.cy + 0.5}"
    records, rigs = [], []
    for name in SENSORS:
        (sensors / "records_data" / name).mkdir(parents=True)
        T = np.linalg.inv(MOUNTED[name])
        x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
        rigs.append(", ".join(str(value) for value in ("rig", name, w, x, y, z, *T[:3, 3])))
        for moment in range(moments):
            records.append(f"{10**18 + 5 * 10**8 * moment}, {name}, {name}/{moment:04d}.png")
            cv2.imwrite(str(sensors / "records_data" / name / f"{moment:04d}.png"), pictures(name, moment))
    (sensors / "sensors.txt").write_text("\n".join(f"{name}, {name}, camera, {model}" for name in SENSORS))
    (sensors / "rigs.txt").write_text("\n".join(rigs))
    (sensors / "records_camera.txt").write_text("\n".join(sorted(records)))


def write_euroc(folder: Path, pictures: Pictures, camera: Camera, moments: int = MOMENTS) -> None:
    """Both cameras' sensor.yaml state where they are on the body."""
    for name, place in zip(SENSORS, ("cam0", "cam1"), strict=True):
        root = folder / "mav0" / place
        (root / "data").mkdir(parents=True)
        stamps = [10**18 + 5 * 10**8 * moment for moment in range(moments)]
        rows = "\n".join(f"{stamp},{stamp}.png" for stamp in stamps)
        (root / "data.csv").write_text(f"#timestamp [ns],filename\n{rows}\n")
        (root / "sensor.yaml").write_text(
            f"T_BS:\n  data: {MOUNTED[name].ravel().tolist()}\n"
            f"intrinsics: [{camera.fx}, {camera.fy}, {camera.cx}, {camera.cy}]\n"
            f"resolution: [{camera.width}, {camera.height}]\n"
        )
        for moment, stamp in enumerate(stamps):
            cv2.imwrite(str(root / "data" / f"{stamp}.png"), pictures(name, moment))


WRITERS = {"kapture": write_kapture, "euroc": write_euroc}


def test_kaptures_folder_at_the_top_of_a_zip_file_stays(tmp_path: Path) -> None:
    write_kapture(tmp_path / "walk", shade, SMALL)
    packed = shutil.make_archive(str(tmp_path / "walk"), "zip", tmp_path / "walk")
    assert read_recording(Path(packed)).format is RecordingFormat.KAPTURE


def test_kaptures_optional_tables_may_be_empty(tmp_path: Path) -> None:
    write_kapture(tmp_path / "walk", shade, SMALL)
    for name in ("rigs", "trajectories", "records_accelerometer", "records_gyroscope"):
        (tmp_path / "walk" / "sensors" / f"{name}.txt").write_text("# kapture format: 1.1\n")
    recording = read_recording(tmp_path / "walk")
    assert (recording.imu, recording.poses, recording.mounted) == (None, None, ())


def test_kaptures_imu_is_read_with_its_warnings(tmp_path: Path) -> None:
    write_kapture(tmp_path / "walk", shade, SMALL)
    for name, values in (("accelerometer", "0, 1, 0"), ("gyroscope", "0, 0, 0.1")):  # g, rad/s
        rows = [f"{10**18 + 5 * 10**6 * row}, imu, {values}" for row in range(220)]
        (tmp_path / "walk" / "sensors" / f"records_{name}.txt").write_text("\n".join(rows))
    recording = read_recording(tmp_path / "walk")
    assert recording.imu is not None
    assert WarningKind.ACCELERATION_UNIT in [warning.kind for warning in recording.warnings]


def shades(recording: Recording) -> dict[int, float]:
    """The brightness of each frame, by its number."""
    images = recording.frames.images(range(len(recording.frames.times)))
    return {n: float(image.mean()) for n, image in zip(recording.frames.numbers.tolist(), images, strict=True)}


@pytest.mark.parametrize("name", WRITERS)
def test_a_rig_links_pictures_of_one_moment(name: str, tmp_path: Path) -> None:
    WRITERS[name](tmp_path, shade, SMALL)
    recording = read_recording(tmp_path)
    assert len(recording.frames.times) == 2 * MOMENTS
    assert not recording.frames.timed
    assert recording.camera == SMALL
    shown = shades(recording)
    assert len(recording.mounted) == MOMENTS
    for one in recording.mounted:
        there = {round(shown[number]) for number in (one.first, one.second)}
        assert max(there) - min(there) == 90
        right_first = shown[one.first] > shown[one.second]
        expected = np.linalg.inv(T_LEFT_RIGHT) if right_first else T_LEFT_RIGHT
        np.testing.assert_allclose(one.T_first_second, expected, atol=1e-9)
    numbers = sorted(recording.frames.numbers.tolist())
    assert len(select_frames(recording, slice(None, numbers[-1])).mounted) == MOMENTS - 1


@pytest.mark.parametrize("name", WRITERS)
def test_one_camera_is_no_rig(name: str, tmp_path: Path) -> None:
    WRITERS[name](tmp_path, shade, SMALL)
    rig, sensor = tmp_path / "sensors" / "rigs.txt", tmp_path / "mav0" / "cam1" / "sensor.yaml"
    if name == "kapture":
        rig.write_text(rig.read_text().splitlines()[0])
    else:
        sensor.write_text(sensor.read_text().split("intrinsics")[0])
    recording = read_recording(tmp_path)
    assert len(recording.frames.times) == MOMENTS
    assert recording.frames.timed
    assert recording.mounted == ()


def test_of_many_pictures_whole_moments_are_used() -> None:
    pairs = [(k, 400 + k) for k in range(400)]
    rows = _chosen_moments(800, pairs)
    assert 290 <= len(rows) <= 300
    assert {row % 400 for row in rows.tolist() if row < 400} == {row - 400 for row in rows.tolist() if row >= 400}
    assert _chosen_moments(20, [(0, 10)]).tolist() == list(range(20))


@pytest.fixture(scope="module")
def rig_walk(site: Scene, tmp_path_factory: pytest.TempPathFactory) -> tuple[Recording, dict[str, FloatArray]]:
    """A rendered walk of two cameras, and T_map_camera (4, 4) of each picture by its path."""
    renderer = Renderer(site, [face.paint.albedo for face in site.faces])
    camera, folder = PHONE_CAMERA.resized(480, 360), tmp_path_factory.mktemp("rig")
    walk = [pose.T_map_camera for pose in make_walk(1).poses(np.arange(0, 6, 0.5))]

    def T_map(sensor: str, moment: int) -> FloatArray:
        return walk[moment] if sensor == "left" else walk[moment] @ T_LEFT_RIGHT

    def shown(sensor: str, moment: int) -> ByteArray:
        return renderer.radiance(camera, [Pose(T_map(sensor, moment))] * 4)

    write_kapture(folder, shown, camera, len(walk))
    moments = range(len(walk))
    return read_recording(folder), {f"{name}/{k:04d}.png": T_map(name, k) for name in SENSORS for k in moments}


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [1.0, -1.0])
def test_a_rig_makes_its_walk_metric(rig_walk: tuple[Recording, dict[str, FloatArray]], wrong: float) -> None:
    """A mounting that contradicts the pictures, its cameras in each other's place, is left out."""
    recording, T_of = rig_walk
    if wrong < 0:
        swapped = tuple(replace(one, T_first_second=np.linalg.inv(one.T_first_second)) for one in recording.mounted)
        recording = replace(recording, mounted=swapped)
    found = estimate_trajectory(recording, PoseMethod.AUTO)
    T = np.array([T_of[name] for name in sorted(T_of, key=lambda path: path.split("/")[1])])[found.rows]
    assert len(found.rows) == len(T_of)
    assert found.report.trusted
    if wrong > 0:
        assert found.scale is Scale.METRIC
        assert found.report.scale.startswith("The mounting of the cameras fixes the scale")
        assert align_poses(found.T_map_camera, T).scale == pytest.approx(1.0, abs=0.01)
    else:
        assert found.scale is Scale.ARBITRARY
        assert found.report.scale is not None
        assert "it contradicts the pictures" in found.report.scale
