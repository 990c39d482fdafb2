"""QR codes of links, as a picture and for a terminal."""

import cv2
import numpy as np

from rholoc.errors import InvalidInput

_QUIET = 4  # light modules around the code
_ON_WHITE, _PLAIN = "\x1b[30;47m", "\x1b[0m"  # a terminal's colours
_HALVES = (" ", "▄", "▀", "█")  # by the upper module (2) and the lower one (1)


def qr_svg(text: str) -> str:
    """A text's QR code as an SVG picture, black on white. Raises InvalidInput: the text is too long."""
    dark = _dark_modules(text)
    size = len(dark)
    cells = "".join(f"M{x} {y}h1v1h-1z" for y, x in np.argwhere(dark))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{size}" height="{size}" viewBox="0 0 {size} {size}">'
        f'<path fill="#fff" d="M0 0h{size}v{size}h-{size}z"/><path shape-rendering="crispEdges" d="{cells}"/></svg>'
    )


def qr_for_terminal(text: str) -> str:
    """A text's QR code as lines of half blocks, black on white. Raises InvalidInput: the text is too long."""
    dark = _dark_modules(text).astype(int)
    upper, lower = dark[::2], np.vstack([dark[1::2], np.zeros_like(dark[:1])])
    rows = ("".join(_HALVES[one] for one in row) for row in 2 * upper + lower[: len(upper)])
    return "\n".join(f"{_ON_WHITE}{row}{_PLAIN}" for row in rows)


def _dark_modules(text: str) -> np.ndarray:
    """Which modules (N, N) of a text's QR code are dark, with four light ones around it. Raises InvalidInput."""
    options = cv2.QRCodeEncoder.Params()
    options.correction_level = cv2.QRCodeEncoder_CORRECT_LEVEL_M
    if any(sign == "\0" or "\ud800" <= sign <= "\udfff" for sign in text):
        raise InvalidInput("The text has characters that a QR code cannot hold.", "Send text without them.")
    try:
        dark = np.asarray(cv2.QRCodeEncoder.create(options).encode(text)) == 0
    except cv2.error as error:
        raise InvalidInput("The text does not fit into a QR code.", "Send a shorter one.") from error
    rows, columns = np.flatnonzero(dark.any(axis=1)), np.flatnonzero(dark.any(axis=0))
    return np.pad(dark[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1], _QUIET)
