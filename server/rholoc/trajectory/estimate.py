"""A recording → its frame poses, by the method asked for."""

from __future__ import annotations

from typing import Any

import numpy as np

from rholoc.errors import InvalidCamera, InvalidRecording, InvalidWaypoints, MappingFailed
from rholoc.geometry import Camera, FloatArray, IntArray
from rholoc.progress import ProgressListener, Stage, silent
from rholoc.recordings import Imu, Recording, Waypoint, check_waypoints_fix_frame
from rholoc.reports import TrajectoryReport, report_to_json
from rholoc.trajectory.child import run_in_child
from rholoc.trajectory.gyro_guard import GyroGuard
from rholoc.trajectory.imu_evidence import compare_with_inertial, weigh_imu
from rholoc.trajectory.inertial import integrate_between_waypoints
from rholoc.trajectory.keyframe_features import extract_keyframe_features
from rholoc.trajectory.keyframes import choose_keyframes, measure_motion
from rholoc.trajectory.map_frame import frame_of_first_camera, frame_of_waypoints
from rholoc.trajectory.rolling_shutter import measure_rolling_shutter
from rholoc.trajectory.trajectory import PoseMethod, Scale, Trajectory
from rholoc.trajectory.upright import up_without_roll
from rholoc.trajectory.visual import MIN_PLACED, VisualPoses, structure_from_motion
from rholoc.trajectory.waypoint_times import choices_of_pauses, find_pauses, times_are_known

_FEWEST_GIVEN = 3
_FEWEST_KEYFRAMES = 4
_FEWEST_FEATURES = 50  # in a keyframe that can be placed
_MAX_GIVEN_TILT_DEG = 5.0  # of given poses that count as upright

_MOVE = "Walk through the room while recording; keep texture in view."


def estimate_trajectory(recording: Recording, method: PoseMethod, progress: ProgressListener = silent) -> Trajectory:
    """The poses of a recording's frames, metric and upright where something measured makes them so.

    Raises:
        InvalidRecording: the method needs poses or an IMU that the recording does not have, or a frame is damaged.
        InvalidCamera: the method needs intrinsics that the recording does not have.
        InvalidWaypoints: there are waypoints, but they do not fix a frame.
        MappingFailed: too few keyframes could be placed, or what was measured contradicts the reconstruction.
        Cancelled: ``progress`` asked to stop.
    """
    if recording.waypoints:
        check_waypoints_fix_frame(recording.waypoints)
    match method:
        case PoseMethod.GIVEN:
            return _given(recording)
        case PoseMethod.INERTIAL:
            return _inertial(recording, progress)
        case PoseMethod.VISUAL | PoseMethod.VISUAL_INERTIAL:
            return _visual(recording, method, progress)


def _given(recording: Recording) -> Trajectory:
    hint = "Put poses.txt beside the frames (frame or time, tx ty tz qx qy qz qw), or choose poses 'visual'."
    if recording.poses is None:
        raise InvalidRecording("The recording came without poses.", hint)
    rows = np.flatnonzero(recording.poses.known)
    if len(rows) < _FEWEST_GIVEN:
        raise InvalidRecording(f"{len(rows)} frames of the recording have a pose; too few for a map.", hint)
    T_map_camera = recording.poses.T_map_camera[rows]
    upright, up = _is_upright(T_map_camera[:, :3, :3])
    report = TrajectoryReport(PoseMethod.GIVEN.value, len(rows), trusted=True, why="The poses were given.", up=up)
    scale = Scale.METRIC if recording.poses.metric else Scale.ARBITRARY
    return Trajectory(
        rows, recording.frames.times[rows], T_map_camera, _known_camera(recording), scale, upright, report
    )


def _is_upright(R_map_camera: FloatArray) -> tuple[bool, str]:
    """Whether the cameras of given poses (K, 3, 3) do not roll about the map's own z axis, and what to say of it."""
    prior = up_without_roll(R_map_camera)
    if not prior.holds:
        return False, f"Unknown; the cameras roll by {prior.roll_deg:.1f}°, so nothing shows whether z is up."
    tilt_deg = float(np.degrees(np.arccos(np.clip(prior.direction[2], -1, 1))))
    return tilt_deg <= _MAX_GIVEN_TILT_DEG, f"By the no-roll prior, z is {tilt_deg:.1f}° off the upward direction."


def _inertial(recording: Recording, progress: ProgressListener) -> Trajectory:
    camera = _known_camera(recording)
    if recording.imu is None:
        raise InvalidRecording("The recording came without an IMU table.", "Choose poses 'visual'.")
    if not recording.waypoints:
        raise InvalidWaypoints("The IMU needs waypoints to correct it.", "Measure three or more, at rest at each.")
    rows, choices = _keyframes(recording, recording.imu, progress)
    waypoints = choices[0]  # the longest pauses
    stops = [waypoint.time for waypoint in waypoints]
    times = recording.frames.times[rows]
    between = (times >= min(stops)) & (times <= max(stops))
    rows, times = rows[between], times[between]
    if len(rows) < _FEWEST_KEYFRAMES:
        raise MappingFailed(f"{len(rows)} keyframes lie between the waypoints.", _MOVE)
    poses = integrate_between_waypoints(recording.imu, waypoints, times)
    progress(Stage.POSES, 1.0, "the IMU was integrated")
    report = TrajectoryReport(
        PoseMethod.INERTIAL.value,
        len(rows),
        trusted=False,
        why="Integrated from the IMU alone; nothing checks it between the waypoints.",
        waypoint_times_s={waypoint.name: waypoint.time for waypoint in waypoints},
    )
    return Trajectory(rows, times, poses, camera, Scale.METRIC, True, report)


