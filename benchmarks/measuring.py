"""What benchmarks share: the data, a port, pictures as they are sent, tables as they are printed."""

import socket
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2

from rholoc.geometry import ByteArray

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


def free_port() -> int:
    """A local port that is free now."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return int(listener.getsockname()[1])


def rounded(value: float, digits: int = 2) -> float:
    return round(float(value), digits)


def jpeg_of(image: ByteArray, quality: int = 92) -> bytes:
    """An image (H, W) or (H, W, 3) as a camera would send it."""
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def print_table(rows: Sequence[dict[str, Any]], columns: Sequence[str]) -> None:
    """Rows under their columns' names; what a row lacks is a dash."""
    cells = [[str(row.get(column, "–")) for column in columns] for row in rows]
    widths = [max(map(len, (column, *(row[i] for row in cells)))) for i, column in enumerate(columns)]
    for line in [list(columns), *cells]:
        print("  ".join(text.ljust(width) for text, width in zip(line, widths, strict=True)).rstrip(), flush=True)
