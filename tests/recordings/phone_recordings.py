"""One short walk, written in the layout of every format that is read. All of it is synthesised here.

The walk: 24 frames at 20 a second whose frame i has shade 10 i, and a phone in portrait that turns about two axes and
is thrust to and fro, sampled 100 times a second in the axes of iOS and Android (x right, y up, z out of the screen).
"""

import csv
import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.geometry import FloatArray
from rholoc.recordings import CameraFile, RecordingFormat, read_recording, write_camera_json

SIZE = (64, 48)
FRAMES = 24
FPS = 20.0
START_S = 1000.0
GRAVITY = 9.80665
R_LANDSCAPE_CAMERA_IMU = np.array([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1]])
R_PORTRAIT_CAMERA_IMU = np.diag([1.0, -1, -1])
INTRINSICS = (60.0, 61.0, 31.5, 23.5)

frame_times = START_S + np.arange(FRAMES) / FPS
imu_times = START_S - 0.3 + np.arange(180) / 100


def truth(times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Rotations R_map_imu (N, 3, 3), positions (N, 3), what the gyroscope and what the accelerometer reads (N, 3)."""
    t = times - START_S

    def rotation(at: FloatArray) -> Rotation:
        upright = Rotation.from_matrix([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # the phone's y is up
        return upright * Rotation.from_euler("yx", np.column_stack([0.8 * at, 0.35 * np.sin(4 * at)]))

    step = 1e-4
    rate = (rotation(t - step / 2).inv() * rotation(t + step / 2)).as_rotvec() / step
    positions = np.column_stack([0.2 * np.sin(3 * t), 0.3 * t, 1.5 + 0.02 * np.sin(6 * t)])
    pull = np.column_stack([-1.8 * np.sin(3 * t), 0 * t, -0.72 * np.sin(6 * t)])
    felt = rotation(t).inv().apply(pull + np.array([0, 0, GRAVITY]))
    return rotation(t).as_matrix(), positions, rate, felt


def camera_poses(R_camera_imu: FloatArray) -> FloatArray:
    """T_map_camera (24, 4, 4) at the frames' times, of a camera mounted so."""
    R, positions, _, _ = truth(frame_times)
    T = np.tile(np.eye(4), (FRAMES, 1, 1))
    T[:, :3, :3] = R @ R_camera_imu.T
    T[:, :3, 3] = positions
    return T


def picture(shade: int) -> np.ndarray:
    return np.full((SIZE[1], SIZE[0], 3), shade, np.uint8)


def write_video(path: Path, frames: int = FRAMES) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), FPS, SIZE)
    assert writer.isOpened()
    for i in range(frames):
        writer.write(picture(10 * i))
    writer.release()


def write_m4v(path: Path) -> None:
    """A video under a name that OpenCV does not write."""
    write_video(path.with_suffix(".mp4"))
    path.with_suffix(".mp4").rename(path)


def write_images(folder: Path, names: list[str]) -> None:
    for i, name in enumerate(names):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(folder / name), picture(10 * i))


