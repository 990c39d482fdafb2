"""Keyframe poses from sightings, IMU and waypoints."""

from rholoc.trajectory.reconstruction.dispatch import reconstruct
from rholoc.trajectory.reconstruction.from_poses import reconstruct_from_poses, unmoved_frame
from rholoc.trajectory.reconstruction.outcome import Reconstruction
from rholoc.trajectory.reconstruction.sights import Sights

__all__ = ["Reconstruction", "Sights", "reconstruct", "reconstruct_from_poses", "unmoved_frame"]
