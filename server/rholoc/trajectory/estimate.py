"""A recording → its frame poses, by the method asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from rholoc.errors import InvalidCamera, InvalidRecording, InvalidWaypoints, MappingFailed, RholocError
from rholoc.features import FeatureSet
from rholoc.geometry import UP, Camera, FloatArray, IntArray, angles_between
from rholoc.progress import ProgressListener, Stage, silent
from rholoc.recordings import Imu, Recording, Waypoint, check_waypoints_fix_frame
from rholoc.reports import ImuReport, InertialComparison, TrajectoryReport
from rholoc.trajectory.checks.blame import LeftOut, explain
from rholoc.trajectory.checks.gaps import describe, missing_spans
from rholoc.trajectory.child import run_in_child
from rholoc.trajectory.dead_reckoning import integrate_between_waypoints
from rholoc.trajectory.frame.upright import up_without_roll
from rholoc.trajectory.frame.waypoint_times import choices_of_pauses, find_pauses, times_are_known
from rholoc.trajectory.inertial_adjustment import adjust_between_waypoints
from rholoc.trajectory.reconstruction import Reconstruction, Sights, reconstruct
from rholoc.trajectory.trajectory import PoseMethod, Scale, Trajectory
from rholoc.trajectory.visual.flow import Flow, track_corners
from rholoc.trajectory.visual.keyframe_features import ImageListener, KeyframeFeatures
from rholoc.trajectory.visual.keyframes import choose_keyframes
from rholoc.trajectory.visual.rolling_shutter import RollingShutter, measure_rolling_shutter
from rholoc.trajectory.visual.self_calibration import calibration_report

_FEWEST_GIVEN = 3
_FEWEST_KEYFRAMES = 4
_MAX_GIVEN_TILT_DEG = 5.0  # of given poses that count as upright
_MIN_PLACED = 0.5  # the share of the keyframes that a map must have
_WELL_PLACED = 0.9  # and that one which is trusted has
_MAX_EXPECTED_ERROR_M = 0.10  # of a trajectory that is trusted
_MAX_EXPECTED_ERROR_DEG = 2.0
_MAX_WAYPOINT_MISS_M = 0.10
_MAX_IMU_MISFIT = 2.0  # times the noise expected, from which the IMU's readings are not what moved the camera
_MAX_IMU_RESIDUAL = 8.0  # times the noise expected, from which IMU and pictures contradict each other

_MOVE = "Walk through the room while recording; keep texture in view."
_SLOWER = "Walk slower, keep more texture in view: no blank walls, no darkness."


def estimate_trajectory(
    recording: Recording,
    method: PoseMethod,
    progress: ProgressListener = silent,
    show: ImageListener | None = None,
) -> Trajectory:
    """The poses of a recording's frames, metric and upright where something measured makes them so.

    Args:
        recording: with frames, and what else the method needs.
        method: where poses come from.
        progress: is called with each step that is done.
        show: is shown the frames that may get a pose, where they are decoded for their features; from threads.

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
        case PoseMethod.ODOMETRY:
            return odometry_from_flow(recording, track_corners(recording.frames, progress), progress)
        case PoseMethod.VISUAL | PoseMethod.VISUAL_INERTIAL:
            return _visual(recording, method, progress, show)


def odometry_from_flow(recording: Recording, flow: Flow, progress: ProgressListener = silent) -> Trajectory:
    """The poses of keyframes that follow from optical flow, and from the IMU where there is one.

    Nothing corrects it: no feature is matched, no place recognised, no waypoint met. Metric where an IMU is of use.

    Args:
        recording: whose frames the flow is of.
        flow: its corners, by :func:`rholoc.trajectory.visual.flow.track_corners`.
        progress: is called with each step that is done.

    Raises:
        MappingFailed: the camera hardly moves, or too few keyframes could be placed.
        Cancelled: ``progress`` asked to stop.
    """
    alone = replace(recording, waypoints=())
    rows, choices = _keyframes(alone, alone.imu, flow)
    sights = _sights(alone, flow, rows, [FeatureSet.empty(0)] * len(rows))
    return _placed(alone, PoseMethod.ODOMETRY, sights, alone.imu, choices, progress)


