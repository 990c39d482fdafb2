"""Reader of Table 4: observations as CSV, by rholoc or by another program."""

from array import array
from pathlib import Path

import numpy as np

from rholoc.errors import InvalidInput
from rholoc.features import Channel
from rholoc.geometry import FloatArray
from rholoc.maps import ObservationTable
from rholoc.maps.formats.observation_table import OBSERVATION_COLUMNS, ROLL_COLUMN, TIME_COLUMN
from rholoc.recordings.tables.csv_table import parse_number, require_columns, shortened, table_rows

MAX_OBSERVATIONS = 5_000_000
_CHANNELS = frozenset(int(channel) for channel in Channel)
_UNIT_TOLERANCE = 0.02  # of a heading's length, which tables round


def read_observations(path: Path) -> ObservationTable:
    """Read Table 4: ``descriptor,u,v,x,y,z,hx,hy,hz``, and ``timestamp`` and ``roll`` where there are such columns.

    The descriptor is hex, two digits of its channel first (01 for A, 02 for B). Pixels, metres, unit vectors; headings
    are made unit length. Further columns are ignored.

    Raises:
        InvalidInput: the file cannot be read, a column is missing, a value is not a finite number, a descriptor not
            hex or of another length than the first, its channel unknown, a heading no direction, or there are no rows.
    """
    with table_rows(path, InvalidInput, MAX_OBSERVATIONS) as (header, rows):
        require_columns(path, header, OBSERVATION_COLUMNS, InvalidInput)
        names = [*OBSERVATION_COLUMNS[1:], *(name for name in (TIME_COLUMN, ROLL_COLUMN) if name in header)]
        places = [(header.index(name), name) for name in names]
        hex_at = header.index(OBSERVATION_COLUMNS[0])
        numbers, data, length = array("d"), bytearray(), 0
        for line, row in enumerate(rows, start=2):
            descriptor = _descriptor(row[hex_at], path, line, length)
            length = len(descriptor)
            data += descriptor
            numbers.extend(parse_number(row[place], path, line, name, InvalidInput) for place, name in places)
    if not length:
        raise InvalidInput(f"{path.name} has a header, but no observations.", "Give a table with rows.")
    values = dict(zip(names, np.frombuffer(numbers).reshape(-1, len(names)).T, strict=True))
    described = np.frombuffer(bytes(data), dtype=np.uint8).reshape(-1, length)
    return ObservationTable(
        channels=described[:, 0].copy(),
        descriptors=described[:, 1:].copy(),
        pixels=np.column_stack([values["u"], values["v"]]),
        positions=np.column_stack([values[name] for name in "xyz"]),
        headings=_headings(np.column_stack([values[name] for name in ("hx", "hy", "hz")]), path),
        times=values.get(TIME_COLUMN),
        rolls=values.get(ROLL_COLUMN),
    )


def _descriptor(text: str, path: Path, line: int, length: int) -> bytes:
    """A descriptor's bytes, the channel first; all of them of one ``length``, where that is not 0."""
    try:
        data = bytes.fromhex(text)
    except ValueError:
        data = b""
    hint = "A descriptor is hex, two digits of its channel first: 01 for A, 02 for B, 00 for grey."
    if len(data) < 2:
        raise InvalidInput(f"{path.name}, row {line}: '{shortened(text[:40])}' is not a descriptor.", hint)
    if data[0] not in _CHANNELS:
        raise InvalidInput(
            f"{path.name}, row {line}: a descriptor begins with {data[0]:02x}, which is not a channel.", hint
        )
    if length and len(data) != length:
        raise InvalidInput(
            f"{path.name}, row {line}: a descriptor has {len(data) - 1} bytes, the ones before {length - 1}.",
            "All descriptors of a table must be of one kind of features.",
        )
    return data


def _headings(headings: FloatArray, path: Path) -> FloatArray:
    with np.errstate(over="ignore"):  # which is not 1 either
        lengths = np.linalg.norm(headings, axis=1)
    wrong = np.flatnonzero(np.abs(lengths - 1) > _UNIT_TOLERANCE)
    if len(wrong):
        raise InvalidInput(
            f"{path.name}, row {wrong[0] + 2}: the heading's length is {lengths[wrong[0]]:.3g}, not 1.",
            "hx, hy, hz are the unit vector of the optical axis.",
        )
    return np.asarray(headings / lengths[:, None])
