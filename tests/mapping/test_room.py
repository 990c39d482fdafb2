"""Depth of a room's views becomes its surfaces: where they are, facing the room, closed where nothing was measured."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidMap
from rholoc.features import Metric
from rholoc.geometry import BoolArray, ByteArray, FloatArray, Pose, Similarity
from rholoc.mapping.build.landmarks import triangulate
from rholoc.mapping.build.reconstruction_cloud import cloud_of
from rholoc.mapping.build.stored_observations import recording_id
from rholoc.mapping.build.tracks import Views, link_observations
from rholoc.mapping.edit.correcting import remove_region, remove_views
from rholoc.mapping.edit.frame_corrections import levelled
from rholoc.mapping.edit.moving import move_map
from rholoc.mapping.edit.sources import forget_recording
from rholoc.mapping.learn.merging import merge_maps
from rholoc.mapping.room import drawing
from rholoc.mapping.room.depth_views import DepthView, depth_views
from rholoc.mapping.room.drawing import draw_room
from rholoc.mapping.room.fusion import fused, sampled_points
from rholoc.mapping.room.planes import close_gaps, floor_height, walls_of
from rholoc.mapping.room.surface import normals_of, surface_of
from rholoc.maps import Cloud, Map, Room, load_map, map_to_bytes, save_map
from rholoc.recordings import MemoryFrames, Recording
from rholoc.recordings.frames.depth import DepthImages

HALF_M = np.array([3.0, 2.5])  # of the room, from its middle; its floor is at 0 and its ceiling at 3 m
SIZE_M = 0.1
FOCAL = 110.0
SIDE = 161


def box_depth(T_map_camera: FloatArray, rays: FloatArray) -> FloatArray:
    """Depths (P,) along the optical axis at which rays (P, 3), z = 1 in the camera's axes, meet the box."""
    directions = rays @ T_map_camera[:3, :3].T + 1e-12
    low, high = np.array([*-HALF_M, 0.0]), np.array([*HALF_M, 3.0])
    reach = np.where(directions > 0, high - T_map_camera[:3, 3], low - T_map_camera[:3, 3]) / directions
    return np.asarray(reach.min(axis=1))


def view_of_box(heading_deg: float, pitch: float, number: int) -> DepthView:
    """What a camera in the middle sees; above 1.6 m the wall to the east (x = 3 m) shows no texture."""
    angle = np.deg2rad(heading_deg)
    pose = Pose.from_heading(np.array([0.0, 0.0, 1.5]), np.array([np.cos(angle), np.sin(angle), pitch]))
    v, u = (grid.ravel() - (SIDE - 1) / 2 for grid in np.mgrid[:SIDE, :SIDE])
    rays = np.column_stack([u / FOCAL, v / FOCAL, np.ones(u.size)])
    depth = box_depth(pose.T_map_camera, rays)
    points = depth[:, None] * rays @ pose.T_map_camera[:3, :3].T + pose.position
    depth[(points[:, 0] > 2.99) & (points[:, 2] > 1.6)] = np.nan
    colours = np.full((SIDE, SIDE, 3), (200, 100, 50), np.uint8)
    shape = (SIDE, SIDE)
    return DepthView(
        pose.T_map_camera,
        FOCAL,
        np.full(2, (SIDE - 1) / 2),
        depth.reshape(shape).astype(np.float32),
        colours,
        frozenset([number]),
    )


@pytest.fixture(scope="module")
def views() -> list[DepthView]:
    headings = [(turn, pitch) for turn in range(0, 360, 45) for pitch in (-0.5, 0.0)]
    return [view_of_box(turn, pitch, number) for number, (turn, pitch) in enumerate(headings)]


def off_the_box(vertices: FloatArray) -> FloatArray:
    """Distances (V,) of vertices from the nearest wall, the floor or the ceiling."""
    across = np.abs(np.abs(vertices[:, :2]) - HALF_M).min(axis=1)
    return np.asarray(np.minimum(across, np.minimum(np.abs(vertices[:, 2]), np.abs(vertices[:, 2] - 3))))


def in_the_gap(vertices: FloatArray) -> BoolArray:
    return np.asarray((vertices[:, 0] > 2.8) & (np.abs(vertices[:, 1]) < 2) & (np.abs(vertices[:, 2] - 2.2) < 0.3))


def test_surfaces_stand_where_they_were_seen_and_face_the_room(views: list[DepthView]) -> None:
    grid = fused(views, sampled_points(views), SIZE_M, np.eye(3))
    mesh = surface_of(grid, 0.01)
    assert len(mesh.vertices) > 3000
    assert np.percentile(off_the_box(mesh.vertices), 95) < SIZE_M / 2
    inwards = np.einsum("vx,vx->v", normals_of(*mesh), np.array([0.0, 0.0, 1.5]) - mesh.vertices)
    assert (inwards > 0).mean() > 0.98
    assert not in_the_gap(mesh.vertices).any()


def test_the_floor_and_walls_are_found_and_close_gaps(views: list[DepthView]) -> None:
    grid = fused(views, sampled_points(views), SIZE_M, np.eye(3))
    mesh = surface_of(grid, 0.01)
    floor, walls = floor_height(mesh, SIZE_M), walls_of(mesh, SIZE_M)
    assert floor == pytest.approx(0.0, abs=SIZE_M / 2)
    assert sorted(round(wall.offset, 1) for wall in walls) == [-3.0, -3.0, -2.5, -2.5]
    for wall in walls:
        assert wall.ends == pytest.approx((-2.5, 2.5) if abs(wall.normal[0]) > 0.9 else (-3.0, 3.0), abs=0.2)
    close_gaps(grid, floor, walls)
    closed = surface_of(grid, 0.01)
    assert in_the_gap(closed.vertices).sum() > 100
    assert np.percentile(off_the_box(closed.vertices), 95) < SIZE_M / 2


