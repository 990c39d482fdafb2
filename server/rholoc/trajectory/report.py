"""What is reported of a reconstruction: whether to trust it, its expected errors, and what its measurements say."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from rholoc.errors import RholocError
from rholoc.geometry import FloatArray
from rholoc.recordings import Recording
from rholoc.reports import ImuReport, InertialComparison, TrajectoryReport
from rholoc.trajectory.checks.mistaken_waypoints import LeftOut, explain
from rholoc.trajectory.dead_reckoning import integrate_between_waypoints
from rholoc.trajectory.reconstruction import Reconstruction
from rholoc.trajectory.reconstruction.outcome import WELL_PLACED
from rholoc.trajectory.trajectory import PoseMethod, Scale
from rholoc.trajectory.visual.calibration_report import calibration_report

_MAX_EXPECTED_ERROR_M = 0.10  # of a trajectory that is trusted
_MAX_EXPECTED_ERROR_DEG = 2.0
_MAX_WAYPOINT_MISS_M = 0.10
_MAX_IMU_MISFIT = 2.0  # multiple of the expected noise, above which IMU and pictures disagree …
_MAX_IMU_RESIDUAL = 8.0  # … and multiple above which the accelerometer contradicts the pictures


def doubts_about(found: Reconstruction, share: float, missing: str) -> list[str]:
    """Reasons not to trust a reconstruction, one line each; empty if none. ``share`` is the share of placed keyframes,
    ``missing`` a text on the others.
    """
    doubts = list(found.frame.doubts)
    if share < WELL_PLACED:
        doubts.append(f"Only {share:.0%} of the keyframes could be placed. {missing}".strip())
    error_m = _expected_error_m(found)
    if error_m is None:
        doubts.append("It is not known how far its poses are off: too little ties them together. Walk in loops.")
    elif found.frame.scale is Scale.METRIC and error_m > _MAX_EXPECTED_ERROR_M:
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
    if found.frame.waypoints and error_deg is not None and error_deg > _MAX_EXPECTED_ERROR_DEG:
        doubts.append(
            f"The waypoints leave the map's rotation open by {error_deg:.0f}°: measure one well off the others' line."
        )
    if found.focal_sigma_px is not None:
        calibration = calibration_report(found.camera, found.focal_sigma_px, int(found.placed.sum()))
        doubts += [] if calibration.observable else [calibration.why]
    return doubts


def _expected_error_m(found: Reconstruction) -> float | None:
    """Median expected position error of the placed keyframes, in the map's unit; None if half of them have no bound."""
    return _median_sigma(found.covariances[found.placed, :3, :3])


def _expected_error_deg(found: Reconstruction) -> float | None:
    """Median expected rotation error of the placed keyframes [deg]; None if half of them have no bound."""
    sigma = _median_sigma(found.covariances[found.placed, 3:, 3:])
    return None if sigma is None else float(np.degrees(sigma))


def _median_sigma(covariances: FloatArray) -> float | None:
    """Median of the root traces of covariances (K, 3, 3), NaN taken as infinite; None if it is infinite."""
    variances = np.nan_to_num(np.trace(covariances, axis1=1, axis2=2), nan=np.inf)
    median = float(np.median(np.sqrt(variances)))
    return median if np.isfinite(median) else None


def report_on(found: Reconstruction, method: PoseMethod, doubts: Sequence[str]) -> TrajectoryReport:
    """Report on a reconstruction by ``method``, which is trusted unless there are ``doubts``."""
    metric, frames = found.frame.scale is Scale.METRIC, int(found.placed.sum())
    error_m = _expected_error_m(found)
    expected = ""
    if metric and error_m is not None:
        expected = f"Its poses are expected to be right to {100 * error_m:.1f} cm."
    if found.agreement is not None:
        expected = f"{expected} {found.agreement.why}".strip()
    why = " ".join(doubts) or expected or "Pictures and IMU agree."
    mistakes = [explain(name, found.left_out[name].off_m) for name in found.mistaken]
    return TrajectoryReport(
        method=method.value,
        frames=frames,
        trusted=not doubts,
        why=f"{why} {found.note}".strip(),
        up=found.frame.why_up,
        scale=found.frame.why_scale,
        keyframes=len(found.placed),
        landmarks=found.landmarks,
        reprojection_error_px=found.residual_px,
        loop_pairs=found.loops,
        camera=None if found.focal_sigma_px is None else calibration_report(found.camera, found.focal_sigma_px, frames),
        waypoints_tilt_deg=found.frame.tilt_deg,
        waypoint_times_s={waypoint.name: waypoint.time for waypoint in found.frame.waypoints} or None,
        waypoint_residuals_m=_residuals(found, lambda out: float(np.linalg.norm(out.off_m))),
        waypoint_sigmas=_residuals(found, lambda out: out.sigmas),
        waypoint_mistake=" ".join(mistakes) or None,
        expected_error_m=error_m if metric else None,
        expected_error_deg=_expected_error_deg(found),
        disagreement_of_depth=None if found.agreement is None else _finite_or_none(found.agreement.distance),
        disagreement_deg=None if found.agreement is None else _finite_or_none(found.agreement.angle_deg),
    )


def _finite_or_none(value: float) -> float | None:
    """The value; None if it is NaN or infinite."""
    return value if np.isfinite(value) else None


def _residuals(found: Reconstruction, figure: Callable[[LeftOut], float]) -> dict[str, float | None] | None:
    """A figure of each waypoint by name, None if the waypoint was not compared; None without waypoints."""
    names = [waypoint.name for waypoint in found.frame.waypoints]
    return {name: figure(found.left_out[name]) if name in found.left_out else None for name in names} or None


def imu_report_on(recording: Recording, found: Reconstruction) -> ImuReport | str:
    """Figures of the recording's IMU, or one line that says why it was not used."""
    if recording.imu is None:
        return "The recording has no IMU; the poses are visual alone."
    if not recording.frames.timed:
        return "The pictures have no times, so the IMU could not be used; the poses are visual alone."
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


def comparison_with_imu(recording: Recording, found: Reconstruction, times: FloatArray) -> InertialComparison | None:
    """Distance of the poses from the paper's method, the IMU integrated between waypoints; None without IMU or
    waypoints. ``times`` (N,) [s] are those of the placed keyframes. If the integration fails, the result says why.
    """
    if recording.imu is None or found.imu is None or not found.frame.waypoints:
        return None
    stops = [waypoint.time for waypoint in found.frame.waypoints]
    between = (times >= min(stops)) & (times <= max(stops))
    gyro = found.imu.gyro
    offset_s = gyro.time_offset_s + found.imu.clock_s
    on_video_clock = replace(recording.imu, times=recording.imu.times - offset_s, R_camera_imu=gyro.R_camera_imu)
    try:
        poses = integrate_between_waypoints(on_video_clock, found.frame.waypoints, times[between])
    except RholocError as error:
        return InertialComparison(why=error.message)
    apart_m = np.linalg.norm(poses[:, :3, 3] - found.T_map_camera[found.placed][between, :3, 3], axis=1)
    return InertialComparison(
        frames=int(between.sum()),
        rms_m=float(np.sqrt(np.mean(apart_m**2))),
        worst_m=float(apart_m.max()),
        worst_time_s=float(times[between][apart_m.argmax()]),
    )
