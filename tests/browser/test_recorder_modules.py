"""The recorder's modules apart from its page: what they write, the service's readers read."""

import base64
import io
import os
import re
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from playwright.sync_api import Browser, Page
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidRecording
from rholoc.recordings import read_recording
from rholoc.recordings.camera_file import read_camera_json
from rholoc.recordings.tables.own_tables import read_frames_csv, read_imu_csv

MODULES = Path(__file__).parents[2] / "client" / "page"


@pytest.fixture(scope="module")
def page(phone_browser: Browser, serve: Callable[..., Any]) -> Iterator[Page]:
    context = phone_browser.new_context(base_url=serve().url, permissions=["camera"])
    page = context.new_page()
    page.goto("/record")
    yield page
    context.close()


@pytest.fixture(scope="module")
def run(page: Page) -> Callable[..., Any]:
    """Calls an exported function of a module of the recorder, or an expression over all it exports."""

    def call(module: str, expression: str, *arguments: Any) -> Any:
        script = f"async (args) => {{ const m = await import('/web/record/{module}.js'); return {expression}; }}"
        return page.evaluate(script, list(arguments))

    return call


BYTES = "Uint8Array.from(atob(args[0]), (c) => c.charCodeAt(0))"
TO_BASE64 = "btoa(Array.from(new Uint8Array(await (BLOB).arrayBuffer()), (b) => String.fromCharCode(b)).join(''))"


def test_zip_files_are_whole_and_the_same_each_time(run):
    data = bytes(np.random.default_rng(0).integers(0, 256, 100_000, dtype=np.uint8))
    blob = """m.zip([
        {name: 'video.webm', blob: new Blob([head, tail]), crc: m.crc32(tail, m.crc32(head))},
        {name: 'größe.csv', blob: new Blob([]), crc: m.crc32(new Uint8Array())},
    ], new Date(Date.UTC(2026, 1, 3, 4, 5, 6)))"""
    halves = f"(async (bytes) => [bytes.slice(0, 70000), bytes.slice(70000)])({BYTES})"
    expression = f"(async ([head, tail]) => {TO_BASE64.replace('BLOB', blob)})(await {halves})"
    first, second = (base64.b64decode(run("zip", expression, base64.b64encode(data).decode())) for _ in range(2))
    assert first == second
    packed = zipfile.ZipFile(io.BytesIO(first))
    assert packed.testzip() is None
    assert packed.namelist() == ["video.webm", "größe.csv"]
    assert packed.read("video.webm") == data
    assert packed.getinfo("video.webm").date_time == (2026, 2, 3, 4, 5, 6)
    assert all(entry.compress_type == zipfile.ZIP_STORED for entry in packed.infolist())


def test_tables_are_read_back_as_they_were_written(run, tmp_path):
    rng = np.random.default_rng(1)
    rows = np.column_stack([np.arange(50) / 60 - 0.01, rng.normal(size=(50, 6))])
    (tmp_path / "imu.csv").write_text(run("tables", "m.imuCsv(args[0])", rows.tolist()))
    imu = read_imu_csv(tmp_path / "imu.csv")
    np.testing.assert_allclose(imu.times, rows[:, 0], atol=1e-6)
    np.testing.assert_allclose(np.hstack([imu.acceleration, imu.angular_velocity]), rows[:, 1:], rtol=1e-8)
    times = np.arange(40) / 30
    (tmp_path / "frames.csv").write_text(run("tables", "m.framesCsv(args[0])", times.tolist()))
    numbers, read = read_frames_csv(tmp_path / "frames.csv")
    np.testing.assert_array_equal(numbers, np.arange(40))
    np.testing.assert_allclose(read, times, atol=1e-6)
    (tmp_path / "camera.json").write_text(run("tables", "m.cameraJson({R_camera_imu: [[1,0,0],[0,-1,0],[0,0,-1]]})"))
    camera = read_camera_json(tmp_path / "camera.json")
    assert camera.gravity_included
    np.testing.assert_array_equal(camera.R_camera_imu, np.diag([1, -1, -1]))
    (tmp_path / "camera.json").write_text(run("tables", "m.cameraJson({R_camera_imu: null})"))
    assert read_camera_json(tmp_path / "camera.json").R_camera_imu is None


