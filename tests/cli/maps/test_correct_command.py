"""``rholoc map correct``: every kind of correction, and what is refused."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rholoc.maps import FloorPlan, MapLabels, load_map, save_map

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def hall(tmp_path: Path, point_room: Any) -> Path:
    """A map's file."""
    save_map(point_room.map_of(point_room.walk(20), "walk"), tmp_path / "hall.rho")
    return tmp_path / "hall.rho"


@pytest.mark.parametrize(
    "arguments",
    [
        ("origin", "--at", "1,2,0.5"),
        ("north", "--direction", "1,1,0"),
        ("wall", "--direction=-1,1,0"),
        ("up", "--direction", "0,0.1,1"),
        ("up",),
        ("scale", "--start", "0,0,1", "--end", "0,2.1,1", "--length", "2.05"),
        ("plan", "--pair", "0,0,0=4,2", "--pair", "1,0,0=4,3", "--scaled"),
    ],
    ids=" ".join,
)
def test_the_frame_moves_by_what_is_said(rholoc: Run, hall: Path, arguments: tuple[str, ...]) -> None:
    before = load_map(hall)
    status, out, err = rholoc("correct", arguments[0], hall, *arguments[1:], "--json")
    assert (status, err) == (0, "")
    done, after = json.loads(out), load_map(hall)
    assert (done["kind"], done["version"]) == (arguments[0], after.info.version)
    expected = done["scale"] * before.landmarks.positions @ np.array(done["rotation"]).T + done["translation"]
    np.testing.assert_allclose(after.landmarks.positions, expected, atol=1e-4)


def test_parts_are_removed(rholoc: Run, hall: Path) -> None:
    status, _, err = rholoc(
        "correct", "region", hall, "--outline", "0 -9, 9 -9, 9 9, 0 9", "--keep", "inside", "--top", 2
    )
    assert status == 0, err
    left = load_map(hall).landmarks.positions
    assert (left[:, 0] >= 0).all()
    assert 1 < left[:, 2].max() <= 2


def test_names_and_labels_are_kept_beside_others(rholoc: Run, hall: Path, tmp_path: Path) -> None:
    target = tmp_path / "named.rho"
    rholoc("correct", "names", hall, "--point", "door=1,2,0", "--area", "hall=0 0, 4 0, 4 3", "-o", target)
    assert load_map(hall).info.names.points == ()
    rholoc("correct", "names", target, "--point", "table=0,1,0", "--remove", "hall")
    names = load_map(target).info.names
    assert ([one.name for one in names.points], names.areas) == (["door", "table"], ())
    rholoc("correct", "labels", target, "--site", "plant 2", "--tag", "old")
    status, out, _ = rholoc("correct", "labels", target, "--floor", "1")
    assert (status, out) == (0, "")
    assert load_map(target).info.labels == MapLabels("plant 2", "1", ("old",))


def test_names_come_from_geojson_and_leave_as_it(rholoc: Run, hall: Path, tmp_path: Path) -> None:
    point = {"type": "Point", "coordinates": [1, 2, 0]}
    feature = {"type": "Feature", "geometry": point, "properties": {"name": "dock", "kind": "charger", "volts": 24}}
    document = {"type": "FeatureCollection", "frame": "map", "features": [feature]}
    (tmp_path / "names.geojson").write_text(json.dumps(document))
    rholoc("correct", "names", hall, "--point", "door=1,0,0", "--kind", "door=way out")
    rholoc("correct", "names", hall, "--geojson", tmp_path / "names.geojson")
    rholoc("correct", "names", hall, "--point", "dock=1,3,0")
    rholoc("export", hall, "--to", "geojson", "-o", tmp_path / "out.geojson")
    found = json.loads((tmp_path / "out.geojson").read_text())["features"]
    assert [one["properties"] for one in found] == [{"name": "door", "kind": "way out"}, feature["properties"]]
    assert found[1]["geometry"]["coordinates"] == [1, 3, 0]


