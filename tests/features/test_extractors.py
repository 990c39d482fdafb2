"""Every extractor keeps its promises on a picture with colour and texture."""

import cv2
import numpy as np
import pytest

from rholoc.errors import InvalidDescriptors, InvalidInput
from rholoc.features import Channel, FeatureSet, Metric, extractor_names, get_extractor
from rholoc.features.extractors._sift import SiftExtractor, evening_rotation
from rholoc.features.matching import descriptor_distances, mutual_matches
from rholoc.geometry import ByteArray


@pytest.fixture(scope="module")
def picture() -> np.ndarray:
    rng = np.random.default_rng(1)
    coarse = rng.integers(0, 256, (24, 32, 3), dtype=np.uint8)
    return np.kron(coarse, np.ones((20, 20, 1), dtype=np.uint8))


def test_the_extractors_that_need_nothing_else_are_there() -> None:
    assert set(extractor_names()) - {"xfeat"} == {"gray", "lab", "lab3", "rgb", "sift", "sift48"}


@pytest.mark.parametrize("name", extractor_names())
def test_features_are_of_the_extractors_kind(name: str, picture: np.ndarray) -> None:
    extractor = get_extractor(name)
    features = extractor.extract(picture)
    assert len(features) > 100
    assert features.descriptors.shape == (len(features), extractor.descriptor_bytes)
    assert set(features.channels) == {int(channel) for channel in extractor.channels}
    assert (features.pixels >= 0).all()
    assert (features.pixels < (640, 480)).all()


@pytest.mark.parametrize("name", extractor_names())
def test_extraction_is_deterministic(name: str, picture: np.ndarray) -> None:
    first, second = (get_extractor(name).extract(picture) for _ in range(2))
    np.testing.assert_array_equal(first.descriptors, second.descriptors)
    np.testing.assert_array_equal(first.pixels, second.pixels)


@pytest.mark.parametrize("name", extractor_names())
def test_a_blank_picture_has_no_features(name: str) -> None:
    assert len(get_extractor(name).extract(np.full((120, 160, 3), 128, dtype=np.uint8))) == 0


@pytest.mark.parametrize("name", extractor_names())
@pytest.mark.parametrize("shape", [(1, 1, 3), (1, 500, 3), (500, 1), (30, 30, 3)])
def test_a_tiny_picture_has_no_features(name: str, shape: tuple[int, ...]) -> None:
    assert len(get_extractor(name).extract(np.zeros(shape, dtype=np.uint8))) == 0


@pytest.mark.parametrize("name", extractor_names())
def test_grey_pictures_are_taken(name: str, picture: np.ndarray) -> None:
    get_extractor(name).extract(picture[:, :, 0].copy())


def test_the_papers_channels_have_the_papers_prefixes() -> None:
    assert [int(channel) for channel in get_extractor("lab").channels] == [1, 2]
    assert Channel.L == 0


def test_an_unknown_name_is_refused_with_the_known_ones() -> None:
    with pytest.raises(InvalidInput, match="gray, lab"):
        get_extractor("surf")


def test_feature_sets_refuse_arrays_that_disagree() -> None:
    one, two = np.zeros(1, np.float32), np.zeros(2, np.float32)
    with pytest.raises(InvalidDescriptors):
        FeatureSet(np.zeros((2, 2), np.float32), np.zeros(1, np.uint8), np.zeros((2, 32), np.uint8), two, two)
    with pytest.raises(InvalidDescriptors):
        FeatureSet(np.full((1, 2), np.nan, np.float32), np.zeros(1, np.uint8), np.zeros((1, 32), np.uint8), one, one)


def test_concatenation_and_taking_undo_each_other(picture: np.ndarray) -> None:
    features = get_extractor("gray").extract(picture)
    halves = [features.take(np.arange(50)), features.take(np.arange(50, len(features)))]
    np.testing.assert_array_equal(FeatureSet.concatenate(halves).descriptors, features.descriptors)


@pytest.fixture(scope="module")
def blots() -> ByteArray:
    """Blots of all sizes, 960 × 720."""
    rng = np.random.default_rng(4)
    noise = [
        cv2.resize(rng.normal(size=(n * 3, n * 4)), (960, 720), interpolation=cv2.INTER_CUBIC) for n in (8, 24, 72)
    ]
    return (128 + 45 * sum(noise)).clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize("size", [32, 64])
def test_shortened_descriptors_keep_their_distances(blots: ByteArray, size: int) -> None:
    whole = SiftExtractor(longest_px=400).extract(blots)
    short = SiftExtractor(longest_px=400, descriptor_bytes=size).extract(blots)
    assert short.descriptors.shape == (len(whole), size)
    pairs = np.random.default_rng(0).integers(0, len(whole), (2000, 2))
    a, b = (
        descriptor_distances(one.descriptors[pairs[:, 0]], one.descriptors[pairs[:, 1]], Metric.EUCLIDEAN)
        for one in (whole, short)
    )
    assert np.corrcoef(a, b)[0, 1] > 0.9
    assert 0.75 < np.median(b[a > 0] / a[a > 0]) < 1.02


@pytest.mark.parametrize("size", [32, 48])
def test_hardly_a_byte_is_cut_off(blots: ByteArray, size: int) -> None:
    descriptors = SiftExtractor(descriptor_bytes=size).extract(blots).descriptors
    assert ((descriptors == 0) | (descriptors == 255)).mean() < 0.02


def test_features_of_a_shrunk_picture_lie_where_those_of_the_whole_one_do(blots: ByteArray) -> None:
    whole = SiftExtractor(descriptor_bytes=48, features=3000, exact=True).extract(blots)
    shrunk = SiftExtractor(descriptor_bytes=48, longest_px=400, exact=True).extract(blots)
    pairs = mutual_matches(whole, shrunk, Metric.EUCLIDEAN, 200)
    assert len(pairs) > 100
    apart = whole.pixels[pairs[:, 0]] - shrunk.pixels[pairs[:, 1]]
    assert np.abs(np.median(apart, axis=0)).max() < 0.15
    ratio = shrunk.sizes[pairs[:, 1]] / whole.sizes[pairs[:, 0]]
    assert np.median(ratio) == pytest.approx(1, abs=0.05)


def test_a_small_picture_is_not_enlarged(blots: ByteArray) -> None:
    small = np.asarray(cv2.resize(blots, (320, 240)))
    one, other = (SiftExtractor(longest_px=px).extract(small) for px in (None, 400))
    np.testing.assert_array_equal(one.pixels, other.pixels)


def test_the_evening_rotation_is_one_and_always_the_same() -> None:
    R = evening_rotation(48)
    np.testing.assert_allclose(R @ R.T, np.eye(48), atol=1e-5)
    np.testing.assert_array_equal(R, evening_rotation(48))


def test_quick_features_are_fewer_of_the_same(blots: ByteArray) -> None:
    whole = SiftExtractor(descriptor_bytes=48, features=5000, longest_px=800, quick_px=400, exact=True)
    assert whole.quick.quick is whole.quick
    assert whole.quick.descriptor_bytes == 48
    few, many = whole.quick.extract(blots), whole.extract(blots)
    assert len(few) < len(many)
    pairs = mutual_matches(few, many, Metric.EUCLIDEAN, 200)
    assert len(pairs) > len(few) / 3
    assert np.abs(np.median(few.pixels[pairs[:, 0]] - many.pixels[pairs[:, 1]], axis=0)).max() < 0.15
