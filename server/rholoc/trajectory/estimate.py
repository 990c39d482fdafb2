"""A recording → its frame poses, by the method asked for."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rholoc.errors import InvalidCamera, InvalidRecording, InvalidWaypoints, MappingFailed
from rholoc.features import FeatureSet
from rholoc.geometry import CAMERA_WRITTEN, UP, Camera, FloatArray, IntArray, angles_between
from rholoc.progress import ProgressListener, Stage, silent
from rholoc.recordings import Imu, PoseKind, Recording, Waypoint, check_waypoints_fix_frame
from rholoc.reports import TrajectoryReport
from rholoc.trajectory.checks.gaps import describe, missing_spans
from rholoc.trajectory.checks.given_poses import PoseAxes, check_given_poses
from rholoc.trajectory.child import run_in_child
from rholoc.trajectory.chosen_keyframes import (
    FEWEST_KEYFRAMES,
    MOVE,
    chosen_rows,
    keyframes_and_waypoints,
    require_keyframes,
    rows_at,
    rows_of,
)
from rholoc.trajectory.frame.upright import up_without_roll
from rholoc.trajectory.inertial.odometry import odometry_steps
from rholoc.trajectory.inertial_adjustment import adjust_between_waypoints
from rholoc.trajectory.optimization.problem import Step
from rholoc.trajectory.reconstruction import (
    Reconstruction,
    Sights,
    reconstruct,
    reconstruct_from_poses,
    unmoved_frame,
)
from rholoc.trajectory.reconstruction.outcome import fewest_placed
from rholoc.trajectory.reconstruction.sights import DENSER
from rholoc.trajectory.report import comparison_with_imu, doubts_about, imu_report_on, report_on
from rholoc.trajectory.trajectory import PoseMethod, Scale, Trajectory
from rholoc.trajectory.visual.flow import Flow, track_corners
from rholoc.trajectory.visual.keyframe_features import ImageListener, KeyframeFeatures
from rholoc.trajectory.visual.keyframes import is_film, may_be_film
from rholoc.trajectory.visual.rolling_shutter import RollingShutter, measure_rolling_shutter

_FEWEST_GIVEN = 3
_MAX_GIVEN_TILT_DEG = 5.0  # of given poses that count as upright
_MOUNTING_SIGMA_M, _MOUNTING_SIGMA_RAD = 0.002, 0.002  # of cameras on a rig

_SLOWER = "Walk slower, keep more texture in view: no blank walls, no darkness."


def estimate_trajectory(
    recording: Recording,
    method: PoseMethod,
    progress: ProgressListener = silent,
    show: ImageListener | None = None,
) -> Trajectory:
    """Estimate poses of a recording's frames: of the keyframes that can be placed, or of the frames with a given pose.

    ``scale`` and ``upright`` of the result state whether a measurement made the poses metric and upright.

    Args:
        recording: the recording, with the measurements that the method needs.
        method: source of the poses.
        progress: called after each step.
        show: called from threads with row and image of frames that may become keyframes, while they are decoded.

    Raises:
        InvalidRecording: the method needs poses or an IMU that the recording does not have, or a frame is damaged.
        InvalidCamera: the method needs intrinsics that the recording does not have.
        InvalidWaypoints: there are waypoints, but they do not fix a frame; or INERTIAL has none.
        MappingFailed: too few keyframes could be placed, or what was measured contradicts the reconstruction.
        Cancelled: ``progress`` asked to stop.
    """
    if recording.waypoints:
        check_waypoints_fix_frame(recording.waypoints)
    recording = _with_poses_in_metres(recording)
    match method:
        case PoseMethod.AUTO:
            return _automatic(recording, progress, show)
        case PoseMethod.GIVEN:
            return _given(recording)
        case PoseMethod.INERTIAL:
            return _inertial(recording, progress)
        case PoseMethod.ODOMETRY:
            return odometry_from_flow(
                recording, track_corners(recording.frames, progress, camera=recording.camera), progress
            )
        case PoseMethod.VISUAL | PoseMethod.VISUAL_INERTIAL:
            return _visual(recording, method, progress, show)


def _with_poses_in_metres(recording: Recording) -> Recording:
    """The recording with its poses scaled to metres by the median ratio of its known lengths.

    Unchanged if the poses are metric already, or if there are no poses or lengths.
    """
    poses = recording.poses
    if poses is None or poses.metric:
        return recording
    positions = poses.T_map_camera[:, :3, 3]
    rows = dict(zip(recording.frames.numbers.tolist(), range(len(positions)), strict=True))
    ratios = [
        one.length_m / apart
        for one in recording.lengths
        if (apart := float(np.linalg.norm(positions[rows[one.first]] - positions[rows[one.second]]))) > 0
    ]
    if not ratios:
        return recording
    T = poses.T_map_camera.copy()
    T[:, :3, 3] *= np.median(ratios)
    return replace(recording, poses=replace(poses, T_map_camera=T, metric=True))


def _automatic(recording: Recording, progress: ProgressListener, show: ImageListener | None) -> Trajectory:
    """Poses by the best method for the recording's measurements.

    The recording's own poses, if it has at least three, no waypoints and intrinsics, and its pictures do not contradict
    them. They are adjusted to the pictures unless they are exact. Otherwise pictures, IMU and waypoints. With waypoints
    the own poses are not used, because the waypoints define the map frame.

    Raises MappingFailed, InvalidRecording, InvalidCamera, InvalidWaypoints.
    """
    if recording.poses is None or recording.poses.known.sum() < _FEWEST_GIVEN or recording.waypoints:
        return _visual(recording, PoseMethod.VISUAL_INERTIAL, progress, show)
    if recording.camera is None:
        return _because(_visual(recording, PoseMethod.VISUAL_INERTIAL, progress, show), "came without intrinsics")
    check = check_given_poses(recording, recording.camera)
    if np.isnan(check.error):
        return _given(recording)
    if not check.usable:
        off_px = check.error * recording.camera.focal
        why = f"contradict its pictures by {off_px:.0f} px in whatever axes"
        return _because(_visual(recording, PoseMethod.VISUAL_INERTIAL, progress, show), why)
    read = replace(recording, poses=replace(recording.poses, T_map_camera=check.read(recording.poses.T_map_camera)))
    if check.exact and recording.poses.kind is PoseKind.EXACT:
        found = _given(read)
    else:
        found = _adjusted_to_pictures(read, progress, show)
    if check.axes is PoseAxes.AS_DOCUMENTED:
        return found
    note = f"The poses are {check.axes}, and were read so."
    return replace(found, report=replace(found.report, why=f"{found.report.why} {note}".strip()))


def _because(found: Trajectory, why: str) -> Trajectory:
    """The trajectory, its report extended by ``why`` the recording's own poses were not used."""
    note = f"The recording's own poses {why}; its pictures were used."
    return replace(found, report=replace(found.report, why=f"{found.report.why} {note}".strip()))


