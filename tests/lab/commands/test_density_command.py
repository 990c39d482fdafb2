"""``rholoc map density``: what it draws can be read, and what it cannot draw it says; ``rholoc paper``."""

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest

from rholoc.density import DensityKind
from rholoc.mapping.build.density_fitting import fit_densities
from rholoc.maps import Map, load_map, observations_csv, read_trajectory_csv, save_map
from rholoc.paper.landscape import Grid, Look, over_headings, over_picture, over_positions
from rholoc.paper.observation_table import observation_table
from rholoc.recordings import CameraFile, write_camera_json
from rholoc.simulation import Light, simulate_recording

Run = Callable[..., tuple[int, str, str]]
SHIPPED = Path(__file__).parents[3] / "maps"


@pytest.fixture(scope="module")
def hall(point_room: Any) -> Map:
    return point_room.map_of(point_room.walk(150)[:20], "walk")


@pytest.fixture
def rholoc(command: Run) -> Run:
    """Runs ``rholoc map``: arguments → (exit status, standard output, standard error)."""
    return partial(command, "map")


@pytest.fixture
def file(hall: Map, tmp_path: Path) -> Path:
    """The map ``hall`` in a file."""
    save_map(hall, tmp_path / "hall.rho")
    return tmp_path / "hall.rho"


def _most_seen(map_: Map) -> int:
    return int(np.argmax(np.bincount(map_.observations.features)))


@pytest.mark.parametrize("kind", list(DensityKind))
def test_every_form_peaks_where_its_feature_appears(hall: Map, kind: DensityKind) -> None:
    map_, feature = fit_densities(hall, kind), _most_seen(hall)
    views = hall.observations.views[hall.observations.features == feature]
    look = Look.of_view(map_, feature, int(views[len(views) // 2]))
    values, pixels = over_picture(map_, look, 60.0, 10.0)
    peak = pixels.reshape(-1, 2)[np.argmax(values)]
    assert values.max() > 0.9
    assert np.linalg.norm(peak - look.pixel) < 15.0
    grid = Grid.about(look.T_map_camera[:3, 3], (0.2, 0.2, 0.0), 0.1)
    around = over_positions(map_, look, grid, 60.0)
    assert around.shape == (1, 5, 5)
    assert around[0, 2, 2] > 0.9
    headings, up, aside = over_headings(map_, look, np.deg2rad(20), 9, 60.0)
    assert up[4] == aside[4] == 0.0
    assert headings[4, 4] > 0.9 > 0.5 > headings[0, 0]


@pytest.mark.parametrize(
    "more", [pytest.param(("--pixel", "300,200", "--tolerance", "20"), marks=pytest.mark.slow), ("--sharpening",)]
)
def test_a_picture(rholoc: Run, file: Path, hall: Map, more: tuple[str, ...]) -> None:
    out = file.with_name("density.png")
    status, _, errors = rholoc("density", file, "--feature", _most_seen(hall), "-o", out, *more)
    assert status == 0, errors
    picture = cv2.imread(str(out))
    assert picture.shape[1] > 800
    assert picture.std() > 10


def test_a_volume_opens_as_an_image(rholoc: Run, file: Path, hall: Map) -> None:
    out = file.with_name("density.vti")
    assert rholoc("density", file, "--feature", _most_seen(hall), "-o", out)[0] == 0
    image = ElementTree.parse(out).getroot()[0]
    extent = [int(number) for number in image.attrib["WholeExtent"].split()]
    points = np.prod([high - low + 1 for low, high in zip(extent[::2], extent[1::2], strict=True)])
    arrays = {array.attrib["Name"]: np.array(array.text.split(), dtype=float) for array in image.iter("DataArray")}
    assert set(arrays) == {"rho", "may_be_seen"}
    assert all(len(values) == points for values in arrays.values())
    assert 0.3 < arrays["rho"].max() <= 1.0
    assert min(float(step) for step in image.attrib["Spacing"].split()) > 0


@pytest.mark.slow
@pytest.mark.parametrize("ending", [".gif", ".mp4"])
def test_a_film_has_a_picture_for_every_view(rholoc: Run, file: Path, ending: str, tmp_path: Path) -> None:
    map_ = load_map(file)
    feature = int(np.argmin(np.abs(np.bincount(map_.observations.features) - 3)))
    out = tmp_path / f"density{ending}"
    status, _, errors = rholoc("density", file, "--feature", feature, "-o", out)
    assert status == 0, errors
    film, count = cv2.VideoCapture(str(out)), 0
    while film.read()[0]:
        count += 1
    assert count == np.bincount(map_.observations.features)[feature]


@pytest.mark.parametrize("ending", [".png", pytest.param(".vti", marks=pytest.mark.slow)])
def test_a_localization_is_shown(rholoc: Run, ending: str, tmp_path: Path) -> None:
    out = tmp_path / f"way{ending}"
    camera = json.loads((SHIPPED / "queries" / "camera.json").read_text())
    intrinsics = ",".join(str(camera[name]) for name in ("fx", "fy", "cx", "cy"))
    query = SHIPPED / "queries" / "1.jpg"
    arguments = ("--picture", query, "--camera", intrinsics, "--starts", "2", "-o", out)
    status, _, errors = rholoc("density", SHIPPED / "testsite.rho", *arguments)
    assert status == 0, errors
    assert out.stat().st_size > 1000


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("--feature", "100000"), "has no feature 100000"),
        (("--feature", "-1"), "has no feature -1"),
        (("--feature", "0", "--view", "999"), "has no view 999"),
        (("--feature", "0", "--pixel", "here"), "'here' is not a pixel"),
        (("--feature", "0", "--pixel", "nan,2"), "is not a pixel"),
        (("--feature", "0", "-o", "x.bmp"), "does not end in .png"),
        (("--feature", "0", "--sharpening", "-o", "x.gif"), "does not end in .png"),
        (("--picture", "nowhere.jpg"), "nowhere.jpg"),
    ],
)
def test_what_cannot_be_drawn_is_said(rholoc: Run, file: Path, arguments: tuple[str, ...], complaint: str) -> None:
    status, _, errors = rholoc("density", file, *arguments)
    assert status == 1
    assert complaint in errors
    assert "Traceback" not in errors


