"""Recording → frame poses: joint adjustment of pictures, IMU and waypoints."""

from rholoc.trajectory.estimate import estimate_trajectory, odometry_from_flow, rolling_shutter_of
from rholoc.trajectory.trajectory import PoseMethod, Scale, Trajectory

__all__ = ["PoseMethod", "Scale", "Trajectory", "estimate_trajectory", "odometry_from_flow", "rolling_shutter_of"]