@pytest.fixture(scope="module", autouse=True)
def _coarse_voxels() -> Iterator[None]:
    """Voxels somewhat larger than phones deserve: hardly coarser rooms in half the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(drawing, "_FINEST", 1 / 55)
        patch.setattr(drawing, "MAX_VERTICES", 40_000)
        yield


@pytest.fixture(scope="module")
def walked_map(point_room: Any) -> Map:
    return point_room.map_of(point_room.walk(60), "walk")


@pytest.fixture(scope="module")
def recording(point_room: Any, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Orange frames of the walk through the room of points, of which every sixth has a depth image in mm."""
    folder = tmp_path_factory.mktemp("depth")
    small = point_room.camera.resized(160, 120)
    v, u = (grid.ravel() for grid in np.mgrid[:120, :160])
    rays = small.rays(np.column_stack([u, v]).astype(np.float64))
    paths: list[Path | None] = [None] * 60
    for row in range(0, 60, 6):
        depth = box_depth(point_room.walk(60)[row].T_map_camera, rays / rays[:, 2:]).reshape(120, 160)
        paths[row] = folder / f"{row}.png"
        assert cv2.imwrite(str(paths[row]), np.round(1000 * depth).astype(np.uint16))
    orange: ByteArray = np.full((480, 640, 3), (0, 128, 255), np.uint8)
    return Recording(MemoryFrames([orange] * 60, 10.0), "walk", folder, depth=DepthImages(tuple(paths)))


def named(map_: Map, recording: Recording) -> Map:
    """The map with this recording as its source."""
    source = replace(map_.info.sources[0], id=recording_id(recording))
    return replace(map_, info=replace(map_.info, sources=(source,)))


@pytest.fixture(scope="module")
def drawn(made_once: Any, walked_map: Map, recording: Recording) -> Room:
    """The room that the recorded depth gives."""
    return made_once("drawn", lambda: draw_room(named(walked_map, recording), [recording]).room)


def test_recorded_depth_becomes_a_room_in_the_maps_scale(walked_map: Map, recording: Recording, drawn: Room) -> None:
    assert recording.depth is not None
    in_feet = replace(recording, depth=replace(recording.depth, unit_m=1e-3 / 0.3048))
    for room in (drawn, draw_room(named(walked_map, in_feet), [in_feet]).room):
        assert 2000 < len(room) <= drawing.MAX_VERTICES
        above_the_floor = room.vertices.positions[room.vertices.positions[:, 2] > 0.6]  # which nobody looked at
        assert np.percentile(off_the_box(above_the_floor), 90) < 0.06
        assert {tuple(colour) for colour in room.vertices.colours.tolist()} == {(255, 128, 0)}


@pytest.mark.slow
def test_recorded_depth_is_of_its_recordings_camera_where_the_map_has_another(
    walked_map: Map, recording: Recording, drawn: Room
) -> None:
    map_ = named(walked_map, recording)
    first = replace(map_.info.camera, fx=2 * map_.info.camera.fx, fy=2 * map_.info.camera.fy)
    source = replace(map_.info.sources[0], camera=map_.info.camera)
    room = draw_room(replace(map_, info=replace(map_.info, camera=first, sources=(source,))), [recording]).room
    np.testing.assert_array_equal(room.vertices.positions, drawn.vertices.positions)


@pytest.mark.slow
def test_depth_that_contradicts_the_landmarks_draws_nothing(walked_map: Map, recording: Recording) -> None:
    shuffled = replace(recording, depth=recording.depth.select(np.roll(np.arange(60), 18)))
    map_ = named(walked_map, shuffled)
    assert draw_room(map_, [shuffled]) is map_


def test_what_the_map_was_not_made_from_draws_nothing(walked_map: Map, recording: Recording) -> None:
    assert draw_room(walked_map, [recording]) is walked_map


def test_pairs_of_frames_measure_depth(point_room: Any) -> None:
    """Two rows of cameras look at a textured wall at y = 2.5 m; depth is right to some per cent wherever two agree."""
    rng = np.random.default_rng(3)
    texture = cv2.resize(rng.integers(0, 255, (90, 150, 3), np.uint8), (900, 540), interpolation=cv2.INTER_CUBIC)
    poses = [
        Pose.from_heading(np.array([x, 0.3, 1.5 + 0.2 * row]), np.array([0.0, 1.0, 0.0]))
        for row in range(2)
        for x in np.linspace(-0.8, 0.8, 9)
    ]
    corners_px = np.array([[0, 0], [900, 0], [900, 540], [0, 540]], np.float32)
    corners = np.array([[-3, 2.5, 3.3], [3, 2.5, 3.3], [3, 2.5, -0.3], [-3, 2.5, -0.3]])
    frames = []
    for pose in poses:
        seen = point_room.camera.project((corners - pose.position) @ pose.R_map_camera).astype(np.float32)
        frames.append(cv2.warpPerspective(texture, cv2.getPerspectiveTransform(corners_px, seen), (640, 480)))
    recording = Recording(MemoryFrames(frames, 10.0), "wall", Path())
    views = depth_views(point_room.map_of(poses, "wall"), recording, 0, 20)
    assert len(views) > 8
    points = sampled_points(views)
    assert len(points) > 5000
    assert np.percentile(np.abs(points[:, 1] - 2.5), 90) < 0.1


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


@pytest.mark.slow
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
