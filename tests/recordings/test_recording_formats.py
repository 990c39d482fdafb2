"""Every format: the same walk comes back from each, with what the format holds of it."""

import json
import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import phone_recordings as phone
import pycolmap
import pytest

from rholoc.errors import InvalidCamera, InvalidRecording, InvalidTrajectory
from rholoc.geometry import Camera, Lens
from rholoc.recordings import (
    CameraFile,
    Recording,
    RecordingFormat,
    read_recording,
    write_camera_json,
    write_waypoints_csv,
)
from rholoc.recordings.frame_slice import SelectedFrames, select_frames
from rholoc.recordings.frames.unified_pictures import SteadyFrames, resampled
from rholoc.recordings.readers import READERS
from rholoc.recordings.recording import Waypoint
from rholoc.reports import WarningKind

UNTIMED = ("7-scenes", "colmap", "nerfstudio", "kapture", "metashape")
SCANNING_APPS = ("scanner-app", "polycam", "record3d", "arkit-scenes")
WITHOUT_IMU = (*UNTIMED, "tum", *SCANNING_APPS)
MOUNTED = {
    "rholoc": phone.R_PORTRAIT_CAMERA_IMU,
    "spectacular": phone.R_LANDSCAPE_CAMERA_IMU,
    "stray": phone.R_LANDSCAPE_CAMERA_IMU,
    "ios-logger": phone.R_LANDSCAPE_CAMERA_IMU,
    "advio": phone.R_PORTRAIT_CAMERA_IMU,
    "euroc": phone.R_PORTRAIT_CAMERA_IMU,
}
POSED = {
    "stray": phone.R_LANDSCAPE_CAMERA_IMU,
    "ios-logger": phone.R_LANDSCAPE_CAMERA_IMU,
    **dict.fromkeys(SCANNING_APPS, phone.R_LANDSCAPE_CAMERA_IMU),
    **dict.fromkeys(("advio", "euroc", "tum", *UNTIMED), phone.R_PORTRAIT_CAMERA_IMU),
}
DISTORTED = {
    "rholoc": (),
    "stray": (),
    **dict.fromkeys((*SCANNING_APPS, "mars-ios", "ios-logger"), ()),
    "spectacular": (0.01, -0.02, 0.0, 0.0, 0.003),
    **dict.fromkeys(("euroc", "colmap", "nerfstudio", "kapture"), (0.1, -0.05, 0.001, 0.002)),
    "metashape": (0.1, -0.05, 0.001, 0.002, 0.0),
}
WARNED = {
    "tum": [WarningKind.NOT_USED],
    **{name: [WarningKind.SCALE_UNKNOWN] for name in ("colmap", "nerfstudio", "kapture")},
}


def read(name: str, tmp_path: Path) -> Recording:
    return read_recording(phone.write_recording(name, tmp_path / "walk"))


@pytest.mark.parametrize("name", phone.WRITERS)
def test_the_walk_comes_back_from_every_format(name: str, tmp_path: Path) -> None:
    recording = read(name, tmp_path)
    assert recording.name == "walk"
    assert recording.format is phone.WRITERS[name][0]
    assert [warning.kind for warning in recording.warnings] == WARNED.get(name, [])
    check_frames(name, recording)
    check_imu(name, recording)
    check_poses(name, recording)
    check_camera(name, recording)


@pytest.mark.parametrize(
    ("name", "known"),
    [(name, 0) for name in ("stray", "7-scenes", "scanner-app", "polycam", "arkit-scenes")] + [("tum", 1)],
)
def test_depth_comes_with_its_frame(name: str, known: int, tmp_path: Path) -> None:
    recording = read(name, tmp_path)
    chosen = select_frames(recording, slice(2, None, 3)).depth
    assert chosen is not None
    for depth, row in ((recording.depth, 5), (chosen, 1)):
        metres = depth.read(row)
        assert np.isnan(metres[0, 0])
        np.testing.assert_allclose(metres[1:], 1.05, atol=2e-4)
    assert sum(path is None for path in recording.depth.paths) == known  # the last of TUM's list is left out