def _adjusted_to_pictures(recording: Recording, progress: ProgressListener, show: ImageListener | None) -> Trajectory:
    """The recording's own poses, which drift, adjusted to its pictures, with a report. Raises MappingFailed."""
    assert recording.poses is not None
    with KeyframeFeatures(recording.frames, (), show, recording.camera) as features:
        flow = track_corners(recording.frames, progress, features.foresee, recording.camera)
        rows = np.intersect1d(chosen_rows(recording, flow, features), np.flatnonzero(recording.poses.known))
        require_keyframes(rows, len(recording.frames.times))
        sights = _sights(recording, flow, rows, _features_of(recording, flow, rows, features, progress))
    T = recording.poses.T_map_camera[rows]
    upright, up = _is_upright(T[:, :3, :3])
    scale = Scale.METRIC if recording.poses.metric else Scale.ARBITRARY
    frame = unmoved_frame(scale, upright, up)
    found = run_in_child(
        reconstruct_from_poses, sights, _known_camera(recording), T, frame, progress=progress, stage=Stage.POSES
    )
    trajectory = _trajectory_of(found, PoseMethod.GIVEN, sights, progress)
    moved = np.linalg.norm(found.T_map_camera[found.placed, :3, 3] - T[found.placed, :3, 3], axis=1)
    unit = (
        f"{100 * float(np.median(moved)):.0f} cm" if recording.poses.metric else f"{float(np.median(moved)):.3g} units"
    )
    note = f"The recording's own poses, adjusted to its pictures by {unit} in the median."
    return replace(trajectory, report=replace(trajectory.report, why=f"{trajectory.report.why} {note}".strip()))


