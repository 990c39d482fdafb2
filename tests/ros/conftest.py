"""The node on a stand-in of rclpy's interface, in one process and without waiting."""

import importlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # for played_robot, ros_messages, ros_stand_in

import ros_stand_in
from played_robot import PlayedService


@pytest.fixture
def bus() -> Iterator[ros_stand_in.Bus]:
    bus = ros_stand_in.Bus()
    with ros_stand_in.installed(bus):
        yield bus


@pytest.fixture
def start(bus: ros_stand_in.Bus, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Any]]:
    """Starts a node with parameters, configured and active, on a service that is played."""
    nodes = []

    def start(service: PlayedService, **parameters: Any) -> Any:
        from rholoc_client.tracking import Tracker

        class PromptTracker(Tracker):
            """Every answer has come when the next picture does."""

            def track(self, *frame: Any) -> Any:
                if self._pending is not None:
                    self._pending.exception(10)
                return super().track(*frame)

        module = importlib.import_module("rholoc_ros.node")  # not the package's attribute: it may be of another bus
        monkeypatch.setattr(module, "Client", lambda *_, **__: service)
        monkeypatch.setattr(module, "Tracker", PromptTracker)
        bus.overrides = {"map_name": "room", "compressed": True, **parameters}
        node = module.LocalizationNode()
        nodes.append(node)
        assert node.on_configure(None) is ros_stand_in.SUCCESS
        assert node.on_activate(None) is ros_stand_in.SUCCESS
        return node

    yield start
    for node in nodes:
        node.on_shutdown(None)