def check_frames(name: str, recording: Recording) -> None:
    times = recording.frames.times - recording.frames.times[0]
    assert recording.frames.timed is (name not in UNTIMED)
    np.testing.assert_allclose(times, np.arange(phone.FRAMES) / (1 if name in UNTIMED else phone.FPS), atol=1e-5)
    if name not in UNTIMED:
        assert recording.frames.times[0] == pytest.approx(0 if name == "advio" else phone.START_S, abs=1e-5)
    assert recording.frames.size == phone.SIZE
    shades = [float(image.mean()) for image in recording.frames.images([3, 11, 20])]
    np.testing.assert_allclose(shades, [30, 110, 200], atol=4)


def check_imu(name: str, recording: Recording) -> None:
    imu = recording.imu
    if name in WITHOUT_IMU:
        assert imu is None
        return
    times = imu.times + (phone.START_S if name == "advio" else 0)
    _, _, rate, felt = phone.truth(times)
    assert len(times) >= 178
    np.testing.assert_allclose(imu.angular_velocity, rate, atol=1e-3)
    np.testing.assert_allclose(imu.acceleration, felt, atol=0.01)
    assert imu.includes_gravity
    if name in MOUNTED:
        np.testing.assert_allclose(imu.R_camera_imu, MOUNTED[name], atol=1e-9)
    else:
        assert imu.R_camera_imu is None


def check_poses(name: str, recording: Recording) -> None:
    if name not in POSED:
        assert recording.poses is None
        return
    assert recording.poses.known.all()
    assert recording.poses.metric is (name not in ("colmap", "nerfstudio", "kapture"))
    np.testing.assert_allclose(recording.poses.T_map_camera, phone.camera_poses(POSED[name]), atol=1e-4)


def check_camera(name: str, recording: Recording) -> None:
    if name in DISTORTED:
        assert recording.camera is not None
        focal = recording.camera.fx if name == "spectacular" else phone.INTRINSICS[0]  # which autofocus changes
        assert recording.camera == Camera(*phone.SIZE, focal, *phone.INTRINSICS[1:], DISTORTED[name])
        assert focal == pytest.approx(phone.INTRINSICS[0], rel=0.02)
    else:
        assert recording.camera is None


@pytest.mark.parametrize("name", phone.WRITERS)
def test_every_format_is_read_from_a_zip_file_wrapped_in_a_folder(name: str, tmp_path: Path) -> None:
    phone.write_recording(name, tmp_path / "packed" / "some name")
    packed = shutil.make_archive(str(tmp_path / "walk"), "zip", tmp_path / "packed")
    recording = read_recording(Path(packed))
    assert recording.format is phone.WRITERS[name][0]
    assert recording.name == "walk"
    assert len(recording.frames.times) == phone.FRAMES


def test_a_folder_of_the_format_at_the_top_of_a_zip_file_stays(tmp_path: Path) -> None:
    folder = phone.write_recording("polycam", tmp_path / "walk")
    (folder / "mesh_info.json").unlink()
    packed = shutil.make_archive(str(tmp_path / "walk"), "zip", folder)
    assert read_recording(Path(packed)).format is RecordingFormat.POLYCAM


def test_every_reader_has_a_format_of_its_own_and_a_walk_here() -> None:
    formats = [reader.format for reader in READERS]
    assert len(set(formats)) == len(formats)
    written = {kind for kind, _ in phone.WRITERS.values()}
    elsewhere = {RecordingFormat.BAG}  # test_bags writes them
    assert {*formats, RecordingFormat.RHOLOC} == written | elsewhere
    assert written | elsewhere | {RecordingFormat.VIDEO} == set(RecordingFormat)


