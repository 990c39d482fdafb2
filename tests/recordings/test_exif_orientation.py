"""Pictures that say how they are to be turned, in the models of programs that take them as they are stored."""

from pathlib import Path

import cv2
import numpy as np
import phone_recordings as phone
import pytest
from PIL import Image

from rholoc.errors import InvalidRecording
from rholoc.geometry import FloatArray
from rholoc.recordings import Recording, read_recording

ROW = 3
POINT = np.array([[0.3, 0.2, 2.0]])  # in the camera of frame ROW, as its picture is stored
TURNED = [(3,), (6,), (8,), (1, 6)]


def pixel_of(recording: Recording, point: FloatArray) -> FloatArray:
    """The pixel (2,) of a point (1, 3) of the map in frame ROW."""
    T_camera_map = np.linalg.inv(recording.poses.T_map_camera[ROW])
    return recording.camera.project(point @ T_camera_map[:3, :3].T + T_camera_map[:3, 3])[0]


def spot_of(recording: Recording) -> FloatArray:
    """The pixel (2,) of the bright spot in frame ROW."""
    (image,) = recording.frames.images([ROW])
    weights = image[:, :, 0].astype(np.float64) * (image[:, :, 0] > 40)
    v, u = np.indices(weights.shape)
    return np.array([(u * weights).sum(), (v * weights).sum()]) / weights.sum()


def save_with_spot(path: Path, pixel: FloatArray, orientation: int) -> None:
    v, u = np.indices((phone.SIZE[1], phone.SIZE[0]))
    grey = 255 * np.exp(-((u - pixel[0]) ** 2 + (v - pixel[1]) ** 2) / 8)
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(np.repeat(grey.astype(np.uint8)[:, :, None], 3, axis=2)).save(path, exif=exif, quality=98)


@pytest.mark.parametrize("name", ["colmap", "nerfstudio", "metashape", "kapture"])
@pytest.mark.parametrize("orientations", TURNED)
def test_cameras_and_poses_are_those_of_the_pictures_as_shown(
    name: str, orientations: tuple[int, ...], tmp_path: Path
) -> None:
    stored = read_recording(phone.write_recording(name, tmp_path / "walk"))
    T = stored.poses.T_map_camera[ROW]
    point = POINT @ T[:3, :3].T + T[:3, 3]
    pixel = pixel_of(stored, point)
    for row, path in enumerate(stored.frames.paths):
        save_with_spot(path, pixel, orientations[row % len(orientations)])
    shown = read_recording(tmp_path / "walk")
    assert len(shown.frames.times) == phone.FRAMES
    np.testing.assert_allclose(pixel_of(shown, point), spot_of(shown), atol=0.1)
    np.testing.assert_allclose(shown.poses.T_map_camera[ROW][:3, 3], T[:3, 3], atol=1e-9)


def test_a_program_that_turned_the_pictures_itself_is_told_by_the_shape_of_its_camera(tmp_path: Path) -> None:
    folder = phone.write_recording("colmap", tmp_path / "walk")
    plain = read_recording(folder)
    for path in plain.frames.paths:
        shown = cv2.rotate(cv2.imread(str(path)), cv2.ROTATE_90_COUNTERCLOCKWISE)
        exif = Image.Exif()
        exif[0x0112] = 6
        Image.fromarray(shown).save(path, exif=exif)
    again = read_recording(folder)
    assert again.camera == plain.camera
    np.testing.assert_array_equal(again.poses.T_map_camera, plain.poses.T_map_camera)


def test_a_mirrored_picture_is_refused(tmp_path: Path) -> None:
    folder = phone.write_recording("colmap", tmp_path / "walk")
    save_with_spot(folder / "images" / "walk" / "frame0003.png", np.array([5, 5]), 2)
    with pytest.raises(InvalidRecording, match=r"frame0003\.png is mirrored"):
        read_recording(folder)