def write_rows(path: Path, header: str, rows: list[list[object]], separator: str = ",") -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [header] * bool(header) + [separator.join(map(str, row)) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def ns(times: FloatArray) -> list[int]:
    return [round(time * 1e9) for time in times]


def quaternions(R: FloatArray) -> FloatArray:
    """(N, 4): x, y, z, w."""
    return np.asarray(Rotation.from_matrix(R).as_quat())


def write_rholoc(folder: Path) -> None:
    _, _, rate, felt = truth(imu_times)
    write_video(folder / "video.mp4")
    write_rows(folder / "frames.csv", "frame,timestamp", [[i, f"{t:.6f}"] for i, t in enumerate(frame_times)])
    rows = np.column_stack([imu_times, felt, rate])
    write_rows(folder / "imu.csv", "timestamp,ax,ay,az,gx,gy,gz", rows.tolist())
    camera = dict(zip(("fx", "fy", "cx", "cy"), INTRINSICS, strict=True))
    values = {"width": SIZE[0], "height": SIZE[1], **camera, "R_camera_imu": R_PORTRAIT_CAMERA_IMU.tolist()}
    (folder / "camera.json").write_text(json.dumps(values))


def write_android_csv(folder: Path) -> None:
    _, _, rate, felt = truth(imu_times)
    write_video(folder / "video.mp4")
    names = [f"frame_{i + 1:06d}.jpg" for i in range(FRAMES)]
    write_rows(folder / "frames.csv", "timestamp_ns,filename", list(zip(ns(frame_times), names, strict=True)))
    for name, columns, values in (("accelerometer", "ax,ay,az", felt), ("gyroscope", "gx,gy,gz", rate)):
        rows = [[time, *value] for time, value in zip(ns(imu_times), values, strict=True)]
        write_rows(folder / f"{name}.csv", f"timestamp_ns,{columns}", rows)


def write_opencamera(folder: Path) -> None:
    later = imu_times + 0.004  # the accelerometer has times of its own
    write_video(folder / "VID_1.mp4")
    tables = folder / "20260101_101010"
    write_rows(tables / "VID_1_timestamps.csv", "", [[time] for time in ns(frame_times)])
    for name, times, values in (
        ("accel", later, truth(later)[3]),
        ("gyro", imu_times, truth(imu_times)[2]),
    ):
        rows = [[*value, time] for time, value in zip(ns(times), values, strict=True)]
        write_rows(tables / f"VID_1_{name}.csv", "", rows)


def write_mars(folder: Path) -> None:
    _, _, rate, felt = truth(imu_times)
    write_video(folder / "movie.mp4")
    header = "Timestamp[nanosec],gx[rad/s],gy[rad/s],gz[rad/s],ax[m/s^2],ay[m/s^2],az[m/s^2],Unix time[nanosec]"
    rows = [[t, *w, *f, 0] for t, w, f in zip(ns(imu_times), rate, felt, strict=True)]
    write_rows(folder / "gyro_accel.csv", header, rows)
    header = "Timestamp[nanosec],fx[px],fy[px],Frame No.,Exposure time[nanosec],Frame readout time[nanosec],ISO"
    extra = [frame_times[0] - 1 / FPS, *frame_times]  # of one capture that is not in the video
    rows = [[t, 60 + i, 61 + i, i, 5_000_000, 15_000_000, 100] for i, t in enumerate(ns(np.array(extra)))]
    write_rows(folder / "movie_metadata.csv", header, rows)
    write_rows(folder / "frame_timestamps.txt", "", [[time] for time in ns(frame_times)])


def write_mars_ios(folder: Path) -> None:
    _, _, rate, felt = truth(imu_times)
    write_video(folder / "movie.mp4")
    header = "#Recording starts\nTimestamp [seconds], gx[rad/s], gy[rad/s], gz[rad/s], ax[m/s^2], ay[m/s^2], az[m/s^2]"
    write_rows(folder / "raw_accel_gyro.csv", header, np.column_stack([imu_times, rate, felt]).tolist(), ", ")
    header = "Timestamp[sec], fx[px], fy[px], cx[px], cy[px], exposure duration[sec]"
    write_rows(folder / "movie_metadata.csv", header, [[t, *INTRINSICS, 0.01] for t in frame_times], ", ")


def write_sensor_logger(folder: Path, platform: str = "android", gravity: bool = False) -> None:
    _, _, rate, felt = truth(imu_times)
    R = truth(imu_times)[0]
    sign = -1 if platform == "ios" else 1
    down = np.einsum("nji,j->ni", R, [0, 0, GRAVITY])
    (folder / "Camera").mkdir(parents=True)
    write_video(folder / "Camera" / f"{round(START_S * 1000)}.mp4")
    tables = {"Gyroscope": rate, "Accelerometer": sign * (felt - down)}
    if platform == "android":
        tables["TotalAcceleration"] = felt
    if gravity:
        tables["Gravity"] = sign * down
    for name, values in tables.items():
        rows = [[t, s - START_S, *v[::-1]] for t, s, v in zip(ns(imu_times), imu_times, values, strict=True)]
        write_rows(folder / f"{name}.csv", "time,seconds_elapsed,z,y,x", rows)
    header = "version,device name,recording epoch time,platform,appVersion,standardisation"
    write_rows(folder / "Metadata.csv", header, [[3, "a phone", 1, platform, "1.64", "false"]])


def write_sensor_logger_ios(folder: Path) -> None:
    write_sensor_logger(folder, "ios", gravity=True)


def write_spectacular(folder: Path) -> None:
    _, _, rate, felt = truth(imu_times)
    write_m4v(folder / "data.m4v")
    lines: list[tuple[float, dict[str, object]]] = []
    for time, w, f in zip(imu_times, rate, felt, strict=True):
        lines.append((time, {"sensor": {"type": "gyroscope", "values": w.tolist()}, "time": time}))
        lines.append((time, {"sensor": {"type": "accelerometer", "values": f.tolist()}, "time": time}))
        lines.append((time, {"sensor": {"type": "imuTemperature", "values": [292.9]}, "time": time}))
    names = ("focalLengthX", "focalLengthY", "principalPointX", "principalPointY")
    for i, time in enumerate(frame_times):
        parameters = dict(zip(names, (60.0 + 0.1 * i, *INTRINSICS[1:]), strict=True))
        frame = {"cameraInd": 0, "cameraParameters": parameters, "time": time}
        lines.append((time, {"frames": [frame], "number": i, "time": time}))
    lines.sort(key=lambda line: line[0])
    folder.joinpath("data.jsonl").write_text("\n".join(json.dumps(line) for _, line in lines) + "\n")
    T = np.eye(4)
    T[:3, :3] = R_LANDSCAPE_CAMERA_IMU
    camera = dict(zip(names, INTRINSICS, strict=True)) | {
        "model": "pinhole",
        "distortionCoefficients": [0.01, -0.02, 0.003],
        "imageWidth": SIZE[0],
        "imageHeight": SIZE[1],
        "imuToCamera": T.tolist(),
    }
    (folder / "calibration.json").write_text(json.dumps({"cameras": [camera]}))


R_MAP_ARKIT = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # ARKit's y is up


def write_depth(folder: Path, names: list[str], unit_m: float = 1e-3, unknown: int = 0) -> None:
    """Depth images of a wall a metre away, and a centimetre more with each frame; of the first pixel it is unknown."""
    for i, name in enumerate(names):
        depth = np.full((SIZE[1], SIZE[0]), round((1 + i / 100) / unit_m), np.uint16)
        depth[0, 0] = unknown
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(folder / name), depth)


