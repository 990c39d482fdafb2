"""``rholoc map export``, ``import`` and ``report``."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from rholoc.maps import Map, load_map, read_trajectory_csv
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


@pytest.mark.parametrize(("degree", "density"), [((), "ray"), (("--degree", "2"), "tensor")])
def test_a_map_goes_through_csv(rholoc: Run, file: Path, hall: Map, degree: tuple[str, ...], density: str) -> None:
    assert rholoc("export", file, "--to", "csv", *degree)[0] == 0
    status, out, _ = rholoc("import", file.with_suffix(".csv"), "-o", file.with_name("again.rho"), "--json")
    assert (status, json.loads(out)["density"]) == (0, density)
    again = load_map(file.with_name("again.rho"))
    assert again.info.sources[0].name == "hall.csv"
    np.testing.assert_array_equal(again.landmarks.positions, hall.landmarks.positions)


def test_a_report_is_drawn_and_printed(rholoc: Run, file: Path) -> None:
    status, out, _ = rholoc("report", file, "--json")
    assert (status, json.loads(out)) == (0, report_to_json(load_map(file).info.report))
    picture = cv2.imread(str(file.with_name("hall-report.png")))
    assert picture.std() > 5


def test_a_bad_table_is_refused_in_one_line(rholoc: Run, file: Path) -> None:
    assert rholoc("export", file, "--to", "csv")[0] == 0
    table, target = file.with_suffix(".csv"), file.with_name("new.rho")
    header, first, *others = table.read_text().splitlines()
    descriptor, _, *rest = first.split(",")
    table.write_text("\n".join([header, ",".join([descriptor, "nan", *rest]), *others]))
    target.write_text("precious")
    status, out, err = rholoc("import", table, "-o", target)
    assert (status, out, err.count("\n")) == (1, "", 1), err
    assert "row 1 has 'nan' in a_0_0_0_0_0_0" in err
    assert target.read_text() == "precious"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--to", "ply", "--degree", "2"), "A degree does not apply to ply"),
        (("--to", "csv", "--degree", "4"), "degree 4"),
        (("--to", "vtp", "--features", "1"), "Features cannot be chosen for vtp"),
        (("--to", "surfaces", "--features", "1,x"), "not a valid selection of features"),
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
