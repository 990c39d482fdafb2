"""What a phone hands in: one reader per format, video, IMU, waypoints."""

from rholoc.recordings.camera_file import CameraFile, read_camera_json, write_camera_json
from rholoc.recordings.frames_table import read_frames_csv, write_frames_csv
from rholoc.recordings.image import decode_image, read_image
from rholoc.recordings.imu_table import read_imu_csv, write_imu_csv
from rholoc.recordings.pose_table import PoseTable, read_pose_table
from rholoc.recordings.reader import read_recording
from rholoc.recordings.recording import FrameSource, GivenPoses, Imu, Recording, Waypoint
from rholoc.recordings.selection import parse_frame_slice
from rholoc.recordings.waypoints import check_waypoints_fix_frame, read_waypoints_csv, write_waypoints_csv

__all__ = [
    "CameraFile",
    "FrameSource",
    "GivenPoses",
    "Imu",
    "PoseTable",
    "Recording",
    "Waypoint",
    "check_waypoints_fix_frame",
    "decode_image",
    "parse_frame_slice",
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
