"""waypoints.csv; measured distances between places of the camera, in a table or as text."""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidRecording, InvalidWaypoints
from rholoc.geometry.earth import enu_of, places_in
from rholoc.recordings import (
    KnownLength,
    Waypoint,
    check_waypoints_fix_frame,
    read_recording,
    read_waypoints_csv,
    write_waypoints_csv,
)

ROWS = "W1,0.5,1,0,1.5\nW2,1.0,1,2,1.5\nE,1.5,0,2,1.6\n"


@dataclass(frozen=True)
class Frames:
    """Frames 100, 102, … at 10 a second from 0 s on."""

    numbers: np.ndarray
    times: np.ndarray
    size: tuple[int, int] = (64, 48)
    timed: bool = True


FRAMES = Frames(np.arange(100, 142, 2), np.arange(21) / 10)


def written(folder: Path, text: str) -> Path:
    path = folder / "waypoints.csv"
    path.write_text(text)
    return path


def test_waypoints_by_time(tmp_path: Path) -> None:
    waypoints = read_waypoints_csv(written(tmp_path, "name,time,x,y,z\n" + ROWS), FRAMES)
    assert waypoints[0] == Waypoint("W1", 0.5, (1, 0, 1.5))
    assert [waypoint.name for waypoint in waypoints] == ["W1", "W2", "E"]


def test_waypoints_by_frame(tmp_path: Path) -> None:
    text = "name,frame,x,y,z\nA,100,0,0,0\nB,110,1,0,0\nC,140,0,1,0\n"
    assert [waypoint.time for waypoint in read_waypoints_csv(written(tmp_path, text), FRAMES)] == [0, 0.5, 2.0]


@pytest.mark.parametrize("header", ["name,time,x,y,z", "name,x,y,z"])
def test_waypoints_of_pictures_without_times_must_name_a_picture(tmp_path: Path, header: str) -> None:
    rows = ROWS if "time" in header else "W1,0,0,1\nW2,2,0,1\nE,2,3,1\n"
    with pytest.raises(InvalidWaypoints, match="the pictures have no times"):
        read_waypoints_csv(written(tmp_path, f"{header}\n{rows}"), replace(FRAMES, timed=False))


def test_waypoints_come_back(tmp_path: Path) -> None:
    waypoints = (
        Waypoint('the "door", left', 0.25, (1.25, -2, 3)),
        Waypoint("W2", 1.0, (0, 0, 0)),
        Waypoint("Ä", 2.0, (0, 5, 0)),
    )
    write_waypoints_csv(tmp_path / "w.csv", waypoints)
    assert read_waypoints_csv(tmp_path / "w.csv", FRAMES) == waypoints


def test_waypoints_at_the_ends_come_back_although_microseconds_lie_outside(tmp_path: Path) -> None:
    frames = replace(FRAMES, times=np.linspace(4e-7, 2 / 3, 21))
    first, last = frames.times[[0, -1]].tolist()
    times = (first, 0.25, last)
    waypoints = [Waypoint(f"W{i}", time, (i, i * i, 0)) for i, time in enumerate(times)]
    write_waypoints_csv(tmp_path / "w.csv", waypoints)
    assert [waypoint.time for waypoint in read_waypoints_csv(tmp_path / "w.csv", frames)] == [*times]


