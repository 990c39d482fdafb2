"""Spectacular AI's recordings: a video, and everything else as JSON lines.

::

    data.mp4           or .mkv, .mov, .avi
    data.jsonl         {"sensor": {"type": "gyroscope", "values": [x, y, z]}, "time": s}     rad/s; accelerometer m/s²
                       {"frames": [{"cameraInd": 0, "cameraParameters": {…}}], "number": 0, "time": s}
    calibration.json   {"cameras": [{"focalLengthX": …, "model": "pinhole", "imuToCamera": 4×4}]}
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from rholoc.errors import InvalidCamera, InvalidRecording
from rholoc.geometry import Camera, FloatArray, Lens, is_rotation
from rholoc.recordings.imu_normalisation import ImuConvention, Samples, normalise_imu
from rholoc.recordings.readers._camera_models import unsupported
from rholoc.recordings.readers._frames import require_video, timed_video
from rholoc.recordings.recording import Imu, Recording
from rholoc.recordings.tables.csv_table import parse_json, read_text
from rholoc.reports import RecordingWarning, WarningKind

TABLES = ("data.jsonl", "calibration.json")
_INTRINSICS = ("focalLengthX", "focalLengthY", "principalPointX", "principalPointY")
_ROTATION_TOLERANCE = 1e-2
_LENSES = {"pinhole": Lens.PINHOLE, "brown-conrady": Lens.PINHOLE, "kannala-brandt4": Lens.FISHEYE}


@dataclass(eq=False)
class _Log:
    """The lines: rows of time and three values for each sensor; time [s] and description of each frame of camera 0."""

    sensors: dict[str, list[list[float]]] = field(default_factory=lambda: {"accelerometer": [], "gyroscope": []})
    frames: list[tuple[float, dict[str, Any]]] = field(default_factory=list)
    warnings: list[RecordingWarning] = field(default_factory=list)


def recognises(folder: Path) -> bool:
    """Whether there is ``data.jsonl``."""
    return (folder / "data.jsonl").is_file()


def read(folder: Path) -> Recording:
    """Read a recording of this format from its folder.

    Raises:
        InvalidRecording: a line is malformed, there are no frames, or lines and video contradict each other.
        InvalidCamera: the calibration is broken.
    """
    log = _read_lines(folder / "data.jsonl")
    if not log.frames:
        raise InvalidRecording("data.jsonl has no frames.", "It needs a line with 'frames' for each frame.")
    timed = timed_video(require_video(folder, "data"), np.array([time for time, _ in log.frames]), "data.jsonl")
    calibration = _calibration(folder / "calibration.json")
    shown = [log.frames[row][1] for row in timed.rows]
    per_frame = np.array([_intrinsics(frame.get("cameraParameters")) for frame in shown])
    described = calibration or {**(shown[0].get("cameraParameters") or {}), "imuToCamera": shown[0].get("imuToCamera")}
    camera, camera_warnings = _camera(described, timed.frames.size)
    imu, imu_warnings = _imu(log, _rotation(described.get("imuToCamera")))
    return Recording(
        timed.frames,
        camera=camera,
        imu=imu,
        frame_intrinsics=per_frame if np.isfinite(per_frame).any() else None,
        warnings=(*log.warnings, *timed.warnings, *camera_warnings, *imu_warnings),
    )


def _read_lines(path: Path) -> _Log:
    """Content of ``data.jsonl``; a last line that is cut off becomes a warning. Raises InvalidRecording."""
    log = _Log()
    lines = [line for line in read_text(path).splitlines() if line.strip()]
    for number, line in enumerate(lines, start=1):
        try:
            value = parse_json(line)
        except (ValueError, RecursionError) as error:
            if number == len(lines) and number > 1:  # the app was stopped while it wrote
                log.warnings.append(RecordingWarning(WarningKind.NOT_USED, "The last line of data.jsonl is cut off."))
                break
            raise InvalidRecording(f"{path.name}, line {number} is not JSON.", "Record again.") from error
        try:
            _take(log, value)
        except (TypeError, ValueError, KeyError, AttributeError, IndexError, OverflowError) as error:
            raise InvalidRecording(f"{path.name}, line {number} is not of the known form.") from error
    return log


def _take(log: _Log, value: dict[str, Any]) -> None:
    """Add a line's reading or frame to the log; ignore other lines. Raises ValueError for numbers not finite."""
    if "sensor" in value and value["sensor"]["type"] in log.sensors:
        x, y, z = value["sensor"]["values"]
        row = [float(value["time"]), float(x), float(y), float(z)]
        if not np.isfinite(row).all():
            raise ValueError("not finite")
        log.sensors[value["sensor"]["type"]].append(row)
    elif "frames" in value:
        first = next((frame for frame in value["frames"] if frame.get("cameraInd", 0) == 0), None)
        if first is not None:
            time = float(first.get("time", value.get("time")))
            if not np.isfinite(time) or not isinstance(first.get("cameraParameters") or {}, dict):
                raise ValueError("not a frame")
            log.frames.append((time, first))


