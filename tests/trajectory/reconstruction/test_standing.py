"""Pictures that a camera took from one place: they hold no depths, whatever is known of the lens."""

from dataclasses import replace

import numpy as np
import pytest
from scene import descriptors_of, sift_like
from scipy.spatial.transform import Rotation
from synthetic_walk import followed

from rholoc.errors import MappingFailed
from rholoc.geometry import Camera
from rholoc.trajectory.reconstruction import Sights, reconstruct

COUNT, POINTS, NOISE_PX = 12, 900, 0.3
WIDE = Camera(640, 480, 430.0, 430.0, 319.5, 239.5, (-0.25, 0.06, 0.0, 0.0))
LONG = Camera(640, 480, 850.0, 850.0, 319.5, 239.5)


def turning(camera: Camera, given: Camera | None) -> Sights:
    """Pictures over 110°, pitched at random, of points 2 to 5 m away by ``camera``, of which ``given`` is known."""
    rng, descriptors = np.random.default_rng(0), descriptors_of(POINTS)
    away = rng.normal(size=(POINTS, 3)) * [1, 0.4, 1]
    points = away / np.linalg.norm(away, axis=1, keepdims=True) * rng.uniform(2, 5, (POINTS, 1))
    angles = np.column_stack([np.linspace(0, 110, COUNT), rng.uniform(-8, 8, COUNT)])
    features = []
    for R_map_camera in Rotation.from_euler("yx", angles, degrees=True).as_matrix():
        ahead = points @ R_map_camera
        near = np.flatnonzero(ahead[:, 2] > 0.5 * np.linalg.norm(ahead, axis=1))
        pixels = camera.project(ahead[near]) + rng.normal(0, NOISE_PX, (len(near), 2))
        inside = camera.contains(pixels)
        features.append(sift_like(pixels[inside], descriptors[near[inside]]))
    nothing = np.zeros((COUNT, 0))
    flow = followed(np.arange(float(COUNT)), (640, 480), nothing[..., None].repeat(2, 2), nothing.astype(np.bool_))
    return Sights(flow, np.arange(COUNT), features, given, is_film=False)


@pytest.mark.parametrize(
    ("camera", "given"), [(LONG, None), (WIDE, replace(WIDE, distortion=()))], ids=["unknown", "distortion left out"]
)
def test_pictures_from_one_place_are_refused_with_that_reason(camera: Camera, given: Camera | None) -> None:
    """Such a set whose distortion was left out became a map, on which two reconstructions agreed."""
    with pytest.raises(MappingFailed, match="taken from one place") as failed:
        reconstruct(turning(camera, given), None, [])
    assert "sideways" in failed.value.hint
