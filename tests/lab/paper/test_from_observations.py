"""Table 4 → map; A recording → Table 4."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from rholoc.density import ObservedDensities
from rholoc.errors import InvalidInput, MappingFailed
from rholoc.features import get_extractor
from rholoc.geometry import ByteArray, pose_distances
from rholoc.localization import Dof, Localizer, Query
from rholoc.mapping.build.density_fitting import fit_densities
from rholoc.maps import (
    DensityKind,
    Map,
    ObservationTable,
    load_map,
    observations_csv,
    read_coefficient_table,
    save_map,
    write_coefficient_table,
)
from rholoc.paper.density_localizer import DensityLocalizer
from rholoc.paper.observation_table import observation_table
from rholoc.recordings import Recording
from rholoc.reports import TrajectoryReport
from rholoc.trajectory import PoseMethod, Scale, Trajectory
from rholoc.trajectory.visual.rolling_shutter import RollingShutter
from rholoc_lab.paper import observing
from rholoc_lab.paper.from_observations import FitOptions, features_of, fit_figures, map_from_observations
from rholoc_lab.paper.table_reading import read_observations


@pytest.fixture(scope="module")
def walked(point_room: Any) -> list[Any]:
    return point_room.walk(150)[:24]


@pytest.fixture(scope="module")
def table(point_room: Any, walked: list[Any]) -> ObservationTable:
    """What a walk saw, every detection with its own descriptor."""
    seen = [point_room.see(pose, seed) for seed, pose in enumerate(walked)]
    view = np.repeat(np.arange(len(walked)), [len(one) for one in seen])
    return ObservationTable(
        channels=np.concatenate([one.channels for one in seen]),
        descriptors=np.concatenate([one.descriptors for one in seen]),
        pixels=np.concatenate([one.pixels for one in seen]).astype(np.float64),
        positions=np.array([pose.position for pose in walked])[view],
        headings=np.array([pose.heading for pose in walked])[view],
        times=view / 10,
        rolls=np.array([pose.roll for pose in walked])[view],
    )


@pytest.fixture(scope="module")
def fitted(table: ObservationTable, point_room: Any) -> Map:
    return map_from_observations(table, point_room.camera, "table.csv", FitOptions(report=False))


def test_a_table_read_back_is_the_table(table: ObservationTable, tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("".join(observations_csv(table)), encoding="ascii")
    again = read_observations(path)
    assert np.array_equal(again.descriptors, table.descriptors)
    assert np.array_equal(again.channels, table.channels)
    for name, digits in {"pixels": 2, "positions": 4, "headings": 6, "times": 6, "rolls": 6}.items():
        assert np.allclose(getattr(again, name), getattr(table, name), atol=10.0**-digits)


@pytest.mark.parametrize("heading", ["hx,hy,hz", "h_x,h_y,h_z", "$h_x$,$h_y$,$h_z$"])
def test_a_table_may_have_the_papers_header_of_two_rows(heading: str, tmp_path: Path) -> None:
    groups = "Descriptor,Screen coordinates,,Robot coordinates,,,Robot orientation,,"
    path = tmp_path / "table.csv"
    path.write_text(f"{groups}\n,U,V,X,Y,Z,{heading}\n01a3,10,20,1,2,3,0,1,0\n", encoding="utf-8")
    read = read_observations(path)
    assert (read.channels.tolist(), read.descriptors.tolist(), read.pixels.tolist()) == ([1], [[0xA3]], [[10, 20]])
    assert (read.positions.tolist(), read.headings.tolist()) == ([[1, 2, 3]], [[0, 1, 0]])


def test_the_map_localizes_where_the_walk_went(fitted: Map, point_room: Any, walked: list[Any]) -> None:
    assert fitted.info.density is DensityKind.OBSERVED
    localizer, alone = Localizer(fitted), DensityLocalizer(fitted)
    for seed, pose in enumerate(walked[3:21:4], start=100):
        features = point_room.see(pose, seed)
        answer = localizer.localize(Query(features, point_room.camera, Dof.FREE))
        assert pose_distances(answer.pose.T_map_camera, pose.T_map_camera)[0] < 0.03
        climbed = alone.localize(features, point_room.camera)
        assert pose_distances(climbed.optimum.T_map_camera, pose.T_map_camera)[0] < 0.05
        tolerances = [step.tolerance_px for step in climbed.steps]
        assert tolerances == sorted(tolerances, reverse=True)


@pytest.mark.slow
def test_fitted_as_printed_nothing_localizes(table: ObservationTable, point_room: Any, walked: list[Any]) -> None:
    options = FitOptions(seen_only=True, report=False)
    map_ = map_from_observations(table, point_room.camera, "table.csv", options)
    alone = DensityLocalizer(map_)
    found = [alone.localize(point_room.see(pose, 100), point_room.camera) for pose in walked[3:21:4]]
    errors = [
        np.inf if one is None else pose_distances(one.optimum.T_map_camera, pose.T_map_camera)[0]
        for one, pose in zip(found, walked[3:21:4], strict=True)
    ]
    assert min(errors) > 0.03
    printed, observed = fit_figures(map_, True), fit_figures(fit_densities(map_, DensityKind.OBSERVED), False)
    assert printed is not None
    assert observed.peaked_share > 0.99
    assert observed.fitted_share < 0.05 < observed.constant_share


@pytest.mark.slow
def test_a_file_and_a_csv_keep_it(fitted: Map, tmp_path: Path) -> None:
    save_map(fitted, tmp_path / "map.rho")
    again = load_map(tmp_path / "map.rho")
    assert isinstance(again.densities, ObservedDensities)
    assert np.array_equal(again.densities.coefficients, fitted.densities.arrays()["coefficients"])
    write_coefficient_table(again, tmp_path / "map.csv")
    from_csv = read_coefficient_table(tmp_path / "map.csv")
    assert from_csv.info.density is DensityKind.OBSERVED
    assert np.allclose(from_csv.densities.arrays()["coefficients"], again.densities.coefficients)
    assert np.array_equal(from_csv.densities.arrays()["counts"], again.densities.counts)


def test_the_table_of_a_map_makes_a_map(fitted: Map, point_room: Any) -> None:
    again = map_from_observations(observation_table(fitted), point_room.camera, "again.csv", FitOptions(report=False))
    assert len(again) > 0.9 * len(fitted)


def test_every_tenth_view_is_held_out_for_the_report(table: ObservationTable, point_room: Any) -> None:
    map_ = map_from_observations(table, point_room.camera, "table.csv")
    assert map_.info.report.held_out.frames == 2


def test_features_are_recognised_by_their_channels(table: ObservationTable) -> None:
    assert features_of(table) == "gray"
    assert features_of(replace(table, channels=np.where(np.arange(len(table)) % 2, 1, 2).astype(np.uint8))) == "lab"
    with pytest.raises(InvalidInput, match="descriptors of 20 bytes"):
        features_of(replace(table, descriptors=table.descriptors[:, :20]))


def test_too_little_is_refused(table: ObservationTable, point_room: Any) -> None:
    def rows(table: ObservationTable, count: int) -> ObservationTable:
        return ObservationTable(
            *(getattr(table, name)[:count] for name in ("channels", "descriptors", "pixels", "positions", "headings"))
        )

    with pytest.raises(MappingFailed, match="from 1 pose;"):
        map_from_observations(rows(table, 1), point_room.camera, "one.csv")
    small = point_room.camera.resized(100, 80)
    with pytest.raises(InvalidInput, match="outside of 100 × 80"):
        map_from_observations(table, small, "table.csv")
    with pytest.raises(InvalidInput, match="degree 7"):
        map_from_observations(table, point_room.camera, "table.csv", FitOptions(degree=7))
    with pytest.raises(InvalidInput, match="not those of 'lab'"):
        map_from_observations(table, point_room.camera, "table.csv", FitOptions(features="lab"))
    with pytest.raises(InvalidInput, match="not fitted by loss"):
        map_from_observations(table, point_room.camera, "t", FitOptions(DensityKind.RAY, seen_only=True))


_HEADER = "descriptor,u,v,x,y,z,hx,hy,hz"
_ROW = "00" + "ab" * 32 + ",1,2,0,0,0,1,0,0"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "is empty"),
        (_HEADER, "no observations"),
        (_HEADER.replace(",hz", ""), "no column hz"),
        (f"{_HEADER}\n{_ROW.replace(',1,2,', ',nan,2,')}", "row 2: 'nan' under u"),
        (f"{_HEADER}\n{_ROW.replace(',1,2,', ',1,inf,')}", "'inf' under v"),
        (f"{_HEADER}\n{_ROW.replace(',1,0,0', ',2,0,0')}", "row 2: the heading's length is 2"),
        (f"{_HEADER}\n{_ROW.replace(',1,0,0', ',0,0,0')}", "the heading's length is 0"),
        (f"{_HEADER}\n{_ROW}\n{_ROW.replace('abab', 'ab', 1)}", "row 3: a descriptor has 31 bytes, the ones before 32"),
        (f"{_HEADER}\n{_ROW.replace('00ab', '09ab')}", "begins with 09, which is not a channel"),
        (f"{_HEADER}\n{_ROW.replace('00ab', 'xyab')}", "is not a descriptor"),
        (f"{_HEADER}\n{_ROW},5", "10 values under 9"),
    ],
)
def test_a_broken_table_is_refused_by_its_row(text: str, complaint: str, tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InvalidInput, match=complaint):
        read_observations(path)


_ROWS = np.array([1, 4, 7, 10])
_READOUT_S = 0.03
_NOISE = np.random.default_rng(0).integers(0, 255, (12, 240, 320, 3), dtype=np.uint8)
_IMAGES = [cv2.GaussianBlur(one, (0, 0), 2) for one in _NOISE]


class Frames:
    """Twelve frames of texture."""

    times = np.arange(12) / 10
    numbers = np.arange(12)
    size = (320, 240)

    def images(self, rows: Sequence[int]) -> Iterator[ByteArray]:
        for row in rows:
            yield _IMAGES[row]


def test_each_frame_is_corrected_by_its_own_motion(point_room: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    camera = point_room.camera.resized(320, 240)
    recording = Recording(Frames(), "walk", Path("walk"), camera, readout_s=_READOUT_S)
    T = np.array([pose.T_map_camera for pose in point_room.walk(4)])
    velocities = np.zeros((4, 2, 3))
    velocities[:, 0, 2] = [100, 200, 300, 400]
    shutter = RollingShutter(_READOUT_S, 240, velocities)
    report = TrajectoryReport("visual", 4, trusted=True, why="")
    found = Trajectory(_ROWS, _ROWS / 10, T, camera, Scale.METRIC, True, report, shutter)
    monkeypatch.setattr(observing, "estimate_trajectory", lambda *_: found)
    table, _ = observing.observe_recording(recording, "sift48", PoseMethod.VISUAL)
    seen = [get_extractor("sift48").extract(_IMAGES[row]).pixels.astype(np.float64) for row in _ROWS]
    frame = np.repeat(np.arange(4), [len(one) for one in seen])
    pixels = np.concatenate(seen)
    late_s = ((pixels[:, 1] + 0.5) / 240 - 0.5) * _READOUT_S
    np.testing.assert_allclose(table.pixels[:, 0], pixels[:, 0] - late_s * 100 * (frame + 1), atol=1e-3)
    np.testing.assert_array_equal(table.times, _ROWS[frame] / 10)
