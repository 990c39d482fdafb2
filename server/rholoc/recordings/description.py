"""JSON description of a recording, for users to check before mapping."""

from dataclasses import asdict
from typing import Any

import numpy as np

from rholoc.geometry import FloatArray
from rholoc.recordings.recording import FrameSource, GivenPoses, Imu, Recording, Waypoint
from rholoc.recordings.walk.advice import advise
from rholoc.recordings.walk.stillness import pauses
from rholoc.recordings.walk.walk_figures import look_through, measure_walk
from rholoc.reports import report_to_json


def describe_recording(recording: Recording) -> dict[str, Any]:
    """JSON-like dict: format, frames, camera, IMU, waypoints, poses, problems, the walk's figures, and advice; None for
    absent parts.

    At most 25 frames are decoded to measure light and texture.

    Raises:
        InvalidRecording: a frame cannot be decoded.
    """
    times, T_map_camera = _known_poses(recording)
    figures = measure_walk(recording, look_through(recording.frames), times, T_map_camera)
    return {
        "name": recording.name,
        "format": recording.format.value,
        "frames": _frames(recording.frames),
        "camera": None if recording.camera is None else recording.camera.to_dict(),
        "frame_intrinsics": _logged(recording.frame_intrinsics),
        "readout_ms": None if recording.readout_s is None else 1000 * recording.readout_s,
        "depth_images": 0 if recording.depth is None else sum(path is not None for path in recording.depth.paths),
        "imu": None if recording.imu is None else _imu(recording.imu),
        "waypoints": [_waypoint(waypoint) for waypoint in recording.waypoints],
        "poses": None if recording.poses is None else _poses(recording.poses),
        "warnings": [report_to_json(warning) for warning in recording.warnings],
        "figures": asdict(figures),
        "advice": [report_to_json(advice) for advice in advise(figures)],
    }


def _known_poses(recording: Recording) -> tuple[FloatArray, FloatArray]:
    """Times (K,) and poses (K, 4, 4) of the frames that have one; empty without poses."""
    if recording.poses is None:
        return np.zeros(0), np.zeros((0, 4, 4))
    known = recording.poses.known
    return recording.frames.times[known], recording.poses.T_map_camera[known]


def _frames(frames: FrameSource) -> dict[str, Any]:
    """Number, numbers, size, time span and rate of the frames, for JSON; None for what needs measured times."""
    steps = np.diff(frames.times) if frames.timed else np.zeros(0)
    width, height = frames.size
    return {
        "count": len(frames.times),
        "numbers": [int(frames.numbers[0]), int(frames.numbers[-1])],
        "width": width,
        "height": height,
        "start_s": float(frames.times[0]) if frames.timed else None,
        "end_s": float(frames.times[-1]) if frames.timed else None,
        "rate_hz": 1 / float(np.median(steps)) if len(steps) else None,
        "longest_interval_s": float(steps.max()) if len(steps) else None,
    }


def _logged(frame_intrinsics: FloatArray | None) -> dict[str, list[float] | None] | None:
    """Minimum and maximum of fx, fy, cx and cy [px] by name, None if never logged; None without logged intrinsics."""
    if frame_intrinsics is None:
        return None
    spans: dict[str, list[float] | None] = {}
    for name, values in zip(("fx", "fy", "cx", "cy"), frame_intrinsics.T, strict=True):
        known = values[np.isfinite(values)]
        spans[name] = [float(known.min()), float(known.max())] if len(known) else None
    return spans


def _imu(imu: Imu) -> dict[str, Any]:
    """Rows, time span, rate, median force, mounting and pauses of the IMU, for JSON."""
    steps = np.diff(imu.times)
    return {
        "rows": len(imu.times),
        "start_s": float(imu.times[0]),
        "end_s": float(imu.times[-1]),
        "rate_hz": 1 / float(np.median(steps)) if len(steps) else None,
        "longest_interval_s": float(steps.max()) if len(steps) else None,
        "includes_gravity": imu.includes_gravity,
        "force_median_m_s2": float(np.median(np.linalg.norm(imu.acceleration, axis=1))),
        "mounting_known": imu.R_camera_imu is not None,
        "pauses_s": pauses(imu).tolist(),
    }


def _waypoint(waypoint: Waypoint) -> dict[str, Any]:
    """A waypoint's attributes by name, for JSON: an unknown time (NaN) becomes None."""
    return asdict(waypoint) | ({"time": None} if np.isnan(waypoint.time) else {})


def _poses(poses: GivenPoses) -> dict[str, Any]:
    """Number of known poses, whether they are metric, and the path length in their unit, for JSON."""
    positions = poses.T_map_camera[poses.known, :3, 3]
    path = float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum())
    return {"known": int(poses.known.sum()), "metric": poses.metric, "path_length": path}