def _given(recording: Recording) -> Trajectory:
    hint = "Put poses.txt beside the frames (frame or time, tx ty tz qx qy qz qw), or choose poses 'visual'."
    if recording.poses is None:
        raise InvalidRecording("The recording has no poses.", hint)
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
    tilt_deg = float(np.degrees(angles_between(prior.direction, UP)))
    return tilt_deg <= _MAX_GIVEN_TILT_DEG, f"By the no-roll prior, z is {tilt_deg:.1f}° off the upward direction."


def _inertial(recording: Recording, progress: ProgressListener) -> Trajectory:
    camera = _known_camera(recording)
    if recording.imu is None:
        raise InvalidRecording("The recording has no IMU table.", "Choose poses 'visual'.")
    if not recording.waypoints:
        raise InvalidWaypoints("The IMU needs waypoints to correct it.", "Measure three or more, at rest at each.")
    rows, choices = _keyframes(recording, recording.imu, track_corners(recording.frames, progress))
    waypoints = choices[0]  # the longest pauses
    stops = [waypoint.time for waypoint in waypoints]
    times = recording.frames.times[rows]
    between = (times >= min(stops)) & (times <= max(stops))
    rows, times = rows[between], times[between]
    if len(rows) < _FEWEST_KEYFRAMES:
        raise MappingFailed(f"{len(rows)} keyframes lie between the waypoints.", _MOVE)
    poses = adjust_between_waypoints(recording.imu, waypoints, times)
    progress(Stage.POSES, 1.0, "the IMU was integrated")
    report = TrajectoryReport(
        PoseMethod.INERTIAL.value,
        len(rows),
        trusted=False,
        why="Integrated from the IMU alone; nothing checks it between the waypoints.",
        waypoint_times_s={waypoint.name: waypoint.time for waypoint in waypoints},
    )
    return Trajectory(rows, times, poses, camera, Scale.METRIC, True, report)


def _visual(
    recording: Recording, method: PoseMethod, progress: ProgressListener, show: ImageListener | None
) -> Trajectory:
    imu = recording.imu if method is PoseMethod.VISUAL_INERTIAL else None
    with KeyframeFeatures(recording.frames, _rows_at(recording.frames.times, recording.waypoints), show) as features:
        flow = track_corners(recording.frames, progress, features.foresee)
        rows, choices = _keyframes(recording, imu, flow)
        sights = _sights(recording, flow, rows, features.of(rows, progress))
    return _placed(recording, method, sights, imu, choices, progress)


def _placed(
    recording: Recording,
    method: PoseMethod,
    sights: Sights,
    imu: Imu | None,
    choices: Sequence[tuple[Waypoint, ...]],
    progress: ProgressListener,
) -> Trajectory:
    """Keyframes placed by what they see, by the IMU, and by waypoints, of which there may be several choices."""
    flow, rows = sights.flow, sights.rows
    found = run_in_child(
        reconstruct, sights, imu, choices if recording.waypoints else [], progress=progress, stage=Stage.POSES
    )
    missing = missing_spans(flow, rows, found.placed)
    share = float(found.placed.mean())
    if share < _MIN_PLACED:
        raise MappingFailed(
            f"Only {found.placed.sum()} of {len(rows)} keyframes could be placed. {describe(missing)}".strip(), _SLOWER
        )
    kept = np.flatnonzero(found.placed)
    doubts = _doubts(found, share, describe(missing))
    report = _report(found, method, len(rows), kept, doubts)
    report = replace(report, missing=missing)
    if method is not PoseMethod.VISUAL:
        report = replace(report, imu=_imu_report(recording, found))
        report = replace(report, inertial=_comparison(recording, found, flow.times[rows[kept]], kept))
    progress(Stage.POSES, 1.0, f"{len(kept)} of {len(rows)} keyframes placed")
    return Trajectory(
        rows[kept],
        flow.times[rows[kept]],
        found.T_map_camera[kept],
        found.camera,
        found.frame.scale,
        found.frame.upright,
        report,
        None if sights.shutter is None else sights.shutter.take(kept),
        found.covariances[kept],
    )


def _sights(recording: Recording, flow: Flow, rows: IntArray, features: list[FeatureSet]) -> Sights:
    """What the keyframes see, corrected for the rolling shutter where its read-out is known."""
    shutter: RollingShutter | None = None
    if recording.readout_s is not None:
        shutter = measure_rolling_shutter(flow, rows, recording.readout_s)
        features = [shutter.at_once(k, found) for k, found in enumerate(features)]
    return Sights(flow, rows, features, recording.camera, shutter)


