"""Where densities peak, as surfaces."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest

from rholoc.errors import InvalidInput
from rholoc.maps import Map, map_surfaces_vtp


def numbers(piece: ElementTree.Element, path: str) -> np.ndarray:
    element = piece.find(path)
    assert element is not None
    return np.array((element.text or "").split(), dtype=float)


def test_surfaces_are_closed_ellipsoids_three_sigma_wide(make_map) -> None:
    map_: Map = make_map()
    map_.landmarks.covariances[7] = [[0.04, 0.01, 0.0], [0.01, 0.09, 0.0], [0.0, 0.0, 0.01]]
    surfaces, path = ElementTree.fromstring(map_surfaces_vtp(map_, [9, 7])).iter("Piece")
    points = numbers(surfaces, "Points/DataArray").reshape(2, -1, 3)
    triangles = numbers(surfaces, "Polys/DataArray[@Name='connectivity']").astype(int).reshape(2, -1, 3)
    assert surfaces.attrib["NumberOfPoints"] == str(points[..., 0].size)
    assert surfaces.attrib["NumberOfPolys"] == str(triangles[..., 0].size)
    features = numbers(surfaces, "CellData/DataArray[@Name='feature']").reshape(2, -1)
    np.testing.assert_array_equal(features, np.repeat([[7], [9]], features.shape[1], axis=1))
    covariance = np.array([[0.04, 0.01, 0], [0.01, 0.09, 0], [0, 0, 0.01]])
    away = points[0] - map_.landmarks.positions[7]
    distances = np.sqrt(np.einsum("ni,ij,nj->n", away, np.linalg.inv(covariance), away))
    np.testing.assert_allclose(distances, 3, rtol=1e-3)
    edges = {tuple(edge) for t in triangles[0] for edge in (t[[0, 1]], t[[1, 2]], t[[2, 0]])}
    assert len(edges) == 3 * len(triangles[0])
    assert {(b, a) for a, b in edges} == edges  # each edge is walked once in either direction
    volume = np.linalg.det(away[triangles[0]]).sum() / 6
    assert volume == pytest.approx(4 / 3 * np.pi * 27 * np.sqrt(np.linalg.det(covariance)), rel=0.06)
    np.testing.assert_allclose(numbers(path, "Points/DataArray").reshape(-1, 3), map_.views.positions, atol=1e-5)
    assert len(numbers(path, "Lines/DataArray[@Name='connectivity']")) == len(map_.views)


@pytest.mark.parametrize(
    ("features", "says"),
    [([], "No feature"), ([60], "no feature 60"), ([-1], "no feature -1"), (range(5001), "5001 surfaces")],
)
def test_features_that_are_not_there_are_refused(room_map: Map, features, says: str) -> None:
    with pytest.raises(InvalidInput, match=says):
        map_surfaces_vtp(room_map, features)
