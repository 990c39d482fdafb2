"""kapture 1.1, Naver's pivot format of datasets.

::

    sensors/sensors.txt                sensor_id, name, camera, MODEL, width, height, params…    models as COLMAP's
    sensors/records_camera.txt         timestamp, sensor_id, image path below sensors/records_data/
    sensors/trajectories.txt           timestamp, sensor or rig, qw, qx, qy, qz, tx, ty, tz      optional
    sensors/rigs.txt                   rig_id, sensor_id, qw, qx, qy, qz, tx, ty, tz             optional
    sensors/records_accelerometer.txt  timestamp, sensor_id, x, y, z                             optional
    sensors/records_gyroscope.txt      timestamp, sensor_id, x, y, z                             optional

Trajectories take the world to the sensor or rig, rigs take the rig to the sensor, or to a rig in it. The unit of time
is not stated; timestamps that only count have none. Of several cameras with times, the one with most pictures is taken,
unless they are mounted on a rig and there is no IMU; without times, all pictures are. The unit of poses is not stated,
rigs are in metres. Partial poses, of a rotation or a translation alone, count as unknown.
"""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from rholoc.errors import InvalidCamera, InvalidInput, InvalidRecording, InvalidTrajectory
from rholoc.geometry import Camera, FloatArray
from rholoc.recordings.imu_normalisation import ImuConvention, Samples, frame_times_s, normalise_imu
from rholoc.recordings.readers._camera_models import camera_of_model, unsupported
from rholoc.recordings.readers._frames import TimedFrames, listed_file, mounted_frames, timed_images, untimed_images
from rholoc.recordings.readers._orientation import as_shown
from rholoc.recordings.readers.models.colmap import SCALE_WARNING
from rholoc.recordings.recording import GivenPoses, Imu, Recording
from rholoc.recordings.tables.csv_table import read_text
from rholoc.recordings.tables.pose_table import poses_from_rows
from rholoc.reports import RecordingWarning

TABLES = ("sensors/*.txt", "reconstruction/*")
_ADVICE = "Leave it as kapture wrote it."
UNKNOWN_MODEL = "UNKNOWN_CAMERA"  # of a camera without intrinsics
_Pose = dict[tuple[str, str], FloatArray]  # transforms (4, 4) by rig and sensor, or by timestamp and sensor


def recognises(folder: Path) -> bool:
    """Whether there are ``sensors/sensors.txt`` and ``sensors/records_camera.txt``."""
    return all((folder / "sensors" / name).is_file() for name in ("sensors.txt", "records_camera.txt"))


def read(folder: Path) -> Recording:
    """Read a recording of this format from its folder; its poses are of unknown scale.

    Raises:
        InvalidRecording: a table or an image is broken.
        InvalidCamera: a camera is broken.
        InvalidTrajectory: a pose is broken.
    """
    tables = folder / "sensors"
    records = [(stamp, sensor, path) for stamp, sensor, path in _rows(tables / "records_camera.txt", 3)]
    known = read_cameras(tables / "sensors.txt")
    stamps = np.array([_number(stamp, "records_camera.txt") for stamp, _, _ in records])
    is_timed = bool(np.any(np.diff(np.unique(stamps)) != 1))
    rigs = _flattened(_pose_table(tables / "rigs.txt"))
    imu, imu_warnings = _imu(tables) if is_timed else (None, ())
    sensors = {sensor for _, sensor, _ in records}
    if imu is None and len({sensor for _, sensor in rigs} & sensors) > 1:
        is_timed = False
    elif is_timed and len(sensors) > 1:
        most = Counter(sensor for _, sensor, _ in records).most_common(1)[0][0]
        records = [one for one in records if one[1] == most]
        stamps = np.array([_number(stamp, "records_camera.txt") for stamp, _, _ in records])
    paths = [listed_file(tables / "records_data", path) for _, _, path in records]
    cameras, warnings = _cameras(known, [sensor for _, sensor, _ in records])
    cameras, T_stored_shown = as_shown(paths, cameras)
    timed, unit_warnings = _frames(paths, stamps if is_timed else None, cameras)
    taken = [(stamp, sensor) for stamp, sensor, _ in records]
    mountings = _mountings(taken, rigs)
    moments = [(stamp, None if one is None else one[0]) for (stamp, _), one in zip(taken, mountings, strict=True)]
    T_rig_cameras = [None if one is None else one[1] @ T for one, T in zip(mountings, T_stored_shown, strict=True)]
    return Recording(
        timed.frames,
        camera=timed.camera,
        imu=imu,
        poses=_poses(tables, [taken[row] for row in timed.rows], rigs, T_stored_shown[timed.rows]),
        mounted=() if is_timed else mounted_frames(timed, moments, T_rig_cameras),
        warnings=(*unit_warnings, *timed.warnings, *warnings, *imu_warnings, SCALE_WARNING),
    )


