"""The lifecycle node: ROS messages ↔ :class:`.robot.Robot`. The only module that imports ROS."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.qos import qos_profile_sensor_data
from rclpy.time import Time
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, Imu
from std_srvs.srv import Trigger
from tf2_ros import Buffer, TransformBroadcaster, TransformException, TransformListener

from rholoc_client import Client
from rholoc_client.models import Camera
from rholoc_client.tracking import Tracker
from rholoc_client.tracking.rigid import FloatArray
from rholoc_ros.messages import (
    filled_pose,
    filled_status,
    filled_transform,
    pose_of,
    set_stamp,
    stamp_ns,
    transform_of,
    vector_of,
)
from rholoc_ros.pictures import camera_of, compressed_picture_of, picture_of
from rholoc_ros.robot import Picture, Robot
from rholoc_ros.settings import DEFAULTS, Settings

_POSE = "visual_localization/pose"
_PICTURE_POSE = "visual_localization/picture_pose"
_TRIGGER = "visual_localization/trigger_localization"
_LOCALIZE = "visual_localization/localize_picture"
_POLL_S = 0.05
_DIAGNOSTICS_S = 1.0
_QUEUE = 10
_IMU_QUEUE = 200


class TransformTree:
    """The tree of transforms, as tf2 has it."""

    def __init__(self, buffer: Any) -> None:
        self._buffer = buffer

    def lookup(self, target: str, source: str, stamp_ns: int) -> FloatArray | None:
        """T_target_source (4, 4) at a stamp, never the latest; None if it is not known, or not known yet."""
        try:
            return transform_of(self._buffer.lookup_transform(target, source, Time(nanoseconds=stamp_ns)).transform)
        except (TransformException, ValueError):  # or a quaternion that is no rotation
            return None


class LocalizationNode(LifecycleNode):  # type: ignore[misc]
    """Localizes a robot in a map of rholoc; silent until it is localized, and while it is lost."""

    def __init__(self) -> None:
        super().__init__("rholoc")
        for name, default in DEFAULTS.items():
            # Of any type: a whole number does for a float, and 12 is the name of a map. The settings check them.
            self.declare_parameter(name, default, ParameterDescriptor(dynamic_typing=True))
        self._active: list[Any] = []  # subscriptions, services and timers, with what destroys each

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the parameters; connect to the service and the transforms."""
        try:
            self._settings = Settings.of({name: self.get_parameter(name).value for name in DEFAULTS})
        except ValueError as error:
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        self._client = Client(self._settings.url, api_key=os.environ.get("RHOLOC_API_KEY"))
        buffer = Buffer()
        self._listener = TransformListener(buffer, self)
        self._broadcaster = TransformBroadcaster(self)
        self._robot = Robot(self._settings, TransformTree(buffer), self._tracker)
        self._poses = self.create_lifecycle_publisher(PoseWithCovarianceStamped, _POSE, _QUEUE)
        self._picture_poses = self.create_lifecycle_publisher(PoseWithCovarianceStamped, _PICTURE_POSE, _QUEUE)
        self._diagnostics = self.create_lifecycle_publisher(DiagnosticArray, "/diagnostics", _QUEUE)
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to take in messages."""
        settings, sensor = self._settings, qos_profile_sensor_data
        if settings.compressed:
            self._subscribe(CompressedImage, "image/compressed", self._on_compressed, sensor)
        else:
            self._subscribe(Image, "image", self._on_image, sensor)
        if settings.use_camera_info:
            self._subscribe(CameraInfo, "camera_info", self._on_camera_info, sensor)
        if settings.odometry == "topic":
            self._subscribe(Odometry, "odom", self._on_odometry, sensor)
        if settings.use_imu:
            self._subscribe(Imu, "imu", self._on_imu, _IMU_QUEUE)
        for topic in ("/initialpose", _TRIGGER):
            self._subscribe(PoseWithCovarianceStamped, topic, self._on_hint, _QUEUE)
        self._serve(_TRIGGER, self._on_trigger)
        # It waits for the service: in a group of its own, so that pictures are tracked meanwhile.
        self._serve(_LOCALIZE, self._on_localize, callback_group=MutuallyExclusiveCallbackGroup())
        self._every(_POLL_S, self._poll)
        self._every(_DIAGNOSTICS_S, self._diagnose)
        if settings.publish_map_to_odom_tf:
            self._every(1 / settings.tf_rate_hz, self._broadcast)
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Fall silent, and forget the track."""
        self._stop()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the connections."""
        self._close()
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close whatever is open."""
        self._stop()
        self._close()
        return TransitionCallbackReturn.SUCCESS

    def _tracker(self, camera: Camera | None) -> Tracker:
        return Tracker(self._client, self._settings.map_name, camera, self._settings.track_options)

    def _subscribe(self, kind: Any, topic: str, callback: Any, qos: Any) -> None:
        subscription = self.create_subscription(kind, topic, callback, qos)
        self._active.append((self.destroy_subscription, subscription))

    def _serve(self, name: str, callback: Any, **options: Any) -> None:
        self._active.append((self.destroy_service, self.create_service(Trigger, name, callback, **options)))

    def _every(self, seconds: float, callback: Any) -> None:
        self._active.append((self.destroy_timer, self.create_timer(seconds, callback)))

    def _stop(self) -> None:
        for destroy, what in self._active:
            destroy(what)
        self._active.clear()
        if hasattr(self, "_robot"):
            self._robot.restart()

    def _close(self) -> None:
        if hasattr(self, "_robot"):
            self._listener.unregister()
            self._client.close()
            for publisher in (self._poses, self._picture_poses, self._diagnostics):
                self.destroy_lifecycle_publisher(publisher)
            del self._robot

    @property
    def _now_ns(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _on_image(self, message: Image) -> None:
        self._take(message, picture_of)

    def _on_compressed(self, message: CompressedImage) -> None:
        self._take(message, compressed_picture_of)

    def _take(self, message: Any, read: Any) -> None:
        try:
            content = read(message)
        except ValueError as error:
            self._robot.complain(str(error))
            return
        header = message.header
        self._robot.picture(Picture(stamp_ns(header.stamp), header.frame_id, content, self._now_ns * 1e-9))
        self._poll()

    def _on_camera_info(self, message: CameraInfo) -> None:
        try:
            self._robot.camera(camera_of(message, self._settings.rectified))
        except ValueError as error:
            self._robot.complain(str(error))

    def _on_odometry(self, message: Odometry) -> None:
        if message.child_frame_id != self._settings.base_frame:
            self._robot.complain(f"Odometry is of {message.child_frame_id}, not of {self._settings.base_frame}.")
            return
        try:
            self._robot.odometry(stamp_ns(message.header.stamp), pose_of(message.pose.pose))
        except ValueError as error:
            self._robot.complain(str(error))
        self._poll()

    def _on_imu(self, message: Imu) -> None:
        if message.linear_acceleration_covariance[0] < 0 or message.angular_velocity_covariance[0] < 0:
            return  # a field that the sensor does not have
        acceleration, rate = vector_of(message.linear_acceleration), vector_of(message.angular_velocity)
        self._robot.imu(stamp_ns(message.header.stamp), message.header.frame_id, acceleration, rate)

    def _on_hint(self, message: PoseWithCovarianceStamped) -> None:
        if message.header.frame_id not in ("", self._settings.map_frame):
            self.get_logger().warning(f"Hint ignored: it is in {message.header.frame_id}, not in the map's frame.")
            return
        try:
            self._robot.hint(pose_of(message.pose.pose), np.reshape(message.pose.covariance, (6, 6)))
        except ValueError as error:
            self.get_logger().warning(f"Hint ignored: {error}")

    def _on_trigger(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._robot.restart()
        response.success, response.message = True, f"Searching; poses come on {_POSE}."
        return response

    def _on_localize(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.message, estimate = self._robot.localize_once(self._client)
        response.success = estimate is not None
        if estimate is not None:
            message = filled_pose(PoseWithCovarianceStamped(), estimate, self._settings.map_frame)
            self._picture_poses.publish(message)
        return response

    def _poll(self) -> None:
        for estimate in self._robot.poll(self._now_ns * 1e-9):
            self._poses.publish(filled_pose(PoseWithCovarianceStamped(), estimate, self._settings.map_frame))

    def _broadcast(self) -> None:
        now_ns, settings = self._now_ns, self._settings
        T_map_odom = self._robot.map_to_odom(now_ns * 1e-9)
        if T_map_odom is not None:
            expires_ns = now_ns + round(settings.transform_tolerance_s * 1e9)
            frames = settings.map_frame, settings.odom_frame
            self._broadcaster.sendTransform(filled_transform(TransformStamped(), T_map_odom, *frames, expires_ns))

    def _diagnose(self) -> None:
        now_ns, message = self._now_ns, DiagnosticArray()
        set_stamp(message.header.stamp, now_ns)
        status = filled_status(DiagnosticStatus(), self._robot.diagnose(now_ns * 1e-9), KeyValue)
        message.status.append(status)
        self._diagnostics.publish(message)


def main() -> None:
    """Run the node until it is interrupted."""
    rclpy.init()
    node = LocalizationNode()
    executor = MultiThreadedExecutor(2)
    executor.add_node(node)
    try:
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
