"""The frame poses of a recording."""

from dataclasses import dataclass
from enum import StrEnum

from rholoc.features import FeatureSet
from rholoc.geometry import Camera, FloatArray, IntArray
from rholoc.reports import TrajectoryReport
from rholoc.trajectory.visual.rolling_shutter import RollingShutter
from rholoc.trajectory.visual.unzooming import unzoomed_features


class PoseMethod(StrEnum):
    """Where frame poses come from."""

    AUTO = "auto"  # the recording's own poses where its pictures agree with them, else as VISUAL_INERTIAL
    VISUAL_INERTIAL = "visual-inertial"  # structure from motion, made metric and upright by waypoints and IMU
    VISUAL = "visual"  # structure from motion and waypoints, without the IMU
    ODOMETRY = "odometry"  # optical flow and the IMU, without loop closures, so it drifts
    INERTIAL = "inertial"  # the paper's own: the IMU between waypoints, without pictures
    GIVEN = "given"  # the recording's own poses


class Scale(StrEnum):
    """What the map's unit of length is."""

    METRIC = "metric"  # metres
    ARBITRARY = "arbitrary"  # not fixed by any measurement


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses of K frames of a recording, in the map frame.

    Attributes:
        rows: (K,) int64, rows of the recording's frames, increasing.
        times: (K,) float64, seconds.
        T_map_camera: (K, 4, 4).
        camera: the intrinsics that belong to these poses.
        scale: whether lengths are metres.
        upright: whether the map's z axis is known to point up.
        report: figures for people: waypoint residuals, reprojection error, placed frames, …
        rolling_shutter: image motion during the read-out of these frames; None if unknown, or for a global shutter.
        covariances: (K, 6, 6) of each frame's pose in the map frame: x, y, z [m], then the rotation about the map's
            x, y, z axes [rad] (small, applied from the left). Includes errors shared by neighbouring frames. None if
            unknown.
        second_positions: (K, 3) the same frames in a second reconstruction that checked this one, in the map frame;
            NaN where it has none. None without one.
        zooms: (K,) of each frame relative to the camera, where autofocus or another lens changed it; or None.
    """

    rows: IntArray
    times: FloatArray
    T_map_camera: FloatArray
    camera: Camera
    scale: Scale
    upright: bool
    report: TrajectoryReport
    rolling_shutter: RollingShutter | None = None
    covariances: FloatArray | None = None
    second_positions: FloatArray | None = None
    zooms: FloatArray | None = None

    def at_once(self, k: int, features: FeatureSet) -> FeatureSet:
        """``features`` of frame ``k`` (0..K-1), moved to their pixels at the read-out of the middle row, unzoomed."""
        if self.rolling_shutter is not None:
            features = self.rolling_shutter.at_once(k, features)
        return features if self.zooms is None else unzoomed_features(features, float(self.zooms[k]), self.camera)
