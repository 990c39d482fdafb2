"""A stand-in of what the node uses of rclpy and tf2_ros. SciPy evaluates the transforms, not the client."""

import sys
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import Enum
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
from ros_messages import STORE, message_class
from scipy.spatial.transform import Rotation, Slerp

_PACKAGES = ("diagnostic_msgs", "geometry_msgs", "nav_msgs", "rcl_interfaces", "sensor_msgs", "tf2_msgs")


class Return(Enum):
    SUCCESS, FAILURE, ERROR = range(3)


SUCCESS = Return.SUCCESS


class Bus:
    """Carries messages, and keeps the time [ns]."""

    def __init__(self) -> None:
        self.now_ns = 1_000_000_000_000
        self.sent: dict[str, list[Any]] = defaultdict(list)
        self.callbacks: dict[str, list[Callable[[Any], None]]] = defaultdict(list)
        self.services: dict[str, Callable[[Any, Any], Any]] = {}
        self.timers: list[list[Any]] = []  # period, callback, when next
        self.overrides: dict[str, Any] = {}
        self.log: list[str] = []

    def publish(self, topic: str, message: Any) -> None:
        self.sent[topic.lstrip("/")].append(message)
        self.deliver(topic, message)

    def deliver(self, topic: str, message: Any) -> None:
        for callback in [*self.callbacks[topic.lstrip("/")]]:
            callback(message)

    def subscribed(self, kind: str, topic: str) -> None:
        """A node listens to a topic."""

    def advertised(self, kind: str, topic: str) -> None:
        """A node may write on a topic."""

    def fire(self) -> None:
        """Call the timers that are due."""
        for timer in [*self.timers]:
            if timer[2] <= self.now_ns:
                timer[2] = self.now_ns + round(timer[0] * 1e9)
                timer[1]()

    def sleep(self, seconds: float) -> None:
        """Let time pass, by the clock that is played."""
        for _ in range(round(seconds / 0.01)):
            self.now_ns += 10_000_000
            self.fire()


class _Publisher:
    def __init__(self, bus: Bus, topic: str, is_managed: bool) -> None:
        self.bus, self.topic, self.enabled = bus, topic, not is_managed

    def publish(self, message: Any) -> None:
        if self.enabled:
            self.bus.publish(self.topic, message)


def _node_class(bus: Bus) -> type:
    class LifecycleNode:
        def __init__(self, name: str) -> None:
            self._parameters: dict[str, Any] = {}
            self._publishers: list[_Publisher] = []

        def declare_parameter(self, name: str, default: Any, descriptor: Any) -> None:
            self._parameters[name] = bus.overrides.get(name, default)

        def get_parameter(self, name: str) -> Any:
            return SimpleNamespace(value=self._parameters[name])

        def get_clock(self) -> Any:
            return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=bus.now_ns))

        def get_logger(self) -> Any:
            return SimpleNamespace(error=bus.log.append, warning=bus.log.append, info=bus.log.append)

        def create_publisher(self, kind: Any, topic: str, qos: Any) -> _Publisher:
            bus.advertised(kind.kind, topic.lstrip("/"))
            return _Publisher(bus, topic, is_managed=False)

        def create_lifecycle_publisher(self, kind: Any, topic: str, qos: Any) -> _Publisher:
            bus.advertised(kind.kind, topic.lstrip("/"))
            self._publishers.append(_Publisher(bus, topic, is_managed=True))
            return self._publishers[-1]

        def create_subscription(self, kind: Any, topic: str, callback: Any, qos: Any) -> Any:
            bus.callbacks[topic.lstrip("/")].append(callback)
            bus.subscribed(kind.kind, topic.lstrip("/"))
            return topic.lstrip("/"), callback

        def create_service(self, kind: Any, name: str, callback: Any, callback_group: Any = None) -> Any:
            bus.services[name] = callback
            return name

        def create_timer(self, seconds: float, callback: Any) -> Any:
            bus.timers.append([seconds, callback, bus.now_ns])
            return bus.timers[-1]

        def destroy_subscription(self, subscription: Any) -> None:
            bus.callbacks[subscription[0]].remove(subscription[1])

        def destroy_service(self, name: str) -> None:
            del bus.services[name]

        def destroy_timer(self, timer: Any) -> None:
            bus.timers.remove(timer)

        def destroy_lifecycle_publisher(self, publisher: _Publisher) -> None:
            self._publishers.remove(publisher)

        def on_activate(self, state: Any) -> Return:
            for publisher in self._publishers:
                publisher.enabled = True
            return SUCCESS

        def on_deactivate(self, state: Any) -> Return:
            for publisher in self._publishers:
                publisher.enabled = False
            return SUCCESS

    return LifecycleNode


class TransformException(Exception):
    pass


