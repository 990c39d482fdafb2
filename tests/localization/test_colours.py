"""Colours: right matches are as light as their landmarks' let expect, wrong ones are not, in whatever light."""

from collections.abc import Callable

import numpy as np
import pytest

from rholoc.features import FeatureSet
from rholoc.geometry import Camera
from rholoc.localization import Query
from rholoc.localization.pose.colour_evidence import colour_agreement

CAMERA = Camera(64, 48, 50.0, 50.0, 31.5, 23.5)


def _painted(count: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).integers(40, 200, (count, 3), dtype=np.uint8)


@pytest.mark.parametrize(("count", "least"), [(10, 0.35), (20, 0.7), (300, 0.97), (2000, 0.97)])
def test_they_agree_with_their_own_landmarks_and_the_more_the_more_there_are(count: int, least: float) -> None:
    known = _painted(count)
    assert least < colour_agreement(known, known) < 1


@pytest.mark.parametrize("count", [4, 20, 300])
def test_with_others_they_agree_no_more_than_by_chance(count: int) -> None:
    known = _painted(count)
    agreements = [colour_agreement(_painted(count, seed), known) for seed in range(2, 42)]
    assert min(agreements) == 0.0
    assert np.mean(agreements) < 0.15


def _as_grey(colours: np.ndarray) -> np.ndarray:
    return np.repeat((colours @ (0.299, 0.587, 0.114)).astype(np.uint8)[:, None], 3, axis=1)


@pytest.mark.parametrize(
    "seen",
    [
        lambda colours: colours * (1.2, 0.45, 0.3),
        lambda colours: colours * (0.3, 0.5, 1.2),
        lambda colours: 255 * (colours / 255.0) ** 1.8,
        lambda colours: colours.mean(axis=1, keepdims=True) * (1.2, 0.1, 0.05),
        lambda colours: colours[:, ::-1],
        _as_grey,
    ],
    ids=["warm lamp", "cold lamp", "darker", "red lamp", "red for blue", "grey camera"],
)
def test_another_light_or_camera_does_not_change_that(seen: Callable[[np.ndarray], np.ndarray]) -> None:
    known = _painted(100)
    assert colour_agreement(seen(known).astype(np.uint8), known) > 0.85


def test_a_grey_map_is_asked_by_grey_and_by_coloured_pictures() -> None:
    colours = _painted(100)
    grey = _as_grey(colours)
    assert colour_agreement(grey, grey) > 0.9
    assert colour_agreement(colours, grey) > 0.6


def test_of_colours_that_are_not_known_nothing_is_said() -> None:
    known = _painted(10)
    assert np.isnan(colour_agreement(None, known))
    assert np.isnan(colour_agreement(known, None))
    assert np.isnan(colour_agreement(known[:3], known[:3]))
    grey = np.full((10, 3), 128, dtype=np.uint8)
    assert np.isnan(colour_agreement(known, grey))
    assert np.isnan(colour_agreement(grey, known))
    mixed = np.concatenate([known, grey])
    assert colour_agreement(np.concatenate([known, known]), mixed) == colour_agreement(known, known)


def test_a_query_knows_the_colours_of_its_picture() -> None:
    pixels = np.array([[10.0, 10.0], [50.0, 30.0]], dtype=np.float32)
    zeros = np.zeros(2, dtype=np.float32)
    features = FeatureSet(pixels, np.zeros(2, np.uint8), np.zeros((2, 32), np.uint8), zeros, zeros)
    image = np.zeros((48, 64, 3), dtype=np.uint8)
    image[:, :32] = (1, 2, 3)  # blue, green, red
    image[:, 32:] = (40, 50, 60)
    colours = Query(features, CAMERA, image=image).colours
    assert colours.tolist() == [[3, 2, 1], [60, 50, 40]]
    assert Query(features, CAMERA).colours is None
    assert Query(features, CAMERA, image=image[..., 0]).colours is None
    own = np.full((2, 3), 9, dtype=np.uint8)
    sent = FeatureSet(pixels, features.channels, features.descriptors, zeros, zeros, own)
    assert Query(sent, CAMERA, image=image).colours is own