def odometry_from_flow(recording: Recording, flow: Flow, progress: ProgressListener = silent) -> Trajectory:
    """Poses of the keyframes by optical flow, and by the IMU if there is one.

    Nothing corrects drift: features, loop closures and waypoints are not used. Metric only with an IMU.

    Args:
        recording: its waypoints are ignored.
        flow: corners of its frames, by :func:`rholoc.trajectory.visual.flow.track_corners`.
        progress: is called with each step that is done.

    Raises:
        MappingFailed: the camera hardly moves, or too few keyframes could be placed.
        Cancelled: ``progress`` asked to stop.
    """
    alone = replace(recording, waypoints=())
    rows, choices = keyframes_and_waypoints(alone, alone.imu, flow)
    sights = _sights(alone, flow, rows, [FeatureSet.empty(0)] * len(rows))
    return _placed(alone, PoseMethod.ODOMETRY, sights, alone.imu, choices, progress)


def rolling_shutter_of(
    recording: Recording, rows: IntArray, progress: ProgressListener = silent
) -> RollingShutter | None:
    """Image motion in the frames ``rows`` (K,) during their read-out; None if the read-out time or the times are not
    known.

    Raises:
        InvalidRecording: a frame cannot be decoded.
        Cancelled: ``progress`` asked to stop.
    """
    if recording.readout_s is None or not recording.frames.timed:
        return None
    return measure_rolling_shutter(
        track_corners(recording.frames, progress, camera=recording.camera), rows, recording.readout_s
    )


def _given(recording: Recording) -> Trajectory:
    """Trajectory of the recording's own poses, as they are. Raises InvalidRecording, InvalidCamera."""
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
    """Whether z of given poses' frame is within 5° of up by the no-roll prior (False if it fails), and a line on it."""
    prior = up_without_roll(R_map_camera)
    if not prior.holds:
        return False, f"Unknown; the cameras roll by {prior.roll_deg:.1f}°, so nothing shows whether z is up."
    tilt_deg = float(np.degrees(angles_between(prior.direction, UP)))
    return tilt_deg <= _MAX_GIVEN_TILT_DEG, f"By the no-roll prior, z is {tilt_deg:.1f}° off the upward direction."


def _inertial(recording: Recording, progress: ProgressListener) -> Trajectory:
    """Trajectory of the keyframes between the waypoints, by the IMU and the waypoints alone; never trusted."""
    camera = _known_camera(recording)
    if recording.imu is None:
        raise InvalidRecording("The recording has no IMU table.", "Choose poses 'visual'.")
    if not recording.frames.timed:
        raise InvalidRecording(
            "The pictures have no times, so the IMU cannot be used.", "Add frames.csv with frame,timestamp."
        )
    if not recording.waypoints:
        raise InvalidWaypoints("The IMU needs waypoints to correct it.", "Measure three or more, at rest at each.")
    rows, choices = keyframes_and_waypoints(
        recording, recording.imu, track_corners(recording.frames, progress, camera=recording.camera)
    )
    waypoints = choices[0]  # the longest pauses
    stops = [waypoint.time for waypoint in waypoints]
    times = recording.frames.times[rows]
    between = (times >= min(stops)) & (times <= max(stops))
    rows, times = rows[between], times[between]
    if len(rows) < FEWEST_KEYFRAMES:
        raise MappingFailed(f"{len(rows)} keyframes lie between the waypoints.", MOVE)
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
    """Trajectory of the keyframes by what they see, and by the IMU if the method uses it."""
    imu = recording.imu if method is PoseMethod.VISUAL_INERTIAL and recording.frames.timed else None
    stops = rows_at(recording.frames.times, recording.waypoints).union(*rows_of(recording, recording.lengths))
    with KeyframeFeatures(recording.frames, stops, show, recording.camera) as features:
        frames = recording.frames
        flow = track_corners(frames, progress, features.foresee, recording.camera, may_be_film(frames))
        rows, choices = keyframes_and_waypoints(recording, imu, flow, features)
        sights = _sights(recording, flow, rows, _features_of(recording, flow, rows, features, progress))
    return _placed(recording, method, sights, imu, choices, progress)


def _placed(
    recording: Recording,
    method: PoseMethod,
    sights: Sights,
    imu: Imu | None,
    choices: Sequence[tuple[Waypoint, ...]],
    progress: ProgressListener,
) -> Trajectory:
    """Trajectory of the keyframes placed by what they see, by the IMU (None: not used), and by waypoints. ``choices``
    are possible assignments of times to the waypoints. Raises MappingFailed if too few could be placed.
    """
    found = run_in_child(
        reconstruct, sights, imu, choices if recording.waypoints else [], progress=progress, stage=Stage.POSES
    )
    trajectory = _trajectory_of(found, method, sights, progress)
    if method is PoseMethod.VISUAL:
        return trajectory
    report = replace(trajectory.report, imu=imu_report_on(recording, found))
    compared = comparison_with_imu(recording, found, trajectory.times)
    return replace(trajectory, report=replace(report, inertial=compared))


