"""Recordings of walks: one reader per format; video, IMU, waypoints."""

from rholoc.recordings.archive import MAX_FILES, check_archive
from rholoc.recordings.camera_file import CameraFile, read_camera_json, write_camera_json
from rholoc.recordings.description import describe_recording
from rholoc.recordings.file_contents import START_BYTES, ZIP_SUFFIXES, check_file_name, check_file_start
from rholoc.recordings.frame_slice import parse_frame_slice
from rholoc.recordings.frames.image_decoding import decode_image, read_image
from rholoc.recordings.frames.memory_frames import MemoryFrames
from rholoc.recordings.frames.video import MAX_FRAME_PIXELS, frame_pixels_limited
from rholoc.recordings.reader import read_recording
from rholoc.recordings.readers._camera_models import camera_of_model
from rholoc.recordings.recording import (
    GRAVITY,
    FrameSource,
    GivenPoses,
    Imu,
    KnownLength,
    Mounted,
    Odometry,
    PoseKind,
    Recording,
    RecordingFormat,
    Waypoint,
)
from rholoc.recordings.tables.own_tables import read_frames_csv, read_imu_csv, write_frames_csv, write_imu_csv
from rholoc.recordings.tables.pose_table import read_pose_table
from rholoc.recordings.tables.waypoints import check_waypoints_fix_frame, read_waypoints_csv, write_waypoints_csv
from rholoc.recordings.walk.advice import advise
from rholoc.recordings.walk.stillness import pauses
from rholoc.recordings.walk.walk_figures import Look, look_at, look_through, measure_walk

__all__ = [
    "GRAVITY",
    "MAX_FILES",
    "MAX_FRAME_PIXELS",
    "START_BYTES",
    "ZIP_SUFFIXES",
    "CameraFile",
    "FrameSource",
    "GivenPoses",
    "Imu",
    "KnownLength",
    "Look",
    "MemoryFrames",
    "Mounted",
    "Odometry",
    "PoseKind",
    "Recording",
    "RecordingFormat",
    "Waypoint",
    "advise",
    "camera_of_model",
    "check_archive",
    "check_file_name",
    "check_file_start",
    "check_waypoints_fix_frame",
    "decode_image",
    "describe_recording",
    "frame_pixels_limited",
    "look_at",
    "look_through",
    "measure_walk",
    "parse_frame_slice",
    "pauses",
    "read_camera_json",
    "read_frames_csv",
    "read_image",
    "read_imu_csv",
    "read_pose_table",
    "read_recording",
    "read_waypoints_csv",
    "write_camera_json",
    "write_frames_csv",
    "write_imu_csv",
    "write_waypoints_csv",
]
