"""``rholoc track`` and ``rholoc localize`` with bags: what is written, what is refused; no network is needed."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
import tomllib
from contextlib import suppress
from pathlib import Path

import cv2
import httpx
import numpy as np
import pytest
from packaging.requirements import Requirement
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from bag_messages import bag_messages
from foxglove_client import Foxglove
from rholoc.cli.app import app
from rholoc.cli.track import KEY_VARIABLE
from rholoc.maps import read_trajectory_csv, save_map
from rholoc.service.access.keys import KeyStore, Scope
from rholoc.service.settings import KeyPolicy


@pytest.fixture
def walk(tmp_path, picture_world):
    """A map and pictures of its place."""
    save_map(picture_world.map_, tmp_path / "room.rho")
    (tmp_path / "frames").mkdir()
    for number in range(8):
        (tmp_path / "frames" / f"{number}.png").write_bytes(picture_world.png())
    return tmp_path


def topics(path):
    return [topic for topic, _, _ in bag_messages(path)]


def test_a_recording_is_tracked_into_a_bag_and_a_table(command, walk):
    status, printed, errors = command(
        "track", walk / "room.rho", walk / "frames", "-o", walk / "t.mcap", "-o", walk / "t.csv", "--json"
    )
    assert status == 0, errors
    figures = json.loads(printed)
    assert figures["frames"] == 8
    assert "film at 30 a second" in errors
    table = read_trajectory_csv(walk / "t.csv")
    tracked = 8 - figures["searching"] - figures["lost"]
    assert len(table) == tracked > 0
    written = topics(walk / "t.mcap")
    assert written.count("/visual_localization/pose") == tracked
    assert written.count("/visual_localization/status") == 8
    assert written.count("/visual_localization/recognized") == figures["asked"]


def test_a_recording_is_shown_at_its_own_pace(command, walk):
    status, printed, errors = command(
        "track", walk / "room.rho", walk / "frames", "--view", "127.0.0.1:0", "-o", walk / "t.mcap", "--json"
    )
    assert status == 0, errors
    assert "ws://127.0.0.1:" in errors
    assert json.loads(printed)["frames"] >= 1  # those that a busy machine is too slow for are left out
    assert "/map/points" in topics(walk / "t.mcap")


def test_localize_writes_a_bag(command, walk):
    status, _, errors = command("localize", walk / "room.rho", walk / "frames", "-o", walk / "t.mcap")
    assert status == 0, errors
    assert topics(walk / "t.mcap").count("/visual_localization/pose") == 8


def test_localize_shows_the_pose_of_one_picture(command, walk):
    status, printed, errors = command("localize", walk / "room.rho", walk / "frames" / "3.png", "-o", walk / "t.csv")
    assert status == 0, errors
    (row,) = read_trajectory_csv(walk / "t.csv").T_map_camera
    words = [line.split(maxsplit=1) for line in printed.splitlines()[1:]]
    shown = {name: text.strip() for name, text in words}
    assert shown["position"].split(" m ")[0] == ", ".join(f"{value:.2f}" for value in row[:3, 3])
    assert shown["heading"] == ", ".join(f"{value:.2f}" for value in row[:3, 2])
    assert float(shown["recognized"]) > 0.9


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["frames", "--motion", "odometry"], "has no odometry"),
        (["frames", "--motion", "imu"], "has no IMU"),
        (["frames", "--motion", "wheels"], "is not one of"),
        (["frames", "--mount", "1,2,3"], "x,y,z,roll,pitch,yaw"),
        (["frames", "--mount", "1,2,3,0,0,nan"], "x,y,z,roll,pitch,yaw"),
        (["frames", "-o", "t.bag"], "written as .mcap"),
        (["frames", "-o", "none/t.mcap"], "no folder"),
        (["nowhere"], "There is no nowhere"),
        (["/dev/video77"], "cannot be opened"),
        (["/dev/video77", "--frames", "1:2"], "for recordings"),
        (["rtsp://me:secret@127.0.0.1:9/stream"], "rtsp://127.0.0.1:9/stream cannot be opened"),
    ],
)
def test_what_cannot_be_tracked_is_said_in_a_line(command, walk, monkeypatch, arguments, words):
    monkeypatch.chdir(walk)
    status, _, errors = command("track", "room.rho", *arguments)
    assert status
    assert words in errors
    assert "secret" not in errors
    assert sorted(path.name for path in walk.iterdir()) == ["frames", "room.rho"]


@pytest.mark.parametrize(
    "arguments",
    [("frames", "--mqtt", "mqtt://127.0.0.1:9"), ("frames", "--motion", "imu"), ("frames", "--mavlink", "5")],
)
def test_what_fails_at_once_replaces_nothing(command, walk, monkeypatch, arguments):
    monkeypatch.chdir(walk)
    for name in ("t.mcap", "t.csv"):
        (walk / name).write_text("yesterday's")
    status, _, errors = command("track", "room.rho", *arguments, "-o", "t.mcap", "-o", "t.csv")
    assert status, errors
    assert [(walk / name).read_text() for name in ("t.mcap", "t.csv")] == ["yesterday's"] * 2


def test_what_was_tracked_before_a_damaged_picture_is_kept(command, walk):
    whole = (walk / "frames" / "6.png").read_bytes()
    (walk / "frames" / "6.png").write_bytes(whole[: len(whole) // 2])
    status, _, errors = command(
        "track", walk / "room.rho", walk / "frames", "-o", walk / "t.mcap", "-o", walk / "t.csv"
    )
    assert status
    assert "6.png" in errors
    assert len(read_trajectory_csv(walk / "t.csv")) > 0
    assert topics(walk / "t.mcap").count("/visual_localization/status") == 6


ON_BOARD = """
import json, socket, sys

