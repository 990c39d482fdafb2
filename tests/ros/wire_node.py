"""The node in a process of its own, on DDS: python wire_node.py PARAMETERS. It runs until its input is closed."""

import importlib
import json
import sys
import threading
import time
from typing import Any

import ros_stand_in
from wire import Peer


class DdsBus(ros_stand_in.Bus):
    """Carries messages by DDS."""

    def __init__(self) -> None:
        super().__init__()
        self.peer = Peer()

    def publish(self, topic: str, message: Any) -> None:
        self.peer.write(topic, message)

    def subscribed(self, kind: str, topic: str) -> None:
        self.peer.listen(kind, topic)

    def advertised(self, kind: str, topic: str) -> None:
        self.peer.writer(kind, topic)

    def spin(self) -> None:
        """Deliver what came, and call the timers that are due."""
        self.now_ns = time.time_ns()
        for topic, message in self.peer.take():
            self.deliver(topic, message)
        self.fire()


def main() -> None:
    bus = DdsBus()
    bus.overrides = json.loads(sys.argv[1])
    with ros_stand_in.installed(bus):
        node = importlib.import_module("rholoc_ros.node").LocalizationNode()
        assert node.on_configure(None) is ros_stand_in.SUCCESS
        assert node.on_activate(None) is ros_stand_in.SUCCESS
        ended = threading.Event()
        threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
        while not ended.wait(0.002):
            bus.spin()
        node.on_shutdown(None)


if __name__ == "__main__":
    main()