def write_stray(folder: Path) -> None:
    T = camera_poses(R_LANDSCAPE_CAMERA_IMU)
    _, _, rate, felt = truth(imu_times)
    write_video(folder / "rgb.mp4")
    q = quaternions(R_MAP_ARKIT.T @ T[:, :3, :3])
    p = T[:, :3, 3] @ R_MAP_ARKIT
    header = "timestamp, frame, x, y, z, qx, qy, qz, qw, fx, fy, cx, cy, distortion_center_x"
    rows = [[frame_times[i], f"{i:06d}", *p[i], *q[i], *INTRINSICS, ""] for i in range(FRAMES)]
    write_rows(folder / "odometry.csv", header, rows, ", ")
    fx, fy, cx, cy = INTRINSICS
    write_rows(folder / "camera_matrix.csv", "", [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], ", ")
    write_depth(folder, [f"depth/{i:06d}.png" for i in range(FRAMES)])
    header = "timestamp, a_x, a_y, a_z, alpha_x, alpha_y, alpha_z"
    write_rows(folder / "imu.csv", header, np.column_stack([imu_times, -felt / GRAVITY, rate]).tolist(), ", ")


def arkit_rows(T_map_camera: FloatArray) -> FloatArray:
    """x, y, z, qw, qx, qy, qz (N, 7) of cameras with OpenCV's axes, in ARKit's."""
    q = quaternions(R_MAP_ARKIT.T @ T_map_camera[:, :3, :3] @ np.diag([1.0, -1, -1]))
    return np.column_stack([T_map_camera[:, :3, 3] @ R_MAP_ARKIT, q[:, 3], q[:, :3]])