def test_a_feature_or_a_picture_has_to_be_named(rholoc: Run, file: Path) -> None:
    assert rholoc("density", file)[0] == 2
    assert rholoc("density", file, "--feature", "0", "--picture", "x.jpg")[0] == 2


@pytest.fixture
def table(point_room: Any, tmp_path: Path) -> Path:
    path = tmp_path / "walk.csv"
    map_ = point_room.map_of(point_room.walk(60)[:12], "walk")
    path.write_text("".join(observations_csv(observation_table(map_))), encoding="ascii")
    return path


@pytest.mark.slow
def test_the_whole_flow_on_a_recording(command: Run, tmp_path: Path) -> None:
    walk = tmp_path / "walk"
    simulate_recording(walk, light=Light.ARTIFICIAL, seconds=8.0, fps=6)
    (walk / "truth.csv").rename(walk / "poses.csv")
    truth = read_trajectory_csv(walk / "poses.csv")
    lines = [
        " ".join(f"{value:.6f}" for value in (*position, *quaternion))
        for position, quaternion in zip(truth.positions, truth.quaternions_xyzw, strict=True)
    ]
    text = "\n".join(f"{frame} {line}" for frame, line in zip(truth.frames, lines, strict=True))
    (walk / "poses.txt").write_text(text, encoding="utf-8")
    out = tmp_path / "walk.csv"
    status, printed, errors = command(
        "paper", "observations", walk, "-o", out, "--poses", "given", "--features", "lab3", "--json"
    )
    assert status == 0, errors
    figures = json.loads(printed)
    assert out.read_text().startswith("timestamp,descriptor,u,v,x,y,z,hx,hy,hz,roll\n")
    assert {line.split(",")[1][:2] for line in out.read_text().splitlines()[1:]} == {"00", "01", "02"}
    assert figures["observations"] == len(out.read_text().splitlines()) - 1
    status, printed, errors = command("paper", "fit", out, "-o", tmp_path / "walk.rho", "--no-report", "--json")
    assert status == 0, errors
    fit = json.loads(printed)
    assert fit["with_a_peak"] > 0.9
    assert load_map(tmp_path / "walk.rho").info.features == "lab3"
    trajectory = tmp_path / "trajectory.csv"
    arguments = ("paper", "localize", tmp_path / "walk.rho", walk, "-o", trajectory, "--follow", "--json")
    status, printed, errors = command(*arguments)
    assert status == 0, errors
    assert json.loads(printed)["with_a_pose"] == len(read_trajectory_csv(trajectory)) > 10


def test_a_table_needs_its_camera(command: Run, table: Path) -> None:
    out = table.with_name("map.rho")
    status, _, errors = command("paper", "fit", table, "-o", out)
    assert status == 1
    assert "is not known" in errors
    status, _, errors = command("paper", "fit", table, "-o", out, "--camera", "520,520,319.5,239.5", "--no-report")
    assert status == 0, errors
    assert (load_map(out).info.camera.width, load_map(out).info.camera.height) == (640, 480)
    arguments = ("--camera", "520,520,319.5,239.5", "--size", "huge")
    status, _, errors = command("paper", "fit", table, "-o", out, *arguments)
    assert status == 1
    assert "'huge' is not an image size" in errors


def test_the_camera_may_stand_beside_the_table(command: Run, table: Path, point_room: Any) -> None:
    write_camera_json(table.with_name("walk.camera.json"), CameraFile(point_room.camera))
    arguments = ("paper", "fit", table, "-o", table.with_name("map.rho"), "--seen-only", "--no-report", "--json")
    status, printed, errors = command(*arguments)
    assert status == 0, errors
    assert json.loads(printed)["density"] == "observed"


def test_a_missing_table_is_one_line(command: Run, tmp_path: Path) -> None:
    status, _, errors = command("paper", "fit", tmp_path / "no.csv", "-o", tmp_path / "m.rho", "--camera", "5,5,3,3")
    assert status == 1
    assert "Traceback" not in errors
