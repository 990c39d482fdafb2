"""Matching finds what it must, within channels only; pictures as vectors."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rholoc.features import FeatureSet, Metric
from rholoc.features.matching import DescriptorIndex, descriptor_distances, mutual_matches
from rholoc.features.picture_vectors import Vlad
from rholoc.geometry import ByteArray


def _features(descriptors: np.ndarray, channel: int = 0) -> FeatureSet:
    n = len(descriptors)
    zeros = np.zeros(n, np.float32)
    return FeatureSet(np.zeros((n, 2), np.float32), np.full(n, channel, np.uint8), descriptors, zeros, zeros)


def _random(n: int, size: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (n, size), dtype=np.uint8)


@pytest.mark.parametrize(("metric", "size"), [(Metric.HAMMING, 32), (Metric.EUCLIDEAN, 128)])
def test_the_nearest_is_the_nearest(metric: Metric, size: int) -> None:
    stored, asked = _random(200, size, 0), _random(20, size, 1)
    index = DescriptorIndex(stored, np.zeros(200, np.uint8), metric)
    distances, rows = index.nearest(_features(asked), 3)
    every = np.array([descriptor_distances(np.repeat(a[None], 200, 0), stored, metric) for a in asked])
    np.testing.assert_allclose(distances, np.sort(every, axis=1)[:, :3], rtol=1e-4)
    np.testing.assert_allclose(np.take_along_axis(every, rows, axis=1), distances, rtol=1e-4)


@given(flips=st.sets(st.integers(0, 255), max_size=60))
def test_hamming_counts_flipped_bits(flips: set[int]) -> None:
    a = _random(1, 32, 2)
    bits = np.unpackbits(a)
    bits[list(flips)] ^= 1
    assert descriptor_distances(a, np.packbits(bits)[None], Metric.HAMMING)[0] == len(flips)


@pytest.mark.parametrize(("metric", "size"), [(Metric.HAMMING, 32), (Metric.EUCLIDEAN, 128)])
def test_a_shuffled_copy_matches_itself(metric: Metric, size: int) -> None:
    descriptors = _random(100, size, 3)
    order = np.random.default_rng(4).permutation(100)
    pairs = mutual_matches(_features(descriptors), _features(descriptors[order]), metric, limit=1)
    assert len(pairs) == 100
    np.testing.assert_array_equal(order[pairs[:, 1]], pairs[:, 0])


def test_channels_do_not_mix() -> None:
    descriptors = _random(10, 32, 5)
    assert len(mutual_matches(_features(descriptors, 1), _features(descriptors, 2), Metric.HAMMING, 64)) == 0
    distances, rows = DescriptorIndex(descriptors, np.full(10, 1, np.uint8), Metric.HAMMING).nearest(
        _features(descriptors, 2), 2
    )
    assert np.isinf(distances).all()
    assert (rows == -1).all()


def test_nothing_matches_nothing() -> None:
    assert mutual_matches(FeatureSet.empty(32), FeatureSet.empty(32), Metric.HAMMING, 64).shape == (0, 2)


@pytest.mark.parametrize(("metric", "size"), [(Metric.HAMMING, 32), (Metric.EUCLIDEAN, 48)])
def test_an_inverted_file_finds_what_was_seen_again(metric: Metric, size: int) -> None:
    stored = _random(4000, size, 3)
    rng = np.random.default_rng(4)
    rows = rng.integers(0, len(stored), 200)
    noise = rng.integers(0, 256, (200, size), dtype=np.uint8)
    seen_again = np.where(rng.random((200, size)) < 0.1, noise, stored[rows])
    channels = (np.arange(len(stored)) % 2).astype(np.uint8)
    index = DescriptorIndex(stored, channels, metric, inverted=True)
    features = FeatureSet(
        np.zeros((200, 2), np.float32), channels[rows], seen_again, np.zeros(200, np.float32), np.zeros(200, np.float32)
    )
    distances, found = index.nearest(features, 2)
    hit = found[:, 0] == rows
    assert hit.mean() > 0.8  # of random descriptors, which have no lists of their own as real ones do
    exact = descriptor_distances(seen_again[hit], stored[rows[hit]], metric)
    np.testing.assert_allclose(distances[hit, 0], exact, rtol=1e-4)


def test_what_the_lists_of_an_inverted_file_lack_is_no_neighbour() -> None:
    different = _random(4, 48, 1)
    stored = np.concatenate([np.repeat(different[:1], 3997, axis=0), different[1:]])
    index = DescriptorIndex(stored, np.zeros(len(stored), np.uint8), Metric.EUCLIDEAN, inverted=True)
    distances, rows = index.nearest(_features(different[1:2]), 4)
    assert (distances[0, 0], rows[0, 0]) == (0, 3997)
    missing = np.isinf(distances[0])
    assert missing.any()
    np.testing.assert_array_equal(rows[0, missing], -1)
    assert len(set(rows[0, ~missing].tolist())) == np.count_nonzero(~missing)


def test_an_inverted_file_of_few_descriptors_is_exact() -> None:
    stored = _random(30, 32, 5)
    plain = DescriptorIndex(stored, np.zeros(30, np.uint8), Metric.HAMMING)
    inverted = DescriptorIndex(stored, np.zeros(30, np.uint8), Metric.HAMMING, inverted=True)
    asked = _features(_random(10, 32, 6))
    np.testing.assert_array_equal(plain.nearest(asked, 3)[1], inverted.nearest(asked, 3)[1])


@pytest.mark.parametrize("metric", list(Metric))
def test_no_descriptors_have_no_distances(metric: Metric) -> None:
    none = np.zeros((0, 32), dtype=np.uint8)
    assert descriptor_distances(none, none, metric).shape == (0,)


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
