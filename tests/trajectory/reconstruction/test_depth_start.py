"""Relative poses by depth pictures are metric, and chained and fitted to each other."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from scene import CAMERA, arc, cloud, in_pixels

from rholoc.geometry import FloatArray, kabsch
from rholoc.recordings.frames.depth import DepthImages
from rholoc.trajectory.reconstruction.depth_start import depth_start
from rholoc.trajectory.visual.matching import VerifiedPair

COUNT = 6
SCALE_M = 0.5  # metres per unit of the scene


def _depths(folder: Path, T: FloatArray, points: FloatArray) -> DepthImages:
    """Depth pictures (mm) in which a patch around each point has its depth."""
    paths = []
    for k, pose in enumerate(T):
        image = np.zeros((CAMERA.height, CAMERA.width), np.uint16)
        z = ((points - pose[:3, 3]) @ pose[:3, :3])[:, 2]
        for (u, v), depth in zip(np.round(in_pixels(points, pose)).astype(int).tolist(), z, strict=True):
            cv2.rectangle(image, (u - 2, v - 2), (u + 2, v + 2), round(1000 * SCALE_M * float(depth)), -1)
        paths.append(folder / f"{k}.png")
        assert cv2.imwrite(str(paths[-1]), image)
    return DepthImages(tuple(paths))


@pytest.fixture
def scene(tmp_path: Path) -> tuple[FloatArray, DepthImages, list[FloatArray], list[VerifiedPair]]:
    T, points = arc(COUNT), cloud(60)
    rays = [CAMERA.rays(in_pixels(points, pose)) for pose in T]
    all_matches = np.column_stack([np.arange(60)] * 2)
    pairs = [
        VerifiedPair(k, k + step, all_matches, T[k + step, :3, :3].T @ T[k, :3, :3])
        for step in (1, 2)
        for k in range(COUNT - step)
    ]
    return T, _depths(tmp_path, T, points), rays, pairs


def test_pictures_with_depth_are_placed_in_metres(scene) -> None:
    T, depths, rays, pairs = scene
    found = depth_start(CAMERA, depths, rays, pairs)
    assert found[1].tolist() == list(range(COUNT))
    placed = kabsch(found[0][:, :3, 3], SCALE_M * T[:, :3, 3]).poses(found[0])
    np.testing.assert_allclose(placed[:, :3, 3], SCALE_M * T[:, :3, 3], atol=0.02)
    np.testing.assert_allclose(placed[:, :3, :3], T[:, :3, :3], atol=0.02)


def test_a_pair_that_only_looks_alike_does_not_bend_them(scene) -> None:
    T, depths, rays, pairs = scene
    shuffled = np.column_stack([np.arange(60), np.random.default_rng(0).permutation(60)])
    found = depth_start(CAMERA, depths, rays, [*pairs, VerifiedPair(0, COUNT - 1, shuffled, np.eye(3))])
    placed = kabsch(found[0][:, :3, 3], SCALE_M * T[:, :3, 3]).poses(found[0])
    np.testing.assert_allclose(placed[:, :3, 3], SCALE_M * T[:, :3, 3], atol=0.02)


def test_without_depth_nothing_is_placed(scene) -> None:
    _, _, rays, pairs = scene
    assert depth_start(CAMERA, DepthImages((None,) * COUNT), rays, pairs) is None
