"""Refused pictures, in memory only, for people to see why. Kept only if the setting ``keep_refused`` says how many."""

import time
from collections import deque
from dataclasses import dataclass
from itertools import count

import cv2
import numpy as np
from pydantic import Field

from rholoc.errors import Conflict, UnknownPicture
from rholoc.features import FeatureSet, Metric
from rholoc.features.matching import LIMITS, mutual_matches
from rholoc.geometry import FloatArray
from rholoc.localization import AnyLocalizer, Cause, likeliest_views
from rholoc.maps import Map
from rholoc.maps.kept_observations import source_cameras
from rholoc.recordings.frames.image_decoding import SENT_FORMATS, decode_image
from rholoc.service.caller import ASKER
from rholoc.service.frames.answer_models import LocalizationOut
from rholoc.service.http.models import AnswerModel

_PICTURE_PX, _QUALITY = 480, 75
_DAY_S = 24 * 3600.0
_MAX_LINES = 60


@dataclass(frozen=True, eq=False)
class Refusal:
    """A refused picture.

    Attributes:
        number: unique for this server's process.
        map: name of the map that refused it.
        time: seconds since the epoch.
        asker: name of the key, or address.
        cause, message, hint: of the diagnosis.
        picture: a small JPEG.
    """

    number: int
    map: str
    time: float
    asker: str
    cause: Cause
    message: str
    hint: str
    picture: bytes


class LikenessOut(AnswerModel):
    """A refused picture beside the view that it resembles most."""

    view: int | None = Field(description="its number in the map; null where nothing looks alike")
    lines: list[list[float]] = Field(
        description="matches: u and v in the refused picture, u and v in the view, as shares of width and height"
    )


class Refusals:
    """The last refused pictures of a day. Safe to use from any thread.

    Args:
        most: number of pictures; 0 keeps none.
        max_pixels: of a picture as it was sent.
    """

    def __init__(self, most: int, max_pixels: int) -> None:
        self._kept: deque[Refusal] = deque(maxlen=most)
        self._numbers = count(1)
        self._max_pixels = max_pixels
        self.wanted = most > 0

    def keep(self, answer: LocalizationOut, image: bytes) -> None:
        """Keep a picture as a JPEG of at most 480 px a side, with its diagnosis; nothing if localized or without one.

        Raises:
            InvalidImage: it cannot be decoded.
        """
        why = answer.diagnosis
        if not self.wanted or answer.localized or why is None:
            return
        whole = decode_image(image, self._max_pixels, SENT_FORMATS)
        scale = min(1.0, _PICTURE_PX / max(whole.shape[:2]))
        small = cv2.resize(whole, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        picture = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()
        asker = ASKER.get()
        refusal = Refusal(
            next(self._numbers), answer.map, time.time(), asker, why.cause, why.message, why.hint, picture
        )
        self._kept.append(refusal)

    def of_map(self, name: str) -> list[Refusal]:
        """The refusals of the last day in a map, the newest first.

        Raises:
            Conflict: this server keeps none.
        """
        if not self.wanted:
            raise Conflict(
                "This server keeps no refused pictures.", "Set RHOLOC_KEEP_REFUSED=100 to keep the last hundred."
            )
        since = time.time() - _DAY_S
        return [one for one in reversed(tuple(self._kept)) if one.map == name and one.time >= since]

    def get(self, name: str, number: int) -> Refusal:
        """The refusal of a map of that number.

        Raises:
            Conflict: this server keeps none.
            UnknownPicture: it is no longer kept, or a day old.
        """
        for one in self.of_map(name):
            if one.number == number:
                return one
        raise UnknownPicture(f"The refused picture {number} is no longer kept.", "Choose a later one.")


def likeness(localizer: AnyLocalizer, refusal: Refusal) -> LikenessOut:
    """The view that a refused picture resembles most (None if none), and their matches as of :func:`lines_between`."""
    image = decode_image(refusal.picture, _PICTURE_PX**2, SENT_FORMATS)
    features = localizer.extractor.extract(image)
    views = likeliest_views(localizer, features, 1)
    if not views:
        return LikenessOut(view=None, lines=[])
    view, height, width = views[0].view, *image.shape[:2]
    lines = lines_between(features, (width, height), localizer.map, view, localizer.extractor.metric)
    return LikenessOut(view=view, lines=lines.round(4).tolist())


def lines_between(features: FeatureSet, size: tuple[int, int], map_: Map, view: int, metric: Metric) -> FloatArray:
    """At most 60 mutual matches (M, 4) of a picture with a map's view: u, v in the picture, u, v in the view, as shares
    of width and height. Empty if the map does not have the view's pixels.

    Args:
        features: of the picture.
        size: of the picture, width and height [pixels].
        map_: the map.
        view: row of the view.
        metric: of the descriptors.
    """
    rows = slice(int(map_.view_offsets[view]), int(map_.view_offsets[view + 1]))
    seen, pixels = map_.observations.features[rows], map_.observations.pixels
    if pixels is None or not len(seen) or not len(features):
        return np.zeros((0, 4))
    of_view = FeatureSet(
        pixels[rows].astype(np.float32),
        map_.landmarks.channels[seen],
        map_.descriptors.values[np.searchsorted(map_.descriptors.features, seen)],
        np.zeros(len(seen), np.float32),
        np.full(len(seen), np.nan, np.float32),
    )
    ours, theirs = mutual_matches(features, of_view, metric, LIMITS[metric].strict)[:_MAX_LINES].T
    camera = (source_cameras(map_.info) or [map_.info.camera])[map_.views.known_sources[view]]
    return np.column_stack(
        [features.pixels[ours] / size, of_view.pixels[theirs] / (camera.width, camera.height)]
    ).astype(np.float64)
