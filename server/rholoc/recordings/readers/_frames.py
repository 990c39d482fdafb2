"""Frames for the readers: videos with tables of times, images in lists, files by name, pictures of a rig."""

import os
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from rholoc.errors import InvalidRecording
from rholoc.geometry import Camera, FloatArray, IntArray
from rholoc.recordings.frame_slice import SelectedFrames
from rholoc.recordings.frames.depth import MILLIMETRE_M, DepthImages
from rholoc.recordings.frames.image_folder import ImageFolderFrames, image_frames, numbered
from rholoc.recordings.frames.unified_pictures import UnifiedPictures
from rholoc.recordings.frames.video import VIDEO_SUFFIXES, read_video
from rholoc.recordings.imu_normalisation import advancing_rows
from rholoc.recordings.recording import FrameSource, Mounted
from rholoc.reports import RecordingWarning, WarningKind

UNREADABLE_SUFFIXES = (".heic", ".heif", ".avif", ".tif", ".tiff", ".dng")  # of pictures by phones and cameras
MAX_FRAME_COUNT_DIFFERENCE = 2  # frames lost at the end of the video or of its table

_LONGEST_NAME_BYTES = 240  # of a listed file's or folder's name, without suffix
_LONGEST_PATH_BYTES = 2000  # of a listed file's path in the recording's folder


@dataclass(frozen=True, eq=False)
class TimedFrames:
    """Frames with a table's times.

    Attributes:
        frames: N frames with increasing times.
        rows: (N,) row of the table for each frame.
        warnings: mismatches between frames and table.
        camera: of the frames, if each image's camera was given.
    """

    frames: FrameSource
    rows: IntArray
    warnings: tuple[RecordingWarning, ...]
    camera: Camera | None = None


def timed_video(video: Path, times: FloatArray, table: str) -> TimedFrames:
    """Combine a video with times (N,) [s] from the file ``table``; drops surplus frames or rows at the end.

    Raises:
        InvalidRecording: the video cannot be read, the numbers of frames differ by more than
            ``MAX_FRAME_COUNT_DIFFERENCE``, or over 5 % of the times do not increase.
    """
    frames = read_video(video)
    count = min(len(times), len(frames.times))
    warnings: list[RecordingWarning] = []
    if len(times) != len(frames.times):
        difference = f"{table} has {len(times)} frames, but {video.name} has {len(frames.times)}"
        if max(len(times), len(frames.times)) - count > MAX_FRAME_COUNT_DIFFERENCE:
            hint = f"Both must have the same number, give or take {MAX_FRAME_COUNT_DIFFERENCE} at the end."
            raise InvalidRecording(f"{difference}.", hint)
        warnings.append(RecordingWarning(WarningKind.FRAME_COUNT, f"{difference}; the rest is ignored."))
    rows, found = advancing_rows(times[:count], "frames")
    frames = replace(frames, times=times[:count])
    chosen = frames if len(rows) == count else SelectedFrames(frames, rows)
    return TimedFrames(chosen, rows, (*warnings, *found))


def timed_images(paths: Sequence[Path], times: FloatArray, cameras: Sequence[Camera] | None = None) -> TimedFrames:
    """Images with times, numbered by their place in ``paths``. Those whose time does not increase are left out.

    Args:
        paths: N files.
        times: (N,) seconds.
        cameras: each image's camera; None if the intrinsics are unknown.

    Raises:
        InvalidRecording: an image is missing or broken, or more than 5 % of the times do not increase.
        InvalidCamera: a camera has another aspect ratio than its image.
    """
    rows, warnings = advancing_rows(times, "frames")
    chosen = None if cameras is None else [cameras[row] for row in rows]
    frames = image_frames([paths[row] for row in rows], rows, times[rows], chosen)
    return TimedFrames(frames, rows, warnings, camera_of(frames, chosen))


def untimed_images(paths: Sequence[Path], cameras: Sequence[Camera] | None = None) -> TimedFrames:
    """Images without times: numbered by their names, or counted in the order of their names if that fails.

    ``rows`` are indices into ``paths``.

    Args:
        paths: N files.
        cameras: each image's camera, in the order of ``paths``; None if the intrinsics are unknown.

    Raises:
        InvalidRecording: an image is missing or broken.
        InvalidCamera: a camera has another aspect ratio than its image.
    """
    numbers, order = numbered(paths)
    chosen = None if cameras is None else [cameras[place] for place in order]
    frames = image_frames([paths[place] for place in order], numbers, None, chosen)
    return TimedFrames(frames, np.array(order, dtype=np.int64), (), camera_of(frames, chosen))


