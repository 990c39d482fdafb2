"""``rholoc camera``, and commands that name a camera."""

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from rholoc.geometry import Camera
from rholoc.jobs import Job, JobPriority, JobQueue, JobState
from rholoc.library.cameras import CameraLibrary
from rholoc.library.recordings import RecordingStore
from rholoc.library.sites import SiteLibrary
from rholoc.maps import Map, MapInfo, save_map
from rholoc.progress import Stage
from rholoc.reports import ExpectedError, MapReport, TrajectoryReport

ROOT = Path(__file__).parents[2]


@pytest.fixture
def run(command, monkeypatch, tmp_path):
    """Runs a command; its exit status, standard output and error."""
    monkeypatch.setenv("RHOLOC_MAPS_DIR", str(tmp_path / "maps"))
    return command


def test_cameras_are_added_listed_shown_and_removed(run, tmp_path):
    assert run("camera", "add", "phone", "1510.2,1509.8,959.5,539.5,0.08,-0.17,0,0", "--size", "1920x1080")[0] == 0
    library = CameraLibrary(tmp_path / "maps")
    camera = Camera(1920, 1080, 1510.2, 1509.8, 959.5, 539.5, (0.08, -0.17, 0.0, 0.0))
    assert library.get("phone").camera == camera
    assert run("camera", "add", "copy", tmp_path / "maps" / "cameras" / "phone.json")[0] == 0
    assert run("camera", "add", "site", ROOT / "maps" / "testsite.rho")[0] == 0
    status, out, _ = run("camera", "list", "--json")
    assert status == 0
    assert list(json.loads(out)) == ["copy", "phone", "site"]
    assert json.loads(out)["copy"]["fx"] == 1510.2
    assert "1920x1080 1510.2,1509.8,959.5,539.5,0.08,-0.17,0,0" in run("camera", "list")[1]
    assert "1510.2" in run("camera", "show", "phone")[1]
    assert run("camera", "remove", "phone")[0] == 0
    status, _, error = run("camera", "show", "phone")
    assert status == 1
    assert error == "rholoc: There is no camera phone. There are: copy, site.\n"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("add", "x", "500,500,320,240"), "size of the camera's images is missing"),
        (("add", "x", "500,500,320,240", "--size", "big"), "size of the camera's images is missing"),
        (("add", "x", "500,500,3200,240", "--size", "640x480"), "outside the image"),
        (("add", "../x", "500,500,320,240", "--size", "640x480"), "not a valid camera name"),
        (("add", "x", "absent.json"), "absent.json"),
        (("remove", "x"), "There is no camera x"),
        (("calibrate", ".", "--board", "9", "--square-mm", "25"), "'9' is not the size of a board"),
        (("calibrate", ".", "--board", "9x6", "--square-mm", "25", "--name", "a/b"), "not a valid camera name"),
    ],
)
def test_bad_input_is_reported_in_one_line(run, words, said):
    status, out, error = run("camera", *words)
    assert (status, out) == (1, "")
    assert said in error
    assert error.count("\n") == 1


def test_a_calibrated_camera_can_be_named(run, tmp_path):
    """A board before an upright camera: half-size pictures of the camera are recognised from it."""
    camera = Camera(640, 480, 500.0, 500.0, 319.5, 239.5)
    folder = tmp_path / "pictures"
    folder.mkdir()
    for number, picture in enumerate(_board_pictures(camera)):
        cv2.imwrite(str(folder / f"{number}.png"), picture)
    chart = tmp_path / "chart.png"
    status, out, _ = run(
        *("camera", "calibrate", folder, "--board", "7x5", "--square-mm", "30"),
        *("--name", "phone", "--picture", chart, "--json"),
    )
    assert status == 0
    found = json.loads(out)
    assert found["fx"] == pytest.approx(500, abs=2)
    assert found["calibration"]["rms_px"] < 0.2
    assert found["calibration"]["sigmas"]["fx"] < 2
    assert cv2.imread(str(chart)) is not None
    assert "rms px" in run("camera", "show", "phone")[1]

    (tmp_path / "half").mkdir()
    cv2.imwrite(str(tmp_path / "half" / "1.png"), np.full((240, 320, 3), 128, np.uint8))
    map_file = ROOT / "maps" / "testsite.rho"
    words = ("localize", map_file, tmp_path / "half", "-o", tmp_path / "out.csv", "--json", "--camera")
    assert run(*words, "phone")[0] == 0
    assert "There is no camera nikon" in run(*words, "nikon")[2]


