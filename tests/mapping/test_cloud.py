"""Points and pictures of a room that nothing is localized by follow the map through all that is done to it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidMap
from rholoc.features import Metric
from rholoc.geometry import Similarity
from rholoc.mapping.build.landmarks import triangulate
from rholoc.mapping.build.reconstruction_cloud import cloud_of
from rholoc.mapping.build.tracks import Views, link_observations
from rholoc.mapping.edit.correcting import remove_region, remove_views
from rholoc.mapping.edit.frame_from_people import levelled
from rholoc.mapping.edit.moving import move_map
from rholoc.mapping.edit.sources import forget_recording
from rholoc.mapping.learn.merging import merge_maps
from rholoc.maps import Cloud, Map, Room, load_map, map_to_bytes, save_map

TILT = Similarity(2.0, Rotation.from_euler("xz", [100, 25], degrees=True).as_matrix(), np.array([4.0, -1.0, 0.2]))
EAST = np.array([[0.0, -9.0], [9.0, -9.0], [9.0, 9.0], [0.0, 9.0]])


def picture(number: int) -> bytes:
    return b"\xff\xd8\xff" + bytes([number])


def decorated(map_: Map, seed: int = 0) -> Map:
    """The map with a hundred points within the room, and a picture of each view."""
    rng = np.random.default_rng(seed)
    colours = rng.integers(0, 256, (100, 3), dtype=np.uint8)
    cloud = Cloud(rng.uniform(-2, 2, (100, 3)).astype(np.float32), colours, np.zeros(100, np.int32))
    faces = np.arange(100, dtype=np.int32).reshape(25, 4)
    map_ = replace(map_, room=Room(replace(cloud, positions=-cloud.positions), faces))
    return replace(
        map_, views=replace(map_.views, pictures=tuple(picture(view) for view in range(len(map_.views)))), cloud=cloud
    )


@pytest.fixture(scope="module")
def room(point_room: Any) -> Map:
    return decorated(point_room.map_of(point_room.walk(30), "walk"))


def test_what_is_no_landmark_is_a_point_in_its_colour(walked: Views, point_room: Any) -> None:
    rng = np.random.default_rng(0)
    colours = np.tile(rng.integers(0, 256, (1, 3), dtype=np.uint8), (len(walked.features), 1))
    views = replace(walked, features=replace(walked.features, colours=colours))
    reconstructed = triangulate(views, link_observations(views, Metric.HAMMING))
    is_landmark = rng.random(len(reconstructed)) < 0.5
    sources = np.arange(len(views)) >= 30
    cloud = cloud_of(views, reconstructed, is_landmark, sources.astype(np.int64))
    assert 0.8 * (~is_landmark).sum() < len(cloud) <= (~is_landmark).sum()
    assert {tuple(row) for row in cloud.positions.tolist()} <= {
        tuple(row) for row in reconstructed.positions[~is_landmark].astype(np.float32).tolist()
    }
    np.testing.assert_array_equal(cloud.colours, np.broadcast_to(colours[0], (len(cloud), 3)))
    assert set(cloud.sources.tolist()) == {0, 1}
    assert len(cloud_of(walked, reconstructed, is_landmark, sources.astype(np.int64))) == 0  # no colours are known


def test_both_come_back_from_a_file(room: Map, tmp_path: Path) -> None:
    save_map(room, tmp_path / "room.rho")
    read = load_map(tmp_path / "room.rho")
    np.testing.assert_array_equal(read.cloud.positions, room.cloud.positions)
    np.testing.assert_array_equal(read.cloud.colours, room.cloud.colours)
    np.testing.assert_array_equal(read.room.vertices.positions, room.room.vertices.positions)
    np.testing.assert_array_equal(read.room.faces, room.room.faces)
    assert read.views.pictures == room.views.pictures
    bare = replace(room, views=replace(room.views, pictures=None), cloud=Cloud(), room=Room())
    assert b"picture" not in map_to_bytes(bare)
    assert b"cloud" not in map_to_bytes(bare)
    assert b"room_" not in map_to_bytes(bare)


@pytest.mark.parametrize(
    "broken",
    [
        {"cloud": Cloud(np.full((1, 3), np.nan, np.float32), np.zeros((1, 3), np.uint8), np.zeros(1, np.int32))},
        {"cloud": Cloud(np.zeros((1, 3), np.float32), np.zeros((2, 3), np.uint8), np.zeros(1, np.int32))},
        {"cloud": Cloud(np.zeros((1, 3), np.float32), np.zeros((1, 3), np.uint8), np.ones(1, np.int32))},
        {"room": Room(Cloud(), np.zeros((1, 4), np.int32))},
        {"room": Room(Cloud(np.zeros((1, 3), np.float32), np.zeros((1, 3), np.uint8), np.ones(1, np.int32)))},
    ],
)
def test_what_contradicts_the_map_is_refused(room: Map, broken: dict[str, Any]) -> None:
    with pytest.raises(InvalidMap):
        map_to_bytes(replace(room, **broken))


@pytest.mark.parametrize("pictures", [(b"\xff\xd8\xff",), (b"no JPEG",) * 30])
def test_pictures_that_are_none_are_refused(room: Map, pictures: tuple[bytes, ...]) -> None:
    with pytest.raises(InvalidMap):
        map_to_bytes(replace(room, views=replace(room.views, pictures=pictures)))


def test_they_move_with_the_map(room: Map) -> None:
    moved = move_map(room, TILT)
    np.testing.assert_allclose(moved.cloud.positions, TILT.points(room.cloud.positions.astype(float)), atol=1e-5)
    np.testing.assert_allclose(
        moved.room.vertices.positions, TILT.points(-room.cloud.positions.astype(float)), atol=1e-5
    )
    assert moved.views.pictures == room.views.pictures


def test_they_are_cut_with_the_map(room: Map) -> None:
    left = remove_region(room, EAST, None, None, keep_inside=False)
    assert 0 < len(left.cloud) < 100
    assert (left.cloud.positions[:, 0] <= 0).all()
    corners = left.room.vertices.positions[left.room.faces]
    assert 0 < len(corners) < 25
    assert (corners[..., 0] <= 0).all()
    shorter = remove_views(room, 10, 19)
    assert shorter.views.pictures == tuple(picture(view) for view in [*range(10), *range(20, 30)])
    assert len(shorter.cloud) == 100


def test_they_are_merged_and_forgotten_with_their_recording(room: Map, point_room: Any) -> None:
    other = decorated(point_room.map_of(point_room.walk(30, 0.2), "second"), seed=1)
    merged = merge_maps(room, move_map(other, Similarity(1.0, np.eye(3), np.array([0.5, 0.0, 0.0]))))
    np.testing.assert_array_equal(merged.cloud.sources, np.repeat([0, 1], 100))
    np.testing.assert_allclose(merged.cloud.positions[100:], other.cloud.positions, atol=0.02)
    assert merged.views.pictures is not None
    assert len(merged.views.pictures) == 60
    left = forget_recording(merged, "walk")
    np.testing.assert_array_equal(left.cloud.colours, other.cloud.colours)
    assert set(left.cloud.sources.tolist()) == {0}
    assert left.views.pictures == other.views.pictures
    assert len(merged.room) == 200
    np.testing.assert_array_equal(left.room.faces, other.room.faces)


def test_a_map_that_lies_on_its_side_is_levelled(room: Map) -> None:
    assert levelled(room) is None  # it is upright
    moved = move_map(room, TILT)
    R = levelled(replace(moved, info=replace(moved.info, upright=False)))
    assert R is not None
    up = R @ TILT.rotation @ [0.0, 0.0, 1.0]
    np.testing.assert_allclose(up, [0, 0, 1], atol=np.sin(np.deg2rad(3)))
    wall = R @ TILT.rotation @ [1.0, 0.0, 0.0]
    assert max(abs(wall[0]), abs(wall[1])) > np.cos(np.deg2rad(4))
