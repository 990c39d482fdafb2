"""The node's parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from rholoc_client.tracking import OdometryNoise, TrackOptions
from rholoc_ros.correction import CorrectionLimits

ODOMETRIES = ("tf", "topic", "none")


@dataclass(frozen=True)
class Settings:
    """The node's parameters, under the names and with the defaults that they have in ROS.

    Attributes:
        url: the service.
        map_name: the map to localize in.
        map_frame, odom_frame, base_frame: names of the frames of REP 105.
        odometry: where T_odom_base comes from: ``tf``, ``topic`` (``nav_msgs/Odometry``) or ``none`` (the pictures).
        odometry_drift: one sigma of a distance by odometry, as a share of it.
        compressed: whether pictures are ``CompressedImage`` messages.
        use_camera_info: whether the intrinsics come from ``CameraInfo``; else the map's own are used.
        rectified: whether the pictures are rectified.
        use_imu: whether ``imu`` is read; it helps only without odometry.
        publish_map_to_odom_tf: whether map→odom is broadcast.
        planar: whether map→odom is restricted to x, y and yaw.
        tf_rate_hz: how often map→odom is broadcast.
        transform_tolerance_s: how far map→odom is dated into the future.
        correction_m_s, correction_deg_s: bound on the rate at which map→odom moves the robot.
        correction_max_m, correction_max_deg: a larger correction is a pause, then a new start.
        pose_at_answers_only: whether a pose is published for every answer of the service rather than every picture.
        answers_per_s: the most requests in a second.
        lost_m, lost_deg: one sigma of the pose beyond which the node is silent.
        wait_s: how long a picture waits for odometry and transforms of its moment.
        silent_after_s: map→odom is no longer broadcast so long after the last picture that was tracked.
        hint_s: how long a hint is sent with requests.

    Raises:
        ValueError: a value makes no sense.
    """

    url: str = "http://127.0.0.1:8080"
    map_name: str = ""
    map_frame: str = "map"
    odom_frame: str = "odom"
    base_frame: str = "base_link"
    odometry: str = "tf"
    odometry_drift: float = 0.02
    compressed: bool = False
    use_camera_info: bool = True
    rectified: bool = False
    use_imu: bool = False
    publish_map_to_odom_tf: bool = False
    planar: bool = False
    tf_rate_hz: float = 20.0
    transform_tolerance_s: float = 0.3
    correction_m_s: float = 0.2
    correction_deg_s: float = 10.0
    correction_max_m: float = 0.5
    correction_max_deg: float = 15.0
    pose_at_answers_only: bool = False
    answers_per_s: float = 2.0
    lost_m: float = 0.5
    lost_deg: float = 20.0
    wait_s: float = 0.5
    silent_after_s: float = 1.0
    hint_s: float = 10.0

    def __post_init__(self) -> None:
        if not self.map_name:
            raise ValueError("The parameter map_name is empty: name the map to localize in.")
        if self.odometry not in ODOMETRIES:
            raise ValueError(f"The parameter odometry is '{self.odometry}': use one of {', '.join(ODOMETRIES)}.")
        names = (self.map_frame, self.odom_frame, self.base_frame)
        if len({*names}) < len(names) or not all(names):
            raise ValueError("map_frame, odom_frame and base_frame must be three different names.")
        if self.publish_map_to_odom_tf and self.odometry == "none":
            raise ValueError("Without odometry there is no odom frame: set publish_map_to_odom_tf to false.")
        for name, value in vars(self).items():
            if isinstance(value, float) and not 0 < value < math.inf:
                raise ValueError(f"The parameter {name} is {value}: give a positive number.")

    @classmethod
    def of(cls, parameters: Mapping[str, Any]) -> Settings:
        """The settings of ROS parameters by name; whole numbers do for floats. Raises ValueError."""
        for name, value in parameters.items():
            if isinstance(DEFAULTS[name], bool) != isinstance(value, bool):
                raise ValueError(
                    f"The parameter {name} is {value!r}, and {DEFAULTS[name]!r} by default: use that type."
                )
        return cls(**{name: type(DEFAULTS[name])(value) for name, value in parameters.items()})

    @property
    def limits(self) -> CorrectionLimits:
        """How the broadcast transform may change."""
        return CorrectionLimits(
            self.correction_m_s,
            self.correction_deg_s,
            self.correction_max_m,
            self.correction_max_deg,
            self.transform_tolerance_s,
        )

    @property
    def track_options(self) -> TrackOptions:
        """The tracker's options."""
        return TrackOptions(
            odometry=OdometryNoise(drift=self.odometry_drift),
            answers_per_s=self.answers_per_s,
            lost_m=self.lost_m,
            lost_deg=self.lost_deg,
        )


DEFAULTS: dict[str, Any] = {field.name: field.default for field in fields(Settings)}
