"""EuRoC, the layout of ASL's datasets: one folder a sensor, nanoseconds.

::

    mav0/cam0/data.csv      #timestamp [ns],filename        images in cam0/data/
    mav0/cam0/sensor.yaml   camera_model (pinhole), intrinsics, T_BS,
                            distortion_model (radial-tangential, equidistant), …_coefficients
    mav0/imu0/data.csv      #timestamp [ns],w_RS_S_x [rad s^-1],…,a_RS_S_x [m s^-2],…    gravity included
    mav0/imu0/sensor.yaml   T_BS
    mav0/state_groundtruth_estimate0/data.csv    #timestamp, p_RS_R_x [m],…,q_RS_w [],…    of the body

``groundtruth_cam0.txt`` instead holds time [ns], x, y, z, qx, qy, qz, qw of cam0 itself. Pictures of cam1, laid out
likewise, are read where there is neither an IMU nor ground truth and both files state T_BS: a rig, whose times are not
used. Other cameras are ignored.
"""

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from rholoc.errors import InvalidCamera
from rholoc.geometry import Camera, FloatArray, Lens, is_rotation
from rholoc.recordings.imu_normalisation import ImuConvention, Samples, frame_times_s, normalise_imu
from rholoc.recordings.readers._camera_models import unsupported
from rholoc.recordings.readers._frames import listed_file, mounted_frames, timed_images, untimed_images
from rholoc.recordings.recording import FrameSource, GivenPoses, Imu, Recording
from rholoc.recordings.tables.csv_table import read_text, shortened
from rholoc.recordings.tables.logged_table import has_columns, read_logged_table
from rholoc.recordings.tables.pose_table import PoseTable, match_poses, poses_from_rows
from rholoc.reports import RecordingWarning

TABLES = (
    "*cam0/data.csv",
    "*cam0/sensor.yaml",
    "*cam1/data.csv",
    "*cam1/sensor.yaml",
    "*imu0/data.csv",
    "*imu0/sensor.yaml",
    "*state_groundtruth_estimate0/*",
    "groundtruth_cam0.txt",
)
_RIG = ("cam0", "cam1")
_GYROSCOPE = tuple(f"w_rs_s_{axis}" for axis in "xyz")
_ACCELEROMETER = tuple(f"a_rs_s_{axis}" for axis in "xyz")
_BODY_POSE = ("p_rs_r_x", "p_rs_r_y", "p_rs_r_z", "q_rs_x", "q_rs_y", "q_rs_z", "q_rs_w")
_NS_PER_S = 1e9
_LENSES = {  # by the name of the distortion
    **dict.fromkeys(("radial-tangential", "radtan", "plumb_bob", "none"), Lens.PINHOLE),
    **dict.fromkeys(("equidistant", "kannala-brandt"), Lens.FISHEYE),
}
_MAX_SENSOR_BYTES = 2**16


def recognises(folder: Path) -> bool:
    """Whether there is ``cam0/data.csv`` with columns of times and file names."""
    return has_columns(_root(folder) / "cam0" / "data.csv", ("timestamp", "filename"))


def read(folder: Path) -> Recording:
    """Read cam0, imu0 and the ground truth; without the last two, cam0 and cam1 as a rig, if they are mounted.

    Raises:
        InvalidRecording: a table or an image is missing or broken.
        InvalidCamera: ``sensor.yaml`` is broken.
        InvalidTrajectory: the ground truth is broken.
    """
    root = _root(folder)
    table = read_logged_table(root / "cam0" / "data.csv")
    times, unit_warnings = frame_times_s(table.named("timestamp")[:, 0], "ns")
    images = root / "cam0" / "data"
    timed = timed_images([listed_file(images, name) for name in table.text("filename")], times)
    sensor = _sensor(root / "cam0" / "sensor.yaml")
    camera, camera_warnings = _camera(sensor, timed.frames.size, "cam0")
    T_body_camera = _body(sensor)
    imu, imu_warnings = _imu(root / "imu0", T_body_camera)
    poses = _poses(root, T_body_camera, timed.frames)
    if imu is None and poses is None and (rig := _rig(root, camera)) is not None:
        return rig
    return Recording(
        timed.frames,
        camera=camera,
        imu=imu,
        poses=poses,
        warnings=(*unit_warnings, *timed.warnings, *camera_warnings, *imu_warnings),
    )


def _rig(root: Path, first: Camera | None) -> Recording | None:
    """Pictures of cam0 and cam1, linked where they are of one moment; None unless both are calibrated and mounted, with
    common moments. Raises InvalidRecording, InvalidCamera.
    """
    paths: list[Path] = []
    moments: list[float] = []
    cameras: list[Camera] = []
    mountings: list[FloatArray | None] = []
    for name in _RIG:
        if not has_columns(root / name / "data.csv", ("timestamp", "filename")):
            return None
        table, sensor = read_logged_table(root / name / "data.csv"), _sensor(root / name / "sensor.yaml")
        T_body_camera = _body(sensor)
        listed = [listed_file(root / name / "data", one) for one in table.text("filename")]
        size = (first.width, first.height) if first else (0, 0)
        camera = first if name == _RIG[0] else _camera(sensor, size, name)[0]
        if camera is None or T_body_camera is None:
            return None
        paths += listed
        moments += table.named("timestamp")[:, 0].tolist()
        cameras += [camera] * len(listed)
        mountings += [T_body_camera] * len(listed)
    timed = untimed_images(paths, cameras)
    mounted = mounted_frames(timed, moments, mountings)
    if not mounted:
        return None
    return Recording(timed.frames, camera=timed.camera, mounted=mounted)


