"""Coverage: what a camera would see from where, by geometry alone; the report as a picture."""

import io
import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from rholoc.geometry import Camera, Pose, pose_matrix
from rholoc.maps import Map, MapObservations, coverage_of
from rholoc.maps.coverage import SUFFICIENT
from rholoc.pictures.map_report import report_png
from rholoc.reports import HeldOutReport, MapReport, report_to_json


@pytest.fixture
def wall_map(make_map) -> Map:
    """A wall of 200 landmarks at x = 3, seen from a walk along y that looks at it."""
    map_ = make_map(features=200, views=9)
    rng = np.random.default_rng(5)
    wall = np.column_stack([np.full(200, 3.0), rng.uniform(-1, 1, 200), rng.uniform(1, 2, 200)])
    places = np.column_stack([np.zeros(9), np.linspace(-0.5, 0.5, 9), np.full(9, 1.5)])
    poses = [Pose.from_heading(place, np.array([1.0, 0, 0])).T_map_camera for place in places]
    return replace(
        map_,
        landmarks=replace(map_.landmarks, positions=wall.astype(np.float32)),
        views=replace(map_.views, T_map_camera=np.array(poses)),
        observations=MapObservations(
            np.repeat(np.arange(9), 200).astype(np.int32), np.tile(np.arange(200), 9).astype(np.int32)
        ),
    )


def _stretched(map_: Map, times: float) -> Map:
    poses = pose_matrix(map_.views.T_map_camera[:, :3, :3], times * map_.views.positions)
    return replace(
        map_,
        views=replace(map_.views, T_map_camera=poses),
        landmarks=replace(map_.landmarks, positions=map_.landmarks.positions * np.float32(times)),
    )


def test_who_looks_at_the_wall_sees_it_and_who_turns_away_does_not(wall_map: Map) -> None:
    coverage = coverage_of(wall_map)
    middle = np.argmin(np.linalg.norm(coverage.positions - (0, 0, 1.5), axis=1))
    assert coverage.counts[middle, 0] == 200
    assert (coverage.counts[:, 4:9] == 0).all()
    assert 0 < coverage.share_sufficient < 0.6


def test_positions_lie_within_reach_of_the_walk_at_its_height(wall_map: Map) -> None:
    coverage = coverage_of(wall_map)
    distances = np.linalg.norm(coverage.positions[:, None] - wall_map.views.positions, axis=2).min(axis=1)
    assert coverage.step_m == 0.25
    assert distances.max() <= 0.75 + 1e-6
    np.testing.assert_allclose(coverage.positions[:, 2], 1.5, atol=1e-6)
    assert len(np.unique(coverage.cells, axis=0)) == len(coverage.cells)


def test_counts_are_those_of_the_camera_itself(wall_map: Map) -> None:
    """Without distortion the field of view is the image."""
    camera = Camera(640, 480, 500.0, 500.0, 319.5, 239.5)
    wall_map = replace(wall_map, info=replace(wall_map.info, camera=camera))
    coverage = coverage_of(wall_map)
    middle = int(np.argmin(np.linalg.norm(coverage.positions - (0, 0, 1.5), axis=1)))
    for number, heading_deg in enumerate(coverage.headings_deg):
        heading = np.array([np.cos(np.deg2rad(heading_deg)), np.sin(np.deg2rad(heading_deg)), 0.0])
        T_camera_map = Pose.from_heading(coverage.positions[middle], heading).inverse()
        pixels = camera.project(wall_map.landmarks.positions @ T_camera_map[:3, :3].T + T_camera_map[:3, 3])
        assert coverage.counts[middle, number] == camera.contains(pixels).sum()


def test_a_map_that_is_not_upright_is_covered_alike(wall_map: Map) -> None:
    """Turned as a whole, with another frame's axes: as many headings see the wall as before."""
    turn = Rotation.from_euler("xyz", [-90, 0, 0], degrees=True)
    R = turn.as_matrix() @ wall_map.views.T_map_camera[:, :3, :3]
    turned = replace(
        wall_map,
        info=replace(wall_map.info, upright=False),
        landmarks=replace(wall_map.landmarks, positions=turn.apply(wall_map.landmarks.positions).astype(np.float32)),
        views=replace(wall_map.views, T_map_camera=pose_matrix(R, turn.apply(wall_map.views.positions))),
    )
    coverage, level = coverage_of(turned), coverage_of(wall_map)
    np.testing.assert_allclose(coverage.up, turn.apply([0, 0, 1]), atol=1e-6)
    assert np.linalg.det(np.vstack([coverage.axes, coverage.up])) == pytest.approx(1)
    assert coverage.counts.max() == level.counts.max() == 200
    assert coverage.share_sufficient == pytest.approx(level.share_sufficient, abs=0.05)