def write_ios_logger(folder: Path) -> None:
    R, _, rate, felt = truth(imu_times)
    write_m4v(folder / "Frames.m4v")
    write_rows(folder / "Frames.txt", "", [[t, i, *INTRINSICS] for i, t in enumerate(frame_times)])
    poses = arkit_rows(camera_poses(R_LANDSCAPE_CAMERA_IMU))
    write_rows(folder / "ARposes.txt", "", np.column_stack([frame_times, poses]).tolist())
    down = np.einsum("nji,j->ni", R, [0, 0, 1.0])
    fused = np.column_stack([imu_times, rate, -down, -(felt / GRAVITY - down), np.zeros(len(felt))])
    write_rows(folder / "MotARH.txt", "", fused.tolist())


def write_advio(folder: Path) -> None:
    phone = folder / "iphone"
    _, _, rate, felt = truth(imu_times)
    write_m4v(phone / "frames.mov")
    stamped = frame_times + 5.0  # frames and ARKit count from the first frame, the IMU does not
    write_rows(phone / "frames.csv", "", [[t, i + 1] for i, t in enumerate(stamped)])
    T = camera_poses(R_PORTRAIT_CAMERA_IMU)
    write_rows(phone / "arkit.csv", "", np.column_stack([stamped, arkit_rows(T)]).tolist())
    since = imu_times - START_S
    write_rows(phone / "accelerometer.csv", "", np.column_stack([since, felt]).tolist())
    write_rows(phone / "gyro.csv", "", np.column_stack([since, rate]).tolist())


def write_euroc(folder: Path) -> None:
    root = folder / "mav0"
    _, _, rate, felt = truth(imu_times)
    names = [f"{time}.png" for time in ns(frame_times)]
    write_images(root / "cam0" / "data", names)
    write_rows(root / "cam0" / "data.csv", "#timestamp [ns],filename", list(zip(ns(frame_times), names, strict=True)))
    header = "#timestamp [ns]," + ",".join(
        [f"w_RS_S_{a} [rad s^-1]" for a in "xyz"] + [f"a_RS_S_{a} [m s^-2]" for a in "xyz"]
    )
    rows = [[t, *w, *f] for t, w, f in zip(ns(imu_times), rate, felt, strict=True)]
    write_rows(root / "imu0" / "data.csv", header, rows)
    T_BS = np.eye(4)
    T_BS[:3, :3] = R_PORTRAIT_CAMERA_IMU.T
    T_BS[:3, 3] = (0.01, 0.02, 0.03)
    (root / "cam0" / "sensor.yaml").write_text(
        "%YAML:1.0\nsensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n"
        f"  data: {T_BS.ravel().tolist()}\nresolution: {list(SIZE)}\nintrinsics: {list(INTRINSICS)} #fu, fv, cu, cv\n"
        "distortion_model: radial-tangential\ndistortion_coefficients: [0.1, -0.05, 0.001, 0.002]\n"
    )
    R, positions, _, _ = truth(imu_times)
    q = quaternions(R)
    header = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []"
    body = positions - np.einsum("nij,j->ni", R, T_BS[:3, 3])
    rows = [[t, *p, o[3], *o[:3]] for t, p, o in zip(ns(imu_times), body, q, strict=True)]
    write_rows(root / "state_groundtruth_estimate0" / "data.csv", header, rows)


def write_tum(folder: Path) -> None:
    T = camera_poses(R_PORTRAIT_CAMERA_IMU)
    names = [f"rgb/{time:.6f}.png" for time in frame_times]
    write_images(folder, names)
    comment = "# color images\n# file: 'walk.bag'\n# timestamp filename"
    write_rows(folder / "rgb.txt", comment, [[f"{t:.6f}", n] for t, n in zip(frame_times, names, strict=True)], " ")
    depths = [f"depth/{time:.6f}.png" for time in frame_times + 0.01]
    write_depth(folder, depths, unit_m=1 / 5000)
    listed = [[f"{t + 0.01:.6f}", n] for t, n in zip(frame_times, depths, strict=True)]
    write_rows(folder / "depth.txt", "# timestamp filename", listed[:-1], " ")
    rows = np.column_stack([frame_times, T[:, :3, 3], quaternions(T[:, :3, :3])])
    write_rows(folder / "groundtruth.txt", "# timestamp tx ty tz qx qy qz qw", rows.tolist(), " ")
    write_rows(folder / "accelerometer.txt", "# timestamp ax ay az", [[START_S, 0, 9.8, 0]], " ")


