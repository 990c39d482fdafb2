"""Recordings of real phones and rigs, read as what they are."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rholoc.geometry import rotation_angles
from rholoc.recordings import RecordingFormat, describe_recording, read_recording
from rholoc.recordings.imu_normalisation import force_points_up
from rholoc.reports import WarningKind
from rholoc.trajectory.inertial.gyroscope import calibrate_gyro

pytestmark = pytest.mark.real


@pytest.mark.slow
def test_an_android_phones_folder(real_data: Path) -> None:
    recording = read_recording(real_data / "android_livingroom")
    assert recording.format is RecordingFormat.ANDROID_CSV
    assert [one.kind for one in recording.warnings] == [WarningKind.NOT_USED]  # session_metadata.json
    assert len(recording.frames.times) == 608
    assert recording.frames.times[-1] - recording.frames.times[0] == pytest.approx(23.5, abs=0.1)
    assert recording.imu.includes_gravity
    assert np.median(np.diff(recording.imu.times)) == pytest.approx(0.005, abs=2e-4)
    assert np.linalg.norm(recording.imu.acceleration, axis=1).mean() == pytest.approx(9.8, abs=0.1)
    assert describe_recording(recording)["advice"] == []


@pytest.mark.slow
def test_the_rig_of_euroc(real_data: Path) -> None:
    recording = read_recording(real_data / "euroc_v101")
    assert recording.format is RecordingFormat.EUROC
    assert recording.warnings == ()
    assert len(recording.frames.times) == 90
    assert recording.camera.fx == 458.654
    assert recording.poses.known.all()
    positions = recording.poses.T_map_camera[:, :3, 3]
    assert np.linalg.norm(np.diff(positions, axis=0), axis=1).sum() == pytest.approx(1.45, abs=0.05)
    assert recording.imu is not None
    fit = calibrate_gyro(recording.frames.times, recording.poses.T_map_camera[:, :3, :3], recording.imu)
    free = replace(recording.imu, R_camera_imu=None)
    found = calibrate_gyro(recording.frames.times, recording.poses.T_map_camera[:, :3, :3], free)
    assert fit.residual_deg < 0.2
    assert np.degrees(rotation_angles(fit.R_camera_imu, found.R_camera_imu)) < 3
    assert force_points_up(recording.imu, recording.frames.times, recording.poses.T_map_camera[:, :3, :3])


def test_an_iphones_tables_without_its_video(real_data: Path) -> None:
    recording = read_recording(real_data / "iphone_imu")
    assert recording.format is RecordingFormat.IOS_LOGGER
    assert recording.warnings[0].kind is WarningKind.NO_IMAGES
    assert len(recording.frames.times) == 1309
    assert recording.frame_intrinsics[0].tolist() == [1461.888184, 1461.888184, 963.666687, 694.755127]
    T = recording.poses.T_map_camera
    assert np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1).sum() == pytest.approx(24, abs=0.1)
    # The axes of ARKit and CoreMotion, sign and unit: the gyroscope fits the poses, gravity's reaction points up.
    found = calibrate_gyro(recording.frames.times, T[:, :3, :3], replace(recording.imu, R_camera_imu=None))
    assert recording.imu.R_camera_imu is not None
    assert np.degrees(rotation_angles(found.R_camera_imu, recording.imu.R_camera_imu)) < 1
    felt = np.column_stack(
        [np.interp(recording.frames.times, recording.imu.times, a) for a in recording.imu.acceleration.T]
    )
    in_map = np.einsum("nij,jk,nk->ni", T[:, :3, :3], recording.imu.R_camera_imu, felt).mean(axis=0)
    np.testing.assert_allclose(in_map, [0, 0, 9.8], atol=0.1)
    # Apple's sign of the user's acceleration: along with the second derivative of the path, not against it.
    thrust = np.gradient(np.gradient(T[:, :3, 3], recording.frames.times, axis=0), recording.frames.times, axis=0)
    own = np.einsum("nij,jk,nk->ni", T[:, :3, :3], recording.imu.R_camera_imu, felt) - [0, 0, 9.8]
    smooth = np.ones(15) / 15
    correlations = [
        np.corrcoef(np.convolve(thrust[:, axis], smooth, "same"), np.convolve(own[:, axis], smooth, "same"))[0, 1]
        for axis in range(3)
    ]
    assert min(correlations) > 0.7


def test_the_kitchen_is_our_own_layout(real_data: Path) -> None:
    info = describe_recording(read_recording(real_data / "redkitchen", frames="400:1000"))
    assert info["format"] == "rholoc"
    assert info["warnings"] == []
    assert info["poses"]["known"] == 600
    assert info["imu"] is None
    assert info["figures"]["turn_deg_s"] is None  # the pictures have no times
