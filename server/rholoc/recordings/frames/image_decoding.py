"""Image files → arrays. Images with more pixels than allowed are refused before memory is allocated for them."""

import io
import re
import struct
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
from PIL import Image, ImageFile, ImageOps, UnidentifiedImageError

from rholoc.errors import InvalidImage, InvalidRecording
from rholoc.geometry import ByteArray, IntArray

IMAGE_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".webp", ".bmp", ".ppm", ".pgm"})
DEFAULT_MAX_PIXELS = 50_000_000

IMAGE_START_BYTES = 12

_FORMATS = ("JPEG", "PNG", "WEBP", "BMP", "PPM")
SENT_FORMATS = ("JPEG", "PNG", "WEBP")  # their decoding time is bounded by the number of pixels and scans
MAX_JPEG_SCANS = 100  # cameras write 1 or 3, progressive encoders 6 to 12; even an empty scan visits every pixel
MAX_SCANNED_IMAGES = 10  # pixels times scans, as a multiple of the pixels allowed
_SCANS_OF_AN_IMAGE = 4  # this many scans take as long to decode as everything else
_PIECES = 256  # of a file; ``still_wanted`` is called before each
_MIN_PIECE_BYTES, _MAX_PIECE_BYTES = 64, 2**16
_JPEG_MARKER = re.compile(rb"\xff([^\x00\xff\xd0-\xd7])")  # ends coded data
_JPEG_SCAN, _JPEG_END = 0xDA, 0xD9
_ORIENTATION_TAG = 0x0112  # EXIF
_EXIF_IFD, _FOCAL_35MM_TAG = 0x8769, 0xA405
_HINT = "Send a whole JPEG, PNG or WebP file."
_FILM_DIAGONAL_MM = float(np.hypot(36, 24))
_FOCALS_35MM = (5.0, 1000.0)  # plausible range
_TRANSPOSED = range(5, 9)  # the EXIF orientations that swap width and height
# We have a limit of our own. Set once, because warning filters are shared by all threads.
warnings.filterwarnings("ignore", category=Image.DecompressionBombWarning)

_DECODING_ERRORS = (OSError, SyntaxError, ValueError, struct.error, EOFError, IndexError, KeyError, TypeError)