def test_what_a_recorder_logs_of_every_frame(tmp_path: Path) -> None:
    android = read_recording(phone.write_recording("mars-android", tmp_path / "android"), frames="3:5")
    assert android.readout_s == pytest.approx(0.015)
    np.testing.assert_array_equal(android.frame_intrinsics[:, :2], [[64, 65], [65, 66]])
    assert np.isnan(android.frame_intrinsics[:, 2:]).all()
    ios = read_recording(phone.write_recording("mars-ios", tmp_path / "ios"))
    for name in ("stray", "ios-logger"):
        recording = read_recording(phone.write_recording(name, tmp_path / name))
        for logged in (ios, recording):
            np.testing.assert_array_equal(logged.frame_intrinsics, np.tile(phone.INTRINSICS, (24, 1)))
    spectacular = read_recording(phone.write_recording("spectacular", tmp_path / "spectacular"))
    np.testing.assert_allclose(spectacular.frame_intrinsics[:, 0], 60 + 0.1 * np.arange(24))


@pytest.mark.parametrize("platform", ["android", "ios"])
def test_sensor_logger_without_gravity(platform: str, tmp_path: Path) -> None:
    folder = tmp_path / "walk"
    phone.write_sensor_logger(folder, platform)
    (folder / "TotalAcceleration.csv").unlink(missing_ok=True)
    imu = read_recording(folder).imu
    assert not imu.includes_gravity
    R, _, _, felt = phone.truth(imu.times)
    np.testing.assert_allclose(imu.acceleration, felt - np.einsum("nji,j->ni", R, [0, 0, phone.GRAVITY]), atol=1e-2)


def test_the_raw_tables_of_ios_logger_serve_without_the_fused_one(tmp_path: Path) -> None:
    folder = phone.write_recording("ios-logger", tmp_path / "walk")
    rate = phone.truth(phone.imu_times)[2]
    later = phone.imu_times + 0.003
    phone.write_rows(folder / "Gyro.txt", "", np.column_stack([phone.imu_times, rate]).tolist())
    accelerometer = np.column_stack([later, -phone.truth(later)[3] / phone.GRAVITY])
    phone.write_rows(folder / "Accel.txt", "", accelerometer.tolist())
    (folder / "MotARH.txt").unlink()
    imu = read_recording(folder).imu
    np.testing.assert_allclose(imu.acceleration, phone.truth(imu.times)[3], atol=0.02)


def test_ios_logger_without_its_video_has_times_and_no_images(tmp_path: Path) -> None:
    folder = phone.write_recording("ios-logger", tmp_path / "walk")
    (folder / "Frames.m4v").unlink()
    write_camera_json(folder / "camera.json", CameraFile(Camera(*phone.SIZE, *phone.INTRINSICS)))
    recording = read_recording(folder)
    assert recording.warnings[0].kind is WarningKind.NO_IMAGES
    assert len(recording.frames.times) == phone.FRAMES
    with pytest.raises(InvalidRecording, match="no images"):
        list(recording.frames.images([0]))


def test_apples_sign_is_found_by_the_poses_where_a_format_does_not_have_it(tmp_path: Path) -> None:
    folder = phone.write_recording("advio", tmp_path / "walk")
    _, _, _, felt = phone.truth(phone.imu_times)
    rows = np.column_stack([phone.imu_times - phone.START_S, -felt / phone.GRAVITY])
    phone.write_rows(folder / "iphone" / "accelerometer.csv", "", rows.tolist())
    recording = read_recording(folder)
    assert {warning.kind for warning in recording.warnings} == {WarningKind.ACCELERATION_UNIT, WarningKind.SIGN}
    check_imu("advio", recording)


def test_waypoints_and_intrinsics_may_be_added_to_any_format(tmp_path: Path) -> None:
    folder = phone.write_recording("opencamera", tmp_path / "walk")
    waypoints = [Waypoint(f"W{i}", phone.START_S + 0.3 * i, (i, i * i, 1.5)) for i in range(3)]
    write_waypoints_csv(folder / "waypoints.csv", waypoints)
    camera = Camera(2 * 64, 2 * 48, 120, 120, 63.5, 47.5)
    write_camera_json(
        folder / "camera.json", CameraFile(camera, R_camera_imu=phone.R_PORTRAIT_CAMERA_IMU, readout_s=0.02)
    )
    recording = read_recording(folder)
    assert recording.format is RecordingFormat.OPENCAMERA_SENSORS
    assert [waypoint.name for waypoint in recording.waypoints] == ["W0", "W1", "W2"]
    assert recording.camera == Camera(64, 48, 60, 60, 31.5, 23.5)
    np.testing.assert_array_equal(recording.imu.R_camera_imu, phone.R_PORTRAIT_CAMERA_IMU)
    assert recording.readout_s == 0.02