def write_seven_scenes(folder: Path) -> None:
    T = camera_poses(R_PORTRAIT_CAMERA_IMU)
    write_images(folder, [f"frame-{i:06d}.color.png" for i in range(FRAMES)])
    for i, pose in enumerate(T):
        write_rows(folder / f"frame-{i:06d}.pose.txt", "", pose.tolist(), "\t ")
    write_depth(folder, [f"frame-{i:06d}.depth.png" for i in range(FRAMES)], unknown=65535)


def write_colmap(folder: Path) -> None:
    T = np.linalg.inv(camera_poses(R_PORTRAIT_CAMERA_IMU))
    write_images(folder / "images", [f"walk/frame{i:04d}.png" for i in range(FRAMES)])
    model = folder / "sparse" / "0"
    fx, fy, cx, cy = INTRINSICS
    cameras = [[1, "OPENCV", *SIZE, fx, fy, cx + 0.5, cy + 0.5, 0.1, -0.05, 0.001, 0.002]]
    write_rows(model / "cameras.txt", "# Camera list\n# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]", cameras, " ")
    lines = ["# Image list with two lines of data per image:"]
    for i in reversed(range(FRAMES)):
        qx, qy, qz, qw = quaternions(T[i : i + 1, :3, :3])[0]
        numbers = [i + 1, qw, qx, qy, qz, *T[i, :3, 3], 1, f"walk/frame{i:04d}.png"]
        lines += [" ".join(map(str, numbers)), "10.5 11.5 7 3.0 4.0 -1" if i % 2 else ""]
    (model / "images.txt").write_text("\n".join(lines) + "\n")
    (model / "points3D.txt").write_text("# 3D point list\n")


def write_kapture(folder: Path) -> None:
    T = np.linalg.inv(camera_poses(R_PORTRAIT_CAMERA_IMU))
    names = [f"walk/{i:04d}.png" for i in range(FRAMES)]
    sensors = folder / "sensors"
    write_images(sensors / "records_data", names)
    fx, fy, cx, cy = INTRINSICS
    camera = ["cam", "back", "camera", "OPENCV", *SIZE, fx, fy, cx + 0.5, cy + 0.5, 0.1, -0.05, 0.001, 0.002]
    poses = np.column_stack([np.roll(quaternions(T[:, :3, :3]), 1, axis=1), T[:, :3, 3]]).tolist()
    tables: dict[str, list[list[object]]] = {
        "sensors": [camera],
        "records_camera": [[i, "cam", name] for i, name in enumerate(names)],
        "trajectories": [[i, "cam", *pose] for i, pose in enumerate(poses)],
    }
    for name, rows in tables.items():
        write_rows(sensors / f"{name}.txt", "# kapture format: 1.1", rows, ", ")


def write_nerfstudio(folder: Path) -> None:
    T = camera_poses(R_PORTRAIT_CAMERA_IMU) @ np.diag([1.0, -1, -1, 1])
    names = [f"images/frame_{i + 1:05d}.png" for i in range(FRAMES)]
    write_images(folder, names)
    fx, fy, cx, cy = INTRINSICS
    frames = [{"file_path": n, "transform_matrix": pose.tolist()} for n, pose in zip(names, T, strict=True)]
    values = {"camera_model": "OPENCV", "fl_x": fx, "fl_y": fy, "cx": cx + 0.5, "cy": cy + 0.5, "w": 64, "h": 48}
    values |= {"k1": 0.1, "k2": -0.05, "p1": 0.001, "p2": 0.002}
    (folder / "transforms.json").write_text(json.dumps({**values, "frames": frames[::-1]}))


def arkit_poses() -> FloatArray:
    """T_arkit_camera (24, 4, 4) of the phone on its side."""
    T = np.tile(np.eye(4), (FRAMES, 1, 1))
    T[:, :3, :3] = R_MAP_ARKIT
    return np.asarray(np.linalg.inv(T) @ camera_poses(R_LANDSCAPE_CAMERA_IMU) @ np.diag([1.0, -1, -1, 1]))


