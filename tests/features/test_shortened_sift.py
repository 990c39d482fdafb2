"""SIFT of shrunk pictures, its descriptors shortened."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from rholoc.features import Metric
from rholoc.features.extractors._sift import SiftExtractor, evening_rotation
from rholoc.features.matching import descriptor_distances, mutual_matches
from rholoc.geometry import ByteArray


@pytest.fixture(scope="module")
def picture() -> ByteArray:
    """Blots of all sizes, 960 × 720."""
    rng = np.random.default_rng(4)
    noise = [
        cv2.resize(rng.normal(size=(n * 3, n * 4)), (960, 720), interpolation=cv2.INTER_CUBIC) for n in (8, 24, 72)
    ]
    return (128 + 45 * sum(noise)).clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize("size", [32, 48, 64])
def test_shortened_descriptors_keep_their_distances(picture: ByteArray, size: int) -> None:
    whole = SiftExtractor(longest_px=400).extract(picture)
    short = SiftExtractor(longest_px=400, descriptor_bytes=size).extract(picture)
    assert short.descriptors.shape == (len(whole), size)
    pairs = np.random.default_rng(0).integers(0, len(whole), (2000, 2))
    a, b = (
        descriptor_distances(one.descriptors[pairs[:, 0]], one.descriptors[pairs[:, 1]], Metric.EUCLIDEAN)
        for one in (whole, short)
    )
    assert np.corrcoef(a, b)[0, 1] > 0.9
    assert 0.75 < np.median(b[a > 0] / a[a > 0]) < 1.02


@pytest.mark.parametrize("size", [32, 48, 64])
def test_hardly_a_byte_is_cut_off(picture: ByteArray, size: int) -> None:
    descriptors = SiftExtractor(descriptor_bytes=size).extract(picture).descriptors
    assert ((descriptors == 0) | (descriptors == 255)).mean() < 0.02


def test_features_of_a_shrunk_picture_lie_where_those_of_the_whole_one_do(picture: ByteArray) -> None:
    whole = SiftExtractor(descriptor_bytes=48, features=3000, exact=True).extract(picture)
    shrunk = SiftExtractor(descriptor_bytes=48, longest_px=400, exact=True).extract(picture)
    pairs = mutual_matches(whole, shrunk, Metric.EUCLIDEAN, 200)
    assert len(pairs) > 100
    apart = whole.pixels[pairs[:, 0]] - shrunk.pixels[pairs[:, 1]]
    assert np.abs(np.median(apart, axis=0)).max() < 0.15
    ratio = shrunk.sizes[pairs[:, 1]] / whole.sizes[pairs[:, 0]]
    assert np.median(ratio) == pytest.approx(1, abs=0.05)


def test_a_small_picture_is_not_enlarged(picture: ByteArray) -> None:
    small = np.asarray(cv2.resize(picture, (320, 240)))
    one, other = (SiftExtractor(longest_px=px).extract(small) for px in (None, 400))
    np.testing.assert_array_equal(one.pixels, other.pixels)


def test_the_evening_rotation_is_one_and_always_the_same() -> None:
    R = evening_rotation(48)
    np.testing.assert_allclose(R @ R.T, np.eye(48), atol=1e-5)
    np.testing.assert_array_equal(R, evening_rotation(48))


def test_quick_features_are_fewer_of_the_same(picture: ByteArray) -> None:
    whole = SiftExtractor(descriptor_bytes=48, features=5000, longest_px=800, quick_px=400, exact=True)
    assert whole.quick.quick is whole.quick
    assert whole.quick.descriptor_bytes == 48
    few, many = whole.quick.extract(picture), whole.extract(picture)
    assert len(few) < len(many)
    pairs = mutual_matches(few, many, Metric.EUCLIDEAN, 200)
    assert len(pairs) > len(few) / 3
    assert np.abs(np.median(few.pixels[pairs[:, 0]] - many.pixels[pairs[:, 1]], axis=0)).max() < 0.15