def test_waypoints_may_come_in_order_alone(tmp_path: Path) -> None:
    path = written(tmp_path, "name,x,y,z\nW1,0,0,1\nW2,2,0,1\nE,2,3,1\n")
    found = read_waypoints_csv(path, FRAMES)
    assert [waypoint.name for waypoint in found] == ["W1", "W2", "E"]
    assert np.isnan([waypoint.time for waypoint in found]).all()
    write_waypoints_csv(tmp_path / "again.csv", found)
    assert (tmp_path / "again.csv").read_text().startswith("name,x,y,z\nW1,0.0000,")


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "empty"),
        ("name,time,x,y,z\n", "0 waypoints"),
        ("name,time,x,y,z\nW1,0.5,1,0,1\nW2,1,2,0,1\n", "2 waypoints"),
        ("name,x,y,z\nW1,1,0,1\n", "1 waypoints"),
        ("name,time,x,y\n", "no column z"),
        ("name,time,x,y,z\n" + ROWS + "W1,1.7,1,1,1\n", "W1 more than once"),
        ("name,time,x,y,z\n" + ROWS + ",1.7,1,1,1\n", "no name"),
        ("name,time,x,y,z\n" + ROWS + "N,1.7,nan,1,1\n", "row 5: 'nan' under x"),
        ("name,time,x,y,z\n" + ROWS + "N,soon,1,1,1\n", "'soon' under time"),
        ("name,time,x,y,z\n" + ROWS + "late,2.1,1,1,1\n", "late is at 2.100 s, outside"),
        ("name,time,x,y,z\n" + ROWS + "early,-0.1,1,1,1\n", "early is at"),
        ("name,frame,x,y,z\nodd,101,1,1,1\n", "odd is at frame 101"),
        ("name,frame,x,y,z\nhalf,100.5,1,1,1\n", "half is at frame 100.5"),
    ],
)
def test_broken_waypoints_are_reported(tmp_path: Path, text: str, complaint: str) -> None:
    with pytest.raises(InvalidWaypoints, match=complaint):
        read_waypoints_csv(written(tmp_path, text), FRAMES)


def test_wrong_columns_tell_the_right_ones(tmp_path: Path) -> None:
    with pytest.raises(InvalidWaypoints) as caught:
        read_waypoints_csv(written(tmp_path, "label,x,y\nA,1,2\n"), FRAMES)
    assert "name,time,x,y,z or name,frame,x,y,z" in caught.value.hint


def test_a_missing_file_is_reported(tmp_path: Path) -> None:
    with pytest.raises(InvalidWaypoints, match="does not exist"):
        read_waypoints_csv(tmp_path / "none.csv", FRAMES)


def as_waypoints(positions: np.ndarray) -> list[Waypoint]:
    return [Waypoint(f"W{i}", float(i), tuple(map(float, position))) for i, position in enumerate(positions)]


@given(seed=st.integers(0, 1000), n=st.integers(3, 6), length=st.floats(0.1, 50))
def test_a_line_fixes_no_frame_but_a_bend_does(seed: int, n: int, length: float) -> None:
    R = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    line = np.column_stack([np.linspace(0, length, n), np.zeros(n), np.zeros(n)])
    with pytest.raises(InvalidWaypoints, match="one line"):
        check_waypoints_fix_frame(as_waypoints(line @ R.T + 3))
    line[1, 1] = 0.2 * length
    check_waypoints_fix_frame(as_waypoints(line @ R.T + 3))


def test_one_place_or_two_points_fix_no_frame() -> None:
    with pytest.raises(InvalidWaypoints):
        check_waypoints_fix_frame(as_waypoints(np.ones((4, 3))))
    with pytest.raises(InvalidWaypoints, match="at least 3"):
        check_waypoints_fix_frame(as_waypoints(np.eye(3)[:2]))
    check_waypoints_fix_frame(as_waypoints(np.eye(3)))


def test_how_well_a_waypoint_was_measured_is_written_where_it_is_not_as_usual(tmp_path: Path) -> None:
    places = [(0.0, 0.0, 1.0), (1.0, 0.0, 1.0), (1.0, 2.0, 1.0)]
    waypoints = [Waypoint(f"W{i}", float("nan"), place, (0.02, 0.05, 0.2)[i]) for i, place in enumerate(places)]
    write_waypoints_csv(tmp_path / "w.csv", waypoints)
    found = read_waypoints_csv(tmp_path / "w.csv", FRAMES)
    assert [(one.position, one.sigma_m) for one in found] == [(one.position, one.sigma_m) for one in waypoints]


def test_waypoints_on_earth_are_metres_around_the_first(tmp_path: Path) -> None:
    text = "name,frame,lat,lon,h\nA,100,52.52,13.405,74\nB,110,52.5201,13.405,74\nC,140,52.52,13.4051,75.5\n"
    a, b, c = read_waypoints_csv(written(tmp_path, text), FRAMES)
    assert a.position == pytest.approx((0, 0, 0), abs=1e-6)
    assert b.position == pytest.approx((0, 11.127, 0), abs=2e-3)
    assert c.position == pytest.approx((6.788, 0, 1.5), abs=2e-3)
    assert (c.earth.latitude_deg, c.earth.longitude_deg, c.earth.height_m) == (52.52, 13.4051, 75.5)