def read_cameras(path: Path) -> dict[str, Camera | str]:
    """The cameras of ``sensors.txt`` by sensor, in the file's order; the model's name where it is not supported.

    Raises:
        InvalidCamera: a line is broken.
    """
    found: dict[str, Camera | str] = {}
    for sensor, _, kind, *parameters in _rows(path, 3, InvalidCamera):
        if kind != "camera":
            continue
        try:
            model, width, height, *values = parameters
            size = int(float(width)), int(float(height))
            found[sensor] = camera_of_model(model, size, [float(value) for value in values]) or model
        except InvalidCamera:
            raise
        except (ValueError, IndexError, OverflowError) as error:
            raise InvalidCamera(f"{path.name}: the camera {sensor[:40]} is broken.") from error
    return found


def _rows(path: Path, fewest: int, error: type[InvalidInput] = InvalidRecording) -> list[list[str]]:
    """The fields of each line; raises ``error`` if a line has fewer than ``fewest``, or there are no lines."""
    rows = _optional_rows(path, fewest, error)
    if not rows:
        raise error(f"{path.name}: it has no lines.", _ADVICE)
    return rows


def _optional_rows(path: Path, fewest: int, error: type[InvalidInput] = InvalidRecording) -> list[list[str]]:
    """The fields of each line, none without the file; raises ``error`` if a line has fewer than ``fewest``."""
    if not path.is_file():
        return []
    lines = [line for line in read_text(path, error).splitlines() if line.strip() and not line.startswith("#")]
    rows = [[field.strip() for field in line.split(",")] for line in lines]
    broken = next((row for row in rows if len(row) < fewest), None)
    if broken is not None:
        raise error(f"{path.name}: '{', '.join(broken)[:60]}' has too few fields.", _ADVICE)
    return rows


def _number(text: str, table: str) -> float:
    """A finite number. Raises InvalidRecording, naming ``table``."""
    try:
        number = float(text)
    except ValueError:
        number = np.nan
    if not np.isfinite(number):
        raise InvalidRecording(f"{table}: '{text[:40]}' is not a finite number.")
    return number


def _cameras(
    known: Mapping[str, Camera | str], used: Sequence[str]
) -> tuple[list[Camera] | None, tuple[RecordingWarning, ...]]:
    """The camera of each picture, by the sensors ``used``; None if one is unknown, with a warning for its model."""
    cameras = [known.get(sensor, UNKNOWN_MODEL) for sensor in used]
    models = sorted({camera for camera in cameras if isinstance(camera, str)})
    if models:
        return None, tuple(unsupported(model[:40]) for model in models if model != UNKNOWN_MODEL)
    return [camera for camera in cameras if isinstance(camera, Camera)], ()


def _frames(
    paths: Sequence[Path], stamps: FloatArray | None, cameras: Sequence[Camera] | None
) -> tuple[TimedFrames, tuple[RecordingWarning, ...]]:
    """Frames, by time if there are ``stamps`` (N,), their rows indices of ``paths``; and warnings on the unit."""
    if stamps is None:
        return untimed_images(paths, cameras), ()
    times, warnings = frame_times_s(stamps, "ns")
    order = np.argsort(times, kind="stable")
    chosen = None if cameras is None else [cameras[row] for row in order]
    found = timed_images([paths[row] for row in order], times[order], chosen)
    return TimedFrames(found.frames, order[found.rows], found.warnings, found.camera), warnings


