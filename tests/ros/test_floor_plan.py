"""A map's floor plan for map_server, and what is installed where ROS looks for it."""

import re
import runpy
import sys
from pathlib import Path
from types import ModuleType
from unittest.mock import MagicMock
from xml.etree import ElementTree

import cv2
import httpx
import numpy as np
import pytest
import yaml

from rholoc_ros.floor_plan import PlanPlace, fetch_plan, main, occupancy
from rholoc_ros.settings import DEFAULTS

ROS = Path(__file__).parents[2] / "ros"


@pytest.mark.parametrize("turn_deg", [0.0, 90.0, 30.0])
@pytest.mark.parametrize("resolution_m", [0.02, 0.05])
def test_a_wall_lies_where_the_plan_has_it(turn_deg, resolution_m):
    """As map_server reads it: pixel (u, v) is at origin + resolution · (u + ½, rows − v − ½)."""
    plan = np.full((200, 300), 255, np.uint8)
    plan[40:42, 50:250] = 0  # a wall of 4 m
    place = PlanPlace((-1.0, 2.0), turn_deg, 0.02)
    grey, corner = occupancy(plan, place, resolution_m)
    v, u = np.nonzero(grey == 0)
    found = np.column_stack([corner[0] + resolution_m * (u + 0.5), corner[1] + resolution_m * (len(grey) - v - 0.5)])
    turn = np.deg2rad(turn_deg)
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    along = np.column_stack([np.linspace(50, 250, 50) * 0.02, np.full(50, (200 - 41) * 0.02)]) @ R.T + place.corner
    apart = np.linalg.norm(found[:, None] - along, axis=2)
    assert apart.min(axis=0).max() < 1.5 * resolution_m  # all of it
    assert apart.min(axis=1).max() < 2.5 * resolution_m + 0.05  # and nothing else
    assert (grey == 205).any() == (turn_deg == 30.0)


def test_the_map_is_fetched_and_written(monkeypatch, tmp_path):
    pixels = np.zeros((40, 60, 4), np.uint8)
    pixels[:, :30] = 0, 0, 0, 255  # the right half is transparent
    png = cv2.imencode(".png", pixels)[1].tobytes()
    plan = {"media_type": "image/png", "corner": [1.0, 2.0], "turn_deg": 0.0, "m_per_unit": 0.05}

    def answer(request):
        assert request.headers["Authorization"] == "Bearer secret"
        return (
            httpx.Response(200, content=png)
            if request.url.path.endswith("/plan")
            else httpx.Response(200, json={"plan": plan})
        )

    serve_by(monkeypatch, answer)
    monkeypatch.setenv("RHOLOC_API_KEY", "secret")
    main(["office", str(tmp_path / "office.yaml")])
    written = yaml.safe_load((tmp_path / "office.yaml").read_text())
    assert (written["resolution"], written["origin"], written["negate"]) == (0.05, [1.0, 2.0, 0.0], 0)
    grey = cv2.imread(str(tmp_path / written["image"]), cv2.IMREAD_GRAYSCALE)
    assert grey.shape == (40, 60)
    assert grey[0, 0] == 0
    assert grey[0, -1] == 255


@pytest.mark.parametrize(
    ("answered", "message"),
    [
        (httpx.Response(200, json={"plan": None}), "has no floor plan"),
        (httpx.Response(200, json={"plan": {"media_type": "application/geo+json"}}), "has no pixels"),
        (httpx.Response(404), "404"),
    ],
)
def test_a_map_without_a_plan_is_one_line(monkeypatch, tmp_path, answered, message):
    serve_by(monkeypatch, lambda request: answered)
    with pytest.raises(SystemExit, match=message):
        main(["office", str(tmp_path / "office.yaml")])
    assert not list(tmp_path.iterdir())


def serve_by(monkeypatch, answer):
    made = httpx.Client
    monkeypatch.setattr(httpx, "Client", lambda **options: made(transport=httpx.MockTransport(answer), **options))


def test_a_services_own_map_has_its_plan(service):
    """The service's routes, from a plan that is sent to them."""
    png = cv2.imencode(".png", np.full((20, 30), 200, np.uint8))[1].tobytes()
    with httpx.Client(base_url=service.url, timeout=30) as http:
        place = {"x": 1.0, "y": -2.0, "turn_deg": 15.0, "m_per_unit": 0.1}
        sent = http.put("/v1/maps/room/plan", params=place, content=png, headers={"Content-Type": "image/png"})
        sent.raise_for_status()
        pixels, found = fetch_plan(http, "room")
    assert (found.corner, found.turn_deg, found.m_per_unit) == ((1.0, -2.0), 15.0, 0.1)
    assert (pixels.shape[:2], pixels.min()) == ((20, 30), 200)


