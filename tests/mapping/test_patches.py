"""The patches that maps know of their landmarks: what every view that saw them measured, about."""

from typing import Any

import numpy as np
import pytest

from rholoc.geometry import patch_appearance
from rholoc.mapping.learn.merging import remembered_frames
from rholoc.maps import Map, load_map, save_map


@pytest.fixture(scope="module")
def map_(point_room: Any) -> Map:
    return point_room.map_of(point_room.walk(45), "walk")


def test_landmarks_know_their_patches(point_room: Any, map_: Map) -> None:
    turned, octaves = point_room.patch_errors(map_)
    assert np.percentile(turned, [50, 90]) == pytest.approx([0, 0], abs=25)
    assert np.percentile(octaves, [50, 90]) == pytest.approx([0, 0], abs=0.2)


def test_patches_foretell_what_another_camera_measures(point_room: Any, map_: Map) -> None:
    pose = point_room.walk(80, sideways_m=0.3)[20]
    seen = point_room.see(pose, seed=7, share=1.0)
    camera, T = point_room.camera, pose.T_map_camera
    pixels = camera.project((map_.landmarks.positions - T[:3, 3]) @ T[:3, :3])
    apart_px = np.linalg.norm(np.nan_to_num(pixels, nan=1e6)[:, None] - seen.pixels, axis=2)
    landmarks = np.flatnonzero(apart_px.min(axis=1) < 3)
    assert len(landmarks) > 50
    rows = apart_px[landmarks].argmin(axis=1)
    angles, sizes_px = patch_appearance(
        camera, T, map_.landmarks.positions[landmarks], map_.landmarks.patches[landmarks]
    )
    turned = np.rad2deg(np.abs(np.angle(np.exp(1j * (angles - seen.angles[rows])))))
    octaves = np.abs(np.log2(sizes_px / seen.sizes[rows]))
    assert np.mean((turned < 20) & (octaves < 0.4)) > 0.9


def test_a_map_that_is_read_back_has_the_patches_that_were_built(map_: Map, tmp_path: Any) -> None:
    save_map(map_, tmp_path / "room.rho")
    np.testing.assert_array_equal(load_map(tmp_path / "room.rho").landmarks.patches, map_.landmarks.patches)


def test_remembered_frames_have_patches_as_they_looked(point_room: Any, map_: Map) -> None:
    frames, poses = remembered_frames(map_), point_room.walk(45)
    _, remembered = frames[10]
    seen = point_room.see(poses[10], seed=10)
    rows = np.linalg.norm(remembered.pixels[:, None] - seen.pixels, axis=2).argmin(axis=1)
    turned = np.rad2deg(np.abs(np.angle(np.exp(1j * (remembered.angles - seen.angles[rows])))))
    octaves = np.abs(np.log2(remembered.sizes / seen.sizes[rows]))
    assert np.mean((turned < 20) & (octaves < 0.4)) > 0.9
