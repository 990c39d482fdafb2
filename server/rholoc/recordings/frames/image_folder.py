"""Frames that are image files in a folder."""

import re
from collections import Counter
from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rholoc.errors import InvalidImage, InvalidRecording
from rholoc.geometry import ByteArray, Camera, FloatArray, IntArray
from rholoc.recordings.frames.image_decoding import IMAGE_SUFFIXES, exif_focal_px, image_size, read_frame
from rholoc.recordings.frames.unified_pictures import UnifiedPictures, common_camera
from rholoc.recordings.frames.video import check_frame_size
from rholoc.recordings.tables.own_tables import read_frames_csv

_SUBFOLDERS = (".", "frames", "images")
_MASKS = ("_mask", ".mask")
_LAST_DIGITS = re.compile(r"(\d+)\D*$")
_SAME_FOCAL = 1.02  # maximum ratio of focal lengths of one lens
_MAX_FRAME_NUMBER = 2**63 - 1
_MAX_DIGITS = 25  # including leading zeros; Python refuses to parse thousands of digits


@dataclass(frozen=True, eq=False)
class ImageFolderFrames:
    """Image files of one size as frames, see :class:`rholoc.recordings.FrameSource`; ``paths`` has one file per row.

    ``focal_px`` is their focal length [px] by EXIF, None where it is not known.
    """

    paths: tuple[Path, ...]
    numbers: IntArray
    times: FloatArray
    size: tuple[int, int]
    timed: bool = True
    focal_px: float | None = None

    def images(self, rows: Sequence[int]) -> Iterator[ByteArray]:
        """The images (H, W, 3) BGR of the rows, which must increase.

        Raises:
            InvalidRecording: a file is damaged, or has changed since it was listed.
        """
        return (read_frame(self.paths[row], self.size) for row in rows)


def find_images(folder: Path) -> tuple[Path, ...]:
    """The image files of a folder, else of its subfolder ``frames`` or ``images``, by name; empty if there are none."""
    for subfolder in _SUBFOLDERS:
        paths = _images_in(folder / subfolder)
        if paths:
            return paths
    return ()


def read_image_folder(
    paths: Sequence[Path], times_csv: Path | None = None, fps: float | None = None
) -> ImageFolderFrames | UnifiedPictures:
    """Frames from image files, ordered and numbered by the last digits of their names, or by their names.

    Times come from ``times_csv`` (``frame,timestamp``), else from number / ``fps``; without either they are unknown.

    Raises:
        InvalidRecording: there are no files, one has no image header, or the table of times is broken or lacks a frame.
    """
    numbers, order = numbered(paths)
    ordered = [paths[place] for place in order]
    if times_csv is not None:
        return image_frames(ordered, numbers, _times_of(numbers, times_csv))
    return image_frames(ordered, numbers, None if fps is None else numbers / fps)


def numbered(paths: Sequence[Path]) -> tuple[IntArray, list[int]]:
    """Frame numbers (N,), increasing, and the index (N) in ``paths`` of each.

    A file's number is the last digits of its name before the first dot. If a name has none, or two numbers are equal,
    files are sorted by name and numbered from 0.
    """
    named = [number_in_name(Path(path.name.split(".")[0])) for path in paths]  # not of frame-000001.color.png
    if None not in named and len(set(named)) == len(named):
        order = sorted(range(len(paths)), key=lambda place: named[place] or 0)
        return np.array([named[place] for place in order], dtype=np.int64), order
    order = sorted(range(len(paths)), key=lambda place: paths[place].name)
    return np.arange(len(paths)), order


