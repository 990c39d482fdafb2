"""Tables 4 and 6 as CSV."""

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidInput, InvalidMap, InvalidTrajectory
from rholoc.geometry import Pose, pose_matrix
from rholoc.maps import (
    DensityKind,
    Map,
    ObservationTable,
    TrajectoryTable,
    observations_csv,
    part_of,
    read_trajectory_csv,
    trajectory_csv,
    trust_of,
    validate_map,
    write_trajectory_csv,
)
from rholoc.reports import LearningReport, MapReport, TrajectoryReport

PAPER_HEADER = "timestamp,x,y,z,hx,hy,hz"


def random_trajectory(n: int, seed: int = 0) -> TrajectoryTable:
    rng = np.random.default_rng(seed)
    R = Rotation.random(n, rng=rng).as_matrix() if n else np.zeros((0, 3, 3))
    return TrajectoryTable(
        times=np.arange(n) / 30,
        frames=np.arange(n) * 2 + 100,
        T_map_camera=pose_matrix(R, rng.normal(size=(n, 3))),
        confidences=rng.uniform(size=n),
        inliers=rng.integers(0, 300, n),
    )


@pytest.mark.parametrize("n", [0, 1, 25])
def test_a_trajectory_comes_back(tmp_path: Path, n: int) -> None:
    table = random_trajectory(n)
    write_trajectory_csv(tmp_path / "t.csv", table)
    back = read_trajectory_csv(tmp_path / "t.csv")
    np.testing.assert_array_equal(back.frames, table.frames)
    np.testing.assert_array_equal(back.inliers, table.inliers)
    np.testing.assert_allclose(back.times, table.times, atol=1e-6)
    np.testing.assert_allclose(back.T_map_camera, table.T_map_camera, atol=1e-5)
    np.testing.assert_allclose(back.confidences, table.confidences, atol=1e-4)


def test_table_6_has_the_papers_columns_first() -> None:
    header, row = trajectory_csv(random_trajectory(1)).splitlines()
    assert header == f"{PAPER_HEADER},frame,roll,qx,qy,qz,qw,confidence,inliers,map_trusted,expected_error_m"
    assert len(row.split(",")) == len(header.split(","))


def test_directions_agree_with_the_pose() -> None:
    table = random_trajectory(10)
    for row, T in enumerate(table.T_map_camera):
        pose = Pose(T)
        np.testing.assert_allclose(table.headings[row], pose.heading)
        np.testing.assert_allclose(table.positions[row], pose.position)
        np.testing.assert_allclose(table.rolls[row], pose.roll)
        np.testing.assert_allclose(table.quaternions_xyzw[row], pose.quaternion_xyzw)


def test_the_papers_seven_columns_suffice(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(f"{PAPER_HEADER}\n0.5,1,2,3,0,1,0\n")
    table = read_trajectory_csv(tmp_path / "t.csv")
    expected = Pose.from_heading(np.array([1.0, 2, 3]), np.array([0.0, 1, 0])).T_map_camera
    np.testing.assert_allclose(table.T_map_camera[0], expected, atol=1e-12)
    assert table.frames.tolist() == [-1]
    assert np.isnan(table.confidences[0])


def test_roll_without_quaternions_is_used(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(f"{PAPER_HEADER},roll\n0.5,1,2,3,0,1,0,0.25\n")
    np.testing.assert_allclose(read_trajectory_csv(tmp_path / "t.csv").rolls, [0.25])


def test_columns_that_are_not_ours_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(f"note,{PAPER_HEADER}\nhello,0.5,1,2,3,0,1,0\n")
    assert read_trajectory_csv(tmp_path / "t.csv").times.tolist() == [0.5]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "timestamp,x,y,z\n0,1,2,3\n",
        f"{PAPER_HEADER}\n0,1,2,3,0,1\n",
        f"{PAPER_HEADER}\n0,1,2,three,0,1,0\n",
        f"{PAPER_HEADER}\n0,1,2,nan,0,1,0\n",
        f"{PAPER_HEADER}\n0,1,2,3,0,0,0\n",
        f"{PAPER_HEADER}\n0,1,2,3,0,2,0\n",
        f"{PAPER_HEADER},frame\n0,1,2,3,0,1,0,1.5\n",
        f"{PAPER_HEADER},frame\n0,1,2,3,0,1,0,nan\n",
        f"{PAPER_HEADER},roll\n0,1,2,3,0,1,0,inf\n",
        f"{PAPER_HEADER},qx,qy,qz,qw\n0,1,2,3,0,1,0,0,0,0,0\n",
        f"{PAPER_HEADER},qx,qy,qz,qw\n0,1,2,3,0,1,0,nan,0,0,1\n",
    ],
)
def test_a_broken_trajectory_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(InvalidTrajectory):
        read_trajectory_csv(tmp_path / "t.csv")


