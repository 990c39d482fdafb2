"""A recording → its frame poses, by the method asked for."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rholoc.errors import InvalidCamera, InvalidRecording, InvalidWaypoints, MappingFailed
from rholoc.geometry import Camera, FloatArray, IntArray
from rholoc.progress import ProgressListener, Stage, silent
from rholoc.recordings import Recording, check_waypoints_fix_frame
from rholoc.trajectory.alignment import Similarity
from rholoc.trajectory.child import run_in_child
from rholoc.trajectory.imu import GyroCalibration, calibrate_gyro
from rholoc.trajectory.inertial import integrate_between_waypoints
from rholoc.trajectory.keyframe_features import extract_keyframe_features
from rholoc.trajectory.keyframes import choose_keyframes, measure_motion
from rholoc.trajectory.trajectory import PoseMethod, Scale, Trajectory
from rholoc.trajectory.upright import rotation_to_upright, up_without_roll
from rholoc.trajectory.visual import MIN_PLACED, VisualPoses, structure_from_motion
from rholoc.trajectory.visual_inertial import InertialAlignment, align_inertially
from rholoc.trajectory.waypoint_alignment import UpMeasurement, align_to_waypoints

_FEWEST_GIVEN = 3
_FEWEST_KEYFRAMES = 4
_FEWEST_FEATURES = 50  # in a keyframe that can be placed
_MAX_SCALE_SIGMA = 0.1  # relative; an IMU scale less certain than this is no scale
_GRAVITY_SIGMA_DEG = 0.5
_NO_ROLL_SIGMA_DEG = 1.5
_MAX_GIVEN_TILT_DEG = 5.0  # of given poses that count as upright
_MAX_TILT_DEG = 15.0  # between the waypoints' z axis and the measured up, above which they are not the same
_MAX_WAYPOINT_RESIDUAL_M = 0.1  # of a trajectory that is trusted
_MAX_CONTRADICTION = 0.2  # the share of intervals in which camera and gyroscope may differ

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
    report = {
        "method": PoseMethod.GIVEN.value,
        "frames": len(rows),
        "trusted": True,
        "why": "The poses were given.",
        "up": up,
    }
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
    rows = _keyframes(recording, progress)
    stops = [waypoint.time for waypoint in recording.waypoints]
    times = recording.frames.times[rows]
    between = (times >= min(stops)) & (times <= max(stops))
    rows, times = rows[between], times[between]
    if len(rows) < _FEWEST_KEYFRAMES:
        raise MappingFailed(f"{len(rows)} keyframes lie between the waypoints.", _MOVE)
    poses = integrate_between_waypoints(recording.imu, recording.waypoints, times)
    progress(Stage.POSES, 1.0, "the IMU was integrated")
    report = {
        "method": PoseMethod.INERTIAL.value,
        "frames": len(rows),
        "trusted": False,
        "why": "Integrated from the IMU alone; nothing checks it between the waypoints.",
    }
    return Trajectory(rows, times, poses, camera, Scale.METRIC, True, report)


def _visual(recording: Recording, method: PoseMethod, progress: ProgressListener) -> Trajectory:
    rows = _keyframes(recording, progress)
    features = extract_keyframe_features(recording.frames, rows, progress)
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
        progress=progress,
        stage=Stage.POSES,
    )
    rows = rows[visual.reconstruction.placed]
    times = recording.frames.times[rows]
    report = _visual_report(visual, len(features), method)
    doubts = [] if visual.trusted else [visual.why]
    if visual.calibration is not None:
        report["camera"] = visual.calibration.report
        if not visual.calibration.observable:
            doubts.append(visual.calibration.why)
    inertial = _ask_imu(recording, method, times, visual.reconstruction.T_world_camera, report, doubts)
    fixed = _fix_frame(recording, times, visual, inertial)
    report.update(fixed.report)
    doubts += fixed.doubts
    report["trusted"] = not doubts
    report["why"] = " ".join(doubts) or visual.why
    progress(Stage.POSES, 1.0, f"{len(rows)} frames placed")
    T = fixed.similarity.poses(visual.reconstruction.T_world_camera)
    return Trajectory(rows, times, T, visual.camera, fixed.scale, fixed.upright, report)


def _keyframes(recording: Recording, progress: ProgressListener) -> IntArray:
    """Keyframes by motion and sharpness, and the frame nearest to each waypoint."""
    motion, sharpness = measure_motion(recording.frames, progress)
    chosen = choose_keyframes(motion, sharpness)
    times = recording.frames.times
    stops = [int(np.abs(times - waypoint.time).argmin()) for waypoint in recording.waypoints]
    rows = np.union1d(chosen, np.array(stops, dtype=np.int64))
    if len(rows) < _FEWEST_KEYFRAMES:
        raise MappingFailed("The camera hardly moves in this recording.", _MOVE)
    return rows


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
        "frames": len(model.placed),
        "landmarks": model.landmarks,
        "reprojection_error_px": model.reprojection_error_px,
        "loop_pairs": visual.loops,
        "disagreement_of_depth": _or_none(visual.disagreement),
        "disagreement_deg": _or_none(visual.disagreement_deg),
    }


def _ask_imu(
    recording: Recording,
    method: PoseMethod,
    times: FloatArray,
    T_world_camera: FloatArray,
    report: dict[str, Any],
    doubts: list[str],
) -> InertialAlignment | None:
    """What the IMU says about scale and gravity; notes in the report why not, where it says nothing."""
    if method is not PoseMethod.VISUAL_INERTIAL:
        return None
    if recording.imu is None:
        report["imu"] = "The recording has no IMU; the poses are visual alone."
        return None
    gyro = calibrate_gyro(times, T_world_camera[:, :3, :3], recording.imu)
    if gyro is None:
        report["imu"] = "IMU and video hardly overlap; the poses are visual alone."
        return None
    report["imu"] = _gyro_report(gyro)
    if gyro.contradiction > _MAX_CONTRADICTION:
        doubts.append(f"The gyroscope contradicts the cameras in {gyro.contradiction:.0%} of the walk.")
        return None
    return align_inertially(times, T_world_camera, recording.imu, gyro)


def _gyro_report(gyro: GyroCalibration) -> dict[str, Any]:
    return {
        "time_offset_s": gyro.time_offset_s,
        "gyro_bias_rad_per_s": [float(value) for value in gyro.bias],
        "rotation_residual_deg": gyro.residual_deg,
        "contradiction": gyro.contradiction,
    }


@dataclass(frozen=True, eq=False)
class _Fixed:
    """How a reconstruction comes to the map frame."""

    similarity: Similarity
    scale: Scale
    upright: bool
    report: dict[str, Any]
    doubts: list[str] = field(default_factory=list)


def _fix_frame(
    recording: Recording, times: FloatArray, visual: VisualPoses, inertial: InertialAlignment | None
) -> _Fixed:
    up, report = _measure_up(visual, inertial)
    if recording.waypoints:
        return _fix_to_waypoints(recording, times, visual, up, report)
    scale, unit = Scale.ARBITRARY, 1 / visual.reconstruction.median_depth
    why = "Nothing measured fixes the scale; the unit is the median distance of the landmarks."
    if inertial is not None:
        report["imu_scale_sigma"] = inertial.scale_sigma
        if inertial.scale > 0 and inertial.scale_sigma <= _MAX_SCALE_SIGMA:
            scale, unit = Scale.METRIC, inertial.scale
            why = f"The accelerometer fixes the scale to {inertial.scale_sigma:.1%}."
        else:
            why = f"The accelerometer leaves the scale open ({inertial.scale_sigma:.0%}): start and stop more often."
    report["scale"] = why
    similarity = _at_first_frame(visual.reconstruction.T_world_camera[0], None if up is None else up.direction, unit)
    return _Fixed(similarity, scale, up is not None, report)


def _fix_to_waypoints(
    recording: Recording, times: FloatArray, visual: VisualPoses, up: UpMeasurement | None, report: dict[str, Any]
) -> _Fixed:
    positions = visual.reconstruction.T_world_camera[:, :3, 3]
    similarity, residuals = align_to_waypoints(times, positions, recording.waypoints)
    tilt_deg = None
    if up is not None:
        tilt_deg = float(np.degrees(np.arccos(np.clip((similarity.rotation @ up.direction)[2], -1, 1))))
        if tilt_deg <= _MAX_TILT_DEG:
            similarity, residuals = align_to_waypoints(times, positions, recording.waypoints, up)
    report["scale"] = "The waypoints fix the scale."
    report["waypoints_tilt_deg"] = tilt_deg
    report["waypoint_residuals_m"] = {
        waypoint.name: _or_none(value) for waypoint, value in zip(recording.waypoints, residuals, strict=True)
    }
    worst = float(np.nanmax(residuals))
    doubts = [f"A waypoint is missed by {worst:.2f} m."] if worst > _MAX_WAYPOINT_RESIDUAL_M else []
    if tilt_deg is not None and tilt_deg > _MAX_TILT_DEG:
        report["up"] += f" The waypoints' z axis is {tilt_deg:.0f}° off it, and was left there."
    return _Fixed(similarity, Scale.METRIC, tilt_deg is not None and tilt_deg <= _MAX_TILT_DEG, report, doubts)


def _measure_up(visual: VisualPoses, inertial: InertialAlignment | None) -> tuple[UpMeasurement | None, dict[str, Any]]:
    """The upward direction from gravity or else from the no-roll prior, and what to say about it."""
    if inertial is not None and inertial.up is not None:
        return UpMeasurement(inertial.up, _GRAVITY_SIGMA_DEG), {"up": "Gravity was measured by the accelerometer."}
    prior = up_without_roll(visual.reconstruction.T_world_camera[:, :3, :3])
    figures = f"the cameras' x axes are {prior.roll_deg:.1f}° off one plane and spread {prior.turn_deg:.0f}° in it"
    if prior.holds:
        return UpMeasurement(prior.direction, _NO_ROLL_SIGMA_DEG), {"up": f"By the no-roll prior: {figures}."}
    return None, {"up": f"Unknown; the no-roll prior does not hold: {figures}."}


def _at_first_frame(T_world_camera: FloatArray, up: FloatArray | None, scale: float) -> Similarity:
    """Origin at a camera, x axis along its horizontal heading, z axis along ``up``, or against its own y axis."""
    R_level = rotation_to_upright(-T_world_camera[:3, 1] if up is None else up)
    heading = R_level @ T_world_camera[:3, 2]
    length = float(np.hypot(heading[0], heading[1]))
    c, s = (heading[0] / length, heading[1] / length) if length > 1e-6 else (1.0, 0.0)
    R = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ R_level
    return Similarity(scale, R, -scale * R @ T_world_camera[:3, 3])


def _or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