def _keyframes(recording: Recording, imu: Imu | None, flow: Flow) -> tuple[IntArray, list[tuple[Waypoint, ...]]]:
    """Keyframes by motion and sharpness, and the frames nearest to the waypoints; the waypoints with their times.

    Where those are not known, one frame for each pause, and every way to take pauses for the waypoints.
    """
    choices = [recording.waypoints]
    if not times_are_known(recording.waypoints):
        choices = list(choices_of_pauses(recording.waypoints, find_pauses(flow.times, flow.motion, imu)))
    stops = set().union(*(_rows_at(flow.times, waypoints) for waypoints in choices))
    rows = choose_keyframes(flow.times, flow.motion, flow.sharpness)
    rows = np.union1d(rows, np.array(sorted(stops), dtype=np.int64))
    if len(rows) < _FEWEST_KEYFRAMES:
        raise MappingFailed("The camera hardly moves in this recording.", _MOVE)
    return rows, choices


def _rows_at(times: FloatArray, waypoints: Sequence[Waypoint]) -> set[int]:
    """The frames (times (N,)) that are nearest to waypoints, of those whose time is known."""
    return {int(np.abs(times - at.time).argmin()) for at in waypoints if not np.isnan(at.time)}


def _known_camera(recording: Recording) -> Camera:
    if recording.camera is None:
        raise InvalidCamera(
            "The recording's intrinsics are unknown.",
            "Give the camera as fx,fy,cx,cy[,k1,k2,p1,p2[,k3]], or choose poses 'visual'.",
        )
    return recording.camera


def _doubts(found: Reconstruction, share: float, missing: str) -> list[str]:
    """Why a reconstruction is not to be trusted, one line each."""
    doubts = list(found.frame.doubts)
    if share < _WELL_PLACED:
        doubts.append(f"Only {share:.0%} of the keyframes could be placed. {missing}".strip())
    error_m = _expected_error_m(found)
    if found.frame.scale is Scale.METRIC and error_m > _MAX_EXPECTED_ERROR_M:
        doubts.append(f"Its poses are uncertain by {100 * error_m:.0f} cm: measure waypoints, or walk in loops.")
    for name, out in found.left_out.items():
        if name not in found.mistaken and float(np.linalg.norm(out.off_m)) > _MAX_WAYPOINT_MISS_M and out.mistaken:
            doubts.append(f"The waypoint {name} is missed by {np.linalg.norm(out.off_m):.2f} m.")
    if found.imu is not None and found.imu.residual > _MAX_IMU_RESIDUAL:
        doubts.append("The accelerometer contradicts the pictures.")
    elif found.imu is not None and found.imu.misfit > _MAX_IMU_MISFIT:
        doubts.append(
            f"The IMU disagrees with the pictures by {found.imu.misfit:.0f} times its noise, as where vibrations "
            "meet too few readings. The scale may be wrong: measure waypoints."
        )
    if found.agreement is not None and not found.agreement.same:
        doubts.append(found.agreement.why)
    error_deg = _expected_error_deg(found)
    if found.frame.waypoints and error_deg > _MAX_EXPECTED_ERROR_DEG:
        doubts.append(
            f"The waypoints leave the map's rotation open by {error_deg:.0f}°: measure one well off the others' line."
        )
    if found.focal_sigma_px is not None:
        calibration = calibration_report(found.camera, found.focal_sigma_px)
        doubts += [] if calibration.observable else [calibration.why]
    return doubts


def _expected_error_m(found: Reconstruction) -> float:
    return float(np.median(np.sqrt(np.trace(found.covariances[found.placed, :3, :3], axis1=1, axis2=2))))


def _expected_error_deg(found: Reconstruction) -> float:
    return float(np.degrees(np.median(np.sqrt(np.trace(found.covariances[found.placed, 3:, 3:], axis1=1, axis2=2)))))


