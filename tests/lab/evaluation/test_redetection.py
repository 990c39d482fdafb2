"""Repeatability and precision, where they are known."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from rholoc.errors import InvalidInput
from rholoc.features import FeatureSet, Metric, extractor_names, get_extractor
from rholoc_lab.evaluation.lighting_pairs import compare_lighting_pairs, stereo_counts
from rholoc_lab.evaluation.redetection import Redetection, redetection


def features(pixels: np.ndarray, descriptors: np.ndarray, channels: np.ndarray | int = 0) -> FeatureSet:
    n = len(pixels)
    zeros = np.zeros(n, np.float32)
    return FeatureSet(
        np.asarray(pixels, np.float32), np.full(n, channels, np.uint8) if np.isscalar(channels) else channels,
        descriptors, zeros, zeros,
    )  # fmt: skip


@pytest.fixture
def descriptors() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (5, 32), dtype=np.uint8)


def test_features_are_redetected_within_three_pixels_in_their_channel(descriptors: np.ndarray) -> None:
    a = features(np.array([[10, 10], [50, 50], [90, 90], [130, 130], [170, 170]]), descriptors)
    offsets = np.array([[0, 0], [2, 2], [3, 3], [0, 0], [0, 0]])  # the third is 4.2 px off
    channels = np.array([0, 0, 0, 1, 0], np.uint8)  # the fourth is of another channel
    where = np.asarray(a.pixels, np.float64).copy()
    where[4] = np.nan  # the fifth is hidden
    counts = redetection(a, features(a.pixels + offsets, descriptors, channels), where, Metric.HAMMING)
    # the fourth has no likeness in its channel that is mutual; the fifth matches, but cannot be right
    assert counts == Redetection(visible=4, redetected=2, matches=4, right=2)
    assert counts.repeatability == 0.5
    assert counts.precision == 0.5


def test_nothing_visible_has_no_share(descriptors: np.ndarray) -> None:
    a = features(np.zeros((5, 2)), descriptors)
    counts = redetection(a, FeatureSet.empty(32), np.full((5, 2), np.nan), Metric.HAMMING)
    assert counts == Redetection(0, 0, 0, 0)
    assert counts.figures() == {"repeatability": None, "precision": None, "right_matches": 0}


def test_totals_are_sums() -> None:
    assert Redetection.total([Redetection(4, 3, 2, 1), Redetection(6, 2, 3, 3)]) == Redetection(10, 5, 5, 4)


def test_a_stereo_match_lies_on_the_row_at_a_possible_disparity(descriptors: np.ndarray) -> None:
    left = features(np.array([[100, 10], [100, 50], [100, 90], [100, 130], [100, 170]]), descriptors)
    right = features(left.pixels - [[20, 0], [0, 0.5], [64, 0], [65, 0], [-3, 0]], descriptors)
    assert stereo_counts(left, right, get_extractor("gray"), max_disparity_px=64) == (5, 3)
    off_row = features(left.pixels - [[20, 1.5]], descriptors)
    assert stereo_counts(left, off_row, get_extractor("gray"), max_disparity_px=64) == (5, 0)


def write_scene(folder: Path, stereo: bool) -> None:
    image = np.random.default_rng(1).integers(0, 256, (60, 80, 3), dtype=np.uint8)
    image = cv2.resize(image, (320, 240), interpolation=cv2.INTER_NEAREST)
    folder.mkdir()
    cv2.imwrite(str(folder / "right_changed.png"), image)
    cv2.imwrite(str(folder / "left_default.png" if stereo else folder / "right_default.png"), image)


def test_every_extractor_is_compared_on_every_scene(tmp_path: Path) -> None:
    write_scene(tmp_path / "a", stereo=False)
    write_scene(tmp_path / "b", stereo=True)
    (tmp_path / "b" / "calib.txt").write_text("baseline=100\n ndisp= 64 \n")
    found = compare_lighting_pairs(tmp_path)
    assert [(pair.scene, pair.features) for pair in found] == [(s, n) for s in "ab" for n in extractor_names()]
    for pair in found:
        if pair.scene == "a":  # the same picture twice
            assert pair.registered is not None
            assert pair.registered.repeatability == 1
            assert pair.registered.precision == pytest.approx(1, abs=0.02)  # but for features that look alike
            assert pair.stereo_precision is None
        else:
            assert pair.registered is None
            assert pair.stereo_precision == pytest.approx(1, abs=0.02)


def test_a_folder_without_scenes_or_calibration_is_reported(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="no lighting pairs"):
        compare_lighting_pairs(tmp_path)
    write_scene(tmp_path / "b", stereo=True)
    with pytest.raises(InvalidInput, match=r"calib\.txt"):
        compare_lighting_pairs(tmp_path, ["gray"])
