"""Pictures → what is sent: files and bytes as they are, arrays as PNG."""

import struct
import zlib
from pathlib import Path
from typing import Any, Protocol, TypeAlias


class ImageArray(Protocol):
    """A NumPy array: (H, W, 3) BGR, as OpenCV gives it, or (H, W) grey, uint8."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Height, width[, channels]."""
        ...

    @property
    def dtype(self) -> Any:
        """uint8."""
        ...

    def __getitem__(self, index: Any, /) -> Any:
        """Slicing."""
        ...

    def tobytes(self) -> bytes:
        """The pixels, row by row."""
        ...


ImageLike: TypeAlias = bytes | str | Path | ImageArray  # a text is a path

_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8\xff"
_GREY, _RGB = 0, 2


def encoded(image: ImageLike) -> tuple[bytes, str]:
    """The picture's bytes and media type.

    Raises:
        ValueError: neither bytes nor a path nor an array that is a picture.
        OSError: the file cannot be read.
    """
    if isinstance(image, str | Path):
        image = Path(image).read_bytes()
    if isinstance(image, bytes):
        return image, "image/png" if image.startswith(_PNG) else "image/jpeg"
    if not hasattr(image, "dtype"):
        raise ValueError(f"A picture is bytes, a path or an array, not {type(image).__name__}.")
    return png(image), "image/png"


def png(image: ImageArray) -> bytes:
    """An array as PNG, losslessly and fast rather than small."""
    shape = image.shape
    if str(image.dtype) != "uint8" or not (len(shape) == 2 or (len(shape) == 3 and shape[2] == 3)):
        raise ValueError(f"A picture is uint8 of shape (H, W) or (H, W, 3), not {image.dtype} of shape {shape}.")
    height, width = shape[:2]
    pixels = image.tobytes() if len(shape) == 2 else image[:, :, ::-1].tobytes()
    stride = len(pixels) // max(height, 1)
    rows = b"".join(b"\0" + pixels[start : start + stride] for start in range(0, len(pixels), stride or 1))
    kind = _GREY if len(shape) == 2 else _RGB
    header = struct.pack(">IIBBBBB", width, height, 8, kind, 0, 0, 0)
    return _PNG + _chunk(b"IHDR", header) + _chunk(b"IDAT", zlib.compress(rows, 1)) + _chunk(b"IEND", b"")


def _chunk(name: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))