def colmap_of_two_cameras(folder: Path) -> Path:
    """A COLMAP model whose fifth picture is by a camera of its own."""
    phone.write_recording("colmap", folder)
    cameras = folder / "sparse" / "0" / "cameras.txt"
    cameras.write_text(cameras.read_text() + "2 PINHOLE 64 48 70 71 32 24\n")
    path = folder / "sparse" / "0" / "images.txt"
    path.write_text(path.read_text().replace(" 1 walk/frame0004.png", " 2 walk/frame0004.png"))
    return folder


def test_one_camera_is_refused_for_resampled_pictures(tmp_path: Path) -> None:
    folder = colmap_of_two_cameras(tmp_path / "walk")
    write_camera_json(folder / "camera.json", CameraFile(Camera(*phone.SIZE, *phone.INTRINSICS)))
    with pytest.raises(InvalidCamera, match="One camera is given"):
        read_recording(folder)


@pytest.mark.parametrize("ending", ["_timestamps.csv", "_imu_timestamps.csv"])
def test_times_of_opencamera_are_the_gyroscopes_sibling(tmp_path: Path, ending: str) -> None:
    tables = phone.write_recording("opencamera", tmp_path / "walk") / "20260101_101010"
    times = tables / "VID_1_timestamps.csv"
    shutil.move(times, tables / f"VID_1{ending}")
    phone.write_rows(tables / "VID_0_timestamps.csv", "", [[time] for time in phone.ns(phone.frame_times + 0.1)])
    np.testing.assert_allclose(read_recording(tmp_path / "walk").frames.times, phone.frame_times, atol=1e-6)


def test_fisheye_intrinsics_are_read(tmp_path: Path) -> None:
    edits = {
        "euroc": ("mav0/cam0/sensor.yaml", "radial-tangential", "equidistant"),
        "colmap": ("sparse/0/cameras.txt", "1 OPENCV", "1 OPENCV_FISHEYE"),
        "nerfstudio": ("transforms.json", '"OPENCV"', '"OPENCV_FISHEYE"'),
    }
    for name, (file, old, new) in edits.items():
        path = phone.write_recording(name, tmp_path / name) / file
        assert old in path.read_text()
        path.write_text(path.read_text().replace(old, new))
        recording = read_recording(tmp_path / name)
        assert recording.camera.lens is Lens.FISHEYE
        assert recording.camera.distortion[:2] == DISTORTED[name][:2]  # nerfstudio's others are called k3 and k4


def test_a_camera_model_of_euroc_that_is_not_a_pinhole_is_named(tmp_path: Path) -> None:
    sensor = phone.write_recording("euroc", tmp_path / "walk") / "mav0" / "cam0" / "sensor.yaml"
    sensor.write_text(sensor.read_text().replace("intrinsics: [", "camera_model: omni\nintrinsics: [1.2, "))
    recording = read_recording(tmp_path / "walk")
    assert recording.camera is None
    (warning,) = recording.warnings
    assert warning.kind is WarningKind.CAMERA_UNSUPPORTED
    assert "omni" in warning.text


def test_the_broken_camera_of_a_rig_is_named(tmp_path: Path) -> None:
    root = phone.write_recording("euroc", tmp_path / "walk") / "mav0"
    for name in ("imu0", "state_groundtruth_estimate0"):
        shutil.rmtree(root / name)
    shutil.copytree(root / "cam0", root / "cam1")
    sensor = root / "cam1" / "sensor.yaml"
    sensor.write_text(sensor.read_text().replace("intrinsics: [", "intrinsics: [wide, "))
    with pytest.raises(InvalidCamera, match=r"^cam1/sensor\.yaml"):
        read_recording(tmp_path / "walk")


