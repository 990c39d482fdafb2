"""Depth images become points of the room, in the map's own scale, and only where they agree with its landmarks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from rholoc.features import Metric
from rholoc.geometry import ByteArray, Camera, FloatArray, Pose
from rholoc.mapping import BuildOptions, build_map
from rholoc.mapping.build.depth_cloud import depth_cloud
from rholoc.mapping.build.landmarks import Landmarks, triangulate
from rholoc.mapping.build.tracks import Views, link_observations
from rholoc.recordings import MemoryFrames, Recording, read_recording
from rholoc.recordings.frames.depth import DepthImages
from rholoc.simulation import PHONE_CAMERA, Renderer, Scene, make_test_site, make_walk
from rholoc.trajectory import PoseMethod

WALLS_M = np.array([3.0, 2.5])
WITH_DEPTH = tuple(range(0, 60, 6))
SIZE = (160, 120)  # of depth images: a quarter of the frames'


@pytest.fixture(scope="module")
def landmarks(walked: Views) -> Landmarks:
    return triangulate(walked, link_observations(walked, Metric.HAMMING))


def depth_of_room(pose: Pose, camera: Any) -> FloatArray:
    """(H, W) metres to the walls of the room of points."""
    small = camera.resized(*SIZE)
    v, u = np.mgrid[: SIZE[1], : SIZE[0]]
    rays = small.rays(np.column_stack([u.ravel(), v.ravel()]).astype(np.float64))
    directions = (rays @ pose.R_map_camera.T)[:, :2]
    with np.errstate(divide="ignore"):
        reach = ((np.sign(directions) * WALLS_M - pose.position[:2]) / directions).min(axis=1)
    return np.asarray((reach * rays[:, 2]).reshape(SIZE[1], SIZE[0]))


@pytest.fixture(scope="module")
def recording(point_room: Any, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Orange frames of the walk through the room, of which every sixth has a depth image in mm."""
    folder = tmp_path_factory.mktemp("depth")
    paths: list[Path | None] = [None] * 60
    for row in WITH_DEPTH:
        depth = np.round(1000 * depth_of_room(point_room.walk(60)[row], point_room.camera)).astype(np.uint16)
        depth[:10] = 65535
        paths[row] = folder / f"{row}.png"
        assert cv2.imwrite(str(paths[row]), depth)
    orange: ByteArray = np.full((480, 640, 3), (0, 128, 255), np.uint8)
    frames = MemoryFrames([orange] * 60, 10.0)
    return Recording("walk", folder, frames, depth=DepthImages(tuple(paths), unknown=(0, 65535)))


def points_of(recording: Recording, walked: Views, landmarks: Landmarks) -> Any:
    return depth_cloud(recording, np.arange(60), walked, np.arange(60), landmarks, 2)


def off_the_walls(positions: FloatArray) -> FloatArray:
    return np.asarray(np.abs(np.abs(positions[:, :2]) - WALLS_M).min(axis=1))


def test_surfaces_stand_where_they_are_in_the_pictures_colours(recording, walked, landmarks):
    cloud = points_of(recording, walked, landmarks)
    assert 2000 < len(cloud) < 200_000
    assert np.percentile(off_the_walls(cloud.positions), 95) < 0.03
    assert {tuple(colour) for colour in cloud.colours.tolist()} == {(255, 128, 0)}
    assert set(cloud.sources.tolist()) == {2}


def test_depth_takes_the_maps_scale(recording, walked, landmarks):
    in_feet = replace(recording, depth=replace(recording.depth, unit_m=1e-3 / 0.3048))
    cloud = points_of(in_feet, walked, landmarks)
    assert np.percentile(off_the_walls(cloud.positions), 95) < 0.03


def test_depth_that_contradicts_the_landmarks_is_left_out(recording, walked, landmarks):
    shuffled = recording.depth.select(np.roll(np.arange(60), 18))
    assert len(points_of(replace(recording, depth=shuffled), walked, landmarks)) == 0


def test_no_depth_and_broken_depth_give_no_points(recording, walked, landmarks, tmp_path):
    (tmp_path / "broken.png").write_bytes(b"no picture")
    assert cv2.imwrite(str(tmp_path / "coloured.png"), np.zeros((4, 4, 3), np.uint8))
    broken = [tmp_path / name for name in ("broken.png", "coloured.png", "missing.png")]
    for depth in (None, DepthImages((*broken, *[None] * 57))):
        assert len(points_of(replace(recording, depth=depth), walked, landmarks)) == 0


def off_the_faces(scene: Scene, points: FloatArray) -> FloatArray:
    """(N,) how far points are from the nearest face of a scene, metres."""
    nearest = np.full(len(points), np.inf)
    for face in scene.faces:
        offset = points - face.origin
        a, b = offset @ face.right / face.width_m**2, offset @ face.down / face.height_m**2
        inside = (np.abs(a - 0.5) < 0.55) & (np.abs(b - 0.5) < 0.55)
        nearest = np.where(inside, np.minimum(nearest, np.abs(offset @ face.normal)), nearest)
    return nearest


@pytest.mark.slow
def test_a_recording_with_depth_becomes_a_map_with_the_rooms_surfaces(tmp_path):
    """7-Scenes' files of the simulated room."""
    scene = make_test_site(0)
    renderer = Renderer(scene, [face.paint.albedo for face in scene.faces])
    camera = PHONE_CAMERA.resized(320, 240)
    depth_camera = Camera(640, 480, 585.0, 585.0, 320.0, 240.0).resized(*SIZE)
    for i, pose in enumerate(make_walk(1).poses(np.arange(0, 6, 0.25))):
        name = tmp_path / f"frame-{i:06d}"
        depth = np.round(1000 * renderer.surface(depth_camera, pose).depth).astype(np.uint16)
        assert cv2.imwrite(f"{name}.color.png", renderer.radiance(camera, [pose] * 4))
        assert cv2.imwrite(f"{name}.depth.png", depth)
        np.savetxt(f"{name}.pose.txt", pose.T_map_camera)
    recording = replace(read_recording(tmp_path), camera=camera)
    options = BuildOptions(poses=PoseMethod.GIVEN, report=False)
    cloud = build_map([recording], options).cloud
    assert len(cloud) > 5000  # of which the reconstruction alone has some hundred
    assert np.percentile(off_the_faces(scene, cloud.positions.astype(np.float64)), 95) < 0.03