def _board_pictures(camera: Camera) -> list[np.ndarray]:
    """Ten views of a 7x5 checkerboard of 30 mm, by warping its print."""
    texel_m = 0.001
    squares = np.add.outer(np.arange(6), np.arange(8)) % 2
    texture = np.kron(squares, np.full((30, 30), 220)).astype(np.uint8) + 20
    texture = cv2.copyMakeBorder(texture, *[30] * 4, cv2.BORDER_CONSTANT, value=240)
    middle = np.array(texture.shape[::-1]) / 2
    pictures = []
    for k in range(10):
        turn = np.array([0.5 * np.cos(2.4 * k), 0.5 * np.sin(2.4 * k), 0.1 * k])
        shift = np.array([0.05 * np.cos(k), 0.03 * np.sin(3 * k), 0.38 + 0.02 * k])
        R = cv2.Rodrigues(turn)[0]
        T_camera_texture = np.column_stack([R[:, 0] * texel_m, R[:, 1] * texel_m, shift - R[:, :2] @ middle * texel_m])
        size = (camera.width, camera.height)
        picture = cv2.warpPerspective(
            texture, camera.matrix @ T_camera_texture, size, flags=cv2.INTER_AREA, borderValue=90
        )
        pictures.append(cv2.GaussianBlur(picture, (0, 0), 0.7))
    return pictures


Run = Callable[..., tuple[int, str, str]]


def with_report(map_: Map, report: MapReport) -> Map:
    info: MapInfo = replace(map_.info, report=report)
    return replace(map_, info=info)


def test_maps_are_listed_with_their_trust(point_room, tmp_path: Path, command: Run) -> None:
    map_ = point_room.map_of(point_room.walk(20), "walk")
    bent = TrajectoryReport(method="visual", trusted=False, why="Two reconstructions disagree.")
    known = ExpectedError(rms_m=0.021, worst_m=0.03, worst_time_s=1.0, views_m=(0.02, None))
    save_map(with_report(map_, MapReport()), tmp_path / "a.rho")
    save_map(with_report(map_, MapReport(trajectories=(bent,), expected_error=known)), tmp_path / "b.rho")
    (tmp_path / "c.rho").write_bytes(b"no map")
    _, printed, errors = command("map", "list", tmp_path)
    first, second = printed.splitlines()
    assert first.startswith("a: ")
    assert "expected error unknown, trusted: unknown" in first
    assert "expected error 2.1 cm, trusted: no. Two reconstructions disagree." in second
    assert "c" in errors
    rows = json.loads(command("map", "list", tmp_path, "--json")[1])
    found = [(row["name"], row["trusted"], row["expected_error_m"]) for row in rows]
    assert found == [("a", None, None), ("b", False, 0.021)]


def test_jobs_are_listed_with_their_trust(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Run) -> None:
    def job(number: int, state: JobState, warnings: tuple[str, ...], error: str | None) -> Job:
        code = None if error is None else "mapping_failed"
        return Job(
            str(number) * 32, "r" * 32, f"map-{number}", state, Stage.POSES, 1.0, "", (), warnings,
            code, error, error and "", float(number), None, None, 1,
        )  # fmt: skip

    jobs = [
        job(1, JobState.PUBLISHED, (), None),
        job(2, JobState.PUBLISHED, ("The walk is bent.",), None),
        job(3, JobState.FAILED, (), "Too dark."),
        job(4, JobState.RUNNING, (), None),
    ]
    monkeypatch.setattr(JobQueue, "list", lambda _: jobs)
    lines = [line.partition(": ")[2] for line in command("job", "list", "--data", tmp_path)[1].splitlines()]
    assert lines == [
        "map-4, running, poses",
        "map-3, failed: Too dark.",
        "map-2, published, trusted: no. The walk is bent.",
        "map-1, published, trusted: yes",
    ]
    assert [row["trusted"] for row in json.loads(command("job", "list", "--data", tmp_path, "--json")[1])] == [
        None,
        None,
        False,
        True,
    ]


def test_a_job_that_waits_gets_another_priority(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Run) -> None:
    recordings = RecordingStore(tmp_path)
    queue = JobQueue(recordings)
    job = queue.submit(recordings.create([("walk.mp4", [b"x"])]).id, "hall")
    assert command("job", "prioritize", job.id, "high", "--data", tmp_path)[0] == 0
    assert queue.get(job.id).priority is JobPriority.HIGH
    queue.close()
    assert "waiting for a worker: none is running" in command("job", "list", "--data", tmp_path)[1]