def test_a_frame_that_tracking_lost_has_no_pose(tmp_path: Path) -> None:
    folder = phone.write_recording("7-scenes", tmp_path / "walk")
    (folder / "frame-000005.pose.txt").write_text("-1.#IND " * 16)
    (folder / "frame-000006.pose.txt").write_text("nan " * 16)
    (folder / "frame-000007.pose.txt").unlink()
    with pytest.raises(InvalidTrajectory, match=r"frame-000005\.pose\.txt"):
        read_recording(folder)
    (folder / "frame-000005.pose.txt").write_text("inf " * 16)
    poses = read_recording(folder).poses
    assert np.flatnonzero(~poses.known).tolist() == [5, 6, 7]


def test_a_partial_pose_of_kapture_counts_as_unknown(tmp_path: Path) -> None:
    sensors, pictures = tmp_path / "sensors", tmp_path / "sensors" / "records_data"
    pictures.mkdir(parents=True)
    for number in range(3):
        cv2.imwrite(str(pictures / f"{number}.jpg"), np.full((48, 64, 3), 80 * number, np.uint8))
    (sensors / "sensors.txt").write_text("cam, , camera, PINHOLE, 64, 48, 40, 40, 32, 24\n")
    (sensors / "records_camera.txt").write_text("".join(f"{number}, cam, {number}.jpg\n" for number in range(3)))
    (sensors / "trajectories.txt").write_text(
        "0, cam, 1, 0, 0, 0, 1, 2, 3\n1, cam, 1, 0, 0, 0, , , \n2, cam, , , , , 1, 2, 3\n"
    )
    poses = read_recording(tmp_path).poses
    assert poses is not None
    assert poses.known.tolist() == [True, False, False]
    np.testing.assert_allclose(poses.T_map_camera[0, :3, 3], [-1, -2, -3])


def test_7_scenes_is_recognised_by_any_frame_and_in_capitals(tmp_path: Path) -> None:
    folder = phone.write_recording("7-scenes", tmp_path / "walk")
    (folder / "frame-000000.pose.txt").unlink()
    for path in folder.glob("*.color.png"):
        path.rename(path.with_suffix(".PNG"))
    recording = read_recording(folder)
    assert recording.format is RecordingFormat.SEVEN_SCENES
    assert recording.poses.known.tolist() == [False, *[True] * (phone.FRAMES - 1)]


def test_times_of_poses_that_belong_to_no_frame_are_written_in_full(tmp_path: Path) -> None:
    folder = phone.write_recording("tum", tmp_path / "walk")
    (folder / "groundtruth.txt").write_text("1305031102.25 0 0 0 0 0 0 1\n1305031105.5 0 0 0 0 0 0 1\n")
    with pytest.raises(InvalidTrajectory, match=r"from 1305031102\.25 to 1305031105\.5"):
        read_recording(folder)


def test_frames_that_a_colmap_model_does_not_place_are_left_aside(tmp_path: Path) -> None:
    folder = phone.write_recording("colmap", tmp_path / "walk")
    phone.write_images(folder / "images", ["walk/frame0099.png"])
    path = folder / "sparse" / "0" / "images.txt"
    lines = path.read_text().splitlines()
    path.write_text("\n".join(lines[:1] + lines[5:]))
    recording = read_recording(folder)
    assert recording.frames.numbers.tolist() == list(range(22))


def test_a_cameras_own_intrinsics_of_several_in_a_colmap_model(tmp_path: Path) -> None:
    folder = colmap_of_two_cameras(tmp_path / "walk")
    recording = read_recording(folder)
    plain = read_recording(phone.write_recording("colmap", tmp_path / "plain"))
    assert recording.camera.distortion == ()
    assert recording.camera.fx == pytest.approx(60, rel=0.02)
    assert recording.frames.size[0] >= phone.SIZE[0] - 2
    shades = [float(image[10:-10, 10:-10].mean()) for image in recording.frames.images([3, 11, 20])]
    expected = [float(image[10:-10, 10:-10].mean()) for image in plain.frames.images([3, 11, 20])]
    np.testing.assert_allclose(shades, expected, atol=4)


