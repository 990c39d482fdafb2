"""What the IMU says about a reconstruction: whether it is right, its scale, and which way is up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from rholoc.errors import RholocError
from rholoc.geometry import BoolArray, FloatArray
from rholoc.recordings import Imu, Waypoint
from rholoc.trajectory.imu import GyroCalibration, agreeing_rotations, calibrate_gyro, camera_rotations
from rholoc.trajectory.inertial import integrate_between_waypoints
from rholoc.trajectory.visual_inertial import InertialAlignment, align_inertially

_MAX_DROPPED = 0.1  # the share of frames that the gyroscope may contradict in a trajectory that is trusted
_MAX_TIME_SIGMA_S = 0.05


@dataclass(frozen=True, eq=False)
class ImuEvidence:
    """What the IMU says.

    Attributes:
        kept: (N,) bool, the frames whose rotation it does not contradict.
        gyro: how it relates to the camera, or None where that is not observable.
        alignment: scale and gravity, or None where neither is.
        report: figures with their uncertainties, and under ``not_observable`` what could not be found out, and why.
        doubts: why the trajectory is not to be trusted, one line each.
    """

    kept: BoolArray
    gyro: GyroCalibration | None = None
    alignment: InertialAlignment | None = None
    report: dict[str, Any] = field(default_factory=dict)
    doubts: tuple[str, ...] = ()


def weigh_imu(times: FloatArray, T_world_camera: FloatArray, imu: Imu) -> ImuEvidence:
    """Hold an IMU against poses (N, 4, 4) of arbitrary frame and scale at ``times`` (N,)."""
    kept = np.ones(len(times), dtype=np.bool_)
    gyro = calibrate_gyro(times, T_world_camera[:, :3, :3], imu)
    if gyro is None:
        return ImuEvidence(kept, report={"not_observable": {"all": "IMU and video hardly overlap."}})
    report = _gyro_report(gyro) | {"not_observable": _why_not_calibrated(gyro)}
    if not gyro.mounting_is_known:
        return ImuEvidence(kept, report=report)
    if not gyro.fits:
        doubt = f"The gyroscope contradicts the cameras: moment by moment they turn {gyro.residual_deg:.1f}° apart."
        return ImuEvidence(kept, report=report, doubts=(doubt,))
    kept = agreeing_rotations(times, T_world_camera[:, :3, :3], camera_rotations(imu, gyro, times))
    report["frames_contradicted"] = int((~kept).sum())
    doubts = []
    if np.mean(~kept) > _MAX_DROPPED:
        doubts.append(f"The gyroscope contradicts {np.mean(~kept):.0%} of the frames; they were dropped.")
    alignment = None if doubts else align_inertially(times[kept], T_world_camera[kept], imu, gyro)
    if alignment is not None:
        report |= _alignment_report(alignment)
        if alignment.why_no_scale:
            report["not_observable"]["scale"] = alignment.why_no_scale
    elif not doubts:
        report["not_observable"]["scale"] = "IMU and placed frames have too few seconds in common."
    if not imu.includes_gravity:
        report["not_observable"]["gravity"] = "The recorder took gravity out of the acceleration."
    return ImuEvidence(kept, gyro, alignment, report, tuple(doubts))


def compare_with_inertial(
    times: FloatArray, T_map_camera: FloatArray, waypoints: Sequence[Waypoint], imu: Imu, gyro: GyroCalibration
) -> dict[str, Any]:
    """How far the paper's own way, the IMU integrated between waypoints, is from poses (N, 4, 4) at ``times`` (N,)."""
    stops = [waypoint.time for waypoint in waypoints]
    between = (times >= min(stops)) & (times <= max(stops))
    on_video_clock = replace(imu, times=imu.times - gyro.time_offset_s, R_camera_imu=gyro.R_camera_imu)
    try:
        poses = integrate_between_waypoints(on_video_clock, waypoints, times[between])
    except RholocError as error:
        return {"why": error.message}
    apart_m = np.linalg.norm(poses[:, :3, 3] - T_map_camera[between, :3, 3], axis=1)
    return {
        "frames": int(between.sum()),
        "rms_m": float(np.sqrt(np.mean(apart_m**2))),
        "worst_m": float(apart_m.max()),
        "worst_time_s": float(times[between][apart_m.argmax()]),
    }


def _why_not_calibrated(gyro: GyroCalibration) -> dict[str, str]:
    reasons = {}
    if gyro.time_offset_sigma_s > _MAX_TIME_SIGMA_S:
        reasons["time_offset"] = "The camera hardly turns: nothing shows by how much camera and IMU are apart in time."
    if not gyro.mounting_is_known:
        reasons["mounting"] = (
            "How the IMU is mounted is not known, and the camera hardly turns about two axes, which would show it."
        )
    return reasons


def _gyro_report(gyro: GyroCalibration) -> dict[str, Any]:
    return {
        "time_offset_s": gyro.time_offset_s,
        "time_offset_sigma_s": gyro.time_offset_sigma_s,
        "gyro_bias_rad_per_s": gyro.bias.tolist(),
        "gyro_bias_sigma_rad_per_s": gyro.bias_sigma,
        "R_camera_imu": gyro.R_camera_imu.tolist(),
        "R_camera_imu_contradicts_recording": gyro.contradicts_recording,
        "mounting_sigma_deg": gyro.mounting_sigma_deg,
        "rotation_residual_deg": gyro.residual_deg,
    }


def _alignment_report(alignment: InertialAlignment) -> dict[str, Any]:
    return {
        "scale_sigma": alignment.scale_sigma,
        "up_sigma_deg": None if alignment.up is None else alignment.up_sigma_deg,
        "accelerometer_bias_m_s2": alignment.bias.tolist(),
        "lever_m": alignment.lever_m.tolist(),
        "acceleration_residual_m_s2": alignment.residual,
    }