def test_a_database_that_cannot_be_used_is_one_line(command: Run, tmp_path: Path) -> None:
    (tmp_path / "jobs.sqlite").write_text("no database")
    for asked in (["list"], ["prioritize", "0" * 32, "high"]):
        status, _, said = command("job", *asked, "--data", tmp_path)
        assert (status, said.count("\n")) == (1, 1)
        assert "not a database of jobs" in said


@pytest.fixture
def maps(tmp_path: Path, point_room, picture_world) -> Path:
    """Two maps that overlap, and a room elsewhere."""
    folder = tmp_path / "maps"
    folder.mkdir()
    walk = point_room.walk(80)
    for name, poses in (("west", walk[:45:2]), ("east", walk[25:65:2])):
        save_map(point_room.map_of(poses, name), folder / f"{name}.rho")
    save_map(picture_world.map_, folder / "room.rho")
    return folder


@pytest.fixture
def site(command: Run) -> Run:
    return partial(command, "site")


def test_a_site_is_put_placed_shown_and_deleted(site: Run, maps: Path, tmp_path: Path) -> None:
    document = {"maps": [{"map": "west", "floor": "1"}, {"map": "east"}, {"map": "room"}]}
    (tmp_path / "campus.json").write_text(json.dumps(document))
    assert site("put", "campus", tmp_path / "campus.json", "--maps", maps)[0] == 0
    status, _, said = site("place", "campus", "--maps", maps)
    assert status == 0
    assert "west and east: found" in said
    assert "Nothing joins room to the others" in said
    status, shown, _ = site("show", "campus", "--maps", maps)
    assert "west, floor 1: at 0.00, 0.00, 0.00 m" in shown
    assert "room: not placed" in shown
    assert "west – east: overlap" in shown
    as_json = json.loads(site("show", "campus", "--maps", maps, "--json")[1])
    assert as_json["maps"][1]["pose"]["position"] == pytest.approx([0, 0, 0], abs=0.03)
    assert "campus: 3 maps, 2 of them placed" in site("list", "--maps", maps)[1]
    (maps / "room.rho").unlink()
    assert "there is no such map any more" in site("show", "campus", "--maps", maps)[1]
    assert site("delete", "campus", "--maps", maps)[0] == 0
    assert json.loads(site("list", "--maps", maps, "--json")[1]) == []


def test_two_maps_are_linked(site: Run, maps: Path, tmp_path: Path) -> None:
    (tmp_path / "campus.json").write_text('{"maps": [{"map": "west"}, {"map": "east"}]}')
    site("put", "campus", tmp_path / "campus.json", "--maps", maps)
    assert site("link", "campus", "west", "east", "--maps", maps)[0] == 0
    assert SiteLibrary(maps).site_of("east") == "campus"


def test_placing_is_left_to_the_workers(site: Run, command: Run, maps: Path, tmp_path: Path) -> None:
    (tmp_path / "campus.json").write_text('{"maps": [{"map": "west"}, {"map": "east"}]}')
    site("put", "campus", tmp_path / "campus.json", "--maps", maps)
    where = ("--maps", maps, "--data", tmp_path / "data", "--queue")
    status, said, _ = site("place", "campus", *where, "--json")
    assert status == 0
    (job,) = json.loads(command("job", "list", "--data", tmp_path / "data", "--json")[1])
    assert (job["id"], job["kind"], job["site"]) == (json.loads(said)["id"], "place", "campus")
    assert "site campus" in command("job", "list", "--data", tmp_path / "data")[1]
    assert site("place", "campus", *where)[0] == 1
    assert site("place", "nowhere", *where)[0] == 1


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", "is no site"),
        ('{"maps": [{"floor": "1"}]}', "maps.0.map"),
        ('{"maps": [{"map": "nowhere"}]}', "There is no map nowhere"),
        ('{"maps": [{"map": "west"}, {"map": "west"}]}', "listed twice"),
    ],
)
def test_what_can_be_no_site_is_refused_in_a_line(site: Run, maps: Path, tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "campus.json").write_text(text)
    status, _, said = site("put", "campus", tmp_path / "campus.json", "--maps", maps)
    assert status == 1
    assert says in said
    assert said.count("\n") == 1
    assert SiteLibrary(maps).names() == []
