"""Recording → frame poses: joint adjustment of pictures, IMU and waypoints.

``rholoc.trajectory.estimate`` estimates them; its solvers are loaded with it, not with this package.
"""

from rholoc.trajectory.trajectory import PoseMethod, Scale, Trajectory

__all__ = ["PoseMethod", "Scale", "Trajectory"]
