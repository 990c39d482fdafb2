"""rholoc's own folder: frames, as a video or as images, and what was measured beside them.

::

    video.mp4 | .mov | .webm | …     or images, here or in frames/ or images/
    frames.csv | times.csv           frame,timestamp                        optional
    imu.csv                          timestamp,ax,ay,az,gx,gy,gz (Table 3)  optional
    waypoints.csv                    name[,time|frame],x,y,z                optional
    camera.json                      intrinsics, fps, R_camera_imu          optional
    poses.txt | poses.csv            frame|time tx ty tz qx qy qz qw        optional
    odometry.csv                     timestamp,x,y,z,qx,qy,qz,qw            optional
"""

from pathlib import Path

import numpy as np

from rholoc.errors import InvalidRecording
from rholoc.geometry import IntArray
from rholoc.recordings.camera_file import CameraFile, read_camera_json
from rholoc.recordings.frames.image_decoding import IMAGE_SUFFIXES
from rholoc.recordings.frames.image_folder import ImageFolderFrames, find_images, read_image_folder
from rholoc.recordings.frames.unified_pictures import UnifiedPictures, require_one_camera
from rholoc.recordings.frames.video import read_video
from rholoc.recordings.imu_normalisation import ImuConvention, Samples, frame_times_s, normalise_imu
from rholoc.recordings.readers._frames import UNREADABLE_SUFFIXES, find_video, timed_video, unreadable
from rholoc.recordings.recording import FrameSource, Imu, Recording
from rholoc.recordings.tables.own_tables import read_frame_numbers, read_imu_rows, read_odometry_csv
from rholoc.recordings.tables.pose_table import match_poses, read_pose_table
from rholoc.recordings.tables.waypoints import read_waypoints_csv
from rholoc.reports import RecordingWarning

_MAX_NAMED = 4
TABLES = ("frames.csv", "times.csv", "imu.csv", "poses.txt", "poses.csv", "odometry.csv", "truth.csv")


def read(folder: Path) -> Recording:
    """Read a folder with a video or images, and the tables beside them.

    Raises:
        InvalidRecording: no frames, or a file that cannot be read or contradicts another.
        InvalidCamera: ``camera.json`` is broken, or is of another image shape than the frames, or
            these are pictures of several sizes or lenses.
        InvalidWaypoints: ``waypoints.csv`` is broken.
        InvalidTrajectory: the table of poses, or of odometry, is broken.
    """
    description = read_description(folder)
    frames, warnings = _read_frames(folder, description)
    imu, imu_warnings = _read_imu(folder, description)
    waypoints_csv, odometry_csv = folder / "waypoints.csv", folder / "odometry.csv"
    poses = _first_file(folder, "poses.txt", "poses.csv")
    camera = description.camera
    if camera is not None:
        require_one_camera(frames)
    return Recording(
        frames,
        camera=None if camera is None else camera.fitted(*frames.size),
        imu=imu,
        waypoints=read_waypoints_csv(waypoints_csv, frames) if waypoints_csv.is_file() else (),
        poses=None if poses is None else match_poses(read_pose_table(poses), frames),
        readout_s=description.readout_s,
        odometry=read_odometry_csv(odometry_csv) if odometry_csv.is_file() else None,
        focal_px=frames.focal_px if isinstance(frames, ImageFolderFrames | UnifiedPictures) else None,
        lenses=frames.lens_by_number if isinstance(frames, UnifiedPictures) else {},
        warnings=(*warnings, *imu_warnings),
    )


def read_description(folder: Path) -> CameraFile:
    """Content of ``camera.json``; an empty description if there is none.

    Raises:
        InvalidCamera: it is broken.
    """
    camera_json = folder / "camera.json"
    return read_camera_json(camera_json) if camera_json.is_file() else CameraFile()


def _read_imu(folder: Path, description: CameraFile) -> tuple[Imu | None, tuple[RecordingWarning, ...]]:
    """The IMU by ``imu.csv``, and warnings; None without the file. Raises InvalidRecording."""
    path = folder / "imu.csv"
    if not path.is_file():
        return None, ()
    rows = read_imu_rows(path)
    accelerometer, gyroscope = Samples(rows[:, 0], rows[:, 1:4]), Samples(rows[:, 0], rows[:, 4:7])
    says = ImuConvention(includes_gravity=description.gravity_included)
    return normalise_imu(accelerometer, gyroscope, says, description.R_camera_imu)


def _read_frames(folder: Path, description: CameraFile) -> tuple[FrameSource, tuple[RecordingWarning, ...]]:
    """Frames of the video, else of the images, with their table of times if there is one; and warnings."""
    times_csv = _first_file(folder, "frames.csv", "times.csv")
    video = find_video(folder)
    if video is not None and times_csv is not None:
        numbers, logged = read_frame_numbers(times_csv)
        _require_no_gap(numbers, times_csv.name)
        times, unit_warnings = frame_times_s(logged, "s")
        timed = timed_video(video, times, times_csv.name)
        return timed.frames, (*unit_warnings, *timed.warnings)
    if video is not None:
        return read_video(video), ()
    images = find_images(folder)
    if images:
        return read_image_folder(images, times_csv, description.fps), ()
    raise _without_frames(folder)


def _without_frames(folder: Path) -> InvalidRecording:
    """The error for a folder without readable frames, which says where else pictures are."""
    found = [path.relative_to(folder) for path in sorted(folder.rglob("*"))]
    below = [path for path in found if not any(part.startswith(".") for part in path.parts)]
    places = [*dict.fromkeys(path.parts[0] for path in below if path.suffix.lower() in IMAGE_SUFFIXES)]
    other = next((path for path in below if path.suffix.lower() in UNREADABLE_SUFFIXES), None)
    hint = "It needs video.mp4, or images (JPEG, PNG, WebP), here or in frames/."
    if not any(folder.iterdir()):
        return InvalidRecording(f"The folder {folder.name} is empty.", hint)
    if places:
        more = f" and {len(places) - _MAX_NAMED} more" if len(places) > _MAX_NAMED else ""
        which = "one of these folders" if len(places) > 1 else "that folder"
        hint = f"There are pictures in {', '.join(places[:_MAX_NAMED])}{more}: give {which}."
    elif other is not None:
        return unreadable(other)
    return InvalidRecording(f"The folder {folder.name} contains neither a video nor images.", hint)


def _require_no_gap(numbers: IntArray, table: str) -> None:
    """Raise InvalidRecording unless the frame numbers (N,) of a video's table are 0 … N - 1."""
    gaps = np.flatnonzero(numbers != np.arange(len(numbers)))
    if len(gaps):
        raise InvalidRecording(
            f"{table} has no time for frame {gaps[0]} of the video.",
            "Frames count from 0, and rows may be missing only at the end.",
        )


def _first_file(folder: Path, *names: str) -> Path | None:
    """The first of these files that the folder has; None if it has none."""
    return next((folder / name for name in names if (folder / name).is_file()), None)