def _trajectory_of(found: Reconstruction, method: PoseMethod, sights: Sights, progress: ProgressListener) -> Trajectory:
    """Trajectory of the placed keyframes with its report.

    Raises MappingFailed if less than half of the keyframes are placed (of a set of pictures, less than a quarter and
    fewer than eight).
    """
    flow, rows, kept = sights.flow, sights.rows, np.flatnonzero(found.placed)
    missing = missing_spans(flow, rows, found.placed, found.disputed)
    count, share = len(rows), len(kept) / len(rows)
    if len(kept) < fewest_placed(count, sights.is_film):
        what, advice = ("keyframes", _SLOWER) if sights.is_film else ("pictures", DENSER)
        raise MappingFailed(f"Only {len(kept)} of {count} {what} could be placed. {describe(missing)}".strip(), advice)
    second = None if found.agreement is None else found.agreement.second_positions
    doubts = doubts_about(found, share, describe(missing))
    progress(Stage.POSES, 1.0, f"{len(kept)} of {count} keyframes placed")
    return Trajectory(
        rows[kept],
        flow.times[rows[kept]],
        found.T_map_camera[kept],
        found.camera,
        found.frame.scale,
        found.frame.upright,
        replace(report_on(found, method, doubts), missing=missing),
        None if sights.shutter is None else sights.shutter.take(kept),
        found.covariances[kept],
        None if second is None else second[kept],
        None if found.zooms is None else found.zooms[kept],
    )


def _features_of(
    recording: Recording, flow: Flow, rows: IntArray, features: KeyframeFeatures, progress: ProgressListener
) -> list[FeatureSet]:
    """Features of the keyframes ``rows`` (K,); of mostly dim pictures in a set, weak ones too."""
    return features.of(rows, progress) if _is_film(recording, flow) else features.of_set(rows, progress)


def _sights(recording: Recording, flow: Flow, rows: IntArray, features: list[FeatureSet]) -> Sights:
    """Measurements of the keyframes ``rows`` (K,): their ``features``, flow, depth, known lengths, odometry and the
    poses between cameras of a rig.

    The features are corrected for the rolling shutter if its read-out time is known. Known lengths and poses by a rig
    are kept if both of their frames are keyframes.
    """
    shutter: RollingShutter | None = None
    if recording.readout_s is not None and flow.timed:
        shutter = measure_rolling_shutter(flow, rows, recording.readout_s)
        features = [shutter.at_once(k, found) for k, found in enumerate(features)]
    depth = None if recording.depth is None else recording.depth.select(rows)
    lengths = tuple(
        (int(np.searchsorted(rows, a)), int(np.searchsorted(rows, b)), one.length_m)
        for one, (a, b) in zip(recording.lengths, rows_of(recording, recording.lengths), strict=True)
        if np.isin((a, b), rows).all()
    )
    steps: tuple[Step, ...] = ()
    if recording.odometry is not None and flow.timed:
        moved = odometry_steps(recording.odometry, flow.times[rows])
        steps = tuple(Step(k, k + 1, T, sigma_m, sigma_rad) for k, T, sigma_m, sigma_rad in moved)
    for one, (a, b) in zip(recording.mounted, rows_of(recording, recording.mounted), strict=True):
        if np.isin((a, b), rows).all():
            first, second = np.searchsorted(rows, (a, b)).tolist()
            steps += (Step(first, second, one.T_first_second, _MOUNTING_SIGMA_M, _MOUNTING_SIGMA_RAD, True),)
    focal_px, lenses = recording.focal_px, None
    if recording.lenses:
        lenses = np.array([recording.lenses[number] for number in recording.frames.numbers[rows].tolist()])
    film = _is_film(recording, flow)
    return Sights(flow, rows, features, recording.camera, film, shutter, depth, focal_px, lengths, steps, lenses)


def _is_film(recording: Recording, flow: Flow) -> bool:
    """Whether corners are followed from frame to frame: by one camera, through a film."""
    return is_film(flow) and not recording.mounted and not recording.lenses


def _known_camera(recording: Recording) -> Camera:
    """The recording's camera. Raises InvalidCamera without one."""
    if recording.camera is None:
        raise InvalidCamera(
            "The recording's intrinsics are unknown.",
            f"Give the camera as {CAMERA_WRITTEN}, or choose poses 'visual'.",
        )
    return recording.camera