def test_a_long_walk_takes_longer_steps_and_still_fits_the_report(make_map) -> None:
    map_ = make_map(features=900, views=60)
    coverage = coverage_of(_stretched(map_, 30))
    assert coverage.step_m > 0.25
    assert 0 < len(coverage.cells) <= 250
    worst = replace(coverage, counts=np.full_like(coverage.counts, 9999))
    assert len(json.dumps(report_to_json(worst.report()), separators=(",", ":"))) < 20_000


def test_the_unit_of_length_does_not_matter_where_it_is_arbitrary(wall_map: Map) -> None:
    loose = replace(wall_map, info=replace(wall_map.info, metric=False))
    small, large_coverage = coverage_of(loose), coverage_of(_stretched(loose, 40))
    assert large_coverage.step_m == pytest.approx(40 * small.step_m, rel=1e-4)
    assert large_coverage.share_sufficient == pytest.approx(small.share_sufficient, abs=0.02)


@pytest.mark.parametrize(("features", "views"), [(0, 0), (0, 1), (1, 0), (3, 1)])
def test_small_maps_have_a_coverage(make_map, features: int, views: int) -> None:
    coverage = coverage_of(make_map(features=features, views=views))
    assert coverage.counts.shape == (len(coverage.cells), 12)
    assert coverage.counts.max(initial=0) < SUFFICIENT
    assert coverage.report().share_sufficient == 0.0


FRAMES = HeldOutReport(4, 3, 0.02, 0.3, errors_m=(0.01, 0.02, None, 0.3), confidences=(0.9, 0.8, 0.1, 0.4))


def picture(map_: Map, held_out: HeldOutReport | None = None) -> np.ndarray:
    png = report_png(replace(map_, info=replace(map_.info, report=MapReport(held_out=held_out))), "room")
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)


@pytest.fixture(scope="module")
def without(room_map: Map) -> np.ndarray:
    """The picture of a map of which nothing is known."""
    return picture(room_map)


@pytest.mark.slow
def test_errors_of_held_out_frames_are_plotted(room_map: Map, without: np.ndarray) -> None:
    drawn = picture(room_map, FRAMES)
    assert drawn.shape == (1080, 1800, 3)
    upper_right = (slice(0, 540), slice(900, 1800))
    green = (0x1A, 0x7F, 0x5A)
    assert (np.abs(drawn[upper_right] - green).sum(axis=2) < 12).sum() > 500
    assert (np.abs(without[upper_right] - green).sum(axis=2) < 12).sum() == 0


def test_the_expected_error_is_drawn_over_the_walk(room_map: Map, without: np.ndarray) -> None:
    spread = np.tile(np.diag([1e-4] * 3 + [1e-6] * 3).astype(np.float32), (len(room_map.views), 1, 1))
    right = (slice(0, 540), slice(1350, 1800))
    known = picture(replace(room_map, views=replace(room_map.views, covariances=spread)))
    pale = (0xE4, 0xF0, 0xEB)  # below the curve
    shares = [(np.abs(drawn[right] - pale).sum(axis=2) < 20).mean() for drawn in (without, known)]
    assert shares[1] > 0.2 > 10 * shares[0]


def test_coverage_is_coloured(make_map) -> None:
    """Of 900 landmarks many are in view; of 3, never enough."""
    share = {}
    for features in (3, 900):
        left = picture(make_map(features=features))[:, :900]
        share[features] = (np.abs(left - (0x78, 0xC0, 0x8C)).sum(axis=2) < 12).sum()
    assert share[3] < 0.2 * share[900]


@pytest.mark.parametrize(
    "held_out",
    [
        HeldOutReport(4, 4, 0.01, 0.02, errors_m=(0.01,), confidences=()),
        pytest.param(
            HeldOutReport(2, 0, None, None, errors_m=(None, None), confidences=(0.0, 0.2)), marks=pytest.mark.slow
        ),
    ],
)
def test_whatever_is_known_of_frames_held_out_there_is_a_picture(room_map: Map, held_out: HeldOutReport) -> None:
    assert picture(room_map, held_out).std() > 5


def test_an_empty_map_has_a_picture(make_map) -> None:
    assert picture(make_map(features=0, views=0)).min() < 100
