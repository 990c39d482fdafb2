"""Positions of cameras from what they see, their rotations known."""

import numpy as np
from scene import arc, cloud, on_plane
from scipy.spatial.transform import Rotation

from rholoc.geometry import umeyama
from rholoc.trajectory.initialization.global_positioning import global_positions


def test_positions_come_back_up_to_place_and_scale() -> None:
    """And not up to a rotation: that is known."""
    T, points = arc(16), cloud(120)
    rng = np.random.default_rng(0)
    keyframes, tracks = (grid.ravel() for grid in np.meshgrid(np.arange(16), np.arange(120), indexing="ij"))
    plane = np.concatenate([on_plane(points, one) for one in T]) + rng.normal(0, 1e-3, (16 * 120, 2))
    seen = rng.random(len(plane)) < 0.7
    rays = np.column_stack([plane, np.ones(len(plane))])
    found = global_positions(T[:, :3, :3], keyframes[seen], tracks[seen], rays[seen])
    similarity = umeyama(found, T[:, :3, 3])
    assert np.linalg.norm(similarity.points(found) - T[:, :3, 3], axis=1).max() < 0.03
    assert np.degrees(Rotation.from_matrix(similarity.rotation).magnitude()) < 1.0
