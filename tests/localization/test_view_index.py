"""One index over the views of many maps, held against comparing all of them."""

from itertools import pairwise
from typing import cast

import numpy as np
import pytest

from rholoc.features import Metric
from rholoc.features.picture_vectors import DIMENSIONS, PictureVectors, normalised
from rholoc.geometry import ByteArray, FloatArray
from rholoc.localization.index.view_index import ViewIndex, packed_vectors, unpacked_vectors


class Given:
    """Pictures that are vectors already."""

    def vectors(self, pictures: list[FloatArray]) -> FloatArray:
        return np.array(pictures, dtype=np.float32).reshape(-1, DIMENSIONS)


def index() -> ViewIndex:
    return ViewIndex(cast(PictureVectors, Given()))


def room(seed: int, views: int = 60) -> FloatArray:
    """The vectors of a room's views, which have something in common."""
    rng = np.random.default_rng(seed)
    return normalised(rng.normal(size=(1, DIMENSIONS)) + rng.normal(size=(views, DIMENSIONS))).astype(np.float32)


def beside(vector: FloatArray) -> ByteArray:
    noise = np.random.default_rng(1).normal(size=DIMENSIONS) / np.sqrt(DIMENSIONS)
    return cast(ByteArray, normalised((vector + 0.5 * noise)[None])[0])


@pytest.mark.parametrize("maps", [20, 300])  # few are all compared; many are in lists
def test_the_map_that_a_picture_was_taken_in_comes_first(maps: int) -> None:
    found = index()
    for first in range(0, maps, 10):
        found.put({f"room{seed}": room(seed) for seed in range(first, first + 10)})
    assert len(found) == 60 * maps
    for seed in range(0, maps, 7):
        likely = found.likeliest(beside(room(seed)[3]), 5)
        assert likely[0].name == f"room{seed}"
        assert len(likely) == 5
        assert all(a.score >= b.score for a, b in pairwise(likely))


def test_a_map_that_is_dropped_or_replaced_is_not_found_as_it_was() -> None:
    found = index()
    found.put({f"room{seed}": room(seed) for seed in range(8)})
    found.drop(["room3"])
    found.put({"room4": room(40)})
    assert found.names == {f"room{seed}" for seed in range(8)} - {"room3"}
    assert found.likeliest(beside(room(3)[0]), 1)[0].name != "room3"
    assert found.likeliest(beside(room(40)[0]), 1)[0].name == "room4"


def test_what_was_dropped_is_cleared_away_when_it_is_much() -> None:
    found = index()
    for seed in range(250):
        found.put({f"room{seed % 10}": room(seed)})
    assert found.names == {f"room{seed}" for seed in range(10)}
    assert len(found) == 600
    assert len(found._held.owners) < 10_000
    assert found.likeliest(beside(room(247)[0]), 1)[0].name == "room7"


@pytest.mark.parametrize("maps", [20, 300])
def test_some_maps_can_be_chosen_from(maps: int) -> None:
    found = index()
    for first in range(0, maps, 10):
        found.put({f"room{seed}": room(seed) for seed in range(first, first + 10)})
    likely = found.likeliest(beside(room(3)[0]), 5, among=["room5", "room7", "no such room"])
    assert {one.name for one in likely} <= {"room5", "room7"}
    assert found.likeliest(beside(room(7)[0]), 5, among=["room5", "room7"])[0].name == "room7"


def test_a_picture_without_features_speaks_for_no_map() -> None:
    found = index()
    found.put({"room": room(0)})
    assert found.likeliest(cast(ByteArray, np.zeros(DIMENSIONS)), 5) == []
    assert index().likeliest(beside(room(0)[0]), 5) == []


def test_vectors_are_kept_to_a_byte_a_number() -> None:
    vectors = room(0)
    assert packed_vectors(vectors).nbytes == vectors.size
    assert np.abs(unpacked_vectors(packed_vectors(vectors)) - vectors).max() <= 0.5 / 254 + 1e-6


@pytest.mark.parametrize("metric", list(Metric))
def test_pictures_that_share_descriptors_have_like_vectors(metric: Metric) -> None:
    rng = np.random.default_rng(0)
    rooms = [rng.integers(0, 256, (400, 32), dtype=np.uint8) for _ in range(6)]
    pictures = [one[rng.permutation(400)[:150]] for one in rooms for _ in range(8)]
    learned = PictureVectors.learned(pictures, metric)
    restored = PictureVectors.of_arrays(learned.arrays(), metric)
    vectors = restored.vectors([*(one[:200] for one in rooms), np.zeros((0, 32), np.uint8)])
    assert np.array_equal(vectors, learned.vectors([*(one[:200] for one in rooms), np.zeros((0, 32), np.uint8)]))
    assert np.allclose(np.linalg.norm(vectors[:-1], axis=1), 1, atol=1e-5)
    assert not vectors[-1].any()
    likeness = vectors[:-1] @ restored.vectors(pictures).T
    assert np.array_equal(likeness.argmax(axis=1) // 8, np.arange(6))
