"""Every extractor keeps its promises on a picture with colour and texture."""

from __future__ import annotations

import numpy as np
import pytest

from rholoc.errors import InvalidDescriptors, InvalidInput
from rholoc.features import Channel, FeatureSet, extractor_names, get_extractor


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
