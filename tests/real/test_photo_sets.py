"""Sets of real pictures without times."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from rholoc.geometry import align_poses
from rholoc.recordings import read_recording, write_frames_csv
from rholoc.trajectory import PoseMethod, Scale
from rholoc.trajectory.estimate import estimate_trajectory

pytestmark = [pytest.mark.real, pytest.mark.slow]


def _set_of(paths: list[Path], folder: Path) -> Path:
    folder.mkdir()
    for number, path in enumerate(paths):
        (folder / f"{number:04d}{path.suffix}").symlink_to(path)
    return folder


def test_every_picture_of_a_shuffled_set_is_placed(real_data: Path, tmp_path: Path) -> None:
    kitchen = real_data / "redkitchen"
    known = read_recording(kitchen, "525.505,525.505,320,240", "400:1000:20")
    order = np.arange(len(known.frames.times))
    np.random.default_rng(0).shuffle(order)
    paths = [kitchen / "frames" / f"frame-{known.frames.numbers[row]:06d}.jpg" for row in order]
    recording = read_recording(_set_of(paths, tmp_path / "set"))
    assert not recording.frames.timed
    found = estimate_trajectory(recording, PoseMethod.AUTO)
    assert len(found.rows) == len(paths)
    assert found.report.trusted
    assert found.report.missing == ()
    T = known.poses.T_map_camera[order[found.rows]]
    off_m = np.linalg.norm(align_poses(found.T_map_camera, T).poses(found.T_map_camera)[:, :3, 3] - T[:, :3, 3], axis=1)
    assert np.median(off_m) < 0.02


@pytest.mark.parametrize(("step", "share", "told"), [(20, 0.6, True), (20, 0.25, False), (3, 0.7, True)])
def test_a_second_lens_is_measured_or_the_map_not_trusted(
    real_data: Path, tmp_path: Path, step: int, share: float, told: bool
) -> None:
    """Every other picture is cropped, as a longer lens would have taken it; of a set, or of a film with times."""
    known = read_recording(real_data / "redkitchen", "525.505,525.505,320,240", f"400:{400 + 20 * step}:{step}")
    assert known.poses is not None
    for number, image in enumerate(known.frames.images(range(20))):
        height, width = (round((share if number % 2 else 1) * side) for side in image.shape[:2])
        top, left = (image.shape[0] - height) // 2, (image.shape[1] - width) // 2
        cv2.imwrite(str(tmp_path / f"{number:04d}.png"), image[top : top + height, left : left + width])
    if step == 3:
        write_frames_csv(tmp_path / "frames.csv", np.arange(20), np.arange(20) / 10)
    found = estimate_trajectory(read_recording(tmp_path), PoseMethod.AUTO)
    assert found.report.trusted is told
    if not told:
        assert "several sizes" in found.report.why
        return
    assert np.median(found.zooms[1::2]) == pytest.approx(1 / share, rel=0.03)
    T = known.poses.T_map_camera[found.rows]
    off_m = np.linalg.norm(align_poses(found.T_map_camera, T).poses(found.T_map_camera)[:, :3, 3] - T[:, :3, 3], axis=1)
    assert np.median(off_m) < 0.02


def test_pictures_of_a_desk_are_placed_as_its_colmap_model_has_them(real_data: Path, tmp_path: Path) -> None:
    """Pictures as users of Gaussian splatting have them, without their model."""
    known = read_recording(real_data / "splat_desk")
    images = sorted((real_data / "splat_desk" / "images").iterdir())
    found = estimate_trajectory(read_recording(_set_of(images, tmp_path / "set")), PoseMethod.AUTO)
    assert len(found.rows) == len(images)
    T = known.poses.T_map_camera[found.rows]
    fitted = align_poses(found.T_map_camera, T)
    off = np.linalg.norm(fitted.poses(found.T_map_camera)[:, :3, 3] - T[:, :3, 3], axis=1)
    assert np.median(off) < 0.005 * fitted.scale  # the set's unit of length is its median depth


@pytest.mark.parametrize(("focal_px", "contradicted"), [(525.505, False), (600.0, True)])
def test_a_wrong_focal_length_is_doubted(real_data: Path, focal_px: float, contradicted: bool) -> None:
    recording = read_recording(real_data / "redkitchen", f"{focal_px},{focal_px},320,240", "400:600:14")
    found = estimate_trajectory(recording, PoseMethod.VISUAL)
    assert found.report.trusted is not contradicted
    assert ("contradict the focal length" in found.report.why) is contradicted


def test_lidar_depth_gives_the_scale_of_a_walk(real_data: Path) -> None:
    """The first fifth of a corridor, without ARKit's poses: metric by its depth pictures alone."""
    known = read_recording(real_data / "corridor_lidar" / "scan", frames="0:30")
    found = estimate_trajectory(replace(known, poses=None), PoseMethod.AUTO)
    assert len(found.rows) == 30
    assert found.scale is Scale.METRIC
    assert (found.report.scale or "").startswith("Depth pictures fix the scale to ")
    T = known.poses.T_map_camera[found.rows]
    fitted = align_poses(found.T_map_camera, T)
    assert abs(fitted.scale - 1) < 0.03
    off_m = np.linalg.norm(fitted.poses(found.T_map_camera)[:, :3, 3] - T[:, :3, 3], axis=1)
    assert np.median(off_m) < 0.05  # of poses that drift themselves


def test_one_known_length_gives_the_scale_of_a_set(real_data: Path, tmp_path: Path) -> None:
    kitchen = real_data / "redkitchen"
    known = read_recording(kitchen, "525.505,525.505,320,240", "400:700:15")
    paths = [kitchen / "frames" / f"frame-{number:06d}.jpg" for number in known.frames.numbers]
    places = known.poses.T_map_camera[:, :3, 3]
    far = int(np.linalg.norm(places - places[0], axis=1).argmax())
    length_m = float(np.linalg.norm(places[far] - places[0]))
    recording = read_recording(_set_of(paths, tmp_path / "set"), lengths=[f"0,{far},{length_m}"])
    found = estimate_trajectory(recording, PoseMethod.AUTO)
    assert found.scale is Scale.METRIC
    assert (found.report.scale or "").startswith("A known length fixes the scale to ")
    assert abs(align_poses(found.T_map_camera, known.poses.T_map_camera[found.rows]).scale - 1) < 0.02