def _root(folder: Path) -> Path:
    """Folder of the sensors: ``mav0``, or the folder itself if there is none."""
    return folder / "mav0" if (folder / "mav0").is_dir() else folder


def _sensor(path: Path) -> dict[str, Any]:
    """Content of a ``sensor.yaml``; empty without the file. Raises InvalidCamera if it is not plain YAML."""
    if not path.is_file():
        return {}
    lines = read_text(path, InvalidCamera, _MAX_SENSOR_BYTES).splitlines()
    text = "\n".join(line for line in lines if not line.startswith("%YAML"))
    try:
        # By references, a few lines stand for more values than any memory holds.
        plain = not any(isinstance(token, yaml.AliasToken) for token in yaml.scan(text))
        values = yaml.safe_load(text) if plain else None
    except (yaml.YAMLError, RecursionError, ValueError, OverflowError):
        plain = False
    if not plain:
        hint = "Leave it as the dataset has it, or leave it out."
        raise InvalidCamera(f"{path.parent.name}/{path.name} is not plain YAML.", hint)
    return values if isinstance(values, dict) else {}


def _camera(
    sensor: dict[str, Any], size: tuple[int, int], name: str
) -> tuple[Camera | None, tuple[RecordingWarning, ...]]:
    """The camera of a sensor's description, rescaled to the pictures' ``size``, and warnings.

    None without intrinsics, or (with a warning) if the camera or distortion model is not supported. Raises
    InvalidCamera, naming the folder ``name``, if the intrinsics are broken, or of pictures of another shape.
    """
    if "intrinsics" not in sensor:
        return None, ()
    model, distortion = str(sensor.get("camera_model", "pinhole")), str(sensor.get("distortion_model", "none"))
    if model != "pinhole" or distortion not in _LENSES:
        return None, (unsupported(shortened(distortion if model == "pinhole" else model)),)
    try:
        fx, fy, cx, cy = (float(value) for value in sensor["intrinsics"])
        coefficients = tuple(float(value) for value in sensor.get("distortion_coefficients") or ())
        width, height = (int(value) for value in sensor.get("resolution") or size)
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidCamera(f"{name}/sensor.yaml: a part of the intrinsics is not a number.") from error
    return Camera(width, height, fx, fy, cx, cy, coefficients, _LENSES[distortion]).fitted(*size), ()


def _body(sensor: dict[str, Any]) -> FloatArray | None:
    """T_body_sensor (4, 4) of a sensor's description; None where it is missing or no rigid motion."""
    try:
        T = np.array(sensor["T_BS"]["data"], dtype=np.float64).reshape(4, 4)
    except (KeyError, TypeError, ValueError, OverflowError):
        return None
    return T if is_rotation(T[:3, :3]) else None


def _imu(folder: Path, T_body_camera: FloatArray | None) -> tuple[Imu | None, tuple[RecordingWarning, ...]]:
    """The IMU of its folder, and warnings; None without a table. The mounting is None if ``T_body_camera`` is."""
    if not (folder / "data.csv").is_file():
        return None, ()
    table = read_logged_table(folder / "data.csv")
    times = table.named("timestamp")[:, 0]
    T_body_imu = _body(_sensor(folder / "sensor.yaml"))
    R_body_imu = np.eye(3) if T_body_imu is None else T_body_imu[:3, :3]
    return normalise_imu(
        Samples(times, table.named(*_ACCELEROMETER)),
        Samples(times, table.named(*_GYROSCOPE)),
        ImuConvention(time_unit="ns"),
        None if T_body_camera is None else T_body_camera[:3, :3].T @ R_body_imu,
    )


def _poses(root: Path, T_body_camera: FloatArray | None, frames: FrameSource) -> GivenPoses | None:
    """Ground truth of cam0: of the body where its mounting is known, else of cam0 itself; None without such a file."""
    of_body, of_camera = root / "state_groundtruth_estimate0" / "data.csv", root / "groundtruth_cam0.txt"
    if of_body.is_file() and T_body_camera is not None:
        table = read_logged_table(of_body)
        poses = poses_from_rows(table.named(*_BODY_POSE), "state_groundtruth_estimate0") @ T_body_camera
        return match_poses(PoseTable(table.named("timestamp")[:, 0] / _NS_PER_S, poses), frames)
    if of_camera.is_file():
        rows = read_logged_table(of_camera).numbered(*range(8))
        return match_poses(PoseTable(rows[:, 0] / _NS_PER_S, poses_from_rows(rows[:, 1:], of_camera.name)), frames)
    return None