def test_waypoints_with_awkward_names_are_read_back(run, tmp_path):
    writer = cv2.VideoWriter(str(tmp_path / "video.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), 30, (64, 48))
    for level in range(60):
        writer.write(np.full((48, 64, 3), 4 * level, np.uint8))
    writer.release()
    names = ["W1", 'the "desk", left', "E"]
    points = [{"name": name, "time": i / 2, "position": [i, 0.25, -1.5]} for i, name in enumerate(names)]
    (tmp_path / "waypoints.csv").write_text(run("tables", "m.waypointsCsv(args[0])", points))
    read = read_recording(tmp_path).waypoints
    assert [one.name for one in read] == names
    assert [one.position for one in read] == [(float(i), 0.25, -1.5) for i in range(3)]


RECORD = """async ([type, milliseconds]) => {
    const stream = await navigator.mediaDevices.getUserMedia({video: {width: 320, height: 240}});
    const recorder = new MediaRecorder(stream, {mimeType: type});
    const parts = [];
    recorder.ondataavailable = ({data}) => parts.push(data);
    recorder.start(200);
    await new Promise((resolve) => setTimeout(resolve, milliseconds));
    await new Promise((resolve) => { recorder.onstop = resolve; recorder.stop(); });
    stream.getTracks().forEach((track) => track.stop());
    const bytes = new Uint8Array(await new Blob(parts).arrayBuffer());
    return btoa(Array.from(bytes, (b) => String.fromCharCode(b)).join(''));
}"""


@pytest.mark.parametrize(
    "kind",
    [
        "webm;codecs=vp8",
        *(
            pytest.param(kind, marks=pytest.mark.slow)
            for kind in ("mp4;codecs=avc1.42E01E", "webm;codecs=h264", "mp4;codecs=vp9")
        ),
    ],
)
def test_frame_times_are_those_that_the_reader_finds(run, page, tmp_path, kind):
    video = tmp_path / ("video." + kind.split(";")[0])
    expected = np.zeros(0)
    for milliseconds in (2_500, 10_000, 40_000):  # software encoders drop most frames of a busy machine
        data = base64.b64decode(page.evaluate(RECORD, [f"video/{kind}", milliseconds]))
        video.write_bytes(data)
        try:
            expected = read_recording(video).frames.times
        except InvalidRecording:  # not one frame
            continue
        if len(expected) >= 2:
            break
    assert len(expected) >= 2
    times = run("container", f"m.frameTimes(new Blob([{BYTES}]))", base64.b64encode(data).decode())
    np.testing.assert_allclose(times, expected - expected[0], atol=0.0015)
    cut = run("container", f"m.frameTimes(new Blob([{BYTES}]))", base64.b64encode(data[:-1]).decode())
    assert len(times) - 1 <= len(cut) <= len(times)
    np.testing.assert_allclose(cut, times[: len(cut)], atol=1e-9)


@pytest.mark.parametrize(
    "data", [b"", b"no video at all", b"\x1a\x45\xdf\xa3" + bytes(50), b"\0\0\0\x20ftypisom\0\0\0\0"]
)
def test_what_is_no_video_has_no_frame_times(run, data):
    assert run("container", f"m.frameTimes(new Blob([{BYTES}]))", base64.b64encode(data).decode()) is None


@pytest.mark.parametrize("seed", range(5))
def test_recorded_frames_get_the_times_at_which_they_were_seen(run, seed):
    """The page misses some frames, the recorder drops some, and neither knows the other's clock."""
    rng = np.random.default_rng(seed)
    taken = 100 + np.arange(300) / 30 + rng.uniform(-0.006, 0.006, 300)
    started = taken[20] - rng.uniform(0.001, 0.02)
    kept = np.sort(np.concatenate([[20], rng.choice(np.arange(21, 290), 240, replace=False)]))
    seen = np.sort(rng.choice(taken, 250, replace=False))
    recorded = np.round(taken[kept] - taken[kept[0]], 3)
    found = np.array(run("clock", "m.clockTimes(...args)", recorded.tolist(), seen.tolist(), started))
    np.testing.assert_allclose(found, taken[kept], atol=0.0015)
    assert (np.diff(found) > 0).all()
    assert np.median(np.abs(found - taken[kept])) < 1e-6


def test_a_perfectly_steady_camera_begins_with_the_first_frame_after_the_start(run):
    taken = 7 + np.arange(120) / 30
    recorded = (taken[30:100] - taken[30]).tolist()
    found = run("clock", "m.clockTimes(...args)", recorded, taken.tolist(), float(taken[30]) - 0.01)
    np.testing.assert_allclose(found, taken[30:100], atol=1e-9)


def test_without_seen_frames_times_count_from_the_start(run):
    assert run("clock", "m.clockTimes([0, 0.5], [], 3)") == [3, 3.5]


def test_motion_becomes_rows_of_table_3(run):
    event = {
        "timeStamp": 1500,
        "accelerationIncludingGravity": {"x": 1, "y": 2, "z": 3},
        "rotationRate": {"alpha": 180, "beta": 0, "gamma": -90},
    }
    np.testing.assert_allclose(run("motion", "m.motionRow(args[0])", event), [1.5, 1, 2, 3, np.pi, 0, -np.pi / 2])
    np.testing.assert_allclose(run("motion", "m.motionRow(args[0], -1)", event)[1:5], [-1, -2, -3, np.pi])
    without = {**event, "rotationRate": {"alpha": None, "beta": None, "gamma": None}}
    assert run("motion", "m.motionRow(args[0])", without) is None
    assert run("motion", "m.missingSensors(args[0])", without) == ["gyroscope"]
    assert run("motion", "m.missingSensors(args[0])", {"timeStamp": 0}) == ["accelerometer", "gyroscope"]


@pytest.mark.parametrize(("sign", "platform"), [(1, "the standard"), (-1, "iPhones")])
def test_the_sign_of_acceleration_is_found_by_comparing_it_with_what_is_up(run, sign, platform):
    for yaw, beta, gamma in [(0, 85, 0), (120, 60, 20), (-40, 90, -60), (10, 5, 3)]:
        up = Rotation.from_euler("ZXY", [yaw, beta, gamma], degrees=True).as_matrix()[2]
        np.testing.assert_allclose(run("motion", "m.upward(args[0])", {"beta": beta, "gamma": gamma}), up, atol=1e-9)
        read = dict(zip("xyz", (sign * 9.81 * up).tolist(), strict=True))
        assert run("motion", "m.accelerationSign(...args)", read, up.tolist()) == sign
    assert run("motion", "m.accelerationSign({x: 9.8, y: 0, z: 0}, [0, 1, 0])") == 0


@pytest.mark.parametrize("angle", [0, 90, 180, 270])
def test_the_camera_on_the_back_is_mounted_as_the_screen_is_turned(run, angle):
    R = np.array(run("motion", "m.R_camera_imu(args[0])", angle))
    upright = np.diag([1, -1, -1]) @ Rotation.from_euler("z", angle, degrees=True).as_matrix()
    np.testing.assert_allclose(R, upright, atol=1e-12)
    # Held so that the picture is upright, the device axis that is up is the camera's -y.
    gravity = upright.T @ [0, -9.81, 0]
    assert run("coaching", "m.rollDegrees(...args)", gravity.tolist(), angle) == pytest.approx(0, abs=1e-9)


def test_roll_is_how_far_the_picture_leans(run):
    lean = np.radians(25)
    right = [9.81 * np.sin(-lean), 9.81 * np.cos(lean), 0.5]
    assert run("coaching", "m.rollDegrees(args[0])", right) == pytest.approx(25)
    assert run("coaching", "m.rollDegrees([0.1, 0.2, 9.8])") is None


GOOD = {"turnDegS": 10, "light": 0.5, "rollDeg": 3, "imuHz": 60}


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({}, None),
        ({"turnDegS": 80}, "too-fast"),
        ({"light": 0.05}, "too-dark"),
        ({"rollDeg": -30}, "not-upright"),
        ({"imuHz": 12}, "slow-sensors"),
        ({"stoodS": 5}, None),
        ({"stoodS": 7}, "standing"),
        ({"light": None, "rollDeg": None, "imuHz": None, "turnDegS": 0}, None),
    ],
)
def test_advice_is_given_where_something_is_wrong(run, changes, code):
    advised = run("coaching", "m.advice(args[0])", {**GOOD, **changes})
    assert (advised and advised["code"]) == code


