"""``rholoc track`` and ``rholoc localize`` with bags: what is written, what is refused; no network is needed."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from bag_messages import bag_messages
from rholoc.maps import read_trajectory_csv, save_map


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


def test_localize_writes_a_bag(command, walk):
    status, _, errors = command("localize", walk / "room.rho", walk / "frames", "-o", walk / "t.mcap")
    assert status == 0, errors
    assert topics(walk / "t.mcap").count("/visual_localization/pose") == 8


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


def test_it_needs_no_network_no_server_and_nothing_that_only_mapping_needs(walk):
    code = """
import sys, socket
def refuse(*_, **__): raise AssertionError("network")
socket.socket.connect = socket.socket.bind = refuse
from rholoc.cli import main
sys.argv = ["rholoc", "track", "room.rho", "frames", "-o", "t.mcap"]
main()
heavy = {"gtsam", "pycolmap", "fastapi", "sqlalchemy", "uvicorn", "matplotlib", "obstore", "psycopg"}
assert not heavy & set(sys.modules), heavy & set(sys.modules)
"""
    run = subprocess.run([sys.executable, "-c", code], cwd=walk, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert (walk / "t.mcap").is_file()
