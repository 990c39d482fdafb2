"""What a phone hands in: one reader per format, video, IMU, waypoints."""

from rholoc.recordings.recording import FrameSource, GivenPoses, Imu, Recording, Waypoint

__all__ = ["FrameSource", "GivenPoses", "Imu", "Recording", "Waypoint"]
