"""A folder as a recording: frames, as a video or as images, and what was measured beside them.

::

    video.mp4 | .mov | .webm | …     or images, here or in frames/ or images/
    frames.csv | times.csv           frame,timestamp                        optional
    imu.csv                          timestamp,ax,ay,az,gx,gy,gz (Table 3)  optional
    waypoints.csv                    name,time|frame,x,y,z                  optional
    camera.json                      intrinsics, fps, R_camera_imu          optional
    poses.txt | poses.csv            frame|time tx ty tz qx qy qz qw        optional
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from rholoc.errors import InvalidCamera, InvalidRecording
from rholoc.geometry import Camera
from rholoc.recordings.camera_file import CameraFile, read_camera_json
from rholoc.recordings.frames_table import read_frames_csv
from rholoc.recordings.image_folder import find_images, read_image_folder
from rholoc.recordings.imu_table import read_imu_csv
from rholoc.recordings.pose_table import match_poses, read_pose_table
from rholoc.recordings.recording import FrameSource, Recording
from rholoc.recordings.video import VIDEO_SUFFIXES, VideoFrames, read_video
from rholoc.recordings.waypoints import read_waypoints_csv

MAX_FRAME_COUNT_DIFFERENCE = 2  # frames that a recorder may lose at the end of the video or of its table
_ASPECT_TOLERANCE = 0.01


def read_folder(folder: Path) -> Recording:
    """Read a folder with a video or images, and the tables beside them.

    Raises:
        InvalidRecording: no frames, or a file that cannot be read or contradicts another.
        InvalidCamera: ``camera.json`` is broken, or is of another image shape than the frames.
        InvalidWaypoints: ``waypoints.csv`` is broken.
        InvalidTrajectory: the table of poses is broken.
    """
    description = _read_description(folder)
    frames = _read_frames(folder, description)
    imu_csv, waypoints_csv = folder / "imu.csv", folder / "waypoints.csv"
    poses = _first_file(folder, "poses.txt", "poses.csv")
    return Recording(
        name=folder.resolve().name,
        path=folder,
        frames=frames,
        camera=None if description.camera is None else _fitted(description.camera, frames.size),
        imu=(
            read_imu_csv(imu_csv, description.gravity_included, description.R_camera_imu) if imu_csv.is_file() else None
        ),
        waypoints=read_waypoints_csv(waypoints_csv, frames) if waypoints_csv.is_file() else (),
        poses=None if poses is None else match_poses(read_pose_table(poses), frames),
    )


def _read_description(folder: Path) -> CameraFile:
    camera_json = folder / "camera.json"
    return read_camera_json(camera_json) if camera_json.is_file() else CameraFile()


def _read_frames(folder: Path, description: CameraFile) -> FrameSource:
    times_csv = _first_file(folder, "frames.csv", "times.csv")
    video = _find_video(folder)
    if video is not None:
        frames = read_video(video)
        return frames if times_csv is None else _with_times(frames, times_csv)
    images = find_images(folder)
    if images:
        return read_image_folder(images, times_csv, description.fps)
    empty = not any(folder.iterdir())
    raise InvalidRecording(
        f"The folder {folder.name} is empty."
        if empty
        else f"The folder {folder.name} holds neither a video nor images.",
        "It needs video.mp4, or images whose names end in a number, here or in frames/.",
    )


def _find_video(folder: Path) -> Path | None:
    """``video.*``, or the only video there is."""
    videos = [
        path
        for path in sorted(folder.iterdir())
        if path.suffix.lower() in VIDEO_SUFFIXES and not path.name.startswith(".") and path.is_file()
    ]
    named = [path for path in videos if path.stem.lower() == "video"]
    if len(named or videos) > 1:
        names = ", ".join(path.name for path in named or videos)
        raise InvalidRecording(f"The folder {folder.name} holds several videos: {names}.", "Name the one video.mp4.")
    return next(iter(named or videos), None)


def _with_times(frames: VideoFrames, times_csv: Path) -> VideoFrames:
    """The frames with the table's times, row by row. What either has more of at its end is dropped."""
    _, times = read_frames_csv(times_csv)
    count = min(len(times), len(frames.times))
    if max(len(times), len(frames.times)) - count > MAX_FRAME_COUNT_DIFFERENCE:
        raise InvalidRecording(
            f"{times_csv.name} has {len(times)} frames, but {frames.path.name} has {len(frames.times)}.",
            f"Both must have the same number, give or take {MAX_FRAME_COUNT_DIFFERENCE} at the end.",
        )
    return replace(frames, times=times[:count])


def _fitted(camera: Camera, size: tuple[int, int]) -> Camera:
    """The camera for frames of ``size``; camera.json may be of another resolution of the same shape."""
    width, height = size
    if abs(width * camera.height / (height * camera.width) - 1) > _ASPECT_TOLERANCE:
        raise InvalidCamera(
            f"camera.json is for {camera.width}×{camera.height} pixels, but the frames are {width}×{height}.",
            "Give the intrinsics of the frames as they are shown, after rotation.",
        )
    return camera if (camera.width, camera.height) == size else camera.resized(width, height)


def _first_file(folder: Path, *names: str) -> Path | None:
    return next((folder / name for name in names if (folder / name).is_file()), None)
