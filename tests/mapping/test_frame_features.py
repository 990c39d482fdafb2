"""Frames that another step has decoded are not decoded again for their features."""

from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from rholoc.features import get_extractor
from rholoc.mapping.build.frame_features import FrameFeatures
from rholoc.recordings import look_at
from rholoc.trajectory.visual.keyframe_features import KeyframeFeatures

IMAGES = np.random.default_rng(0).integers(0, 255, (6, 120, 160, 3), np.uint8)
EXTRACTOR = get_extractor("gray")


class Frames:
    """Counts what is decoded."""

    size = (160, 120)
    times = np.arange(6.0)
    numbers = np.arange(6)
    timed = True

    def __init__(self) -> None:
        self.decoded: list[int] = []

    def images(self, rows: Sequence[int]) -> Iterator[np.ndarray]:
        for row in rows:
            self.decoded.append(row)
            yield IMAGES[row]


def test_shown_frames_are_not_decoded_again() -> None:
    frames = Frames()
    features = FrameFeatures(frames, EXTRACTOR)
    with KeyframeFeatures(frames, show=features.show) as keyframes:
        keyframes.of(np.array([0, 2, 3]))
    assert frames.decoded == [0, 2, 3]
    found = list(features.of([0, 1, 3, 5]))
    assert frames.decoded == [0, 2, 3, 1, 5]
    for (one, look, picture), row in zip(found, [0, 1, 3, 5], strict=True):
        expected = EXTRACTOR.extract(IMAGES[row]).coloured(IMAGES[row])
        np.testing.assert_array_equal(one.descriptors, expected.descriptors)
        np.testing.assert_array_equal(one.colours, expected.colours)
        assert look == look_at(IMAGES[row])
        assert picture == b""


def test_without_a_step_before_all_are_decoded_once() -> None:
    frames = Frames()
    assert len(list(FrameFeatures(frames, EXTRACTOR).of([1, 4]))) == 2
    assert frames.decoded == [1, 4]


def test_small_pictures_are_kept_where_they_are_wanted() -> None:
    features = FrameFeatures(Frames(), EXTRACTOR, pictures=True)
    features.show(2, np.full((600, 1200, 3), 90, np.uint8))
    (shown,) = features.of([2])
    picture = cv2.imdecode(np.frombuffer(shown.picture, np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (120, 240, 3)
    np.testing.assert_allclose(picture, 90, atol=2)