def image_frames(
    paths: Sequence[Path],
    numbers: IntArray,
    times: FloatArray | None,
    cameras: Sequence[Camera] | None = None,
) -> ImageFolderFrames | UnifiedPictures:
    """Frames from image files with known numbers: as they are, or resampled to one camera if their sizes or lenses
    differ.

    Focal lengths by EXIF within 2 % count as one lens. Without times, rows serve as times.

    Args:
        paths: N files.
        numbers: (N,), increasing.
        times: (N,) seconds, or None if they are unknown.
        cameras: each picture's camera; None if unknown. Focal lengths then come from EXIF, or are proportional to the
            longer sides of pictures without it.

    Raises:
        InvalidRecording: there are no files, or one is missing, has no image header, a side below 16 px or over 8K
            pixels.
        InvalidCamera: a camera has another aspect ratio than its picture.
    """
    if not paths:
        raise InvalidRecording("The recording lists no images.")
    missing = next((path for path in paths if not path.is_file()), None)
    if missing is not None:
        raise InvalidRecording(f"The image {missing.name} is listed but missing.", "Pack the images with the lists.")
    timed = times is not None
    times = np.arange(len(paths), dtype=np.float64) if times is None else times
    sizes = [picture_size(path) for path in paths]
    if cameras is None:
        focals = [exif_focal_px(path) for path in paths]
        known = [focal for focal in focals if focal is not None]
        focal_px = float(np.median(known)) if known else None
        if len(set(sizes)) == 1 and (not known or max(known) <= _SAME_FOCAL * min(known)):
            return ImageFolderFrames(tuple(paths), numbers, times, sizes[0], timed, focal_px)
        cameras = [nominal_camera(size, focal) for size, focal in zip(sizes, focals, strict=True)]
        common = common_camera(cameras)
        focal_px = common.focal if 2 * len(known) >= len(paths) else None
        lenses = _lenses([max(size) if focal is None else None for size, focal in zip(sizes, focals, strict=True)])
        return UnifiedPictures(tuple(paths), tuple(cameras), common, numbers, times, timed, focal_px, lenses)
    cameras = [camera.fitted(*size) for camera, size in zip(cameras, sizes, strict=True)]
    if len(set(cameras)) == 1:
        return ImageFolderFrames(tuple(paths), numbers, times, sizes[0], timed)
    return UnifiedPictures(tuple(paths), tuple(cameras), common_camera(cameras), numbers, times, timed)


def _lenses(longer_px: Sequence[int | None]) -> tuple[int, ...]:
    """Lens number of each picture; pictures with an equal value share a lens. Empty if all are equal.

    ``longer_px`` is the picture's longer side, None if EXIF states the focal length. None becomes lens 0; the others
    follow by frequency, the commonest first.
    """
    kinds = sorted(Counter(longer_px).items(), key=lambda one: (one[0] is not None, -one[1]))
    numbers = {longer: number for number, (longer, _) in enumerate(kinds)}
    return tuple(numbers[one] for one in longer_px) if len(numbers) > 1 else ()


def nominal_camera(size: tuple[int, int], focal_px: float | None = None) -> Camera:
    """Camera for images of ``size`` (width, height); the default focal length is the longer side, as a first guess."""
    width, height = size
    focal = float(max(size)) if focal_px is None else focal_px
    return Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)


def _images_in(folder: Path) -> tuple[Path, ...]:
    """The image files of a folder by name; neither hidden ones nor masks of others."""
    if not folder.is_dir():
        return ()
    paths = [
        path
        for path in sorted(folder.iterdir())
        if path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith(".") and path.is_file()
    ]
    files = {path.name for path in paths}
    names = files | {path.stem for path in paths}
    return tuple(path for path in paths if not _is_mask(path, names, files))


def _is_mask(path: Path, names: Container[str], files: Container[str]) -> bool:
    """Whether a file is named after another picture: ``a_mask.png`` or ``a.mask.png`` after a, ``a.jpg.png`` after
    a.jpg. ``files`` are the pictures' names with suffix, ``names`` those with and without.
    """
    pictures = {path.stem[: -len(ending)] for ending in _MASKS if path.stem.lower().endswith(ending)}
    return path.stem in files or any(name in names for name in pictures)


def number_in_name(path: Path) -> int | None:
    """The last digits of a file's name, without suffix, as a number; None for none, over 25 digits, or over 64 bits."""
    match = _LAST_DIGITS.search(path.stem)
    number = int(match[1]) if match and len(match[1]) <= _MAX_DIGITS else -1
    return number if 0 <= number <= _MAX_FRAME_NUMBER else None


def _times_of(numbers: IntArray, times_csv: Path) -> FloatArray:
    """Times (N,) [s] of the frames ``numbers`` (N,) by a table. Raises InvalidRecording if it lacks one."""
    table_numbers, table_times = read_frames_csv(times_csv)
    missing = np.setdiff1d(numbers, table_numbers)
    if len(missing):
        raise InvalidRecording(
            f"{times_csv.name} has no time for frame {missing[0]}.",
            f"{len(missing)} of {len(numbers)} frames lack one.",
        )
    return table_times[np.searchsorted(table_numbers, numbers)]


def picture_size(path: Path) -> tuple[int, int]:
    """Width and height [px] of a picture file as it is shown.

    Raises:
        InvalidRecording: it has no image header, a side below 16 px, or more pixels than 8K video.
    """
    try:
        size = image_size(path)
    except InvalidImage as error:
        raise InvalidRecording(f"{path.name}: {error.message}", "Leave that file out.") from error
    check_frame_size(path.name, *size)
    return size
