"""``lengths.csv``: measured distances between camera positions."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rholoc.errors import InvalidRecording
from rholoc.geometry import IntArray
from rholoc.recordings.recording import KnownLength
from rholoc.recordings.tables.csv_table import read_numbers, shortened

_COLUMNS = ("first", "second", "length")
_MIN_M, _MAX_M = 0.05, 1000.0
_HINT = "Give two frames' numbers and the metres between the camera's places there: 12,340,2.40."


def read_lengths_csv(path: Path, numbers: IntArray) -> tuple[KnownLength, ...]:
    """Read lengths under the header ``first,second,length``: two frames' numbers, metres.

    Args:
        path: the file.
        numbers: (N,) of the recording's frames.

    Raises:
        InvalidRecording: a column is missing, a value is not a number, a frame unknown, or a length not 0.05 to 1000 m.
    """
    table = read_numbers(path, _COLUMNS)
    rows = zip(table["first"].tolist(), table["second"].tolist(), table["length"].tolist(), strict=True)
    return tuple(_checked(first, second, length_m, numbers, path.name) for first, second, length_m in rows)


def parse_length(text: str, numbers: IntArray) -> KnownLength:
    """Parse ``12,340,2.40``: the camera's positions in frames 12 and 340 were 2.40 m apart.

    Args:
        text: two frames' numbers and metres.
        numbers: (N,) of the recording's frames.

    Raises:
        InvalidRecording: the text is something else, a frame is not in the recording, or it is not 0.05 to 1000 m.
    """
    try:
        first, second, length_m = (float(part) for part in text.split(","))
    except ValueError:
        raise InvalidRecording(f"'{shortened(text)}' is not a length between two frames.", _HINT) from None
    return _checked(first, second, length_m, numbers, "A length")


def _checked(first: float, second: float, length_m: float, numbers: IntArray, what: str) -> KnownLength:
    for number in (first, second):
        if not np.any(numbers == number):
            raise InvalidRecording(
                f"{what} names the frame {number:g}, which the recording does not have.",
                f"Its frames are {numbers[0]} to {numbers[-1]}.",
            )
    if first == second:
        raise InvalidRecording(f"{what} is between the frame {first:g} and itself.", _HINT)
    if not _MIN_M <= length_m <= _MAX_M:
        raise InvalidRecording(f"{what} of {length_m:g} m cannot be used.", f"Measure {_MIN_M:g} to {_MAX_M:g} m.")
    return KnownLength(int(first), int(second), length_m)