def test_brightness_and_turning_are_measured(run):
    assert run("coaching", "m.brightness(m.greyLevels([255, 255, 255, 255, 0, 0, 0, 255]))") == pytest.approx(0.5)
    rows = [[0, 0, 0, 0, 0.3, 0, 0.4], [0.1, 0, 0, 0, 0, 0, 0]]
    assert run("coaching", "m.turnRate(args[0])", rows) == pytest.approx(np.degrees(0.25))
    assert run("coaching", "m.turnRate([])") == 0
    assert run("motion", "m.rate([0, 0.1, 0.2, 0.3])") == pytest.approx(10)


def test_waypoints_are_marked_in_order_and_new_ones_named(run):
    marked = "[1, 2, 3, 3.5, 4, 5, 6].reduce((points, time) => m.marked(points, time), m.planned())"
    points = run("waypoints", marked)
    assert [one["name"] for one in points] == ["W1", "W2", "W3", "E", "W4", "W5"]
    assert [one["time"] for one in points] == [1, 2, 3, 4, 5, 6]


@pytest.mark.parametrize(
    ("text", "value"),
    [("1.25", 1.25), (" -0,5 ", -0.5), ("+3", 3), (".5", 0.5), ("", None), ("1e3", None), ("a", None)],
)
def test_coordinates_are_read_as_people_type_them(run, text, value):
    assert run("waypoints", "m.coordinate(args[0])", text) == value


