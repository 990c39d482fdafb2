"""Colours: right matches have their landmarks', wrong ones do not, in whatever light."""

from __future__ import annotations

import numpy as np
import pytest

from rholoc.features import FeatureSet
from rholoc.geometry import Camera
from rholoc.localization import Query
from rholoc.localization.colours import colour_agreement

CAMERA = Camera(64, 48, 50.0, 50.0, 31.5, 23.5)


def _painted(count: int) -> np.ndarray:
    return np.random.default_rng(1).integers(40, 200, (count, 3), dtype=np.uint8)


@pytest.mark.parametrize("count", [4, 20, 300, 2000])
def test_they_agree_with_their_own_landmarks_and_the_more_the_more_there_are(count: int) -> None:
    known = _painted(count)
    compared = min(count, 300)
    assert colour_agreement(known, known) == pytest.approx(
        (1 - 1 / compared) * np.sqrt(compared / (compared + 6)), abs=0.02
    )
    assert abs(colour_agreement(np.random.default_rng(2).permutation(known), known)) < 1.5 / np.sqrt(compared)


def test_another_light_does_not_change_that() -> None:
    known = _painted(100)
    by_lamps = (known * (1.2, 0.9, 0.5)).astype(np.uint8)
    darker = (255 * (known / 255.0) ** 1.8).astype(np.uint8)
    assert min(colour_agreement(by_lamps, known), colour_agreement(darker, known)) > 0.85


def test_of_colours_that_are_not_known_nothing_is_said() -> None:
    known = _painted(10)
    assert np.isnan(colour_agreement(None, known))
    assert np.isnan(colour_agreement(known, None))
    assert np.isnan(colour_agreement(known[:3], known[:3]))
    grey = np.full((10, 3), 128, dtype=np.uint8)
    assert np.isnan(colour_agreement(known, grey))
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
    assert colours is not None
    assert colours.tolist() == [[3, 2, 1], [60, 50, 40]]
    assert Query(features, CAMERA).colours is None
    assert Query(features, CAMERA, image=image[..., 0]).colours is None
    own = np.full((2, 3), 9, dtype=np.uint8)
    sent = FeatureSet(pixels, features.channels, features.descriptors, zeros, zeros, own)
    assert Query(sent, CAMERA, image=image).colours is own
