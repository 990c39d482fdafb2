"""Recording → frame poses: structure from motion, inertial, alignment."""

from rholoc.trajectory.trajectory import PoseMethod, Scale, Trajectory

__all__ = ["PoseMethod", "Scale", "Trajectory"]
