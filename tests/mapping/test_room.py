"""Depth of a room's views becomes its surfaces: where they are, facing the room, closed where nothing was measured."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from rholoc.geometry import BoolArray, ByteArray, FloatArray, Pose
from rholoc.mapping.build.stored_observations import recording_id
from rholoc.mapping.room.depth_views import DepthView, depth_views
from rholoc.mapping.room.drawing import draw_room
from rholoc.mapping.room.fusion import fused, sampled_points
from rholoc.mapping.room.planes import close_gaps, floor_height, walls_of
from rholoc.mapping.room.surface import normals_of, surface_of
from rholoc.maps import Map
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
    return Recording("walk", folder, MemoryFrames([orange] * 60, 10.0), depth=DepthImages(tuple(paths)))


def named(map_: Map, recording: Recording) -> Map:
    """The map with this recording as its source."""
    source = replace(map_.info.sources[0], id=recording_id(recording))
    return replace(map_, info=replace(map_.info, sources=(source,)))


def test_recorded_depth_becomes_a_room_in_the_maps_scale(walked_map: Map, recording: Recording) -> None:
    assert recording.depth is not None
    in_feet = replace(recording, depth=replace(recording.depth, unit_m=1e-3 / 0.3048))
    for one in (recording, in_feet):
        room = draw_room(named(walked_map, one), [one]).room
        assert len(room) > 2000
        above_the_floor = room.vertices.positions[room.vertices.positions[:, 2] > 0.6]  # which nobody looked at
        assert np.percentile(off_the_box(above_the_floor), 90) < 0.06
        assert {tuple(colour) for colour in room.vertices.colours.tolist()} == {(255, 128, 0)}


def test_depth_that_contradicts_the_landmarks_draws_nothing(walked_map: Map, recording: Recording) -> None:
    assert recording.depth is not None
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
    recording = Recording("wall", Path(), MemoryFrames(frames, 10.0))
    views = depth_views(point_room.map_of(poses, "wall"), recording, 0, 20)
    assert len(views) > 8
    points = sampled_points(views)
    assert len(points) > 5000
    assert np.percentile(np.abs(points[:, 1] - 2.5), 90) < 0.1