class Absent:
    # What only the extras bring, and poselib, which ARM64 Linux has no wheel for.
    names = set(sys.argv.pop(1).split(","))

    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in self.names:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

def refuse(*_, **__):
    raise AssertionError("network")

sys.meta_path.insert(0, Absent())
socket.socket.connect = socket.socket.bind = refuse
from rholoc.cli import main

failed = False
for arguments in json.loads(sys.argv[1]):
    sys.argv = ["rholoc", *arguments]
    print(sys.argv, file=sys.stderr)
    try:
        main()
    except SystemExit as ended:
        failed |= bool(ended.code)
sys.exit(failed)
"""


def of_extras() -> set[str]:
    """Modules that only the extras bring."""
    named = {"opencv-python-headless": "cv2", "faiss-cpu": "faiss", "pyyaml": "yaml", "pillow": "PIL"}
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    base = {Requirement(text).name for text in project["dependencies"]}
    extras = {
        Requirement(text).name for extra in ("server", "mapping") for text in project["optional-dependencies"][extra]
    }
    modules = {named.get(name, name.replace("-", "_")) for name in extras - base} | {"poselib"}
    return modules - {"httpx", "packaging", "pydantic"}  # of the client, faiss and typer


def on_board(folder, *commands):
    """Run commands, one after the other, where no extra is installed and there is no network."""
    program = [sys.executable, "-c", ON_BOARD, ",".join(of_extras()), json.dumps(commands)]
    return subprocess.run(program, cwd=folder, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_localizing_needs_no_network_and_no_extra(walk):
    commands = (
        "track room.rho frames -o tracked.mcap",
        "camera add robot 520,520,319.5,239.5 --size 640x480",
        "track room.rho frames --camera robot -o tracked.csv",
        "localize room.rho frames -o localized.csv",
        "recording info frames",
        "map info room.rho",
        "map correct origin room.rho --at 0,0,0",
        "--version",
    )
    run = on_board(walk, *(command.split() for command in commands))
    assert run.returncode == 0, run.stderr
    for name in ("tracked.mcap", "tracked.csv", "localized.csv"):
        assert (walk / name).stat().st_size > 1000


def test_what_needs_an_extra_says_which(walk):
    run = on_board(walk, ["map", "build", "frames"], ["serve"], ["doctor"], ["demo"], ["key", "list"])
    assert run.returncode == 1
    said = re.findall(r"which is not installed\. pip install 'rholoc\[(\w+)\]'\.$", run.stderr, re.MULTILINE)
    assert said == ["mapping", "server", "server", "server", "server"]


PATIENCE_S = 60.0


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return listener.getsockname()[1]


@pytest.fixture
def running(serve, picture_world):
    """A service that shows who asks, and its keys."""
    service = serve(live=True, keys=KeyPolicy.ALWAYS)
    store = KeyStore(service.settings.data_dir)
    (service.settings.maps_dir / "hall.rho").write_bytes(picture_world.rho())
    return service, store.create("robot-7", Scope.LOCALIZE), store.create("watcher", Scope.READ)


@pytest.mark.slow
def test_robots_are_frames_of_their_names_in_the_map(running, picture_world):
    service, robot, watcher = running
    port = free_port()
    command = [sys.executable, "-m", "rholoc", "watch", "hall", "--url", service.url, "--view", f"127.0.0.1:{port}"]
    watching = subprocess.Popen(command, env=os.environ | {KEY_VARIABLE: watcher}, stderr=subprocess.PIPE, text=True)
    try:
        assert f"ws://127.0.0.1:{port}" in watching.stderr.readline()
        jpeg = cv2.imencode(".png", picture_world.image)[1].tobytes()
        headers = {"Authorization": f"Bearer {robot}", "Content-Type": "image/png"}
        answer = httpx.post(f"{service.url}/v1/maps/hall/localize", content=jpeg, headers=headers, timeout=60).json()
        assert answer["localized"]
        seen, deadline = {}, time.monotonic() + PATIENCE_S
        while not {"/tf", "/map/points"} <= seen.keys():
            assert time.monotonic() < deadline, f"only {sorted(seen)} came"
            httpx.post(f"{service.url}/v1/maps/hall/localize", content=jpeg, headers=headers, timeout=60)
            with Foxglove(port) as foxglove:
                seen |= dict(foxglove.messages(1.0))
        (transform,) = seen["/tf"].transforms
        assert (transform.header.frame_id, transform.child_frame_id) == ("map", "robot-7")
        p, q = transform.transform.translation, transform.transform.rotation
        np.testing.assert_allclose([p.x, p.y, p.z], answer["pose"]["position"], atol=1e-3)
        R = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
        np.testing.assert_allclose(R, np.array(answer["pose"]["T_map_camera"])[:3, :3], atol=1e-3)
        assert seen["/map/points"].width == len(picture_world.map_)
        watching.send_signal(signal.SIGINT)
        assert watching.wait(PATIENCE_S) == 0
    finally:
        with suppress(ProcessLookupError):
            watching.kill()
        watching.wait()
        watching.stderr.close()


def test_what_the_service_refuses_is_a_line(running, monkeypatch):
    service, _, watcher = running
    monkeypatch.setenv(KEY_VARIABLE, watcher)
    missing = CliRunner().invoke(app, ["watch", "attic", "--url", service.url, "--view", "127.0.0.1:0"])
    assert "attic" in str(missing.exception)
    monkeypatch.setenv(KEY_VARIABLE, "wrong")
    stranger = CliRunner().invoke(app, ["watch", "hall", "--url", service.url, "--view", "127.0.0.1:0"])
    assert "key" in str(stranger.exception)
