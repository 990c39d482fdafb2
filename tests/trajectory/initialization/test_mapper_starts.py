"""pycolmap's mappers give all pieces of a set of pictures, the largest first."""

import numpy as np
import pytest
from scene import CAMERA, arc, cloud, descriptors_of, in_pixels, sift_like

from rholoc.geometry import umeyama
from rholoc.trajectory.initialization.mapper_starts import Mapper, PycolmapStarts
from rholoc.trajectory.visual.matching import match_pictures

_SMALL, _LARGE = 7, 10  # pictures of each room


@pytest.mark.parametrize("mapper", [Mapper.INCREMENTAL, Mapper.GLOBAL])
def test_pictures_of_two_rooms_are_two_pieces(mapper: Mapper) -> None:
    rooms = [(cloud(200, seed), descriptors_of(200, seed), arc(size)) for seed, size in ((0, _SMALL), (1, _LARGE))]
    features = [sift_like(in_pixels(points, T), found) for points, found, poses in rooms for T in poses]
    pairs, _ = match_pictures(features, [CAMERA.rays(one.pixels) for one in features], CAMERA.focal)
    pixels = [one.pixels.astype(np.float64) for one in features]
    with PycolmapStarts(CAMERA, True, pixels, pairs) as starts:
        (large, T_large, _), (small, T_small, _) = starts.pieces(mapper)
    np.testing.assert_array_equal(large, np.arange(_SMALL, _SMALL + _LARGE))
    np.testing.assert_array_equal(small, np.arange(_SMALL))
    for found, truth in ((T_large, arc(_LARGE)), (T_small, arc(_SMALL))):
        positions = umeyama(found[:, :3, 3], truth[:, :3, 3]).points(found[:, :3, 3])
        np.testing.assert_allclose(positions, truth[:, :3, 3], atol=0.02)
