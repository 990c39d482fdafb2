"""A floor plan kept with a map, and its pose in the map frame."""

from __future__ import annotations

import io
import json
import warnings
import zlib
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from PIL import Image

from rholoc.errors import InvalidInput, TooLarge
from rholoc.geometry import Similarity

MAX_PLAN_BYTES = 8 * 2**20
GEOJSON = "application/geo+json"
ARCHIVE = "application/zip"
_STARTS = {"image/png": b"\x89PNG\r\n\x1a\n", "image/jpeg": b"\xff\xd8\xff", "image/webp": b"RIFF"}
MEDIA_TYPES = (*_STARTS, GEOJSON)
MAX_PIXELS = 50_000_000
_MAX_TEXT_BYTES = 2**20
_TEXTS = (b"tEXt", b"zTXt", b"iTXt", b"iCCP")  # chunks of a PNG file
_CHUNK_BYTES, _MAX_CHUNKS = 12, 10_000  # bytes around a chunk's data, and maximum number of chunks
_LEVEL = 1e-6  # maximum deviation of a tilt's cosine from one


@dataclass(frozen=True)
class FloorPlan:
    """Type and pose of a floor plan.

    Attributes:
        media_type: of its file, one of ``MEDIA_TYPES``.
        corner: (2,) x and y of its lower left corner, metres, map frame.
        turn_deg: angle of its lower edge from the map's x towards y.
        m_per_unit: metres per unit: a pixel, or a metre of GeoJSON.
    """

    media_type: str
    corner: tuple[float, float]
    turn_deg: float
    m_per_unit: float

    def moved(self, similarity: Similarity) -> FloorPlan | None:
        """The plan after the map's frame moved; None if that tilts the map, so that the plan is no longer level."""
        R = similarity.rotation
        if R[2, 2] < 1 - _LEVEL:
            return None
        x, y, _ = similarity.points(np.array([[*self.corner, 0.0]]))[0].tolist()
        turn = self.turn_deg + float(np.degrees(np.arctan2(R[1, 0], R[0, 0])))
        return FloorPlan(self.media_type, (x, y), turn, self.m_per_unit * similarity.scale)


def media_type_of(content: bytes) -> str:
    """Media type of a plan's file by its first bytes: a picture's, ``ARCHIVE`` for a ZIP file, else GeoJSON."""
    starts = {**_STARTS, ARCHIVE: b"PK"}
    return next((kind for kind, start in starts.items() if content.startswith(start)), GEOJSON)


def check_plan(content: bytes, plan: FloorPlan) -> FloorPlan:
    """Return the plan, checked for storage in a map.

    Raises:
        TooLarge: it is longer than ``MAX_PLAN_BYTES``.
        InvalidInput: the file is not of its type, or is a picture that cannot be shown; or its pose is not valid.
    """
    if len(content) > MAX_PLAN_BYTES:
        raise TooLarge(f"The floor plan is longer than {MAX_PLAN_BYTES} bytes.", "Make the picture smaller.")
    if plan.media_type not in MEDIA_TYPES:
        raise InvalidInput(f"{plan.media_type[:50]} is not a floor plan.", f"Send one of {', '.join(MEDIA_TYPES)}.")
    if not (_is_geojson(content) if plan.media_type == GEOJSON else content.startswith(_STARTS[plan.media_type])):
        raise InvalidInput(f"The floor plan is not {plan.media_type}.", "Send the file as it is, with its own type.")
    if plan.media_type != GEOJSON:
        _check_picture(content)
    if not (np.isfinite([*plan.corner, plan.turn_deg]).all() and np.isfinite(plan.m_per_unit) and plan.m_per_unit > 0):
        raise InvalidInput("The floor plan's place makes no sense.", "Give finite numbers, and a positive size.")
    return plan


def _check_picture(content: bytes) -> None:
    """Refuse a picture that cannot be read or takes too much memory to show. Decodes only its header. Raises
    InvalidInput for an unreadable file, more than ``MAX_PIXELS``, or more than 1 MiB of text in a PNG file.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(io.BytesIO(content)) as image:
                width, height = image.size
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise InvalidInput(
            "The floor plan's picture cannot be read.", "Send it as a plain PNG or JPEG file."
        ) from error
    if width * height > MAX_PIXELS:
        raise InvalidInput(f"The floor plan has {width}×{height} pixels.", f"Send at most {MAX_PIXELS}.")
    if content.startswith(_STARTS["image/png"]) and _png_text_bytes(content) > _MAX_TEXT_BYTES:
        raise InvalidInput("The floor plan's file holds too much text.", "Save the picture without its metadata.")


def _png_text_bytes(content: bytes) -> int:
    """Expanded length of the texts and profiles of a PNG file; counting stops a little above 1 MiB. More than 10,000
    chunks count as too long.
    """
    at, chunks, found = len(_STARTS["image/png"]), 0, 0
    while at + _CHUNK_BYTES <= len(content) and found <= _MAX_TEXT_BYTES:
        length, kind = int.from_bytes(content[at : at + 4]), content[at + 4 : at + 8]
        chunks += 1
        if chunks > _MAX_CHUNKS:
            return _MAX_TEXT_BYTES + 1
        if kind in _TEXTS:
            compressed = _compressed(kind, content[at + 8 : at + 8 + length])
            with suppress(zlib.error):
                found += len(zlib.decompressobj().decompress(compressed, _MAX_TEXT_BYTES + 1))
            found += length
        at += _CHUNK_BYTES + length
    return found


def _compressed(kind: bytes, data: bytes) -> bytes:
    """Compressed part of the ``data`` of a PNG chunk of type ``kind``, a text or profile; empty if it has none."""
    rest = data.partition(b"\0")[2]  # after the keyword: the method, or for iTXt whether it is compressed
    if kind == b"tEXt" or (kind == b"iTXt" and not rest.startswith(b"\1")):
        return b""
    return rest[1:] if kind != b"iTXt" else rest[2:].partition(b"\0")[2].partition(b"\0")[2]


def _is_geojson(content: bytes) -> bool:
    """Whether a file is a JSON object; its members are not checked."""
    try:
        return isinstance(json.loads(content), dict)
    except (ValueError, RecursionError):
        return False
