"""Image files → arrays. What claims more pixels than allowed is refused before memory is taken for it."""

from __future__ import annotations

import io
import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError

from rholoc.errors import InvalidImage
from rholoc.geometry import ByteArray

IMAGE_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".webp", ".bmp", ".ppm", ".pgm"})
DEFAULT_MAX_PIXELS = 50_000_000

_FORMATS = ("JPEG", "PNG", "WEBP", "BMP", "PPM")
_ORIENTATION_TAG = 0x0112  # EXIF
_TRANSPOSED = range(5, 9)  # the EXIF orientations that swap width and height
# Ours is the limit that counts. Set once, because the filters are shared by all threads.
warnings.filterwarnings("ignore", category=Image.DecompressionBombWarning)

_DECODING_ERRORS = (OSError, SyntaxError, ValueError, struct.error, EOFError, IndexError, KeyError, TypeError)


def decode_image(data: bytes, max_pixels: int = DEFAULT_MAX_PIXELS) -> ByteArray:
    """The bytes of a JPEG, PNG, WebP, BMP or PPM file → the image (H, W, 3) BGR.

    The EXIF orientation is applied, so intrinsics belong to the image as it is shown. 16-bit images keep their upper
    8 bits, grey is repeated over the channels, transparency is dropped.

    Raises:
        InvalidImage: not an image, empty, truncated, or more than ``max_pixels``; the last is read from the header,
            before anything is decoded.
    """
    if not data:
        raise InvalidImage("The image is empty: 0 bytes.", "Send a JPEG or PNG file.")
    with _opened(io.BytesIO(data), max_pixels) as image:
        upright = ImageOps.exif_transpose(image)
        if upright.mode.startswith("I"):  # 16-bit grey
            grey = (np.asarray(upright).astype(np.int64) >> 8).clip(0, 255).astype(np.uint8)
            return np.ascontiguousarray(np.repeat(grey[:, :, None], 3, axis=2))
        return np.ascontiguousarray(np.asarray(upright.convert("RGB"))[:, :, ::-1])


def read_image(path: Path, max_pixels: int = DEFAULT_MAX_PIXELS) -> ByteArray:
    """An image file → the image (H, W, 3) BGR, as :func:`decode_image` does.

    Raises:
        InvalidImage: the file cannot be read or decoded.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InvalidImage(f"The image cannot be read: {error.strerror}.") from error
    return decode_image(data, max_pixels)


def image_size(path: Path, max_pixels: int = DEFAULT_MAX_PIXELS) -> tuple[int, int]:
    """Width and height in pixels of an image file as it is shown; only its header is read.

    Raises:
        InvalidImage: the file has no image header, or claims more than ``max_pixels``.
    """
    with _opened(path, max_pixels) as image:
        width, height = image.size
        exif = Image.Image.getexif(image)  # a PNG file's own getexif would decode the pixels
        transposed = exif.get(_ORIENTATION_TAG) in _TRANSPOSED
    return (height, width) if transposed else (width, height)


@contextmanager
def _opened(source: Path | io.BytesIO, max_pixels: int) -> Iterator[Image.Image]:
    """The image with its header read; whatever goes wrong inside becomes an InvalidImage."""
    hint = "Send a whole JPEG or PNG file."
    try:
        with Image.open(source, formats=_FORMATS) as image:
            width, height = image.size
            if width * height > max_pixels:
                raise _too_large(f"of {width}×{height} pixels", max_pixels)
            yield image
    except UnidentifiedImageError as error:
        raise InvalidImage("This is not an image that can be read.", hint) from error
    except Image.DecompressionBombError as error:
        raise _too_large("of far too many pixels", max_pixels) from error
    except _DECODING_ERRORS as error:
        raise InvalidImage(f"The image is broken: {error}.", hint) from error


def _too_large(what: str, max_pixels: int) -> InvalidImage:
    return InvalidImage(
        f"The image's header claims an image {what}; {max_pixels} pixels are allowed.", "Scale it down."
    )