def test_the_parameters_of_the_launch_files_exist():
    for file in (ROS / "config").glob("*.yaml"):
        parameters = yaml.safe_load(file.read_text())["rholoc"]["ros__parameters"]
        assert parameters.keys() <= DEFAULTS.keys(), file.name
        assert all(type(value) is type(DEFAULTS[name]) for name, value in parameters.items()), file.name


def test_every_parameter_and_topic_is_documented():
    page = (ROS / "README.md").read_text()
    source = (ROS / "rholoc_ros" / "node.py").read_text()
    for name in DEFAULTS:
        assert f"`{name}`" in page, name
    for topic in re.findall(r'"(visual_localization/\w+)"', source):
        assert f"`{topic}`" in page, topic


@pytest.mark.parametrize("name", ["camera", "nav2", "robot_localization"])
def test_launch_files_describe_nodes_that_exist(name, monkeypatch):
    """On stand-ins of launch and launch_ros: they run, and name this package's executables and files."""
    modules = ("launch", "launch.actions", "launch.conditions", "launch.events", "launch.substitutions")
    modules += ("launch.launch_description_sources", "launch_ros", "launch_ros.actions", "launch_ros.event_handlers")
    modules += ("launch_ros.events", "launch_ros.events.lifecycle", "launch_ros.substitutions")
    modules += ("lifecycle_msgs", "lifecycle_msgs.msg")
    stand_ins = {module: MagicMock(spec_set=None) for module in modules}
    for module, stand_in in stand_ins.items():
        monkeypatch.setitem(sys.modules, module, stand_in)
    runpy.run_path(str(ROS / "launch" / f"{name}.launch.py"))["generate_launch_description"]()
    joined = [call.args[0] for call in stand_ins["launch.substitutions"].PathJoinSubstitution.call_args_list]
    share = stand_ins["launch_ros.substitutions"].FindPackageShare
    assert share.call_args_list
    for _, folder, file in joined:
        assert folder in ("config", "launch", "params")
        assert (ROS / folder / file).is_file() or file in ("navigation_launch.py", "nav2_params.yaml")
    scripts = installed(monkeypatch)["entry_points"]["console_scripts"]
    names = [script.partition(" =")[0] for script in scripts]
    for call in stand_ins["launch_ros.actions"].LifecycleNode.call_args_list:
        if call.kwargs["package"] == "rholoc_ros":
            assert call.kwargs["executable"] in names


def test_the_package_is_installed_where_ros_looks_for_it(monkeypatch):
    options = installed(monkeypatch)
    package = ElementTree.parse(ROS / "package.xml").getroot()
    assert package.findtext("name") == options["name"] == "rholoc_ros"
    assert package.findtext("version") == options["version"]
    assert package.findtext("license") == options["license"] == "Apache-2.0"
    assert package.findtext("export/build_type") == "ament_python"
    placed = dict(options["data_files"])
    assert placed["share/ament_index/resource_index/packages"] == ["resource/rholoc_ros"]
    assert len(placed["share/rholoc_ros/launch"]) == len(placed["share/rholoc_ros/config"]) == 3
    depended = {one.text for one in package.findall("exec_depend")}
    source = (ROS / "rholoc_ros" / "node.py").read_text()
    imported = set(re.findall(r"^(?:from|import) (\w+)", source, re.MULTILINE))
    assert {
        one for one in imported if one.endswith("_msgs") or one in ("rclpy", "rcl_interfaces", "tf2_ros", "std_srvs")
    } <= depended


def test_only_the_node_imports_ros_and_nothing_imports_the_server():
    ros = re.compile(r"^\s*(?:from|import) (rclpy|rcl_interfaces|tf2_ros|\w+_msgs|std_srvs)\b", re.MULTILINE)
    server = re.compile(r"^\s*(?:from|import) rholoc\b", re.MULTILINE)
    files = list((ROS / "rholoc_ros").glob("*.py"))
    assert [file.name for file in files if ros.search(file.read_text())] == ["node.py"]
    assert not [file.name for file in files if server.search(file.read_text())]


def installed(monkeypatch):
    """What setup.py says."""
    said = {}
    stand_in = ModuleType("setuptools")
    stand_in.setup = lambda **options: said.update(options)
    monkeypatch.setitem(sys.modules, "setuptools", stand_in)
    monkeypatch.chdir(ROS)
    runpy.run_path("setup.py")
    return said
