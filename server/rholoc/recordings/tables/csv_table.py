"""Tables of numbers in CSV files, with errors that name the file and say what is wrong in it."""

import csv
import json
from array import array
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from rholoc.errors import InvalidInput, InvalidRecording
from rholoc.geometry import FloatArray

MAX_TABLE_BYTES = 2**29
MAX_TABLE_ROWS = 3_000_000  # four hours at 200 Hz
MAX_JSON_BYTES = 2**26
_MAX_DIGITS = 300  # of an integer that a float can hold
_PAPER_GROUPS = {
    "the time mark, n": {"": "timestamp"},
    "linear acceleration, m/s2": {"x": "ax", "y": "ay", "z": "az"},
    "angular acceleration, rad/s2": {"x": "gx", "y": "gy", "z": "gz"},
    "descriptor": {"": "descriptor"},
    "screen coordinates": {"u": "u", "v": "v"},
    "robot coordinates": {"x": "x", "y": "y", "z": "z"},
    "robot orientation": {"hx": "hx", "hy": "hy", "hz": "hz"},
}
"""Tables 3 and 4 under the paper's own header: a column by its group, and by its name in the row below."""
_PAPER_HINT = "Write one header row, as maps/README.md shows, or both rows as in the paper."
_MAX_SHOWN = 200  # characters of a table in a message


def read_text(path: Path, error: type[InvalidInput] = InvalidRecording, max_bytes: int = MAX_TABLE_BYTES) -> str:
    """The text of a UTF-8 file, without a byte order mark.

    Raises:
        error: the file is missing, unreadable, not text, or over ``max_bytes``.
    """
    with _raising(error, path):
        _check_size(path, error, max_bytes)
        return path.read_text(encoding="utf-8-sig")


def read_json(path: Path, error: type[InvalidInput] = InvalidRecording, max_bytes: int = MAX_JSON_BYTES) -> Any:
    """The content of a JSON file.

    Raises:
        error: the file cannot be read, is over ``max_bytes``, not JSON, or nested too deep.
    """
    try:
        return parse_json(read_text(path, error, max_bytes))
    except RecursionError as cause:
        raise error(f"{path.name} is not JSON that can be read: it is nested too deep.", "Write plain JSON.") from cause
    except ValueError as cause:
        raise error(f"{path.name} is not JSON: {cause}.", "Write plain JSON; decimal numbers have points.") from cause


def parse_json(text: str) -> Any:
    """The content of a JSON document.

    Raises:
        ValueError: it is not JSON (NaN and Infinity pass), or has an integer of more than 300 digits.
        RecursionError: it is nested too deep.
    """
    return json.loads(text, parse_int=_integer)


def _integer(digits: str) -> int:
    """A JSON integer. Raises ValueError for more than 300 digits."""
    if len(digits) > _MAX_DIGITS:
        raise ValueError(f"it has a number of {len(digits)} digits")
    return int(digits)


def read_rows(
    path: Path, error: type[InvalidInput] = InvalidRecording, max_rows: int = MAX_TABLE_ROWS
) -> tuple[list[str], list[dict[str, str]]]:
    """The header's names (lower case) and one dict per row of a CSV file; blank lines are skipped.

    Raises:
        error: the file cannot be read, is empty, has more than ``max_rows``, or a row has another number of columns
            than the header.
    """
    with table_rows(path, error, max_rows) as (header, rows):
        return header, [dict(zip(header, row, strict=True)) for row in rows]


def read_numbers(path: Path, columns: Sequence[str]) -> dict[str, FloatArray]:
    """The named columns of a CSV file with a header row, each (N,) float64, N ≥ 1; further columns are ignored.

    Row by row: a table takes the memory of its numbers, not of its text.

    Raises:
        InvalidRecording: the file cannot be read, a column is missing, there are no rows or more than
            ``MAX_TABLE_ROWS``, or a value is not a finite number.
    """
    values = {column: array("d") for column in columns}
    with table_rows(path, InvalidRecording, MAX_TABLE_ROWS) as (header, rows):
        require_columns(path, header, columns, InvalidRecording)
        places = [(header.index(column), column, values[column]) for column in columns]
        for line, row in enumerate(rows, start=2):
            for place, column, numbers in places:
                numbers.append(parse_number(row[place], path, line, column, InvalidRecording))
    if not values[columns[0]]:
        raise InvalidRecording(f"{path.name} has a header, but no rows.", "Record again, or leave the file out.")
    return {column: np.frombuffer(numbers, dtype=np.float64) for column, numbers in values.items()}


