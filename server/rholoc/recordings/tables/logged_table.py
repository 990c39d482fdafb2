"""Tables of recorder apps: with or without a header, comments, units in names, commas or spaces."""

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rholoc.errors import InvalidRecording
from rholoc.geometry import FloatArray
from rholoc.recordings.tables.csv_table import MAX_TABLE_ROWS, parse_number, read_text, require_columns

_UNIT = re.compile(r"\[[^\[\]]*\]|\([^()]*\)")  # of a column's name; linear time for unclosed brackets
_HEAD_BYTES = 4096


@dataclass(frozen=True, eq=False)
class LoggedTable:
    """A table's rows as text.

    Attributes:
        path: its file.
        header: the columns' names, lower case, without units; empty if there is none.
        lines: one per row, all with the same number of fields.
        columns: number of columns.
        blanks: whether the separator is a space, not a comma.
        numbers: line number of each row.
    """

    path: Path
    header: tuple[str, ...]
    lines: list[str]
    columns: int
    blanks: bool
    numbers: list[int]

    def __len__(self) -> int:
        return len(self.lines)

    @property
    def rows(self) -> Iterator[list[str]]:
        """Iterate over the fields of each row."""
        return (_fields(line, self.blanks) for line in self.lines)

    def named(self, *names: str) -> FloatArray:
        """The columns of these names in ``header``, (N, len(names)).

        Raises:
            InvalidRecording: a column is missing, the header does not fit the rows, or a value is not a finite number.
        """
        return self.numbered(*self._places(names))

    def numbered(self, *columns: int) -> FloatArray:
        """The columns by their indices, (N, len(columns)), for tables whose format has no header.

        Raises:
            InvalidRecording: there are fewer columns, or a value is not a finite number.
        """
        if max(columns) >= self.columns:
            raise InvalidRecording(f"{self.path.name} has {self.columns} columns; {max(columns) + 1} are expected.")
        fits = len(self.header) == self.columns
        names = [self.header[column] if fits else f"column {column + 1}" for column in columns]
        values = np.empty((len(self), len(columns)))
        for place, (number, row) in enumerate(zip(self.numbers, self.rows, strict=True)):
            values[place] = [
                parse_number(row[column], self.path, number, name, InvalidRecording)
                for column, name in zip(columns, names, strict=True)
            ]
        return values

    def text(self, name: str) -> list[str]:
        """The column of this name in ``header`` as text.

        Raises:
            InvalidRecording: there is no such column, or the header does not fit the rows.
        """
        (place,) = self._places((name,))
        return [row[place] for row in self.rows]

    def _places(self, names: Sequence[str]) -> list[int]:
        """Indices of the columns of these names. Raises InvalidRecording."""
        require_columns(self.path, self.header, names, InvalidRecording)
        if len(self.header) != self.columns:
            raise InvalidRecording(f"{self.path.name} has {len(self.header)} names over {self.columns} columns.")
        return [self.header.index(name) for name in names]


def read_logged_table(path: Path) -> LoggedTable:
    """Read a table whose rows begin with a number; the last line before them is the header.

    Raises:
        InvalidRecording: the file cannot be read, has no rows, more than ``MAX_TABLE_ROWS``, or rows of different
            lengths.
    """
    lines = read_text(path).splitlines()
    first = next((number for number, line in enumerate(lines) if _begins_with_number(line)), None)
    if first is None:
        raise InvalidRecording(f"{path.name} has no rows.", "Record again, or leave the file out.")
    blanks = "," not in lines[first]
    rows: list[str] = []
    numbers: list[int] = []
    columns = len(_fields(lines[first], blanks))
    for number, line in enumerate(lines[first:], start=first + 1):
        if not line.strip() or line.startswith("#"):
            continue
        found = len(_fields(line, blanks))
        if found != columns:
            raise InvalidRecording(f"{path.name}, line {number}: {found} values, not {columns} as before.")
        if len(rows) == MAX_TABLE_ROWS:
            raise InvalidRecording(f"{path.name} has more than {MAX_TABLE_ROWS} rows.", "Record for a shorter time.")
        rows.append(line)
        numbers.append(number)
    return LoggedTable(path, _header(lines[:first], blanks), rows, columns, blanks, numbers)


def header_of(path: Path) -> tuple[str, ...]:
    """The names in a table's header, lower case and without units; empty if its first 4 KiB have no header, or the file
    cannot be read.
    """
    before: list[str] = []
    for line in _head(path):
        if _begins_with_number(line):
            return _header(before, blanks="," not in line)
        before.append(line)
    return _header(before, blanks=False)


def has_columns(path: Path, names: Sequence[str]) -> bool:
    """Whether a table's header has all of the names."""
    return set(names) <= set(header_of(path))


def is_bare_table(path: Path, columns: int) -> bool:
    """Whether a file exists and is a table of so many columns of numbers, by its first line that begins with one."""
    first = next((line for line in _head(path) if _begins_with_number(line)), None)
    return first is not None and len(_fields(first, "," not in first)) == columns


def _head(path: Path) -> list[str]:
    """Lines of a text file's first 4 KiB; none if it cannot be read."""
    try:
        with path.open("rb") as file:
            return file.read(_HEAD_BYTES).decode("utf-8-sig", errors="replace").splitlines()
    except OSError:
        return []


def _begins_with_number(line: str) -> bool:
    """Whether the first field of a line is a number, whatever separates it."""
    text = line.replace(",", " ").split()
    try:
        float(text[0] if text else "")
    except ValueError:
        return False
    return True


def _fields(line: str, blanks: bool) -> list[str]:
    """Fields of a line, separated by spaces if ``blanks``, else by commas and stripped."""
    if blanks:
        return line.split()
    try:
        return [field.strip() for field in next(csv.reader([line]))]
    except csv.Error:  # a field of more than 131072 characters, which is not a number anyway
        return line.split(",")


def _header(lines: list[str], blanks: bool) -> tuple[str, ...]:
    """Names in the last of these lines that is not blank, lower case, without ``#`` and units; empty without one."""
    named = [line.lstrip("#").strip() for line in lines if line.lstrip("#").strip()]
    if not named:
        return ()
    return tuple(_UNIT.sub("", name).strip().lower() for name in _fields(named[-1], blanks))
