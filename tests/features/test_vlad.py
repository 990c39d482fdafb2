"""Pictures as vectors."""

from __future__ import annotations

import numpy as np

from rholoc.features.picture_vectors import Vlad
from rholoc.geometry import ByteArray


def _place(seed: int, count: int = 200) -> ByteArray:
    """Descriptors of a place: around a few centres of its own."""
    rng = np.random.default_rng(seed)
    centres = rng.integers(0, 255, (8, 32))
    return np.clip(centres[rng.integers(0, 8, count)] + rng.normal(0, 6, (count, 32)), 0, 255).astype(np.uint8)


def test_the_same_place_is_most_alike() -> None:
    places = [_place(seed) for seed in range(6)]
    vlad = Vlad(places)
    vectors = np.array([vlad.vector(place) for place in places])
    again = np.array([vlad.vector(place[::2]) for place in places])
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1.0, atol=1e-6)
    assert (again @ vectors.T).argmax(axis=1).tolist() == list(range(6))


def test_the_order_of_descriptors_does_not_matter() -> None:
    place = _place(3)
    vlad = Vlad([place, _place(4)])
    np.testing.assert_allclose(vlad.vector(place[::-1]), vlad.vector(place), atol=1e-6)


def test_a_picture_without_descriptors_is_like_none() -> None:
    vlad = Vlad([_place(0), np.zeros((0, 32), np.uint8)])
    assert not vlad.vector(np.zeros((0, 32), np.uint8)).any()


def test_few_descriptors_give_few_words() -> None:
    assert len(Vlad([_place(0, 90)]).words) == 2