class Buffer:
    """Transforms by time, interpolated, never extrapolated; those of ``/tf_static`` hold always."""

    def __init__(self) -> None:
        self.of: dict[str, tuple[str, list[tuple[int, np.ndarray]]]] = {}
        self.static: set[str] = set()

    def add(self, message: Any, is_static: bool) -> None:
        for one in message.transforms:
            t, q = one.transform.translation, one.transform.rotation
            T = np.eye(4)
            T[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
            T[:3, 3] = t.x, t.y, t.z
            stamp_ns = one.header.stamp.sec * 10**9 + one.header.stamp.nanosec
            samples = self.of.setdefault(one.child_frame_id, (one.header.frame_id, []))[1]
            if samples and stamp_ns < samples[-1][0] - 10**9:
                samples.clear()  # the clock went back
            samples.append((stamp_ns, T))
            if is_static:
                self.static.add(one.child_frame_id)

    def ancestors(self, frame: str) -> list[str]:
        """The frame, its parent, and so on to the root."""
        found = [frame]
        while found[-1] in self.of:
            found.append(self.of[found[-1]][0])
        return found

    def up(self, ancestor: str, frame: str, stamp_ns: int) -> np.ndarray:
        """T_ancestor_frame."""
        T = np.eye(4)
        while frame != ancestor:
            parent, samples = self.of[frame]
            T = (samples[-1][1] if frame in self.static else self._at(samples, stamp_ns)) @ T
            frame = parent
        return T

    def lookup_transform(self, target: str, source: str, time: Any) -> Any:
        above = self.ancestors(target)
        common = next((one for one in self.ancestors(source) if one in above), None)
        if common is None:
            raise TransformException(f"{target} and {source} are not connected")
        T_root_target, T_root_source = (self.up(common, one, time.nanoseconds) for one in (target, source))
        T = np.linalg.inv(T_root_target) @ T_root_source
        found = message_class("geometry_msgs/msg/TransformStamped")()
        t, q = found.transform.translation, found.transform.rotation
        t.x, t.y, t.z = T[:3, 3].tolist()
        q.x, q.y, q.z, q.w = Rotation.from_matrix(T[:3, :3]).as_quat().tolist()
        return found

    @staticmethod
    def _at(samples: list[tuple[int, np.ndarray]], stamp_ns: int) -> np.ndarray:
        times = np.array([one[0] for one in samples], dtype=np.int64)
        if not times[0] <= stamp_ns <= times[-1]:
            raise TransformException("this would be an extrapolation")
        i = int(np.searchsorted(times, stamp_ns))
        if times[i] == stamp_ns:
            return samples[i][1]
        share = (stamp_ns - times[i - 1]) / (times[i] - times[i - 1])
        before, after = samples[i - 1][1], samples[i][1]
        T = np.eye(4)
        T[:3, :3] = Slerp([0, 1], Rotation.from_matrix([before[:3, :3], after[:3, :3]]))(share).as_matrix()
        T[:3, 3] = (1 - share) * before[:3, 3] + share * after[:3, 3]
        return T


class TransformListener:
    def __init__(self, buffer: Buffer, node: Any) -> None:
        kind = message_class("tf2_msgs/msg/TFMessage")
        for topic, is_static in (("/tf", False), ("/tf_static", True)):
            node.create_subscription(kind, topic, lambda one, is_static=is_static: buffer.add(one, is_static), 100)

    def unregister(self) -> None:
        pass


class TransformBroadcaster:
    def __init__(self, node: Any) -> None:
        self.publisher = node.create_publisher(message_class("tf2_msgs/msg/TFMessage"), "/tf", 100)

    def sendTransform(self, transform: Any) -> None:
        message = message_class("tf2_msgs/msg/TFMessage")()
        message.transforms.append(transform)
        self.publisher.publish(message)


@contextmanager
def installed(bus: Bus) -> Iterator[None]:
    """The modules of ROS, as long as it lasts."""
    trigger = SimpleNamespace(Request=SimpleNamespace, Response=SimpleNamespace)
    parts: dict[str, dict[str, Any]] = {
        "rclpy": {"init": lambda: None, "try_shutdown": lambda: None},
        "rclpy.callback_groups": {"MutuallyExclusiveCallbackGroup": object},
        "rclpy.executors": {"ExternalShutdownException": RuntimeError, "MultiThreadedExecutor": object},
        "rclpy.lifecycle": {
            "LifecycleNode": _node_class(bus),
            "LifecycleState": object,
            "TransitionCallbackReturn": Return,
        },
        "rclpy.qos": {"qos_profile_sensor_data": object()},
        "rclpy.time": {"Time": SimpleNamespace},
        "std_srvs": {},
        "std_srvs.srv": {"Trigger": trigger},
        "tf2_ros": {one.__name__: one for one in (Buffer, TransformBroadcaster, TransformException, TransformListener)},
    }
    for package in _PACKAGES:
        names = [name for name in STORE.fielddefs if name.startswith(f"{package}/msg/")]
        parts[package] = {}
        parts[f"{package}.msg"] = {name.rpartition("/")[2]: message_class(name) for name in names}
    modules = {name: ModuleType(name) for name in parts}
    for name, values in parts.items():
        vars(modules[name]).update(values)
    sys.modules.update(modules)
    try:
        yield
    finally:
        for name in (*modules, "rholoc_ros.node"):
            sys.modules.pop(name, None)