def _imu(log: _Log, R_camera_imu: FloatArray | None) -> tuple[Imu | None, tuple[RecordingWarning, ...]]:
    """The IMU, and warnings; None if one of its sensors has no rows. Raises InvalidRecording."""
    accelerometer, gyroscope = (np.array(log.sensors[name]).reshape(-1, 4) for name in ("accelerometer", "gyroscope"))
    if len(accelerometer) == 0 or len(gyroscope) == 0:
        return None, ()
    # Lines of several sensors are written as they arrive; those of one may be out of order.
    accelerometer, gyroscope = (rows[np.argsort(rows[:, 0], kind="stable")] for rows in (accelerometer, gyroscope))
    return normalise_imu(Samples.from_rows(accelerometer), Samples.from_rows(gyroscope), ImuConvention(), R_camera_imu)


def _calibration(path: Path) -> dict[str, Any] | None:
    """The first camera of the file ``calibration.json``; None without the file. Raises InvalidCamera if it has none."""
    if not path.is_file():
        return None
    try:
        camera = parse_json(read_text(path, InvalidCamera))["cameras"][0]
    except (ValueError, TypeError, KeyError, IndexError, RecursionError) as error:
        raise InvalidCamera(
            f"{path.name} describes no camera.", "It needs {'cameras': [{'focalLengthX': …}]}."
        ) from error
    if not isinstance(camera, dict):
        raise InvalidCamera(f"{path.name} describes no camera.")
    return camera


def _intrinsics(values: Any) -> list[float]:
    """fx, fy, cx, cy of ``cameraParameters``; all NaN where one is missing."""
    try:
        return [float(values[name]) for name in _INTRINSICS]
    except (TypeError, KeyError, ValueError):
        return [np.nan] * 4


def _camera(values: dict[str, Any], size: tuple[int, int]) -> tuple[Camera | None, tuple[RecordingWarning, ...]]:
    """Camera rescaled to ``size``, and warnings; None without intrinsics or, with a warning, of an unknown model."""
    fx, fy, cx, cy = _intrinsics(values)
    if not np.isfinite(fx):
        return None, ()
    try:
        model = str(values.get("model") or values.get("distortionModel") or "pinhole").lower()
        coefficients = [float(value) for value in values.get("distortionCoefficients") or []]
        width, height = int(values.get("imageWidth") or size[0]), int(values.get("imageHeight") or size[1])
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidCamera("The calibration holds a value that is not a number.") from error
    if model not in _LENSES:
        return None, (unsupported(model),)
    if model == "pinhole" and len(coefficients) == 3:
        k1, k2, k3 = coefficients
        coefficients = [k1, k2, 0.0, 0.0, k3]
    camera = Camera(width, height, fx, fy, cx, cy, tuple(coefficients), _LENSES[model])
    return camera.fitted(*size), ()


def _rotation(rows: Any) -> FloatArray | None:
    """Rotation (3, 3) of a transform ``imuToCamera``; None if it is missing or no rotation."""
    try:
        R = np.array(rows, dtype=np.float64)[:3, :3]
    except (TypeError, ValueError, IndexError):
        return None
    return R if is_rotation(R, _ROTATION_TOLERANCE) else None
