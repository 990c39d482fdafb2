"""Corners followed through pictures that move in a known way."""

import cv2
import numpy as np
import pytest

from rholoc.geometry import ByteArray
from rholoc.recordings import MemoryFrames
from rholoc.trajectory.visual.flow import track_corners

_STEP_PX = np.array([3.3125, -1.40625])  # that the picture moves from frame to frame; OpenCV shifts by 32nds of a pixel


def _moving(count: int, size: tuple[int, int] = (320, 240), step: float = 1.0) -> list[ByteArray]:
    """Frames of a textured wall that the camera slides along; (u, v) of frame 0 is at (u, v) + k step in frame k."""
    width, height = size
    noise = np.random.default_rng(0).integers(0, 255, (height, width), dtype=np.uint8)
    wall = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 2.5 * width / 320), None, 0, 255, cv2.NORM_MINMAX)
    frames = []
    for k in range(count):
        shift = np.float32([[1, 0, k * step * _STEP_PX[0]], [0, 1, k * step * _STEP_PX[1]]])
        gray = cv2.warpAffine(wall, shift, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
        frames.append(np.repeat(gray[:, :, None], 3, axis=2))
    return frames


def test_corners_are_followed_to_a_tenth_of_a_pixel() -> None:
    flow = track_corners(MemoryFrames(_moving(8)))
    for later in (1, 4, 7):
        shared, first, then = flow.shared(0, later)
        assert len(shared) > 60
        off = np.linalg.norm(then - first - later * _STEP_PX, axis=1)
        assert np.median(off) < 0.1
        assert np.percentile(off, 75) < 0.15
    assert flow.motion[0] == 0
    np.testing.assert_allclose(flow.motion[1:], np.linalg.norm(_STEP_PX) / 320, rtol=0.05)


def test_large_images_are_reduced_but_their_pixels_are_those_of_the_full_image() -> None:
    flow = track_corners(MemoryFrames(_moving(3, (1280, 960), step=4.0)))
    _, first, then = flow.shared(0, 2)
    assert flow.size == (1280, 960)
    assert first[:, 0].max() > 900
    assert np.median(np.linalg.norm(then - first - 8 * _STEP_PX, axis=1)) < 0.15


def test_every_frames_corners_are_numbered_upwards_and_new_ones_are_new() -> None:
    flow = track_corners(MemoryFrames(_moving(12, step=4.0)))
    seen: set[int] = set()
    before: set[int] = set()
    for row in range(len(flow.times)):
        tracks, pixels = flow.of_frame(row)
        now = set(tracks.tolist())
        assert np.all(np.diff(tracks) > 0)
        assert len(pixels) == len(tracks)
        assert not (now - before) & seen, "a lost corner's number was given again"
        seen |= now
        before = now
    assert len(seen) > len(before)


def test_a_blank_wall_has_no_corners() -> None:
    blank = [np.full((240, 320, 3), 180, np.uint8)] * 4
    flow = track_corners(MemoryFrames(blank))
    assert len(flow.tracks) == 0
    assert np.all(flow.sharpness == 0)
    np.testing.assert_allclose(flow.brightness, 180)
    assert np.all(flow.motion[1:] > 0), "what cannot be followed counts as moving, so that keyframes are taken"


def test_sharpness_shows_motion_blur() -> None:
    """Frames that were smeared while they were exposed are less than half as sharp as their neighbours."""
    pictures = _moving(6)
    pictures[3] = cv2.blur(pictures[3], (15, 1))
    sharpness = track_corners(MemoryFrames(pictures)).sharpness
    assert sharpness[3] < 0.5 * np.delete(sharpness, 3).min()


def test_dark_pictures_are_seen_to_be_dark() -> None:
    assert track_corners(MemoryFrames([np.full((240, 320, 3), 9, np.uint8)] * 2)).brightness == pytest.approx([9, 9])


def test_contrast_tells_a_wall_with_noise_from_a_blurred_room() -> None:
    rng = np.random.default_rng(4)
    wall = np.clip(225 + rng.normal(0, 4, (240, 320, 3)), 0, 255).astype(np.uint8)
    room = np.repeat(np.repeat(rng.integers(0, 255, (6, 8, 1), dtype=np.uint8), 40, axis=0), 40, axis=1)
    blurred = cv2.blur(np.repeat(room, 3, axis=2), (61, 61))
    contrast = track_corners(MemoryFrames([wall, blurred])).contrast
    assert contrast[0] < 3
    assert contrast[1] > 15


def _noise(height: int, width: int, seed: int = 0) -> ByteArray:
    return np.random.default_rng(seed).integers(0, 255, (height, width), dtype=np.uint8)


def test_what_is_measured_of_a_picture() -> None:
    """Sharpness is the variance of the Laplacian, contrast the deviation of a picture of 64 pixels."""
    gray = cv2.GaussianBlur(_noise(48, 64), (0, 0), 1.5)
    flow = track_corners(MemoryFrames([np.repeat(gray[:, :, None], 3, axis=2)]))
    padded = np.pad(gray.astype(np.float64), 1, mode="reflect")
    laplacian = padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:] - 4 * padded[1:-1, 1:-1]
    assert flow.sharpness[0] == pytest.approx(laplacian.var(), rel=1e-3)
    assert flow.brightness[0] == pytest.approx(gray.mean(), abs=0.5)
    assert flow.contrast[0] == pytest.approx(gray.std(), abs=0.5)
    large = np.repeat(np.repeat(gray, 5, axis=0), 5, axis=1)
    assert track_corners(MemoryFrames([large])).contrast[0] == pytest.approx(gray.std(), abs=0.5)


def test_no_corners_are_tracked_through_a_set_of_pictures() -> None:
    flow = track_corners(MemoryFrames(_moving(4)), may_be_film=False)
    assert len(flow.tracks) == 0
    assert flow.sharpness.tolist() == track_corners(MemoryFrames(_moving(4))).sharpness.tolist()
    np.testing.assert_allclose(flow.motion, [0.0, 0.05, 0.05, 0.05])