def test_a_trajectory_that_is_missing_or_not_text_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidTrajectory):
        read_trajectory_csv(tmp_path / "none.csv")
    (tmp_path / "t.csv").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(InvalidTrajectory):
        read_trajectory_csv(tmp_path / "t.csv")


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(tail=st.text(max_size=80))
def test_whatever_follows_the_header_gives_a_table_or_our_error(tmp_path: Path, tail: str) -> None:
    (tmp_path / "t.csv").write_text(f"{PAPER_HEADER}\n{tail}", encoding="utf-8", errors="surrogatepass")
    with suppress(InvalidTrajectory):
        assert np.isfinite(read_trajectory_csv(tmp_path / "t.csv").T_map_camera).all()


def test_a_trajectory_into_a_missing_folder_is_reported(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput):
        write_trajectory_csv(tmp_path / "none" / "t.csv", random_trajectory(1))


def test_table_4_writes_channel_and_descriptor_as_hex() -> None:
    table = ObservationTable(
        channels=np.array([1, 16], np.uint8),
        descriptors=np.array([[0, 255, 16], [1, 2, 3]], np.uint8),
        pixels=np.array([[10.25, 20], [1, 2]], np.float32),
        positions=np.array([[1, -2, 3.0], [0, 0, 0]]),
        headings=np.array([[0, 1, 0.0], [1, 0, 0]]),
    )
    assert list(observations_csv(table)) == [
        "descriptor,u,v,x,y,z,hx,hy,hz\n",
        "0100ff10,10.25,20.00,1.0000,-2.0000,3.0000,0.000000,1.000000,0.000000\n",
        "10010203,1.00,2.00,0.0000,0.0000,0.0000,1.000000,0.000000,0.000000\n",
    ]


def test_a_part_has_its_views_and_what_they_saw(room_map: Map) -> None:
    views = np.array([1, 2, 6])
    patches = np.random.default_rng(0).normal(size=(len(room_map), 3)).astype(np.float32)
    part = part_of(replace(room_map, landmarks=replace(room_map.landmarks, patches=patches)), views)
    validate_map(part.map)
    seen = np.isin(room_map.observations.views, views)
    np.testing.assert_array_equal(part.features, np.unique(room_map.observations.features[seen]))
    np.testing.assert_array_equal(part.map.landmarks.positions, room_map.landmarks.positions[part.features])
    np.testing.assert_array_equal(part.map.landmarks.patches, patches[part.features])
    np.testing.assert_array_equal(part.map.views.T_map_camera, room_map.views.T_map_camera[views])
    np.testing.assert_array_equal(part.features[part.map.observations.features], room_map.observations.features[seen])
    np.testing.assert_array_equal(views[part.map.observations.views], room_map.observations.views[seen])
    described = np.isin(room_map.descriptors.features, part.features)
    np.testing.assert_array_equal(part.map.descriptors.values, room_map.descriptors.values[described])
    np.testing.assert_array_equal(
        part.features[part.map.descriptors.features], room_map.descriptors.features[described]
    )


def test_the_part_of_all_views_is_the_map(room_map: Map) -> None:
    part = part_of(room_map, np.arange(len(room_map.views)))
    assert len(part.map) == len(np.unique(room_map.observations.features))
    np.testing.assert_array_equal(part.map.observations.views, room_map.observations.views)


def changed(array: Any, index: Any, value: Any) -> Any:
    copy = array.copy()
    copy[index] = value
    return copy


def broken(map_: Map, **changes: Any) -> Map:
    """The map with other columns, named ``table.column``, or with another description."""
    for name, value in changes.items():
        table, _, column = name.partition(".")
        map_ = replace(map_, **{table: replace(getattr(map_, table), **{column: value}) if column else value})
    return map_


