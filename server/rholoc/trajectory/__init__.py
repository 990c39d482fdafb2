"""Recording → frame poses: structure from motion, inertial, alignment."""

from rholoc.trajectory.estimate import estimate_trajectory
from rholoc.trajectory.trajectory import PoseMethod, Scale, Trajectory

__all__ = ["PoseMethod", "Scale", "Trajectory", "estimate_trajectory"]
