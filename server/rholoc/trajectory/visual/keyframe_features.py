"""SIFT features of keyframes, in pixels of the full image."""

from collections import deque
from collections.abc import Callable, Container
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import Any, Self, TypeVar

import cv2
import numpy as np

from rholoc.features import Extractor, FeatureSet, widened
from rholoc.features.extractors._sift import SiftExtractor
from rholoc.geometry import ByteArray, Camera, IntArray
from rholoc.progress import ProgressListener, Stage, silent
from rholoc.recordings import FrameSource
from rholoc.trajectory.visual.keyframes import KeyframeSteps

_LONGER_SIDE_PX = 960  # larger images are reduced: more pixels cost time and place no more frames
_FEW = 600  # features of a picture, such as of white walls, below which twice the size is searched
_THREADS = 2
_WEAK_CONTRAST = 0.007  # a third of the usual one; such features are less exact, but dim rooms show few others
_FEATURES, _MAX_FEATURES = 1000, 1500  # of a keyframe, and of one in a small set, where more cost little
_SMALL_SET = 100  # pictures

_MAX_WAITING = 2 * _THREADS  # images in memory at a time

Found = TypeVar("Found")

ImageListener = Callable[[int, ByteArray], None]
"""Is shown an image (H, W, 3) BGR: the row of its frame, and the image."""


class KeyframeFeatures:
    """Features of a recording's keyframes, mostly extracted while all frames are decoded for their motion.

    Keyframes are predicted during the walk; short walks and pauses can add others later. Those are decoded when
    requested. A context manager: threads extract within it.
    """

    def __init__(
        self,
        frames: FrameSource,
        certain: Container[int] = (),
        show: ImageListener | None = None,
        camera: Camera | None = None,
    ) -> None:
        """Begin with no frame.

        Args:
            frames: of the recording.
            certain: rows of frames that become keyframes regardless of motion.
            show: called in a thread with each frame whose features are extracted.
            camera: of the frames; needed for wide lenses.
        """
        self._frames = frames
        usual = SiftExtractor(features=_features_each(len(frames.times)))
        weak = replace(usual, contrast_threshold=_WEAK_CONTRAST)
        self._extractor, self._weak_extractor = widened(usual, camera), widened(weak, camera)
        self._longest_px = round(_LONGER_SIDE_PX * (1.0 if camera is None else camera.breadth))
        self._certain = certain
        self._show = show
        self._steps = KeyframeSteps(timed=frames.timed)
        self._sharpest: ByteArray | None = None
        self._found: dict[int, Future[tuple[FeatureSet, int]]] = {}
        self._waiting: deque[Future[Any]] = deque()
        self._pool = ThreadPoolExecutor(_THREADS)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(cancel_futures=True)

    def foresee(self, row: int, image: ByteArray, motion: float, sharpness: float) -> None:
        """Take the next frame (H, W, 3) BGR, its motion since the frame before [share of the longer side], sharpness.

        If the frame begins a new step of motion, extraction of the previous step's sharpest frame starts in a thread.
        If the frame is certain to be a keyframe, its own extraction starts too. Blocks while two images per thread
        wait.
        """
        ended = self._steps.add(row, float(self._frames.times[row]), motion, sharpness)
        if ended is not None and self._sharpest is not None:
            self._extract(ended, self._sharpest)
        if self._steps.sharpest == row:
            self._sharpest = image
        if row in self._certain:
            self._extract(row, image)

    def of(self, rows: IntArray, progress: ProgressListener = silent) -> list[FeatureSet]:
        """Features of the keyframes ``rows`` (K,), increasing. Waits for them; decodes frames that were not predicted.

        Raises:
            InvalidRecording: a frame cannot be decoded.
            Cancelled: ``progress`` asked to stop.
        """
        last = self._steps.end()
        if last is not None and self._sharpest is not None:
            self._extract(last, self._sharpest)
        missing = [row for row in rows.tolist() if row not in self._found]
        for row, image in zip(missing, self._frames.images(missing), strict=True):
            self._extract(row, image)
        features = []
        for row in rows.tolist():
            features.append(self._found[row].result()[0])
            progress(Stage.FEATURES, len(features) / len(rows), f"{len(features)} of {len(rows)} keyframes")
        return features

    def of_set(self, rows: IntArray, progress: ProgressListener = silent) -> list[FeatureSet]:
        """Features of the pictures ``rows`` (K,) of a set, as :meth:`of`.

        If most pictures have fewer than 1000, those are searched again down to a third of the contrast.
        """
        found = self.of(rows, progress)
        plain = [i for i, features in enumerate(found) if len(features) < _FEATURES]
        if 2 * len(plain) <= len(found):
            return found
        weak, again = [], rows[plain].tolist()
        for row, image in zip(again, self._frames.images(again), strict=True):
            weak.append(self._begin(_extract_reduced, image, self._weak_extractor, self._found[row].result()[1]))
            progress(Stage.FEATURES, 1.0, f"{len(weak)} of {len(plain)} that show little, again")
        for i, features in zip(plain, weak, strict=True):
            found[i] = features.result()
        return found

    def _extract(self, row: int, image: ByteArray) -> None:
        """Start an extraction, unless the row's was started."""
        if row not in self._found:
            self._found[row] = self._begin(self._extracted, row, image)

    def _begin(self, extract: Callable[..., Found], *arguments: object) -> Future[Found]:
        """Start an extraction in a thread; blocks while two per thread wait."""
        while len(self._waiting) >= _MAX_WAITING:
            self._waiting.popleft().result()
        begun = self._pool.submit(extract, *arguments)
        self._waiting.append(begun)
        return begun

    def _extracted(self, row: int, image: ByteArray) -> tuple[FeatureSet, int]:
        """Show an image, and extract its features, as :func:`_extract`."""
        if self._show is not None:
            self._show(row, image)
        return _extract(image, self._extractor, self._longest_px)


def _features_each(pictures: int) -> int:
    """Number of features per keyframe, 1000 to 1500: in a small set, more of them cost little time."""
    return round(float(np.clip(_FEATURES * np.sqrt(_SMALL_SET / pictures), _FEATURES, _MAX_FEATURES)))


def _extract(image: ByteArray, extractor: Extractor, longest_px: int) -> tuple[FeatureSet, int]:
    """Features of an image reduced to ``longest_px``, to twice as much if they are under 600; and that side [px]."""
    found = _extract_reduced(image, extractor, longest_px)
    if len(found) >= _FEW or max(image.shape[:2]) <= longest_px:
        return found, longest_px
    return _extract_reduced(image, extractor, 2 * longest_px), 2 * longest_px


def _extract_reduced(image: ByteArray, extractor: Extractor, longest_px: int) -> FeatureSet:
    """Features of an image searched at a longer side of ``longest_px`` at most, in pixels of the whole image."""
    height, width = image.shape[:2]
    longer = max(height, width)
    if longer <= longest_px:
        return extractor.extract(image)
    size = round(width * longest_px / longer), round(height * longest_px / longer)
    features = extractor.extract(np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8))
    factor = np.array([width / size[0], height / size[1]], dtype=np.float32)
    return replace(features, pixels=(features.pixels + 0.5) * factor - 0.5, sizes=features.sizes * factor.max())
