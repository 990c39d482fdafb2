"""Small recordings made on the spot."""

import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))  # for phone_recordings

SIZE = (64, 48)


def picture(shade: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    """A picture (H, W, 3) whose mean identifies it."""
    return np.full((size[1], size[0], 3), shade, np.uint8)


def shade(image: np.ndarray) -> float:
    return float(image.mean())


@pytest.fixture
def make_images() -> Callable[..., Path]:
    """Writes frame-000000.png … with shade 10 times the number."""

    def make(folder: Path, numbers: range = range(6), name: str = "frame-{:06d}.png") -> Path:
        folder.mkdir(parents=True, exist_ok=True)
        for number in numbers:
            assert cv2.imwrite(str(folder / name.format(number)), picture(10 * number % 250))
        return folder

    return make


@pytest.fixture
def make_video() -> Callable[..., Path]:
    """Writes a video whose frame i has shade 15 i."""

    def make(path: Path, frames: int = 12, fps: float = 20.0) -> Path:
        codec = {".avi": "MJPG", ".mkv": "FFV1"}.get(path.suffix, "mp4v")
        path.parent.mkdir(parents=True, exist_ok=True)
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), fps, SIZE)
        assert writer.isOpened()
        for i in range(frames):
            writer.write(picture(15 * i % 250))
        writer.release()
        return path

    return make
