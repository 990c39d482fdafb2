"""The focal length that photos state is where the estimation of their intrinsics starts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from rholoc.recordings import read_recording
from rholoc.recordings.frames.image_decoding import exif_focal_px
from rholoc.recordings.frames.image_folder import ImageFolderFrames
from rholoc.recordings.frames.unified_pictures import UnifiedPictures

_26_MM_PX = 26 * 80 / np.hypot(36, 24)  # of 64 × 48 pixels


def _photo(path: Path, equivalent_mm: int | None, size: tuple[int, int] = (64, 48)) -> Path:
    """A picture whose EXIF data state a focal length, as the equivalent for a film of 36 × 24 mm."""
    exif = Image.Exif()
    if equivalent_mm is not None:
        exif.get_ifd(0x8769)[0xA405] = equivalent_mm
    Image.new("RGB", size).save(path, exif=exif)
    return path


@pytest.mark.parametrize("size", [(64, 48), (48, 64)])
def test_the_equivalent_keeps_the_angle_across_the_diagonal(tmp_path: Path, size: tuple[int, int]) -> None:
    assert exif_focal_px(_photo(tmp_path / "photo.jpg", 26, size)) == pytest.approx(_26_MM_PX)


@pytest.mark.parametrize("equivalent_mm", [None, 0, 2, 65535])
def test_an_impossible_focal_length_is_none(tmp_path: Path, equivalent_mm: int | None) -> None:
    assert exif_focal_px(_photo(tmp_path / "photo.jpg", equivalent_mm)) is None


def test_pictures_of_one_lens_have_its_focal_length(tmp_path: Path) -> None:
    for number in range(3):
        _photo(tmp_path / f"{number}.jpg", 26)
    recording = read_recording(tmp_path)
    assert isinstance(recording.frames, ImageFolderFrames)
    assert recording.camera is None  # the estimation starts from it, and is not held to it
    assert recording.focal_px == pytest.approx(_26_MM_PX)


def test_pictures_of_two_lenses_of_one_phone_become_those_of_one_camera(tmp_path: Path) -> None:
    for number, equivalent_mm in enumerate((13, 26, 26)):
        _photo(tmp_path / f"{number}.jpg", equivalent_mm)
    recording = read_recording(tmp_path)
    assert isinstance(recording.frames, UnifiedPictures)
    focals = [camera.focal for camera in recording.frames.cameras]
    assert focals[1] == pytest.approx(2 * focals[0])
    assert recording.focal_px == pytest.approx(focals[1])


def test_a_focal_length_that_few_pictures_state_is_no_guess(tmp_path: Path) -> None:
    for number, equivalent_mm in enumerate((26, None, None)):
        _photo(tmp_path / f"{number}.jpg", equivalent_mm, (64, 48 if number else 40))
    assert read_recording(tmp_path).focal_px is None