def test_a_binary_colmap_model_is_read_as_its_text_is(tmp_path: Path) -> None:
    text, binary = (phone.write_recording("colmap", tmp_path / name) for name in ("text", "binary"))
    _to_binary(binary / "sparse" / "0")
    one, other = read_recording(text), read_recording(binary)
    assert other.camera == one.camera
    np.testing.assert_allclose(other.poses.T_map_camera, one.poses.T_map_camera, atol=1e-9)
    assert other.frames.numbers.tolist() == one.frames.numbers.tolist()


def test_a_model_by_hloc_is_read_and_its_features_are_named_as_unused(tmp_path: Path) -> None:
    folder = phone.write_recording("colmap", tmp_path / "walk")
    (folder / "outputs").mkdir()
    (folder / "sparse" / "0").rename(folder / "outputs" / "sfm_superpoint+lightglue")
    (folder / "sparse").rmdir()
    (folder / "images").rename(folder / "photos")
    (folder / "outputs" / "feats-superpoint-n4096-r1024.h5").write_bytes(b"\x89HDF\r\n\x1a\n")
    recording = read_recording(folder)
    assert recording.format is RecordingFormat.COLMAP
    assert len(recording.frames.times) == phone.FRAMES
    (warning,) = [one for one in recording.warnings if one.kind is WarningKind.NOT_USED]
    assert warning.text.endswith(": outputs/feats-superpoint-n4096-r1024.h5.")


def test_blank_lines_before_the_images_of_a_colmap_model_are_skipped(tmp_path: Path) -> None:
    folder = phone.write_recording("colmap", tmp_path / "walk")
    path = folder / "sparse" / "0" / "images.txt"
    path.write_text(path.read_text().replace("\n", "\n\n", 1))
    assert len(read_recording(folder).frames.times) == phone.FRAMES


def test_pictures_of_a_colmap_model_are_sought_beside_a_folder_called_images(tmp_path: Path) -> None:
    folder = phone.write_recording("colmap", tmp_path / "walk")
    (folder / "images").rename(folder / "photos")
    phone.write_images(folder / "images", ["thumbnail.png"])
    assert len(read_recording(folder).frames.times) == phone.FRAMES


def test_half_a_binary_colmap_model_does_not_hide_a_whole_one_of_text(tmp_path: Path) -> None:
    folder = phone.write_recording("colmap", tmp_path / "walk")
    (folder / "sparse" / "0" / "images.bin").write_bytes(b"left over")
    assert len(read_recording(folder).frames.times) == phone.FRAMES


@pytest.mark.parametrize("kept", [0, 7, 40, 100])
def test_a_binary_colmap_model_that_is_cut_off_is_refused(kept: int, tmp_path: Path) -> None:
    folder = phone.write_recording("colmap", tmp_path / "walk")
    _to_binary(folder / "sparse" / "0")
    images = folder / "sparse" / "0" / "images.bin"
    images.write_bytes(images.read_bytes()[:kept])
    with pytest.raises(InvalidRecording, match="broken or cut off"):
        read_recording(folder)


def _to_binary(model: Path) -> None:
    pycolmap.Reconstruction(str(model)).write_binary(str(model))
    for name in ("cameras", "images", "points3D"):
        (model / f"{name}.txt").unlink()


def test_a_transform_that_nerfstudio_applied_is_undone(tmp_path: Path) -> None:
    folder = phone.write_recording("nerfstudio", tmp_path / "walk")
    values = json.loads((folder / "transforms.json").read_text())
    applied = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    for frame in values["frames"]:
        frame["transform_matrix"] = (applied @ np.array(frame["transform_matrix"])).tolist()
    values["applied_transform"] = applied[:3].tolist()
    (folder / "transforms.json").write_text(json.dumps(values))
    poses = read_recording(folder).poses
    np.testing.assert_allclose(poses.T_map_camera, phone.camera_poses(POSED["nerfstudio"]), atol=1e-4)


