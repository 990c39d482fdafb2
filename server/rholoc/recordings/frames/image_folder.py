"""Frames that are image files in a folder."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from rholoc.errors import InvalidImage, InvalidRecording
from rholoc.geometry import ByteArray, FloatArray, IntArray
from rholoc.recordings.frames.image import IMAGE_SUFFIXES, image_size, read_image
from rholoc.recordings.frames.video import check_frame_size
from rholoc.recordings.tables.frames_table import read_frames_csv

DEFAULT_FPS = 30.0  # assumed if neither a table of times nor camera.json says otherwise

_SUBFOLDERS = (".", "frames", "images")
_LAST_DIGITS = re.compile(r"(\d+)\D*$")
_MAX_FRAME_NUMBER = 2**63 - 1
_MOST_DIGITS = 25  # including leading zeros; Python refuses to parse thousands of digits


@dataclass(frozen=True, eq=False)
class ImageFolderFrames:
    """Image files as frames, see :class:`rholoc.recordings.FrameSource`; ``paths`` has one file per row."""

    paths: tuple[Path, ...]
    numbers: IntArray
    times: FloatArray
    size: tuple[int, int]

    def images(self, rows: Sequence[int]) -> Iterator[ByteArray]:
        """The images (H, W, 3) BGR of the rows, which must increase.

        Raises:
            InvalidRecording: a file is broken, or has changed since.
        """
        for row in rows:
            path = self.paths[row]
            try:
                image = read_image(path)
            except InvalidImage as error:
                raise InvalidRecording(f"{path.name}: {error.message}", "Leave that frame out.") from error
            if image.shape[1::-1] != self.size:
                raise InvalidRecording(f"{path.name} is not of the {self.size[0]}×{self.size[1]} pixels of the others.")
            yield image


def find_images(folder: Path) -> tuple[Path, ...]:
    """The image files of a folder, or of its subfolder ``frames`` or ``images``; empty if there are none."""
    for subfolder in _SUBFOLDERS:
        paths = _images_in(folder / subfolder)
        if paths:
            return paths
    return ()


def read_image_folder(
    paths: Sequence[Path], times_csv: Path | None = None, fps: float | None = None
) -> ImageFolderFrames:
    """Image files → frames, ordered by number: the last digits of the file's name.

    Times are those of ``times_csv`` (``frame,timestamp``), else number / ``fps``, else number / 30 s.

    Raises:
        InvalidRecording: a file's name has no number, two have the same, sizes differ, a file has no image header, or
            the table of times lacks a frame.
    """
    numbered = sorted((_number(path), path) for path in paths)
    for (number, path), (next_number, next_path) in pairwise(numbered):
        if number == next_number:
            raise InvalidRecording(f"{path.name} and {next_path.name} both have the frame number {number}.")
    ordered = tuple(path for _, path in numbered)
    numbers = np.array([number for number, _ in numbered], dtype=np.int64)
    times = numbers / (fps or DEFAULT_FPS) if times_csv is None else _times_of(numbers, times_csv)
    return image_frames(ordered, numbers, times)


def image_frames(paths: Sequence[Path], numbers: IntArray, times: FloatArray) -> ImageFolderFrames:
    """Image files (N) with known numbers and times (N,) → frames.

    Raises:
        InvalidRecording: there are none, one is missing or has no image header, or sizes differ.
    """
    if not paths:
        raise InvalidRecording("The recording lists no images.")
    missing = next((path for path in paths if not path.is_file()), None)
    if missing is not None:
        raise InvalidRecording(f"The image {missing.name} is listed but missing.", "Pack the images with the lists.")
    return ImageFolderFrames(tuple(paths), numbers, times, _common_size(paths))


def _images_in(folder: Path) -> tuple[Path, ...]:
    if not folder.is_dir():
        return ()
    return tuple(
        path
        for path in sorted(folder.iterdir())
        if path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith(".") and path.is_file()
    )


def number_in_name(path: Path) -> int | None:
    """The last digits of a file's name as a number; None if there are none, or far too many."""
    match = _LAST_DIGITS.search(path.stem)
    number = int(match[1]) if match and len(match[1]) <= _MOST_DIGITS else -1
    return number if 0 <= number <= _MAX_FRAME_NUMBER else None


def _number(path: Path) -> int:
    number = number_in_name(path)
    if number is None:
        raise InvalidRecording(
            f"The name of {path.name} has no frame number.", "Name the images frame-000000.jpg, frame-000001.jpg, …"
        )
    return number


def _times_of(numbers: IntArray, times_csv: Path) -> FloatArray:
    table_numbers, table_times = read_frames_csv(times_csv)
    missing = np.setdiff1d(numbers, table_numbers)
    if len(missing):
        raise InvalidRecording(
            f"{times_csv.name} has no time for frame {missing[0]}.",
            f"{len(missing)} of {len(numbers)} frames lack one.",
        )
    return table_times[np.searchsorted(table_numbers, numbers)]


def _common_size(paths: Sequence[Path]) -> tuple[int, int]:
    size: tuple[int, int] | None = None
    for path in paths:
        try:
            this = image_size(path)
        except InvalidImage as error:
            raise InvalidRecording(f"{path.name}: {error.message}", "Leave that file out.") from error
        if size is not None and this != size:
            raise InvalidRecording(
                f"{path.name} is {this[0]}×{this[1]}, but {paths[0].name} is {size[0]}×{size[1]}.",
                "All frames of a recording must have one size.",
            )
        size = this
    assert size is not None
    check_frame_size(paths[0].name, *size)
    return size
