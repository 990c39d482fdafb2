"""Read recordings of any format."""

import os
import shutil
import tempfile
import weakref
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from rholoc.errors import InvalidRecording
from rholoc.geometry import Camera
from rholoc.recordings.archive import DEFAULT_MAX_BYTES, unpack
from rholoc.recordings.file_contents import ZIP_SUFFIXES
from rholoc.recordings.frame_slice import parse_frame_slice, select_frames
from rholoc.recordings.frames.bag import BAG_SUFFIXES
from rholoc.recordings.frames.image_decoding import IMAGE_SUFFIXES
from rholoc.recordings.frames.image_folder import read_image_folder
from rholoc.recordings.frames.unified_pictures import require_one_camera
from rholoc.recordings.frames.video import VIDEO_SUFFIXES, read_video
from rholoc.recordings.readers import read_folder
from rholoc.recordings.readers.bag import read_bag
from rholoc.recordings.recording import Recording, RecordingFormat
from rholoc.recordings.tables.own_tables import parse_length
from rholoc.recordings.tables.waypoints import read_waypoints_csv
from rholoc.recordings.walk.checks import whole_warnings

_KNOWN = (
    "Known are: a video ("
    + ", ".join(sorted(VIDEO_SUFFIXES))
    + "); a ROS bag ("
    + ", ".join(sorted(BAG_SUFFIXES))
    + "); an image, or a folder with images; "
    "a folder or .zip with video.mp4 or frames/, and with imu.csv, frames.csv, waypoints.csv, camera.json or not; and "
    "those of recorder apps and datasets, which maps/README.md lists."
)


def read_recording(
    path: Path | str,
    camera: Camera | str | None = None,
    frames: str | None = None,
    waypoints: Path | str | None = None,
    workdir: Path | None = None,
    max_unpacked_bytes: int = DEFAULT_MAX_BYTES,
    lengths: Sequence[str] = (),
    topics: Sequence[str] = (),
) -> Recording:
    """Read a recording: a video, an image, a folder of images, or a folder or ZIP file of any format of
    ``RecordingFormat``.

    Args:
        path: the file or folder.
        camera: replaces the recording's own: text for :meth:`Camera.parse` in pixels of the frames, or a camera for any
            size of the same aspect ratio. Must be None for pictures of several sizes or lenses.
        frames: a choice of frames by number, ``start:stop[:step]``.
        waypoints: a CSV file of measured waypoints that replace the recording's own; all within the chosen frames.
        workdir: an existing folder; a ZIP file is unpacked into a new folder in it, which the caller removes. The
            default is a temporary folder that exists as long as the recording's frames do.
        max_unpacked_bytes: upper bound on the unpacked size of a ZIP file.
        lengths: measured distances that replace the recording's own: ``12,340,2.40`` means that the camera's positions
            in frames 12 and 340 were 2.40 m apart.
        topics: names of a bag's topics to use, if there are several of a kind.

    Raises:
        InvalidRecording: the recording, a length or the choice of frames cannot be used.
        InvalidCamera: the intrinsics are impossible or do not fit the frames, or pictures of several sizes or lenses.
        InvalidWaypoints: the waypoints are malformed, or outside the recording.
        InvalidTrajectory: the poses beside the frames are malformed.
        TooLarge: a ZIP file would unpack to too much.
        StorageFull: no room to unpack a ZIP file.
    """
    recording = _read(Path(path), workdir, max_unpacked_bytes, topics)
    recording = replace(recording, warnings=(*recording.warnings, *whole_warnings(recording)))
    if camera is not None:
        require_one_camera(recording.frames)
    if frames is not None:
        recording = select_frames(recording, parse_frame_slice(frames))
    if camera is not None:
        size = recording.frames.size
        fitted = camera.fitted(*size) if isinstance(camera, Camera) else Camera.parse(camera, *size)
        recording = replace(recording, camera=fitted)
    if waypoints is not None:
        recording = replace(recording, waypoints=read_waypoints_csv(Path(waypoints), recording.frames))
    if lengths:
        numbers = recording.frames.numbers
        recording = replace(recording, lengths=tuple(parse_length(text, numbers) for text in lengths))
    return recording


def _read(path: Path, workdir: Path | None, max_unpacked_bytes: int, topics: Sequence[str]) -> Recording:
    """Read a recording of any format as it is. Raises as :func:`read_recording`."""
    suffix = path.suffix.lower()
    if not path.exists():
        raise InvalidRecording(f"There is no {path.name}.", "Check the path.")
    if path.is_dir():
        return read_folder(path, topics)
    if suffix in BAG_SUFFIXES:
        return read_bag(path, topics)
    if suffix in VIDEO_SUFFIXES:
        return Recording(name=path.stem, path=path, frames=read_video(path), format=RecordingFormat.VIDEO)
    if suffix in IMAGE_SUFFIXES:
        frames = read_image_folder([path])
        focal_px = frames.focal_px
        return Recording(name=path.stem, path=path, frames=frames, format=RecordingFormat.RHOLOC, focal_px=focal_px)
    if suffix in ZIP_SUFFIXES:
        return _read_zip(path, workdir, max_unpacked_bytes, topics)
    raise InvalidRecording(f"{path.name} is not a recording of a known format.", _KNOWN)


def _read_zip(path: Path, workdir: Path | None, max_unpacked_bytes: int, topics: Sequence[str]) -> Recording:
    """Unpack a ZIP file into a new folder, and read that; the folder is removed if this fails."""
    folder = Path(tempfile.mkdtemp(prefix="rholoc-recording-", dir=workdir))
    try:
        unpack(path, folder, max_unpacked_bytes)
        recording = replace(read_folder(folder, topics), name=path.stem)
    except InvalidRecording as error:
        shutil.rmtree(folder, ignore_errors=True)
        # The name of our temporary folder means nothing to the sender.
        raise InvalidRecording(
            error.message.replace(f"folder {folder.name}", f"file {path.name}"), error.hint
        ) from error
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    if workdir is None:
        weakref.finalize(recording.frames, _remove, folder, os.getpid())
    return recording


def _remove(folder: Path, owner: int) -> None:
    """Remove the folder if this process has the id ``owner``: a forked child that inherited the recording keeps it."""
    if os.getpid() == owner:
        shutil.rmtree(folder, ignore_errors=True)