def _report(
    found: Reconstruction, method: PoseMethod, keyframes: int, kept: IntArray, doubts: list[str]
) -> TrajectoryReport:
    metric = found.frame.scale is Scale.METRIC
    error_m = _expected_error_m(found)
    expected = f"Its poses are expected to be right to {100 * error_m:.1f} cm." if metric else ""
    if found.agreement is not None:
        expected = f"{expected} {found.agreement.why}".strip()
    mistakes = [explain(name, found.left_out[name].off_m) for name in found.mistaken]
    return TrajectoryReport(
        method=method.value,
        frames=len(kept),
        trusted=not doubts,
        why=" ".join(doubts) or expected or "Pictures and IMU agree.",
        up=found.frame.why_up,
        scale=found.frame.why_scale,
        keyframes=keyframes,
        landmarks=found.landmarks,
        reprojection_error_px=found.residual_px,
        loop_pairs=found.loops,
        camera=None if found.focal_sigma_px is None else calibration_report(found.camera, found.focal_sigma_px),
        waypoints_tilt_deg=found.frame.tilt_deg,
        waypoint_times_s={waypoint.name: waypoint.time for waypoint in found.frame.waypoints} or None,
        waypoint_residuals_m=_residuals(found, lambda out: float(np.linalg.norm(out.off_m))),
        waypoint_sigmas=_residuals(found, lambda out: out.sigmas),
        waypoint_mistake=" ".join(mistakes) or None,
        expected_error_m=error_m if metric else None,
        expected_error_deg=_expected_error_deg(found),
        disagreement_of_depth=None if found.agreement is None else _or_none(found.agreement.distance),
        disagreement_deg=None if found.agreement is None else _or_none(found.agreement.angle_deg),
    )


def _or_none(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _residuals(found: Reconstruction, figure: Callable[[LeftOut], float]) -> dict[str, float | None] | None:
    names = [waypoint.name for waypoint in found.frame.waypoints]
    return {name: figure(found.left_out[name]) if name in found.left_out else None for name in names} or None


def _imu_report(recording: Recording, found: Reconstruction) -> ImuReport | str:
    if recording.imu is None:
        return "The recording has no IMU; the poses are visual alone."
    imu = found.imu
    if imu is None:
        return ImuReport(not_observable={"all": found.imu_reason})
    not_observable = {} if found.frame.scale is Scale.METRIC else {"scale": found.frame.why_scale}
    gyro = imu.gyro
    return ImuReport(
        not_observable=not_observable,
        time_offset_s=gyro.time_offset_s + imu.clock_s,
        time_offset_sigma_s=gyro.time_offset_sigma_s,
        gyro_bias_rad_per_s=tuple(gyro.bias.tolist()),
        gyro_bias_sigma_rad_per_s=gyro.bias_sigma,
        R_camera_imu=tuple(tuple(row) for row in gyro.R_camera_imu.tolist()),
        R_camera_imu_contradicts_recording=gyro.contradicts_recording,
        mounting_sigma_deg=gyro.mounting_sigma_deg,
        rotation_residual_deg=gyro.residual_deg,
        scale_sigma=imu.scale_sigma,
        accelerometer_bias_m_s2=tuple(imu.accelerometer_bias.tolist()),
        lever_m=tuple(imu.lever_m.tolist()),
        accelerometer_scale=imu.accelerometer_scale,
    )


def _comparison(
    recording: Recording, found: Reconstruction, times: FloatArray, kept: IntArray
) -> InertialComparison | None:
    """How far the paper's own way, the IMU integrated between waypoints, is from the poses."""
    if recording.imu is None or found.imu is None or not found.frame.waypoints:
        return None
    stops = [waypoint.time for waypoint in found.frame.waypoints]
    between = (times >= min(stops)) & (times <= max(stops))
    gyro = found.imu.gyro
    on_video_clock = replace(
        recording.imu, times=recording.imu.times - gyro.time_offset_s, R_camera_imu=gyro.R_camera_imu
    )
    try:
        poses = integrate_between_waypoints(on_video_clock, found.frame.waypoints, times[between])
    except RholocError as error:
        return InertialComparison(why=error.message)
    apart_m = np.linalg.norm(poses[:, :3, 3] - found.T_map_camera[kept][between, :3, 3], axis=1)
    return InertialComparison(
        frames=int(between.sum()),
        rms_m=float(np.sqrt(np.mean(apart_m**2))),
        worst_m=float(apart_m.max()),
        worst_time_s=float(times[between][apart_m.argmax()]),
    )