def write_scanner_app(folder: Path) -> None:
    write_images(folder, [f"frame_{3 * i:05d}.jpg" for i in range(FRAMES)])
    write_depth(folder, [f"depth_{3 * i:05d}.png" for i in range(FRAMES)])
    fx, fy, cx, cy = INTRINSICS
    for i, pose in enumerate(arkit_poses()):
        values = {"intrinsics": [fx, 0, cx, 0, fy, cy, 0, 0, 1], "cameraPoseARFrame": pose.ravel().tolist()}
        (folder / f"frame_{3 * i:05d}.json").write_text(json.dumps({**values, "time": frame_times[i]}))


def write_polycam(folder: Path) -> None:
    names = [str(round(1e6 * time)) for time in frame_times]
    keyframes = folder / "keyframes"
    write_images(keyframes / "images", [f"{name}.jpg" for name in names])
    write_depth(keyframes / "depth", [f"{name}.png" for name in names])
    (keyframes / "cameras").mkdir()
    camera = dict(zip(("width", "height", "fx", "fy", "cx", "cy"), (*SIZE, *INTRINSICS), strict=True))
    for name, pose in zip(names, arkit_poses(), strict=True):
        values = {f"t_{row}{column}": pose[row, column] for row in range(3) for column in range(4)}
        (keyframes / "cameras" / f"{name}.json").write_text(json.dumps({**values, **camera, "blur_score": 80.0}))
    (folder / "mesh_info.json").write_text("{}")


def write_record3d(folder: Path) -> None:
    write_images(folder / "rgbd", [f"{i}.jpg" for i in range(FRAMES)])
    T = arkit_poses()
    fx, fy, cx, cy = INTRINSICS
    values = {
        "w": SIZE[0],
        "h": SIZE[1],
        "K": [fx, 0, 0, 0, fy, 0, cx, cy, 1],
        "poses": np.column_stack([quaternions(T[:, :3, :3]), T[:, :3, 3]]).tolist(),
        "perFrameIntrinsicCoeffs": [INTRINSICS] * FRAMES,
        "frameTimestamps": frame_times.tolist(),
    }
    (folder / "metadata").write_text(json.dumps(values))


def write_arkit_scenes(folder: Path) -> None:
    root = folder / "40777060_frames"
    names = [f"40777060_{time:.3f}" for time in frame_times]
    write_images(root / "lowres_wide", [f"{name}.png" for name in names])
    write_depth(root / "lowres_depth", [f"{name}.png" for name in names])
    for name in names:
        write_rows(root / "lowres_wide_intrinsics" / f"{name}.pincam", "", [[*SIZE, *INTRINSICS]], " ")
    T = np.linalg.inv(camera_poses(R_LANDSCAPE_CAMERA_IMU))
    turned = Rotation.from_matrix(T[:, :3, :3]).as_rotvec()
    write_rows(root / "lowres_wide.traj", "", np.column_stack([frame_times, turned, T[:, :3, 3]]).tolist(), " ")


def write_metashape(folder: Path) -> None:
    names = [f"DSC{i:05d}" for i in range(FRAMES)]
    write_images(folder / "photos", [f"{name}.JPG" for name in names])
    fx, fy, cx, cy = INTRINSICS
    values = {"f": fy, "cx": cx + 0.5 - SIZE[0] / 2, "cy": cy + 0.5 - SIZE[1] / 2, "b1": fx - fy}
    values |= {"k1": 0.1, "k2": -0.05, "p1": 0.002, "p2": 0.001}
    size = f'<resolution width="{SIZE[0]}" height="{SIZE[1]}"/>'
    calibration = "".join(f"<{name}>{value!r}</{name}>" for name, value in values.items())
    R, t, scale = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix(), np.array([4.0, -3.0, 2.0]), 2.5
    T = camera_poses(R_PORTRAIT_CAMERA_IMU)
    T[:, :3, :3], T[:, :3, 3] = R.T @ T[:, :3, :3], (T[:, :3, 3] - t) @ R / scale
    cameras = [
        f'<camera id="{i}" sensor_id="0" component_id="0" label="{name}">'
        f"<transform>{' '.join(map(repr, pose.ravel().tolist()))}</transform></camera>"
        for i, (name, pose) in enumerate(zip(names, T, strict=True))
    ]
    (folder / "cameras.xml").write_text(
        '<?xml version="1.0" encoding="UTF-8"?>\n<document version="2.0.0"><chunk label="Chunk 1" enabled="true">'
        f'<sensors><sensor id="0" label="a" type="frame">{size}<calibration type="frame" class="adjusted">{size}'
        f'{calibration}</calibration></sensor></sensors><components><component id="0"><transform>'
        f'<rotation locked="true">{" ".join(map(repr, R.ravel().tolist()))}</rotation>'
        f'<translation locked="true">{" ".join(map(repr, t.tolist()))}</translation><scale>{scale}</scale>'
        f"</transform></component></components><cameras>{''.join(cameras)}"
        '<camera id="99" sensor_id="0" label="not aligned"/></cameras></chunk></document>'
    )