def _visual(recording: Recording, method: PoseMethod, progress: ProgressListener) -> Trajectory:
    imu = recording.imu if method is PoseMethod.VISUAL_INERTIAL else None
    rows, choices = _keyframes(recording, imu, progress)
    features = extract_keyframe_features(recording.frames, rows, progress)
    shutter = None
    if recording.readout_s is not None:
        shutter = measure_rolling_shutter(recording.frames, rows, recording.readout_s)
        features = [shutter.at_once(k, found) for k, found in enumerate(features)]
    textured = sum(len(found) >= _FEWEST_FEATURES for found in features)
    if textured < max(MIN_PLACED * len(rows), 2):
        raise MappingFailed(
            f"{textured} of {len(rows)} keyframes show enough texture to be placed.",
            "Walk slower, keep more texture in view: no blank walls, no darkness.",
        )
    visual = run_in_child(
        structure_from_motion,
        features,
        recording.camera,
        recording.frames.size,
        None if imu is None else GyroGuard(recording.frames.times[rows], imu),
        progress=progress,
        stage=Stage.POSES,
    )
    kept, T = visual.reconstruction.placed, visual.reconstruction.T_world_camera
    rows = rows[kept]
    report = _visual_report(visual, len(features), method)
    doubts = [] if visual.trusted else [visual.why]
    if visual.calibration is not None:
        report["camera"] = visual.calibration.report
        if not visual.calibration.observable:
            doubts.append(visual.calibration.why)
    if method is PoseMethod.VISUAL_INERTIAL and imu is None:
        report["imu"] = "The recording has no IMU; the poses are visual alone."
    evidence = None
    if imu is not None:
        evidence = weigh_imu(recording.frames.times[rows], T, imu)
        rows, T, kept = rows[evidence.kept], T[evidence.kept], kept[evidence.kept]
        report["imu"] = evidence.report
        doubts += evidence.doubts
    times, alignment = recording.frames.times[rows], None if evidence is None else evidence.alignment
    if recording.waypoints:
        frame = frame_of_waypoints(times, T, choices, alignment)
    else:
        frame = frame_of_first_camera(T, visual.reconstruction.median_depth, alignment)
    T = frame.similarity.poses(T)
    report |= frame.report
    doubts += frame.doubts
    if imu is not None and evidence is not None and evidence.gyro is not None and frame.waypoints:
        report["inertial"] = compare_with_inertial(times, T, frame.waypoints, imu, evidence.gyro)
    report["frames"] = len(rows)
    report["trusted"] = not doubts
    report["why"] = " ".join(doubts) or visual.why
    progress(Stage.POSES, 1.0, f"{len(rows)} frames placed")
    shutter = None if shutter is None else shutter.take(kept)
    typed = TrajectoryReport.from_json(report_to_json(report))
    return Trajectory(rows, times, T, visual.camera, frame.scale, frame.upright, typed, shutter)


def _keyframes(
    recording: Recording, imu: Imu | None, progress: ProgressListener
) -> tuple[IntArray, list[tuple[Waypoint, ...]]]:
    """Keyframes by motion and sharpness, and the frames nearest to the waypoints; the waypoints with their times.

    Where those are not known, one frame for each pause, and every way to take pauses for the waypoints.
    """
    motion, sharpness = measure_motion(recording.frames, progress)
    times = recording.frames.times
    choices = [recording.waypoints]
    if not times_are_known(recording.waypoints):
        choices = list(choices_of_pauses(recording.waypoints, find_pauses(times, motion, imu)))
    stops = {waypoint.time for waypoints in choices for waypoint in waypoints}
    near_stops = [int(np.abs(times - stop).argmin()) for stop in stops]
    rows = np.union1d(choose_keyframes(motion, sharpness), np.array(near_stops, dtype=np.int64))
    if len(rows) < _FEWEST_KEYFRAMES:
        raise MappingFailed("The camera hardly moves in this recording.", _MOVE)
    return rows, choices


def _known_camera(recording: Recording) -> Camera:
    if recording.camera is None:
        raise InvalidCamera(
            "The recording's intrinsics are unknown.",
            "Give the camera as fx,fy,cx,cy[,k1,k2,p1,p2[,k3]], or choose poses 'visual'.",
        )
    return recording.camera


def _visual_report(visual: VisualPoses, keyframes: int, method: PoseMethod) -> dict[str, Any]:
    model = visual.reconstruction
    return {
        "method": method.value,
        "keyframes": keyframes,
        "landmarks": model.landmarks,
        "reprojection_error_px": model.reprojection_error_px,
        "loop_pairs": visual.loops,
        "pairs_contradicted_by_gyroscope": visual.contradicted,
        "disagreement_of_depth": _or_none(visual.disagreement),
        "disagreement_deg": _or_none(visual.disagreement_deg),
    }


def _or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
