"""Tables of numbers in CSV files, with errors that name the file and what is wrong in it."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from rholoc.errors import InvalidInput, InvalidRecording
from rholoc.geometry import FloatArray

MAX_TABLE_BYTES = 2**29
_MOST_SHOWN = 200  # characters of a table in a message


def read_text(path: Path, error: type[InvalidInput] = InvalidRecording) -> str:
    """The text of a UTF-8 file, a byte order mark left out.

    Raises:
        error: the file is missing, unreadable, not text, or over 512 MiB.
    """
    try:
        if path.stat().st_size > MAX_TABLE_BYTES:
            raise error(f"{path.name} is larger than {MAX_TABLE_BYTES // 2**20} MiB.", "Record for a shorter time.")
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as cause:
        raise error(f"{path.name} does not exist.", f"Looked for it at {path}.") from cause
    except OSError as cause:
        raise error(f"{path.name} cannot be read: {cause.strerror}.") from cause
    except UnicodeDecodeError as cause:
        raise error(f"{path.name} is not a text file.", "Save it as CSV in UTF-8.") from cause
    return text


def read_rows(path: Path, error: type[InvalidInput] = InvalidRecording) -> tuple[list[str], list[dict[str, str]]]:
    """The header's names (lower case) and one dict per row of a CSV file; blank lines are skipped.

    Raises:
        error: the file cannot be read, is empty, or a row has another number of columns than the header.
    """
    try:
        lines = [
            row for row in csv.reader(io.StringIO(read_text(path, error)), strict=True) if any(map(str.strip, row))
        ]
    except csv.Error as cause:
        raise error(f"{path.name} is not a CSV table: {cause}.") from cause
    if not lines:
        raise error(f"{path.name} is empty.", "It needs a header row and rows of values.")
    header = [name.strip().lower() for name in lines[0]]
    for line, row in enumerate(lines[1:], start=2):
        if len(row) != len(header):
            raise error(f"{path.name}, row {line}: {len(row)} values under {len(header)} column names.")
    return header, [dict(zip(header, map(str.strip, row), strict=True)) for row in lines[1:]]


def read_numbers(
    path: Path, columns: Sequence[str], error: type[InvalidInput] = InvalidRecording
) -> dict[str, FloatArray]:
    """The named columns of a CSV file with a header row, each (N,) float64, N ≥ 1; further columns are ignored.

    Raises:
        error: a column is missing, there are no rows, or a value is not a finite number.
    """
    header, rows = read_rows(path, error)
    require_columns(path, header, columns, error)
    if not rows:
        raise error(f"{path.name} has a header, but no rows.", "Record again, or leave the file out.")
    return {
        column: np.array(
            [parse_number(row[column], path, line, column, error) for line, row in enumerate(rows, start=2)],
            dtype=np.float64,
        )
        for column in columns
    }


def require_columns(path: Path, header: Sequence[str], columns: Sequence[str], error: type[InvalidInput]) -> None:
    """Check that the header has the columns.

    Raises:
        error: one is missing; the hint says which are meant.
    """
    missing = [column for column in columns if column not in header]
    if missing:
        raise error(
            f"{path.name} has no column {', '.join(missing)}; its header is '{_shown(','.join(header))}'.",
            f"The first row must be {','.join(columns)}.",
        )


def parse_number(text: str, path: Path, line: int, column: str, error: type[InvalidInput]) -> float:
    """One value of a table.

    Raises:
        error: it is not a finite number; the message names file, row and column.
    """
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise error(f"{path.name}, row {line}: '{_shown(text)}' under {column} is not a finite number.")
    return value


def _shown(text: str) -> str:
    return text if len(text) <= _MOST_SHOWN else f"{text[:_MOST_SHOWN]}…"


def require_increasing(times: FloatArray, path: Path, error: type[InvalidInput] = InvalidRecording) -> None:
    """Check that times (N,) increase strictly.

    Raises:
        error: a time repeats or goes back; names the first such row.
    """
    steps = np.flatnonzero(np.diff(times) <= 0)
    if len(steps):
        row = int(steps[0])
        raise error(
            f"{path.name}, row {row + 3}: time {times[row + 1]:.6f} s does not come after {times[row]:.6f} s.",
            "Times must increase from row to row.",
        )


def write_numbers(path: Path, columns: Sequence[str], values: FloatArray, formats: Sequence[str]) -> None:
    """Write ``values`` (N, C) under a header row, a printf format per column."""
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(",".join(columns) + "\n")
        np.savetxt(file, values, fmt=list(formats), delimiter=",")