def test_pictures_of_a_scanner_app_with_their_own_focal_lengths_become_frames_of_one_camera(tmp_path: Path) -> None:
    folder = phone.write_recording("scanner-app", tmp_path / "walk")
    for i, path in enumerate(sorted(folder.glob("frame_*.json"))):
        values = json.loads(path.read_text())
        values["intrinsics"][0] = values["intrinsics"][4] = 60 + 0.1 * i
        path.write_text(json.dumps(values))
    recording = read_recording(folder)
    assert 60 < recording.camera.fx < 60 + 0.1 * phone.FRAMES
    assert recording.frames.size == (recording.camera.width, recording.camera.height)


def test_a_broken_picture_of_a_scan_is_named(tmp_path: Path) -> None:
    folder = phone.write_recording("scanner-app", tmp_path / "walk")
    (folder / "frame_00003.jpg").write_bytes(b"")
    with pytest.raises(InvalidRecording, match=r"frame_00003\.jpg: .*Leave that file out"):
        read_recording(folder)


def test_a_second_picture_of_arkit_scenes_at_the_same_time_is_left_out(tmp_path: Path) -> None:
    folder = phone.write_recording("arkit-scenes", tmp_path / "walk")
    (picture,) = folder.rglob("lowres_wide/*_1000.150.png")
    (intrinsics,) = folder.rglob("*_1000.150.pincam")
    for path in (picture, intrinsics):
        shutil.copy(path, path.with_stem(f"{path.stem}0"))
    recording = read_recording(folder)
    assert len(recording.frames.times) == phone.FRAMES
    assert recording.poses.known.all()


@pytest.mark.parametrize("shift_s", [-0.001, 0.001])
def test_intrinsics_of_arkit_scenes_may_be_a_millisecond_off(tmp_path: Path, shift_s: float) -> None:
    folder = phone.write_recording("arkit-scenes", tmp_path / "walk")
    for path in sorted(folder.rglob("*.pincam"), reverse=shift_s > 0):
        scan, time = path.stem.split("_")
        path.rename(path.with_name(f"{scan}_{float(time) + shift_s:.3f}.pincam"))
    camera = read_recording(folder).camera
    assert camera.fx == phone.INTRINSICS[0]


def test_a_broken_depth_image_does_not_keep_a_scan_from_being_read(tmp_path: Path) -> None:
    folder = phone.write_recording("scanner-app", tmp_path / "walk")
    (folder / "depth_00000.png").write_bytes(b"cut off")
    depth = read_recording(folder).depth
    assert depth.camera is not None
    assert depth.read(0) is None
    assert depth.read(1) is not None


def test_record3ds_own_file_is_read(tmp_path: Path) -> None:
    phone.write_recording("record3d", tmp_path / "walk")
    packed = Path(shutil.make_archive(str(tmp_path / "walk"), "zip", tmp_path / "walk"))
    recording = read_recording(packed.rename(tmp_path / "walk.r3d"))
    assert recording.format is RecordingFormat.RECORD3D
    assert recording.poses is not None


def test_polycams_refined_cameras_are_preferred(tmp_path: Path) -> None:
    keyframes = phone.write_recording("polycam", tmp_path / "walk") / "keyframes"
    for kind in ("images", "cameras"):
        shutil.copytree(keyframes / kind, keyframes / f"corrected_{kind}")
    for path in (keyframes / "corrected_cameras").iterdir():
        values = json.loads(path.read_text())
        path.write_text(json.dumps({**values, "t_03": values["t_03"] + 1}))
    poses = read_recording(tmp_path / "walk").poses
    moved = poses.T_map_camera[:, 0, 3] - phone.camera_poses(phone.R_LANDSCAPE_CAMERA_IMU)[:, 0, 3]
    np.testing.assert_allclose(moved, 1, atol=1e-6)