@contextmanager
def table_rows(path: Path, error: type[InvalidInput], max_rows: int) -> Iterator[tuple[list[str], Iterator[list[str]]]]:
    """A CSV file's header (lower case) and an iterator over its rows that are not blank; valid within the block.

    Raises ``error``, in the block too, for an unreadable or empty file, more than ``max_rows``, or a row of another
    length.
    """
    with _raising(error, path):
        _check_size(path, error, MAX_TABLE_BYTES)
        with path.open(encoding="utf-8-sig", newline="") as file:
            lines = (row for row in csv.reader(file, strict=True) if any(map(str.strip, row)))
            first = next(lines, None)
            if first is None:
                raise error(f"{path.name} is empty.", "It needs a header row and rows of values.")
            header = [name.strip().lower() for name in first]
            if header[0] and set(header) <= {"", *_PAPER_GROUPS}:
                header = _paper_columns(header, next(lines, []), path, error)
            yield header, _checked_rows(lines, len(header), path, error, max_rows)


def _paper_columns(groups: list[str], second: list[str], path: Path, error: type[InvalidInput]) -> list[str]:
    """Column names from the paper's two header rows: groups above their first columns, and parts. Raises ``error``."""
    parts = [part.strip().lower().strip("$").replace("_", "") for part in second]
    columns, group = [], ""
    for above, part in zip_longest(groups, parts, fillvalue=""):
        group = above or group
        column = _PAPER_GROUPS.get(group, {}).get(part)
        if column is None:
            raise error(
                f"{path.name}: the header's '{shortened(part)}' under '{shortened(group)}' is not known.", _PAPER_HINT
            )
        columns.append(column)
    return columns


def _checked_rows(
    lines: Iterator[list[str]], columns: int, path: Path, error: type[InvalidInput], max_rows: int
) -> Iterator[list[str]]:
    """Iterate over rows, values stripped; raises ``error`` for another number of ``columns``, or above ``max_rows``."""
    for line, row in enumerate(lines, start=2):
        if line - 1 > max_rows:
            raise error(f"{path.name} has more than {max_rows} rows.", "Record for a shorter time.")
        if len(row) != columns:
            raise error(f"{path.name}, row {line}: {len(row)} values under {columns} column names.")
        yield [value.strip() for value in row]


@contextmanager
def _raising(error: type[InvalidInput], path: Path) -> Iterator[None]:
    """Within the block, turn errors of reading a text or CSV file into ``error``, with a message naming ``path``."""
    try:
        yield
    except FileNotFoundError as cause:
        raise error(f"{path.name} does not exist.", "Check the recording's files.") from cause
    except OSError as cause:
        raise error(f"{path.name} cannot be read: {cause.strerror}.") from cause
    except UnicodeDecodeError as cause:
        raise error(f"{path.name} is not a text file.", "Save it as CSV in UTF-8.") from cause
    except csv.Error as cause:
        raise error(f"{path.name} is not a CSV table: {cause}.") from cause


def _check_size(path: Path, error: type[InvalidInput], max_bytes: int) -> None:
    """Raise ``error`` if the file has more than ``max_bytes``."""
    if path.stat().st_size > max_bytes:
        raise error(f"{path.name} is larger than {max_bytes / 2**20:g} MiB.", "Record for a shorter time.")


def require_columns(path: Path, header: Sequence[str], columns: Sequence[str], error: type[InvalidInput]) -> None:
    """Check that the header has the columns.

    Raises:
        error: one of ``columns`` is missing; the hint says which are expected.
    """
    missing = [column for column in columns if column not in header]
    if missing:
        raise error(
            f"{path.name} has no column {', '.join(missing)}; its header is '{shortened(','.join(header))}'.",
            f"The first row must be {','.join(columns)}.",
        )


def parse_number(text: str, path: Path, line: int, column: str, error: type[InvalidInput]) -> float:
    """A table's value as a float.

    Raises:
        error: it is not a finite number; the message names file, row ``line`` and column.
    """
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise error(f"{path.name}, row {line}: '{shortened(text)}' under {column} is not a finite number.")
    return value


def shortened(text: str) -> str:
    """Text for a message: its first 200 characters, with "…" if it is longer."""
    return text if len(text) <= _MAX_SHOWN else f"{text[:_MAX_SHOWN]}…"


def require_increasing(times: FloatArray, path: Path) -> None:
    """Check that times (N,) increase strictly.

    Raises:
        InvalidRecording: a time repeats or goes back; names the first such row.
    """
    steps = np.flatnonzero(np.diff(times) <= 0)
    if len(steps):
        row = int(steps[0])
        raise InvalidRecording(
            f"{path.name}, row {row + 3}: time {times[row + 1]:.6f} s does not come after {times[row]:.6f} s.",
            "Times must increase from row to row.",
        )


def write_numbers(path: Path, columns: Sequence[str], values: FloatArray, formats: Sequence[str]) -> None:
    """Write ``values`` (N, C) under a header row, a printf format per column."""
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(",".join(columns) + "\n")
        np.savetxt(file, values, fmt=list(formats), delimiter=",")
