"""Corners followed through pictures that move in a known way."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from rholoc.geometry import BoolArray, ByteArray, FloatArray
from rholoc.progress import Stage
from rholoc.recordings import MemoryFrames
from rholoc.trajectory.visual import flow as module
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


@pytest.mark.parametrize(
    ("size", "reduced"),
    [((480, 640), (480, 640)), ((960, 1280), (480, 640)), ((1280, 720), (640, 360)), ((100, 80), (100, 80))],
)
def test_pictures_are_reduced_to_640_pixels(size: tuple[int, int], reduced: tuple[int, int]) -> None:
    whole = np.zeros((*size, 3), np.uint8)
    image, small, factor, _ = module._look(whole)
    assert image is whole
    assert small.shape == reduced
    np.testing.assert_allclose(factor, [size[1] / reduced[1], size[0] / reduced[0]])
    assert module._look(whole[..., 0])[1].shape == reduced


def test_corners_are_said_in_pixels_of_the_whole_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pixel's middle is at a whole number in both."""
    corners = np.array([[0.0, 0.0], [319.5, 239.5], [10.0, 20.0]], np.float32)
    monkeypatch.setattr(module, "_new_corners", lambda image, held, most: corners)
    (tracks, pixels) = track_corners(MemoryFrames([_noise(960, 1280)])).of_frame(0)
    assert tracks.tolist() == [0, 1, 2]
    np.testing.assert_allclose(pixels, [[0.5, 0.5], [639.5, 479.5], [20.5, 40.5]])


def test_corners_are_refilled_once_a_fifth_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    lost = iter([30, 39, 2])  # of 350: 320, 281, 279 are left

    def followed(before: ByteArray, image: ByteArray, corners: FloatArray) -> tuple[FloatArray, BoolArray, float]:
        kept = np.arange(len(corners)) >= next(lost)
        return corners[kept], kept, 0.01

    monkeypatch.setattr(module, "_followed", followed)
    asked: list[int] = []

    def new(image: ByteArray, corners: FloatArray, most: int) -> FloatArray:
        asked.append(len(corners))
        return np.zeros((most - len(corners), 2), np.float32)

    monkeypatch.setattr(module, "_new_corners", new)
    heard: list[tuple[Stage, float, str]] = []
    shown: list[tuple[int, float]] = []
    flow = track_corners(
        MemoryFrames([_noise(60, 80)] * 4),
        lambda stage, share, text="": heard.append((stage, share, text)),
        lambda row, image, motion, sharpness: shown.append((row, motion)),
    )
    assert asked == [0, 279]
    assert np.diff(flow.starts).tolist() == [350, 320, 281, 350]
    assert flow.of_frame(3)[0].tolist() == [*range(71, 350), *range(350, 421)]
    assert flow.motion.tolist() == [0, 0.01, 0.01, 0.01]
    assert shown == [(0, 0.0), (1, 0.01), (2, 0.01), (3, 0.01)]
    assert [share for _, share, _ in heard] == [0.25, 0.5, 0.75, 1.0]
    assert heard[1] == (Stage.KEYFRAMES, 0.5, "2 of 4 frames looked at")


def _scripted(
    monkeypatch: pytest.MonkeyPatch, corners: FloatArray, moved: FloatArray, back: FloatArray, found: FloatArray
) -> tuple[FloatArray, BoolArray, float]:
    """What becomes of corners that go there and back; ``found`` (K, 2) says whether on the way there, and back."""

    def flow(
        before: ByteArray, after: ByteArray, start: FloatArray, guess: FloatArray | None, *_: object
    ) -> tuple[FloatArray, BoolArray]:
        return (moved, found[:, 0]) if guess is None else (back, found[:, 1])

    monkeypatch.setattr(module, "_flow", flow)
    image = np.zeros((60, 80), np.uint8)
    return module._followed(image, image, corners)


def test_a_corner_is_kept_that_is_found_both_ways_within_the_picture_and_comes_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    corners = np.tile([40.0, 30.0], (18, 1))
    moved = np.add(corners, [3.0, -4.0])
    moved[:6] = [[4, 30], [3.9, 30], [75.9, 30], [76, 30], [40, 55.9], [40, 56]]
    moved[6:8] = [[40, 4.0], [40, 3.9]]
    back, found = corners.copy(), np.ones((18, 2), np.bool_)
    back[8:10] += [[0.69, 0], [0.71, 0]]
    found[10:13] = [[False, True], [True, False], [False, False]]
    kept_corners, kept, motion = _scripted(monkeypatch, corners, moved, back, found)
    assert np.flatnonzero(kept).tolist() == [0, 2, 4, 6, 8, 13, 14, 15, 16, 17]
    np.testing.assert_array_equal(kept_corners, moved[kept])
    assert motion == pytest.approx(5 / 80)


@pytest.mark.parametrize(("count", "motion"), [(7, 0.05), (8, 5 / 80)])
def test_of_few_corners_nobody_knows_how_the_picture_moved(
    count: int, motion: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    corners = np.tile([40.0, 30.0], (count, 1))
    found = np.ones((count, 2), np.bool_)
    corners_now, kept, moved = _scripted(monkeypatch, corners, np.add(corners, [3.0, -4.0]), corners, found)
    assert moved == pytest.approx(motion)
    assert kept.all()
    assert len(corners_now) == count
    assert module._followed(np.zeros((60, 80), np.uint8), np.zeros((60, 80), np.uint8), np.zeros((0, 2)))[2] == 0.05


def test_new_corners_are_as_many_as_are_missing_and_apart_from_each_other_and_the_old() -> None:
    image = cv2.GaussianBlur(_noise(480, 640), (0, 0), 1.5)
    first = module._new_corners(image, np.zeros((0, 2), np.float32))
    assert len(first) == 350
    apart = np.linalg.norm(first[:, None] - first[None], axis=2) + 1e3 * np.eye(350)
    assert 14 <= apart.min() < 15
    more = module._new_corners(image, first[:300])
    assert len(more) == 50
    away = np.linalg.norm(more[:, None] - first[None, :300], axis=2).min(axis=1)
    assert away.min() > 13
    assert away.min() < 17


def test_weak_corners_are_followed_too() -> None:
    """A twentieth of the strongest's strength is enough, a thousandth is not."""
    picture = np.full((240, 320), 100, np.uint8)
    for x, contrast in ((60, 100), (160, 16), (250, 3)):
        picture[100:120, x : x + 20] += np.uint8(contrast)
    corners = module._new_corners(picture, np.zeros((0, 2), np.float32))
    assert [int(np.sum(np.abs(corners[:, 0] - x - 10) < 20)) for x in (60, 160, 250)] == [4, 4, 0]


def test_a_guess_is_where_the_search_begins() -> None:
    before, after = (cv2.cvtColor(one, cv2.COLOR_BGR2GRAY) for one in _moving(2, step=10.0))
    corners = module._new_corners(before, np.zeros((0, 2), np.float32))
    here = np.all((corners > 60) & (corners < [260, 180]), axis=1)
    corners = corners[here]
    guess = corners + (10 * _STEP_PX).astype(np.float32)
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 0.03)
    moved, found = module._flow(before, after, corners, guess, 0, stop)
    assert found.mean() > 0.9
    assert np.median(np.linalg.norm(moved - guess, axis=1)) < 0.15
    lost, _ = module._flow(before, after, corners, None, 0, stop)
    assert np.median(np.linalg.norm(lost - guess, axis=1)) > 5
    np.testing.assert_array_equal(guess, corners + (10 * _STEP_PX).astype(np.float32))  # as it was