def camera_of(frames: ImageFolderFrames | UnifiedPictures, cameras: Sequence[Camera] | None) -> Camera | None:
    """Camera of the frames of images with given ``cameras``; None if ``cameras`` is None.

    The common camera if the frames are resampled, else the first of ``cameras`` at the frames' size.

    Raises:
        InvalidCamera: the camera does not fit the frames' aspect ratio.
    """
    if cameras is None:
        return None
    return frames.common if isinstance(frames, UnifiedPictures) else cameras[0].fitted(*frames.size)


def depth_images(
    paths: Sequence[Path | None],
    unit_m: float = MILLIMETRE_M,
    unknown: tuple[int, ...] = (0,),
    camera: Camera | None = None,
) -> DepthImages | None:
    """Depth images of one file per frame, see :class:`DepthImages`; missing files become None. None if all are."""
    found = tuple(path if path is not None and path.is_file() else None for path in paths)
    return DepthImages(found, unit_m, unknown, camera) if any(found) else None


def find_video(folder: Path, name: str = "video") -> Path | None:
    """The video called ``name`` with any suffix, or the only video of the folder; None without videos.

    Raises:
        InvalidRecording: there are several videos, and not exactly one has the name.
    """
    videos = [
        path
        for path in sorted(folder.iterdir())
        if path.suffix.lower() in VIDEO_SUFFIXES and not path.name.startswith(".") and path.is_file()
    ]
    videos = [path for path in videos if path.stem.lower() == name] or videos
    if len(videos) > 1:
        listed = ", ".join(path.name for path in videos)
        raise InvalidRecording(
            f"The folder {folder.name} contains several videos: {listed}.", f"Name the right one {name}.mp4."
        )
    return next(iter(videos), None)


def require_video(folder: Path, name: str) -> Path:
    """The video called ``name``, or the folder's only one. Raises InvalidRecording if none, or unclear."""
    video = find_video(folder, name)
    if video is None:
        raise InvalidRecording(f"The folder {folder.name} contains no video.", "Pack the video with the tables.")
    return video


def unreadable(picture: Path) -> InvalidRecording:
    """The error for a picture in a format that cannot be read, see ``UNREADABLE_SUFFIXES``."""
    return InvalidRecording(
        f"{picture.name} is a {picture.suffix[1:].upper()} picture, which cannot be read.",
        "Export the pictures as JPEG, or set the phone's camera to its most compatible format.",
    )


def listed_file(folder: Path, name: str) -> Path:
    """The file, which need not exist, that a list in the folder names by a path in it; also with Windows' separators.

    Raises:
        InvalidRecording: the name leads out of the folder, is too long for a file, or has half of a surrogate pair.
    """
    local = name.replace("\\", "/")
    try:
        encoded = os.fsencode(local)
    except UnicodeEncodeError as error:
        raise InvalidRecording(f"The list of images names '{name[:80]}', which is not valid text.") from error
    if len(encoded) > _LONGEST_PATH_BYTES or max(map(len, encoded.split(b"/"))) > _LONGEST_NAME_BYTES:
        raise InvalidRecording(f"The list of images names '{name[:80]}…', which is too long for a file.")
    path = folder / local
    if "\0" in name or not path.resolve().is_relative_to(folder.resolve()):
        raise InvalidRecording(
            f"The list of images names '{name[:80]}', outside the recording's folder.",
            "Put the images into the folder, and list them by their paths in it.",
        )
    return path


def mounted_frames(
    timed: TimedFrames, moments: Sequence[Hashable], T_rig_cameras: Sequence[FloatArray | None]
) -> tuple[Mounted, ...]:
    """Relative poses of frames that a rig took at the same moment: each further frame paired with the first.

    Args:
        timed: frames; ``timed.rows`` index the two lists below.
        moments: key of each picture; pictures with equal keys were taken by one rig at one moment.
        T_rig_cameras: (4, 4) mounting of each picture's camera; None for cameras that are not on a rig, whose
            frames get no pair.
    """
    first: dict[Hashable, tuple[int, FloatArray]] = {}
    found = []
    for number, row in zip(timed.frames.numbers.tolist(), timed.rows.tolist(), strict=True):
        T = T_rig_cameras[row]
        if T is None:
            continue
        if moments[row] in first:
            other, T_other = first[moments[row]]
            found.append(Mounted(other, number, np.linalg.inv(T_other) @ T))
        else:
            first[moments[row]] = number, T
    return tuple(found)