WRITERS: dict[str, tuple[RecordingFormat, Callable[[Path], None]]] = {
    "rholoc": (RecordingFormat.RHOLOC, write_rholoc),
    "android-csv": (RecordingFormat.ANDROID_CSV, write_android_csv),
    "opencamera": (RecordingFormat.OPENCAMERA_SENSORS, write_opencamera),
    "mars-android": (RecordingFormat.MARS_LOGGER, write_mars),
    "mars-ios": (RecordingFormat.MARS_LOGGER, write_mars_ios),
    "sensor-logger-android": (RecordingFormat.SENSOR_LOGGER, write_sensor_logger),
    "sensor-logger-ios": (RecordingFormat.SENSOR_LOGGER, write_sensor_logger_ios),
    "spectacular": (RecordingFormat.SPECTACULAR, write_spectacular),
    "stray": (RecordingFormat.STRAY_SCANNER, write_stray),
    "ios-logger": (RecordingFormat.IOS_LOGGER, write_ios_logger),
    "advio": (RecordingFormat.ADVIO, write_advio),
    "euroc": (RecordingFormat.EUROC, write_euroc),
    "tum": (RecordingFormat.TUM_RGBD, write_tum),
    "7-scenes": (RecordingFormat.SEVEN_SCENES, write_seven_scenes),
    "colmap": (RecordingFormat.COLMAP, write_colmap),
    "nerfstudio": (RecordingFormat.NERFSTUDIO, write_nerfstudio),
    "kapture": (RecordingFormat.KAPTURE, write_kapture),
    "scanner-app": (RecordingFormat.SCANNER_APP, write_scanner_app),
    "polycam": (RecordingFormat.POLYCAM, write_polycam),
    "record3d": (RecordingFormat.RECORD3D, write_record3d),
    "arkit-scenes": (RecordingFormat.ARKIT_SCENES, write_arkit_scenes),
    "metashape": (RecordingFormat.METASHAPE, write_metashape),
}


def write_recording(name: str, folder: Path) -> Path:
    """The walk in one of the layouts, in a new folder."""
    folder.mkdir(parents=True)
    WRITERS[name][1](folder)
    return folder


def write_complete_recording(name: str, folder: Path) -> Path:
    """The walk in one of the layouts, with measured waypoints and a camera beside it."""
    write_recording(name, folder)
    frames = read_recording(folder).frames
    moments = (frames.times if frames.timed else frames.numbers)[[2, FRAMES // 2, -2]].tolist()
    first, middle, last = moments
    rows: list[list[object]] = [["A", first, 0, 0, 1.5], ["B", middle, 1, 0, 1.5], ["C", last, 1, 1, 1.5]]
    write_rows(folder / "waypoints.csv", f"name,{'time' if frames.timed else 'frame'},x,y,z", rows)
    if not (folder / "camera.json").exists():
        write_camera_json(folder / "camera.json", CameraFile(fps=FPS, readout_s=0.01))
    return folder


def edit_rows(path: Path, change: Callable[[list[list[str]]], list[list[str]]]) -> None:
    """Rewrite a table's rows, its header among them."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(change(rows))
