"""``rholoc map export``, ``import`` and ``report``."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from rholoc.localization import Dof, Localizer, Query
from rholoc.maps import DensityKind, Map, load_map, read_trajectory_csv
from rholoc.reports import report_to_json

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def hall(point_room: Any) -> Map:
    """A small map that remembers its observations."""
    return point_room.map_of(point_room.walk(60)[:12], "walk")


@pytest.mark.parametrize(
    ("to", "name"),
    [
        ("rho", "copy.rho"),
        ("csv", "hall.csv"),
        ("observations", "hall-observations.csv"),
        ("trajectory", "hall-trajectory.csv"),
        ("ply", "hall.ply"),
        ("vtp", "hall.vtp"),
        ("surfaces", "hall-surfaces.vtp"),
        ("colmap", "hall-colmap.zip"),
        ("nerfstudio", "hall-transforms.json"),
        ("png", "hall.png"),
    ],
)
def test_a_map_is_exported_beside_itself(rholoc: Run, file: Path, to: str, name: str) -> None:
    before = file.read_bytes()
    out = ("-o", file.with_name(name)) if to == "rho" else ()
    status, _, err = rholoc("export", file, "--to", to, *out)
    assert (status, err.count("\n")) == (0, 1)
    assert f"{file.with_name(name).stat().st_size} bytes" in err
    assert {path.name for path in file.parent.iterdir()} == {"hall.rho", name}
    assert file.read_bytes() == before


def test_the_exported_trajectory_is_that_of_the_views(rholoc: Run, file: Path, hall: Map) -> None:
    assert rholoc("export", file, "--to", "trajectory")[0] == 0
    table = read_trajectory_csv(file.with_name("hall-trajectory.csv"))
    np.testing.assert_allclose(table.positions, hall.views.positions, atol=1e-5)
    np.testing.assert_array_equal(table.times, hall.views.times)
    assert table.inliers.sum() == len(hall.observations)


@pytest.mark.parametrize("kind", [DensityKind.RAY, DensityKind.TENSOR])
def test_a_map_goes_through_csv_and_localizes_to_the_same_pose(
    rholoc: Run, file: Path, point_room: Any, kind: DensityKind
) -> None:
    degree = ("--degree", "2") if kind is DensityKind.TENSOR else ()
    assert rholoc("export", file, "--to", "csv", *degree)[0] == 0
    status, out, _ = rholoc("import", file.with_suffix(".csv"), "-o", file.with_name("again.rho"), "--json")
    assert (status, json.loads(out)["density"]) == (0, kind.value)
    again = load_map(file.with_name("again.rho"))
    assert again.info.sources[0].name == "hall.csv"
    pose = point_room.walk(60)[5]
    query = Query(point_room.see(pose, 1000), point_room.camera, Dof.FREE)
    answer = Localizer(again).localize(query).pose
    assert np.linalg.norm(answer.position - pose.position) < 0.05
    if kind is DensityKind.RAY:
        expected = Localizer(load_map(file)).localize(query).pose
        np.testing.assert_allclose(answer.T_map_camera, expected.T_map_camera, rtol=0, atol=1e-6)


def test_a_report_is_drawn_and_printed(rholoc: Run, file: Path) -> None:
    status, out, _ = rholoc("report", file, "--json")
    assert (status, json.loads(out)) == (0, report_to_json(load_map(file).info.report))
    picture = cv2.imread(str(file.with_name("hall-report.png")))
    assert picture.std() > 5


def _damage(table: Path, edit: Callable[[list[list[str]]], None]) -> Path:
    cells = [line.split(",") for line in table.read_text().splitlines()]
    edit(cells)
    table.write_text("\n".join(",".join(row) for row in cells) + "\n")
    return table


def _without_column(cells: list[list[str]]) -> None:
    for row in cells:
        del row[5]


def _with_column(cells: list[list[str]]) -> None:
    for row in cells:
        row.append("1")


def _of_another_degree(cells: list[list[str]]) -> None:
    cells[0] = [name.replace("2_2_2_2_2_2", "5_5_5_5_5_5") for name in cells[0]]


def _with_nan(cells: list[list[str]]) -> None:
    cells[2][1] = "nan"


def _with_a_descriptor_twice(cells: list[list[str]]) -> None:
    cells[2] = [*cells[1][:-1], cells[2][-1]]


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (_without_column, "has no a_0_0_0_0_1_1"),
        (_with_column, "has the unexpected 1"),
        (_of_another_degree, "of degree 5"),
        (_with_nan, "row 2 has 'nan' in a_0_0_0_0_0_0"),
        (_with_a_descriptor_twice, "row 2 repeats a descriptor"),
    ],
)
def test_a_bad_table_is_refused_in_one_line(
    rholoc: Run, file: Path, edit: Callable[[list[list[str]]], None], said: str
) -> None:
    assert rholoc("export", file, "--to", "csv")[0] == 0
    target = file.with_name("new.rho")
    target.write_text("precious")
    status, out, err = rholoc("import", _damage(file.with_suffix(".csv"), edit), "-o", target)
    assert (status, out, err.count("\n")) == (1, "", 1), err
    assert said in err
    assert target.read_text() == "precious"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--to", "ply", "--degree", "2"), "A degree does not apply to ply"),
        (("--to", "csv", "--degree", "4"), "degree 4"),
        (("--to", "vtp", "--features", "1"), "Features cannot be chosen for vtp"),
        (("--to", "surfaces", "--features", "1,x"), "not a valid selection of features"),
        (("--to", "surfaces", "--features", "1,-2"), "not a valid selection of features"),
        (("--to", "surfaces", "--features", "5:5"), "No feature was chosen"),
        (("--to", "surfaces", "--features", "99999"), "no feature 99999"),
        (("--to", "surfaces", "--features", "0:999999999"), "are too many"),
        (("--to", "rho"), "is the map itself"),
        (("--to", "csv", "-o", "/nowhere/x.csv"), "cannot be written"),
    ],
)
def test_exports_without_sense_are_refused_in_one_line(rholoc: Run, file: Path, arguments: Any, said: str) -> None:
    status, out, err = rholoc("export", file, *arguments)
    assert (status, out, err.count("\n")) == (1, "", 1), err
    assert said in err
    assert [path.name for path in file.parent.iterdir()] == ["hall.rho"]


def test_a_map_read_from_csv_has_no_observations_to_export(rholoc: Run, file: Path) -> None:
    assert rholoc("export", file, "--to", "csv")[0] == 0
    assert rholoc("import", file.with_suffix(".csv"), "-o", file)[0] == 0
    status, _, err = rholoc("export", file, "--to", "observations")
    assert (status, err.count("\n")) == (1, 1)
    assert not file.with_name("hall-observations.csv").exists()
