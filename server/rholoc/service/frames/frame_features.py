"""A frame's features, found once by each extractor."""

import math
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

from rholoc.errors import InvalidCamera
from rholoc.features import Extractor, FeatureSet
from rholoc.geometry import ByteArray
from rholoc.lazy import lazy
from rholoc.recordings.frames.image_decoding import SENT_FORMATS, decode_image, image_size
from rholoc.service.frames.queries import Frame, feature_set
from rholoc.service.http.stopwatch import Stopwatch
from rholoc.service.settings import Settings


class FrameFeatures:
    """The frame's features by extractor; the image is decoded once, each extractor runs once.

    Raises InvalidImage: the image's header cannot be read, or names too many pixels. ``deadline_s`` is by ``clock``.
    """

    def __init__(self, frame: Frame, settings: Settings, clock: Stopwatch, deadline_s: float) -> None:
        self._frame = frame
        self._settings = settings
        self._clock = clock
        self._deadline_s = deadline_s
        self._extracted: dict[Extractor, FeatureSet] = {}
        if frame.image is not None:
            with clock.stage("decode"):
                self._image_size = image_size(frame.image, settings.max_image_pixels, SENT_FORMATS)

    @lazy
    def image(self) -> ByteArray | None:
        """The picture (H, W, 3) BGR, decoded once; None if features were sent instead. Raises InvalidImage,
        DeadlineExceeded.
        """
        if self._frame.image is None:
            return None
        with self._clock.stage("decode"):
            return decode_image(
                self._frame.image,
                self._settings.max_image_pixels,
                SENT_FORMATS,
                lambda: self._clock.check(self._deadline_s),
            )

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the image [px], by its header, or as sent with features. Else raises InvalidCamera."""
        if self._frame.image is not None:
            return self._image_size
        camera = self._frame.options.camera
        if camera.width is None or camera.height is None:
            raise InvalidCamera(
                "The size of the image that the features come from is missing.", "Send camera.width and camera.height."
            )
        return camera.width, camera.height

    def by(self, extractor: Extractor) -> FeatureSet:
        """The image's features by this extractor, or the features that were sent. Raises InvalidDescriptors if these
        do not fit the extractor, InvalidImage, DeadlineExceeded.
        """
        if extractor not in self._extracted:
            if self.image is not None:
                with self._clock.stage("extract"):
                    found = self._found(extractor, self.image)
            else:
                assert self._frame.features is not None
                with self._clock.stage("decode"):
                    found = feature_set(self._frame.features, extractor, self._settings.max_features)
            self._extracted[extractor] = found
        return self._extracted[extractor]

    def by_quick(self, extractor: Extractor) -> FeatureSet:
        """The features by the extractor's quick variant, or those sent. Raises the errors of :meth:`by`."""
        return self.by(extractor.quick)

    def more_by(self, extractor: Extractor) -> Callable[[], FeatureSet] | None:
        """Function that extracts all features; None if features were sent or the extractor is its own quick variant."""
        image = self.image
        if image is None or extractor.quick is extractor:
            return None

        def more() -> FeatureSet:
            if extractor not in self._extracted:  # the localizer measures its time
                self._extracted[extractor] = self._found(extractor, image)
            return self._extracted[extractor]

        return more

    def _found(self, extractor: Extractor, image: ByteArray) -> FeatureSet:
        """Features of an image (H, W, 3) BGR, as of :func:`extract_bounded` with the settings' number of pixels."""
        return extract_bounded(extractor, image, self._settings.max_feature_pixels)


def extract_bounded(extractor: Extractor, image: ByteArray, max_pixels: int) -> FeatureSet:
    """The features of an image (H, W, 3) BGR, in its own pixels; from a smaller copy above ``max_pixels``."""
    height, width = image.shape[:2]
    if width * height <= max_pixels:
        return extractor.extract(image)
    scale = math.sqrt(max_pixels / (width * height))
    small = cv2.resize(image, (max(1, int(width * scale)), max(1, int(height * scale))), interpolation=cv2.INTER_AREA)
    found = extractor.extract(np.asarray(small, dtype=np.uint8))
    factors = np.array([width / small.shape[1], height / small.shape[0]])
    pixels = ((found.pixels + 0.5) * factors - 0.5).astype(np.float32)
    return replace(found, pixels=pixels, sizes=(found.sizes * factors.mean()).astype(np.float32))