def test_metashapes_scale_and_fourth_coefficient(tmp_path: Path) -> None:
    path = phone.write_recording("metashape", tmp_path / "walk") / "cameras.xml"
    text = path.read_text()
    path.write_text(text.replace("<k2>", "<k4>0.02</k4><k2>"))
    camera = read_recording(tmp_path / "walk").camera
    assert camera.distortion[4] != 0
    start, end = text.index("<components>"), text.index("<cameras>")
    path.write_text(text[:start] + text[end:])
    recording = read_recording(tmp_path / "walk")
    assert not recording.poses.metric
    assert [warning.kind for warning in recording.warnings] == [WarningKind.SCALE_UNKNOWN]


def test_metashapes_cameras_of_one_label_are_left_out(tmp_path: Path) -> None:
    path = phone.write_recording("metashape", tmp_path / "walk") / "cameras.xml"
    text = path.read_text()
    phone.write_images(tmp_path / "walk" / "other", ["DSC00003.JPG"])
    path.write_text(text.replace('label="DSC00004"', 'label="DSC00003"'))
    recording = read_recording(tmp_path / "walk")
    assert recording.frames.numbers.tolist() == [0, 1, 2, *range(5, phone.FRAMES)]
    (warning,) = [one for one in recording.warnings if "label" in one.text]
    assert warning.kind is WarningKind.NOT_USED
    assert "DSC00003" in warning.text
    path.write_text(re.sub(r'label="DSC\d+"', 'label="DSC00003"', text))
    with pytest.raises(InvalidRecording, match="shares its label"):
        read_recording(tmp_path / "walk")


def test_an_xml_file_with_entities_is_not_expanded(tmp_path: Path) -> None:
    path = phone.write_recording("metashape", tmp_path / "walk") / "cameras.xml"
    path.write_text(path.read_text().replace("<document", '<!DOCTYPE a [<!ENTITY b "c">]><document', 1))
    with pytest.raises(InvalidRecording, match="neither a video nor images"):
        read_recording(tmp_path / "walk")


def test_frames_whose_logged_focal_length_changes_become_frames_of_one_camera(tmp_path: Path) -> None:
    folder = phone.write_recording("stray", tmp_path / "walk")
    (folder / "camera_matrix.csv").unlink()
    steady = read_recording(folder)
    assert steady.camera == Camera(*phone.SIZE, *phone.INTRINSICS)

    def zoomed(rows: list[list[str]]) -> list[list[str]]:
        column = [name.strip() for name in rows[0]].index("fx")
        return [
            rows[0],
            *([*row[:column], str(60 + i), str(61 + i), *row[column + 2 :]] for i, row in enumerate(rows[1:])),
        ]

    phone.edit_rows(folder / "odometry.csv", zoomed)
    recording = read_recording(folder, frames="4:")
    assert recording.camera.fx == 71.5
    assert isinstance(recording.frames, SelectedFrames)
    frames = recording.frames.source
    assert isinstance(frames, SteadyFrames)
    assert frames.cameras[3].fx == 63
    assert [float(image.mean()) for image in recording.frames.images([0, 1])] == pytest.approx([40, 50], abs=4)


def test_a_zoomed_picture_is_resampled_as_rays_are() -> None:
    image = np.random.default_rng(0).integers(0, 255, (48, 64, 3), np.uint8)
    image = cv2.GaussianBlur(image, None, 2)
    camera = Camera(64, 48, 60, 61, 30, 24, (0.1, -0.05, 0.001, 0.002))
    common = Camera(64, 48, 57, 58, 31.5, 23.5, (0.1, -0.05, 0.001, 0.002))
    found = resampled(image, camera, common)
    u, v = np.meshgrid(np.arange(64), np.arange(48))
    places = camera.project(common.rays(np.column_stack([u.ravel(), v.ravel()]))).astype(np.float32).reshape(48, 64, 2)
    expected = cv2.remap(image, places, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    np.testing.assert_allclose(found[4:-4, 4:-4].astype(float), expected[4:-4, 4:-4].astype(float), atol=4)