def _imu(tables: Path) -> tuple[Imu | None, tuple[RecordingWarning, ...]]:
    """IMU of the first accelerometer and gyroscope, None if one is missing, and warnings. Raises InvalidRecording."""
    samples = []
    for name in ("accelerometer", "gyroscope"):
        path = tables / f"records_{name}.txt"
        rows = _optional_rows(path, 5)
        if not rows:
            return None, ()
        rows = [row for row in rows if row[1] == rows[0][1]]
        values = np.array([[_number(text, path.name) for text in (row[0], *row[2:5])] for row in rows])
        samples.append(Samples.from_rows(values[np.argsort(values[:, 0], kind="stable")]))
    return normalise_imu(samples[0], samples[1], ImuConvention(time_unit="ns"))


def _flattened(rigs: _Pose) -> _Pose:
    """T_sensor_rig (4, 4) by rig and sensor, also of sensors in the rigs of a rig; a sensor's outermost rig last."""
    inside: dict[str, list[tuple[str, FloatArray]]] = defaultdict(list)
    for (rig, sensor), T_sensor_rig in rigs.items():
        inside[rig].append((sensor, T_sensor_rig))
    flat, added = dict(rigs), rigs
    while added:
        added = {
            (rig, sensor): T_sensor_inner @ T_inner_rig
            for (rig, inner), T_inner_rig in added.items()
            for sensor, T_sensor_inner in inside.get(inner, ())
            if (rig, sensor) not in flat
        }
        flat |= added
    return flat


def _mountings(records: Sequence[tuple[str, str]], rigs: _Pose) -> list[tuple[str, FloatArray] | None]:
    """For each record (timestamp, sensor) its sensor's rig and T_rig_sensor (4, 4); None for sensors without a rig."""
    of_sensor = {sensor: (rig, np.linalg.inv(T_sensor_rig)) for (rig, sensor), T_sensor_rig in rigs.items()}
    return [of_sensor.get(sensor) for _, sensor in records]


def _poses(
    tables: Path, records: Sequence[tuple[str, str]], rigs: _Pose, T_stored_shown: FloatArray
) -> GivenPoses | None:
    """T_world_camera of each shown picture, of unknown scale, by its sensor's trajectory, else by its rig's. None
    without trajectories.

    ``records`` are the pictures' (timestamp, sensor), ``T_stored_shown`` (N, 4, 4) their orientations. Raises
    InvalidTrajectory if trajectories have no pose of a picture.
    """
    placed = _pose_table(tables / "trajectories.txt")
    mounted: dict[str, list[tuple[str, FloatArray]]] = defaultdict(list)
    for (rig, sensor), T_sensor_rig in rigs.items():
        mounted[sensor].append((rig, T_sensor_rig))
    T = np.full((len(records), 4, 4), np.nan)
    for row, (stamp, sensor) in enumerate(records):
        found = placed.get((stamp, sensor))
        if found is None:
            rigs_of = mounted.get(sensor, ())
            by_rig = (T_sensor_rig @ placed[stamp, rig] for rig, T_sensor_rig in rigs_of if (stamp, rig) in placed)
            found = next(by_rig, None)
        if found is not None:
            T[row] = np.linalg.inv(found) @ T_stored_shown[row]
    known = np.isfinite(T[:, 0, 0])
    if placed and not known.any():
        raise InvalidTrajectory(
            "trajectories.txt has no pose of a picture.", "Its timestamps and sensors must be those of the pictures."
        )
    return GivenPoses(known, T, metric=False) if known.any() else None


def _pose_table(path: Path) -> _Pose:
    """The transform (4, 4) of each line, by its first two fields; none without the file. Lines of partial poses, whose
    rotation or translation is left empty, are skipped. Raises InvalidTrajectory.
    """
    rows = [row for row in _optional_rows(path, 9, InvalidTrajectory) if all(row[2:9])]
    if not rows:
        return {}
    try:
        numbers = np.array([[float(text) for text in row[2:9]] for row in rows])
    except ValueError as error:
        raise InvalidTrajectory(f"{path.name}: a part of a pose is not a number.") from error
    qw, qx, qy, qz, tx, ty, tz = numbers.T
    poses = poses_from_rows(np.column_stack([tx, ty, tz, qx, qy, qz, qw]), path.name)
    return {(row[0], row[1]): T for row, T in zip(rows, poses, strict=True)}
