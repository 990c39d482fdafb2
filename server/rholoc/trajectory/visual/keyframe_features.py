"""SIFT features of keyframes, in pixels of the full image."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace

import cv2
import numpy as np

from rholoc.features import FeatureSet
from rholoc.features.extractors._sift import SiftExtractor
from rholoc.geometry import ByteArray, IntArray
from rholoc.progress import ProgressListener, Stage, silent
from rholoc.recordings import FrameSource

_LONGER_SIDE_PX = 960  # larger images are reduced to this: more pixels cost time and place no frame more
_THREADS = 2
_EXTRACTOR = SiftExtractor(features=1000)

FrameListener = Callable[[int, ByteArray], None]
"""Is shown a frame: its row and its image (H, W, 3) BGR."""


def extract_keyframe_features(
    frames: FrameSource, rows: IntArray, progress: ProgressListener = silent, show: FrameListener | None = None
) -> list[FeatureSet]:
    """The features of the frames in ``rows`` (K,), increasing; ``show`` is shown each of them too, in a thread."""
    features: list[FeatureSet] = []
    with ThreadPoolExecutor(_THREADS) as pool:
        for found in _in_order(pool, rows.tolist(), frames.images(rows.tolist()), show):
            features.append(found)
            progress(Stage.FEATURES, len(features) / len(rows), f"{len(features)} of {len(rows)} keyframes")
    return features


def _in_order(
    pool: ThreadPoolExecutor, rows: list[int], images: Iterator[ByteArray], show: FrameListener | None
) -> Iterator[FeatureSet]:
    """Extract with a few images in flight, not all of them in memory."""
    waiting: list[Future[FeatureSet]] = []

    def extract(row: int, image: ByteArray) -> FeatureSet:
        if show is not None:
            show(row, image)
        return _extract(image)

    for row, image in zip(rows, images, strict=True):
        waiting.append(pool.submit(extract, row, image))
        if len(waiting) > 2 * _THREADS:
            yield waiting.pop(0).result()
    for future in waiting:
        yield future.result()


def _extract(image: ByteArray) -> FeatureSet:
    height, width = image.shape[:2]
    longer = max(height, width)
    if longer <= _LONGER_SIDE_PX:
        return _EXTRACTOR.extract(image)
    size = round(width * _LONGER_SIDE_PX / longer), round(height * _LONGER_SIDE_PX / longer)
    features = _EXTRACTOR.extract(np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8))
    factor = np.array([width / size[0], height / size[1]], dtype=np.float32)
    return replace(features, pixels=(features.pixels + 0.5) * factor - 0.5, sizes=features.sizes * factor.max())
