"""Positions of cameras from what they see, their rotations known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pycolmap
import pytest
from scene import arc, cloud, on_plane, rays
from scipy.spatial.transform import Rotation

from rholoc.errors import MappingFailed
from rholoc.geometry import umeyama
from rholoc.trajectory.initialization.global_positioning import global_positions


def test_positions_come_back_up_to_place_and_scale() -> None:
    """And not up to a rotation: that is known."""
    T, points = arc(16), cloud(120)
    rng = np.random.default_rng(0)
    keyframes, tracks = (grid.ravel() for grid in np.meshgrid(np.arange(16), np.arange(120), indexing="ij"))
    plane = np.concatenate([on_plane(points, one) for one in T]) + rng.normal(0, 1e-3, (16 * 120, 2))
    seen = rng.random(len(plane)) < 0.7
    found = global_positions(T[:, :3, :3], keyframes[seen], tracks[seen], rays(plane[seen]))
    similarity = umeyama(found, T[:, :3, 3])
    assert np.linalg.norm(similarity.points(found) - T[:, :3, 3], axis=1).max() < 0.03
    assert np.degrees(Rotation.from_matrix(similarity.rotation).magnitude()) < 1.0


def test_what_is_seen_is_handed_over_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every sighting, in the image of an ideal camera wide enough for any; the sightings come in no order."""
    handed: list[Any] = []

    def run(options: Any, graph: object, model: Any) -> bool:
        handed.extend([model, options])
        return False

    monkeypatch.setattr(pycolmap, "run_global_positioning", run)
    T, points = arc(4), cloud(9)
    rng = np.random.default_rng(0)
    keyframes, tracks = (grid.ravel() for grid in np.meshgrid(np.arange(4), np.arange(9), indexing="ij"))
    some = rng.permutation(36)[:30]
    keyframes, tracks = keyframes[some], tracks[some]
    plane = np.array([on_plane(points[[track]], T[k])[0] for k, track in zip(keyframes, tracks, strict=True)])
    with pytest.raises(MappingFailed, match="No positions"):
        global_positions(T[:, :3, :3], keyframes, tracks, rays(plane), seed=5)
    model, options = handed
    assert (options.use_gpu, options.random_seed) == (False, 5)
    (camera,) = model.cameras.values()
    assert camera.has_prior_focal_length
    seen = {
        (image.image_id, j): camera.cam_from_img(point.xy)
        for image in model.images.values()
        for j, point in enumerate(image.points2D)
    }
    assert len(seen) == 30
    assert min(camera.width, camera.height) > 3 * camera.focal_length_x
    for image in model.images.values():
        np.testing.assert_allclose(image.cam_from_world().rotation.matrix(), T[image.image_id - 1, :3, :3].T, atol=1e-9)
    found = set()
    for point in model.points3D.values():
        track_of = [(one.image_id - 1, seen[one.image_id, one.point2D_idx]) for one in point.track.elements]
        (track,) = {
            t for k, ray in track_of for t in range(9) if np.allclose(on_plane(points[[t]], T[k])[0], ray, atol=1e-9)
        }
        found |= {(k, track) for k, _ in track_of}
    assert found == set(zip(keyframes.tolist(), tracks.tolist(), strict=True))