def test_a_floor_plan_is_kept_where_its_yaml_says(rholoc: Run, hall: Path, tmp_path: Path) -> None:
    (tmp_path / "hall.pgm").write_bytes(b"P5\n4 3\n255\n" + bytes(12))
    (tmp_path / "hall.yaml").write_text("image: hall.pgm\nresolution: 0.05\norigin: [1, 2, 0]\nnegate: 0\n")
    rholoc("correct", "floor-plan", hall, tmp_path / "hall.yaml", "--turn", "90")
    map_ = load_map(hall)
    assert map_.info.plan == FloorPlan("image/png", (1.0, 2.0), 90.0, 0.05)
    assert map_.plan.startswith(b"\x89PNG")
    (tmp_path / "hall.pgm").unlink()
    code, _, said = rholoc("correct", "floor-plan", hall, tmp_path / "hall.yaml")
    assert (code, said.count("\n")) == (1, 1)
    assert "hall.pgm" in said


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("origin", "--at", "1,2"), "'1,2' is not 3 coordinates"),
        (("origin", "--at", "1,2,nan"), "is not 3 coordinates"),
        (("region", "--outline", "0 0, 4 0", "--keep", "inside"), "has 2 corners"),
        (("region", "--outline", "0 0, 4 0, 4 3", "--keep", "half"), "--keep is 'half'"),
        (("names", "--remove", "attic"), "Nothing is named attic"),
        (("labels", "--tag", "a", "--tag", "a"), "The tags are not valid"),
        (("walk", "--first", 3, "--last", 99), "has the views 0 to"),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_line(
    rholoc: Run, hall: Path, arguments: tuple[Any, ...], said: str
) -> None:
    content = hall.read_bytes()
    status, out, err = rholoc("correct", arguments[0], hall, *arguments[1:])
    assert (status, out) == (1, "")
    assert said in err
    assert err.count("\n") == 1
    assert hall.read_bytes() == content


def test_a_direction_needs_an_upright_map(rholoc: Run, hall: Path) -> None:
    map_ = load_map(hall)
    save_map(replace(map_, info=replace(map_.info, upright=False)), hall)
    assert "not upright" in rholoc("correct", "wall", hall, "--direction", "1,0,0")[2]


def test_a_map_is_placed_on_earth_and_keeps_its_place_when_its_frame_moves(rholoc: Run, hall: Path) -> None:
    places = ("--point", "0,0,0=52.52,13.405,74", "--point=-8,0,0=52.52,13.40488208,74")
    status, out, err = rholoc("correct", "earth", hall, *places, "--json")
    assert (status, err) == (0, "")
    assert json.loads(out)["residual_m"] < 0.01
    placed = load_map(hall).info.earth
    assert placed.heading_deg % 360 == pytest.approx(0, abs=0.1) or placed.heading_deg == pytest.approx(360, abs=0.1)
    point = np.array([1.0, 2.0, 0.5])
    there = placed.place(point)
    assert rholoc("correct", "origin", hall, "--at", "1,2,0.5")[0] == 0
    moved = load_map(hall).info.earth
    assert (moved.latitude_deg, moved.longitude_deg) == pytest.approx((there.latitude_deg, there.longitude_deg))


def test_a_map_is_placed_in_a_national_grid(rholoc: Run, hall: Path) -> None:
    places = ("--point", "0,0,0=391779.24,5820072.41,74", "--heading", "0", "--crs", "EPSG:25833")
    assert rholoc("correct", "earth", hall, *places)[0] == 0
    placed = load_map(hall).info.earth
    assert (placed.latitude_deg, placed.longitude_deg) == pytest.approx((52.520002251, 13.404999635), abs=1e-8)
    status, _, err = rholoc("correct", "earth", hall, *places[:-1], "EPSG:25833+7837")
    assert (status, "de_bkg_gcg2016.tif" in err) == (1, True)


@pytest.mark.parametrize(
    ("points", "words"),
    [
        (["0,0,0=52.52,13.405,74"], "two points"),
        (["0,0,0=95,13.405,74", "1,0,0=52,13,74"], "not possible"),
        (["0,0,0=52.52,13.405", "1,0,0=52,13,74"], "not 3 coordinates"),
        (["0,0,0=52.52,13.405,74", "8,0,0=52.53,13.405,74"], "times as far apart"),
    ],
)
def test_places_that_cannot_be_are_refused(rholoc: Run, hall: Path, points: list[str], words: str) -> None:
    before = hall.read_bytes()
    status, _, err = rholoc("correct", "earth", hall, *(part for point in points for part in ("--point", point)))
    assert status == 1
    assert words in err
    assert hall.read_bytes() == before


def test_a_map_without_metres_has_no_place_on_earth(rholoc: Run, hall: Path) -> None:
    map_ = load_map(hall)
    save_map(replace(map_, info=replace(map_.info, metric=False)), hall)
    status, _, err = rholoc("correct", "earth", hall, "--point", "0,0,0=52.52,13.405,74", "--heading", "0")
    assert status == 1
    assert "Correct its scale first" in err