BREAKS = {
    "dtype": lambda m: {"landmarks.positions": m.landmarks.positions.astype(np.float64)},
    "a list": lambda m: {"views.times": list(m.views.times)},
    "shape": lambda m: {"landmarks.positions": m.landmarks.positions[:, :2]},
    "dimensions": lambda m: {"descriptors.values": m.descriptors.values.ravel()},
    "channels too few": lambda m: {"landmarks.channels": m.landmarks.channels[1:]},
    "covariances too few": lambda m: {"landmarks.covariances": m.landmarks.covariances[1:]},
    "nan landmark": lambda m: {"landmarks.positions": changed(m.landmarks.positions, (0, 0), np.nan)},
    "infinite time": lambda m: {"views.times": changed(m.views.times, 0, np.inf)},
    "infinite range": lambda m: {"observations.ranges_m": np.full(len(m.observations), np.inf, np.float32)},
    "negative variance": lambda m: {"landmarks.covariances": changed(m.landmarks.covariances, (0, 1, 1), -1)},
    "descriptor without owner": lambda m: {"descriptors.features": m.descriptors.features[1:]},
    "owner too large": lambda m: {"descriptors.features": changed(m.descriptors.features, -1, len(m))},
    "owner negative": lambda m: {"descriptors.features": changed(m.descriptors.features, 0, -1)},
    "owners unsorted": lambda m: {"descriptors.features": m.descriptors.features[::-1].copy()},
    "views differ": lambda m: {"views.times": m.views.times[1:]},
    "not a rotation": lambda m: {"views.T_map_camera": changed(m.views.T_map_camera, (0, 0, 0), 2.0)},
    "mirrored": lambda m: {"views.T_map_camera": m.views.T_map_camera * [[1, 1, -1, 1]]},
    "poses differ": lambda m: {"views.T_map_camera": m.views.T_map_camera[1:]},
    "observations differ": lambda m: {"observations.views": m.observations.views[1:]},
    "views fall": lambda m: {"observations.views": m.observations.views[::-1].copy()},
    "view too large": lambda m: {"observations.views": changed(m.observations.views, -1, len(m.views))},
    "view negative": lambda m: {"observations.views": changed(m.observations.views, 0, -1)},
    "seen feature too large": lambda m: {"observations.features": changed(m.observations.features, 0, len(m))},
    "seen feature negative": lambda m: {"observations.features": changed(m.observations.features, 0, -1)},
    "tensors missing": lambda m: {"info": replace(m.info, density=DensityKind.TENSOR)},
}


@pytest.mark.parametrize("name", BREAKS)
def test_arrays_that_contradict_each_other_are_refused(room_map: Map, name: str) -> None:
    validate_map(room_map)
    with pytest.raises(InvalidMap):
        validate_map(broken(room_map, **BREAKS[name](room_map)))


GOOD = TrajectoryReport("visual", 9, trusted=True, why="Two reconstructions agree.")
BAD = TrajectoryReport("visual", 9, trusted=False, why="Two reconstructions disagree.")
LEARNED = LearningReport(2, frames_found=3)
LEARNED_BADLY = LearningReport(2, trusted=False, why="Two reconstructions disagree.")


@pytest.mark.parametrize(
    ("report", "trusted", "reason"),
    [
        (MapReport(trajectories=(GOOD,)), True, "Two reconstructions agree."),
        (MapReport(trajectories=(GOOD, BAD)), False, "Two reconstructions disagree."),
        (MapReport(trajectories=(BAD, BAD)), False, "Two reconstructions disagree."),
        (MapReport(trajectories=(GOOD,), learned=(LEARNED,)), True, "Two reconstructions agree."),
        (MapReport(trajectories=(GOOD,), learned=(LEARNED_BADLY,)), False, "Two reconstructions disagree."),
    ],
)
def test_a_map_is_trusted_where_every_walk_is(room_map: Map, report: MapReport, trusted: bool, reason: str) -> None:
    trust = trust_of(replace(room_map.info, report=report))
    assert (trust.trusted, trust.reason) == (trusted, reason)


@pytest.mark.parametrize("report", [MapReport(), MapReport(trajectories=(TrajectoryReport("visual", 9),))])
def test_a_map_that_does_not_say_is_neither(room_map: Map, report: MapReport) -> None:
    assert trust_of(replace(room_map.info, report=report)).trusted is None
