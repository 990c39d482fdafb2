"""What keyframes see, and what the IMU and waypoints measured → the keyframes' poses."""

from rholoc.trajectory.reconstruction.dispatch import reconstruct
from rholoc.trajectory.reconstruction.outcome import InertialFigures, Reconstruction
from rholoc.trajectory.reconstruction.sights import Sights

__all__ = ["InertialFigures", "Reconstruction", "Sights", "reconstruct"]
