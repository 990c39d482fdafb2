"""Figures of a walk, for :mod:`rholoc.recordings.walk.advice`."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from rholoc.geometry import ByteArray, FloatArray, evenly, rotation_angles
from rholoc.recordings.recording import FrameSource, Imu, Recording, Waypoint
from rholoc.recordings.walk.stillness import pauses
from rholoc.reports import WalkFigures

_LOOKED_AT = 25  # frames
_LOOK_WIDTH_PX = 640
_CORNER_CONTRAST = 20  # grey levels
_FEW_CORNERS = 100
_TURN_PERCENTILE = 90.0
_TURN_INTERVAL_S = 0.1  # minimum, since over shorter intervals noise exceeds rotation
_MAX_POSES = 400
_SAME_WAY_DEG = 60.0
_PAUSE_TOLERANCE_S = 0.5


@dataclass(frozen=True)
class Look:
    """Figures of one frame: its mean grey level, 0 to 255, and its number of corners of a fixed contrast."""

    brightness: float
    corners: int


def look_at(image: ByteArray) -> Look:
    """Mean grey level and corners of an image (H, W, 3) BGR, reduced to at most 640 px width."""
    gray = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    height, width = gray.shape
    if width > _LOOK_WIDTH_PX:
        size = (_LOOK_WIDTH_PX, round(height * _LOOK_WIDTH_PX / width))
        gray = cv2.resize(gray, size, interpolation=cv2.INTER_AREA)
    return Look(float(gray.mean()), len(cv2.FastFeatureDetector.create(_CORNER_CONTRAST).detect(gray)))


def look_through(frames: FrameSource) -> list[Look]:
    """Measure 25 frames, or all of fewer, spread evenly over a recording; none where there are no images.

    Raises:
        InvalidRecording: a frame cannot be decoded.
    """
    if 0 in frames.size:
        return []
    rows = evenly(len(frames.times), _LOOKED_AT)
    return [look_at(image) for image in frames.images(rows.tolist())]


def measure_walk(
    recording: Recording, looks: Sequence[Look], times: FloatArray, T_map_camera: FloatArray
) -> WalkFigures:
    """Figures of a walk from its IMU, the appearance ``looks`` of frames, and N ≥ 0 poses (N, 4, 4) at times (N,) [s].

    A figure is None if its data is missing.
    """
    imu = recording.imu
    return WalkFigures(
        turn_deg_s=_turn(recording, times, T_map_camera),
        brightness=float(np.median([look.brightness for look in looks])) if looks else None,
        bare_share=float(np.mean([look.corners < _FEW_CORNERS for look in looks])) if looks else None,
        pauses=None if imu is None or not recording.waypoints else _rested_at(recording.waypoints, imu),
        waypoints=len(recording.waypoints),
        nearest_return=nearest_return(T_map_camera) if recording.frames.timed else None,
    )


def nearest_return(T_map_camera: FloatArray) -> float | None:
    """Minimum ratio of the distance between two poses to the path length between them.

    Over pairs at least half of the walk apart with headings within 60°; 1 without such pairs. None for fewer than three
    poses, or if the camera does not move.
    """
    T = T_map_camera[:: max(1, len(T_map_camera) // _MAX_POSES)]
    if len(T) < 3:
        return None
    positions = T[:, :3, 3]
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])
    if way[-1] <= 0:
        return None
    between = way[None, :] - way[:, None]
    apart = np.linalg.norm(positions[None, :] - positions[:, None], axis=2)
    same_way = T[:, :3, 2] @ T[:, :3, 2].T > np.cos(np.radians(_SAME_WAY_DEG))
    pairs = (between >= way[-1] / 2) & same_way
    return float((apart[pairs] / between[pairs]).min(initial=1.0))


def _turn(recording: Recording, times: FloatArray, T_map_camera: FloatArray) -> float | None:
    """Rate of turn [°/s], 90th percentile, by the IMU, else by the poses; None without frame times or data."""
    if not recording.frames.timed:
        return None
    if recording.imu is not None:
        return _turn_of_imu(recording.imu, recording.frames.times)
    return _turn_of_poses(times, T_map_camera)


def _turn_of_imu(imu: Imu, times: FloatArray) -> float | None:
    """Rate of turn [°/s], 90th percentile, within the span of frames at ``times`` (N,) [s]; None without readings."""
    rows = (imu.times >= times[0]) & (imu.times <= times[-1])
    if not rows.any():
        return None
    speeds = np.linalg.norm(imu.angular_velocity[rows], axis=1)
    return float(np.degrees(np.percentile(speeds, _TURN_PERCENTILE)))


def _turn_of_poses(times: FloatArray, T_map_camera: FloatArray) -> float | None:
    """Rate of turn [°/s], 90th percentile, between poses (N, 4, 4) at least 0.1 s apart; None without two such."""
    if len(times) < 2:
        return None
    later = np.searchsorted(times, times + _TURN_INTERVAL_S)
    rows = np.flatnonzero(later < len(times))
    if len(rows) == 0:
        return None
    R = T_map_camera[:, :3, :3]
    turned = rotation_angles(R[rows], R[later[rows]])
    return float(np.degrees(np.percentile(turned / (times[later[rows]] - times[rows]), _TURN_PERCENTILE)))


def _rested_at(waypoints: Sequence[Waypoint], imu: Imu) -> int:
    """Number of waypoints within 0.5 s of a pause of the IMU.

    If any waypoint's time is unknown, the number of pauses, at most that of waypoints.
    """
    begin, end = pauses(imu).T
    if any(np.isnan(waypoint.time) for waypoint in waypoints):
        return min(len(begin), len(waypoints))
    begin, end = begin - _PAUSE_TOLERANCE_S, end + _PAUSE_TOLERANCE_S
    return sum(bool(np.any((begin <= waypoint.time) & (waypoint.time <= end))) for waypoint in waypoints)