@pytest.mark.parametrize(("columns", "crs"), [("x,y,z", "EPSG:25833"), ("lat,lon,h", "EPSG:4326")])
def test_waypoints_of_a_reference_system_are_metres_around_the_first(tmp_path: Path, columns: str, crs: str) -> None:
    rows = [(391779.24, 5820072.41, 36.2), (391779.24, 5820082.41, 36.2), (391784.24, 5820072.41, 37.7)]
    places = places_in("EPSG:25833", np.array(rows))
    if columns != "x,y,z":
        rows = [(place.latitude_deg, place.longitude_deg, place.height_m) for place in places]
    lines = [f"W{i},{2 * i + 100},{x!r},{y!r},{z!r},{crs}" for i, (x, y, z) in enumerate(rows)]
    text = "\n".join([f"name,frame,{columns},crs", lines[0], lines[1].removesuffix(crs), lines[2]])
    found = read_waypoints_csv(written(tmp_path, text), FRAMES)
    for waypoint, place in zip(found, places, strict=True):
        assert waypoint.earth == place
        assert waypoint.position == pytest.approx(enu_of(place, places[0]), abs=1e-6)
    with pytest.raises(InvalidWaypoints, match="EPSG:25832, EPSG:"):
        read_waypoints_csv(written(tmp_path, text.replace(lines[2], "C,140,1,2,3,EPSG:25832")), FRAMES)


@pytest.mark.parametrize(
    ("row", "words"),
    [("C,140,95,13.405,74", "no place on Earth"), ("C,140,53.52,13.405,74", "over 10 km"), ("C,140,52.5,,74", "lon")],
)
def test_waypoints_that_are_not_on_earth_are_refused(tmp_path: Path, row: str, words: str) -> None:
    text = f"name,frame,lat,lon,h\nA,100,52.52,13.405,74\nB,110,52.5201,13.405,74\n{row}\n"
    with pytest.raises(InvalidWaypoints, match=words):
        read_waypoints_csv(written(tmp_path, text), FRAMES)


@pytest.fixture
def walk(tmp_path: Path) -> Path:
    """Pictures 10 to 14."""
    for number in range(10, 15):
        assert cv2.imwrite(str(tmp_path / f"{number}.png"), np.zeros((40, 60, 3), np.uint8))
    return tmp_path


def test_lengths_come_from_the_table_or_the_caller(walk: Path) -> None:
    assert read_recording(walk).lengths == ()
    (walk / "lengths.csv").write_text("first,second,length\n10,14,2.4\n11,12,0.6\n")
    recording = read_recording(walk)
    assert recording.lengths == (KnownLength(10, 14, 2.4), KnownLength(11, 12, 0.6))
    assert recording.warnings == ()
    assert read_recording(walk, lengths=["13,10, 1.5"]).lengths == (KnownLength(13, 10, 1.5),)
    assert read_recording(walk, frames="11:14").lengths == (KnownLength(11, 12, 0.6),)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("10,14", r"'10,14' is not a length"),
        ("10,14,far", r"not a length.*12,340,2\.40"),
        ("10,15,2.4", r"names the frame 15.*10 to 14"),
        ("10,10.5,2.4", r"names the frame 10\.5"),
        ("10,nan,2.4", r"names the frame nan"),
        ("12,12,2.4", r"between the frame 12 and itself"),
        ("10,14,0", r"of 0 m cannot be used.*0\.05 to 1000 m"),
        ("10,14,nan", r"of nan m cannot be used"),
    ],
)
def test_what_is_no_length_is_refused(walk: Path, text: str, said: str) -> None:
    with pytest.raises(InvalidRecording) as caught:
        read_recording(walk, lengths=[text])
    assert caught.match(said)


def test_a_broken_table_of_lengths_is_refused(walk: Path) -> None:
    (walk / "lengths.csv").write_text("first,second,length\n10,99,2.4\n")
    with pytest.raises(InvalidRecording, match=r"lengths\.csv names the frame 99"):
        read_recording(walk)