SQUARE = [[0, 0, 1.5], [2, 0, 1.5], [2, 3, 1.5], [0, 3, 1.5]]


@pytest.mark.parametrize(
    ("positions", "words"),
    [
        (SQUARE, None),
        (SQUARE[:3], None),
        (SQUARE[:2], "2 of at least 3"),
        ([], None),
        ([[0, 0, 0], [1, 1, 1], [2, 2, 2.01]], "one line"),
        ([[0, 0, 0], [0, 0, 0], [0, 0, 0]], "one line"),
        ([*SQUARE, [None, 1, 1]], None),
    ],
)
def test_waypoints_that_do_not_fix_a_frame_are_reported(run, positions, words):
    points = [{"name": f"W{i}", "time": float(i), "position": p} for i, p in enumerate(positions)]
    problem = run("waypoints", "m.problem(args[0])", points)
    assert problem is None if words is None else words in problem


def test_two_waypoints_of_one_name_are_reported(run):
    points = [{"name": "W1", "time": float(i), "position": p} for i, p in enumerate(SQUARE)]
    assert "called W1" in run("waypoints", "m.problem(args[0])", points)


def test_all_that_the_recorder_is_made_of_is_kept_for_use_without_a_connection():
    page = (MODULES / "record" / "index.html").read_text(encoding="utf-8")
    made_of = {MODULES / name for name in re.findall(r'(?:href|src)="web/([^"]+)"', page)}
    modules = [path for path in made_of if path.suffix == ".js"]
    while modules:
        module = modules.pop()
        imports = re.findall(r'(?:from |new URL\()"(\.[^"]+\.js)"', module.read_text(encoding="utf-8"))  # and workers
        found = {(module.parent / name).resolve() for name in imports} - made_of
        made_of |= found
        modules += found
    worker = (MODULES / "record" / "service-worker.js").read_text(encoding="utf-8")
    listed = re.findall(r'^  "([^"]+)",$', worker, re.MULTILINE)
    assert sorted(listed) == listed
    assert set(listed) == {os.path.relpath(path, MODULES) for path in made_of}