def decode_image(
    data: bytes,
    max_pixels: int = DEFAULT_MAX_PIXELS,
    formats: tuple[str, ...] = _FORMATS,
    still_wanted: Callable[[], None] = lambda: None,
) -> ByteArray:
    """The bytes of a JPEG, PNG, WebP, BMP or PPM file → the image (H, W, 3) BGR.

    The EXIF orientation is applied, so intrinsics belong to the image as it is shown. 16-bit images keep their upper
    8 bits, grey is repeated over the channels, transparency is dropped.

    Args:
        data: the file.
        max_pixels: upper bound on the image's pixels.
        formats: accepted formats, by Pillow's names.
        still_wanted: called between pieces of the file; may raise to end the decoding.

    Raises:
        InvalidImage: not an image, empty, truncated, a PPM file of text, more than ``max_pixels``, or a JPEG file with
            too many scans (:func:`_check_scans`). All but truncation is detected before decoding.
    """
    if not data:
        raise InvalidImage("The image is empty: 0 bytes.", _HINT)
    with _opened(_Watched(data, still_wanted), max_pixels, formats) as image:
        _check_scans(data, image, max_pixels)
        if isinstance(image, ImageFile.ImageFile):
            image.decodermaxblock = min(max(len(data) // _PIECES, _MIN_PIECE_BYTES), _MAX_PIECE_BYTES)
        ImageOps.exif_transpose(image, in_place=True)
        if image.mode.startswith("I"):  # 16-bit grey
            grey = (np.asarray(image).astype(np.int64) >> 8).clip(0, 255).astype(np.uint8)
            return np.ascontiguousarray(np.repeat(grey[:, :, None], 3, axis=2))
        colours = np.asarray(image if image.mode == "RGB" else image.convert("RGB"))
        # A contiguous copy of colours[:, :, ::-1] takes ten times as long.
        return np.asarray(cv2.cvtColor(colours, cv2.COLOR_RGB2BGR), dtype=np.uint8)


def read_image(path: Path | str, max_pixels: int = DEFAULT_MAX_PIXELS) -> ByteArray:
    """An image file → the image (H, W, 3) BGR, as :func:`decode_image` does.

    Raises:
        InvalidImage: the file cannot be read or decoded.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise InvalidImage(f"The image cannot be read: {error.strerror}.") from error
    return decode_image(data, max_pixels)


def read_frame(path: Path, size: tuple[int, int]) -> ByteArray:
    """An image file of a recording → the image (H, W, 3) BGR.

    Raises:
        InvalidRecording: the file is damaged, or its size is not ``size`` (width, height).
    """
    try:
        image = read_image(path)
    except InvalidImage as error:
        raise InvalidRecording(f"{path.name}: {error.message}", "Leave that picture out.") from error
    if image.shape[1::-1] != size:
        raise InvalidRecording(f"{path.name} is not of {size[0]}×{size[1]} pixels any more.")
    return image


def read_grey(path: Path) -> IntArray:
    """An image file of one channel, up to 16 bits → its unscaled values (H, W). EXIF orientation is ignored.

    Raises:
        InvalidImage: the file cannot be read or decoded, has several channels, or more than 50 megapixels.
    """
    with _opened(path, DEFAULT_MAX_PIXELS) as image:
        if not (image.mode == "L" or image.mode.startswith("I")):
            raise InvalidImage(f"{path.name} is not an image of one channel.")
        return np.asarray(image).astype(np.int64)


def image_size(
    file: Path | bytes, max_pixels: int = DEFAULT_MAX_PIXELS, formats: tuple[str, ...] = _FORMATS
) -> tuple[int, int]:
    """Width and height of an image [px] after its EXIF orientation, from its header. ``file`` is a path or the content.

    Raises:
        InvalidImage: the file has no image header, or claims more than ``max_pixels``.
    """
    with _opened(io.BytesIO(file) if isinstance(file, bytes) else file, max_pixels, formats) as image:
        width, height = image.size
        transposed = _orientation(image) in _TRANSPOSED
    return (height, width) if transposed else (width, height)


def exif_orientation(path: Path) -> int:
    """EXIF orientation of an image file: 1 to 8, where 1, also if none is stated, is the image as it is stored.

    Raises:
        InvalidImage: the file cannot be opened, or has no image header.
    """
    with _opened(path, DEFAULT_MAX_PIXELS) as image:
        return _orientation(image)


def _orientation(image: Image.Image) -> int:
    """EXIF orientation of an open image, 1 to 8; 1 if none or an impossible one is stated."""
    stated = Image.Image.getexif(image).get(_ORIENTATION_TAG, 1)  # a PNG file's own getexif would decode the pixels
    return int(stated) if stated in range(1, 9) else 1


def exif_focal_px(path: Path) -> float | None:
    """Focal length [px] from the 35 mm equivalent in a file's EXIF data; None if missing or not 5 to 1000 mm.

    The equivalent refers to the diagonal angle of view.

    Raises:
        InvalidImage: the file has no image header.
    """
    with _opened(path, DEFAULT_MAX_PIXELS) as image:
        try:
            equivalent_mm = float(Image.Image.getexif(image).get_ifd(_EXIF_IFD).get(_FOCAL_35MM_TAG, 0))
        except _DECODING_ERRORS:  # of the EXIF data, which is optional
            return None
        diagonal_px = float(np.hypot(*image.size))
    if not _FOCALS_35MM[0] <= equivalent_mm <= _FOCALS_35MM[1]:
        return None
    return equivalent_mm / _FILM_DIAGONAL_MM * diagonal_px


def begins_like_an_image(start: bytes) -> bool:
    """Whether the first :data:`IMAGE_START_BYTES` or more bytes of a file may be those of JPEG, PNG or WebP."""
    riff = start.startswith(b"RIFF") and start[8:12] == b"WEBP"
    return riff or start.startswith((b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n"))


def not_an_image() -> InvalidImage:
    """Error for data in none of the supported image formats."""
    return InvalidImage("This is not an image that can be read.", _HINT)


def visited_pixels(data: bytes) -> int:
    """Decoding effort of an image: width × height, times a quarter of its scans if it has more than four.

    Decodes no pixels. 0 for data that is not a JPEG, PNG or WebP image.
    """
    try:
        with Image.open(io.BytesIO(data), formats=SENT_FORMATS) as image:
            return image.width * image.height * max(_SCANS_OF_AN_IMAGE, jpeg_scans(data)) // _SCANS_OF_AN_IMAGE
    except (UnidentifiedImageError, Image.DecompressionBombError, *_DECODING_ERRORS):
        return 0


class _Watched(io.BytesIO):
    """A file in memory that calls ``still_wanted`` before each read."""

    def __init__(self, data: bytes, still_wanted: Callable[[], None]) -> None:
        super().__init__(data)
        self._still_wanted = still_wanted

    def read(self, size: int | None = -1, /) -> bytes:
        self._still_wanted()
        return super().read(size)


def jpeg_scans(data: bytes) -> int:
    """Number of scans of a JPEG file; a progressive decoder visits every pixel in each. 0 for another file.

    Counting stops above ``MAX_JPEG_SCANS``.
    """
    scans, position = 0, 2
    while data.startswith(b"\xff\xd8") and (found := _JPEG_MARKER.search(data, position)) is not None:
        marker = found[1][0]
        scans += marker == _JPEG_SCAN
        if marker == _JPEG_END or scans > MAX_JPEG_SCANS:
            break
        position = found.end() + int.from_bytes(data[found.end() : found.end() + 2])
    return scans


def _check_scans(data: bytes, image: Image.Image, max_pixels: int) -> None:
    """Raise InvalidImage for more than 100 scans, or scans × pixels over 10 × ``max_pixels``."""
    scans = jpeg_scans(data)
    if scans > MAX_JPEG_SCANS or scans * image.width * image.height > MAX_SCANNED_IMAGES * max_pixels:
        raise InvalidImage("The JPEG file has too many scans.", "Save it as baseline JPEG.")


@contextmanager
def _opened(source: Path | io.BytesIO, max_pixels: int, formats: tuple[str, ...] = _FORMATS) -> Iterator[Image.Image]:
    """Open an image for the block, with its header read. Decoding errors inside the block become InvalidImage, and so
    do more than ``max_pixels`` pixels.
    """
    try:
        with Image.open(source, formats=formats) as image:
            if any(tile[0] == "ppm_plain" for tile in getattr(image, "tile", ())):
                raise InvalidImage("The image's pixels are written as text.", "Save it as PNG, or as binary PPM.")
            width, height = image.size
            if width * height > max_pixels:
                raise _too_large(f"of {width}×{height} pixels", max_pixels)
            yield image
    except UnidentifiedImageError as error:
        raise not_an_image() from error
    except Image.DecompressionBombError as error:
        raise _too_large("of far too many pixels", max_pixels) from error
    except _DECODING_ERRORS as error:
        raise InvalidImage(f"The image is broken: {str(error).rstrip('.')}.", _HINT) from error


def _too_large(what: str, max_pixels: int) -> InvalidImage:
    """Error for an image of more than ``max_pixels``; ``what`` follows "an image", such as "of 90000×90000 pixels"."""
    return InvalidImage(
        f"The image's header claims an image {what}; {max_pixels} pixels are allowed.", "Scale it down."
    )
