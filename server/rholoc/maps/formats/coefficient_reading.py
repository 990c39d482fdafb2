"""Read a map from Table 5."""

import codecs
import math
import uuid
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from rholoc.density import FORMS, Densities, DensityKind, DensityRows
from rholoc.errors import InvalidInput, InvalidMap, UnknownMap
from rholoc.features import get_extractor
from rholoc.geometry import Camera, FloatArray, IntArray
from rholoc.maps.formats.coefficient_table import (
    VIEW_NUMBERS,
    table_columns,
)
from rholoc.maps.formats.rho_file import unpacked_covariances, unpacked_poses
from rholoc.maps.info import MapInfo, Source
from rholoc.maps.map import Map
from rholoc.maps.map_tables import MapDescriptors, MapLandmarks, MapObservations, MapViews
from rholoc.maps.validation import validate_map

_MAX_SHOWN = 80  # characters of an unexpected name
_HINT = "Export the map again, or take another copy."
_SNIFFED = 4096


@dataclass(eq=False)
class _Feature:
    """The rows of one feature; ``texts`` are the values common to all of its rows."""

    channel: int
    landmark: FloatArray
    covariance: FloatArray
    texts: tuple[str, ...]
    descriptors: list[bytes] = field(default_factory=list)
    densities: dict[tuple[str, ...], tuple[FloatArray, FloatArray]] = field(default_factory=dict)
    rows: set[tuple[bytes, tuple[str, ...]]] = field(default_factory=set)


@dataclass(frozen=True, eq=False)
class _Header:
    """The form of the table, and its columns."""

    form: type[Densities]
    degree: int
    columns: list[str]

    @property
    def first_after(self) -> int:
        """The column after the coefficients."""
        return self.columns.index("feature")


def is_coefficient_table(path: Path) -> bool:
    """Whether a file begins with text columns, like Table 5, not with a binary length, like ``.rho``."""
    with path.open("rb") as file:
        first_line = file.read(_SNIFFED).removeprefix(codecs.BOM_UTF8).partition(b"\n")[0]
    return first_line.isascii() and b"," in first_line and b"\0" not in first_line


def read_coefficient_table(path: Path, called: str = "") -> Map:
    """Read a map that :func:`rholoc.maps.write_coefficient_table` wrote: a new one, with an id of its own, version 1.

    It localizes with the same densities, but without patches and covariances of views: answers and their confidence
    differ a little from those of the map that was written.

    Errors and the map's source refer to the file as ``called``, by default its name.

    Raises:
        UnknownMap: there is no such file.
        InvalidMap: there is a column too few or too many, P does not fit the columns, a value is not a finite number, a
            descriptor is repeated for the same density, rows contradict each other, or the file is truncated.
    """
    if not path.is_file():
        raise UnknownMap(f"There is no map {path.name}.", "It may have been deleted or renamed.")
    name = called or path.name
    features: dict[int, _Feature] = {}
    shared: list[str] | None = None
    try:
        with path.open(encoding="utf-8-sig") as file:
            header = _header(name, file.readline().rstrip("\r\n").split(","))
            count = 0
            for count, values in _rows(name, file, header):
                of_map = values[-6:-2]
                if shared is not None and of_map != shared:
                    raise _invalid(name, count, "describes another map than the rows before it")
                shared = of_map
                _add(name, count, header, values, features)
    except UnicodeDecodeError as error:
        hint = "A .rho file needs no import: use it as it is." if path.suffix == ".rho" else _HINT
        raise InvalidMap(f"{name} is not a map as CSV.", hint) from error
    except OSError as error:
        raise InvalidMap(f"{name} cannot be read: {error.strerror}.") from error
    if shared is None:
        raise InvalidMap(f"{name} has no rows.", _HINT)
    return _assemble(name, header, shared, features)


def _header(name: str, columns: list[str]) -> _Header:
    """The form implied by the column names. Raises InvalidMap unless they are exactly those of that form, in order."""
    coefficients = [name for name in columns if name.startswith("a_")]
    last = coefficients[-1].removeprefix("a_").split("_") if coefficients else []
    forms: dict[int, list[type[Densities]]] = {}
    for one in FORMS.values():
        forms.setdefault(len(one.variables), []).append(one)
    if not last or len(last) not in forms or not all(power.isdecimal() and len(power) == 1 for power in last):
        raise InvalidMap(
            f"{name} is not a map: its columns do not end in coefficients a_P_…_P of {_either(sorted(forms))} "
            "variables.",
            "Give a CSV file in Table 5's form.",
        )
    form, degree = _with_columns(forms[len(last)], columns), int(last[-1])
    if degree not in form.degrees:
        raise InvalidMap(
            f"{name} has coefficients of degree {degree}; '{form.kind}' densities have {_either(form.degrees)}.", _HINT
        )
    wanted = table_columns(form, degree)
    missing, extra = _without(wanted, columns), _without(columns, wanted)
    if missing or extra or len(columns) != len(wanted):
        complaints = [f"has no {_some(missing)}"] * bool(missing) + [f"has the unexpected {_some(extra)}"] * bool(extra)
        complaint = " and ".join(complaints) or "has a column twice"
        raise InvalidMap(f"{name} {complaint}; of degree {degree} it has {len(wanted)} columns.", _HINT)
    if columns != wanted:
        raise InvalidMap(f"The columns of {name} are out of order.", _HINT)
    return _Header(form, degree, columns)


def _with_columns(forms: list[type[Densities]], columns: list[str]) -> type[Densities]:
    """Density form that a table's ``columns`` fit, among ``forms`` with the same number of variables.

    The form with the most domain columns, all of which are present; the first of ``forms`` if none has all of them.
    """
    there = set(columns)
    whole = [form for form in forms if set(form.domain_columns) <= there]
    return max(whole, key=lambda form: len(form.domain_columns), default=forms[0])


def _rows(name: str, lines: Iterator[str], header: _Header) -> Iterator[tuple[int, list[str]]]:
    """Iterate over the number, from 1, and the values of each row that is not blank. Raises InvalidMap for a row of
    another length or number, or fewer rows than stated.
    """
    total, count = "", 0
    for line in lines:
        if not line.strip():
            continue
        count += 1
        values = line.rstrip("\r\n").split(",")
        if len(values) != len(header.columns):
            raise _invalid(name, count, f"has {len(values)} values under {len(header.columns)} columns")
        number, _, of = values[-1].partition("/")
        if number != str(count) or (total and of != total):
            raise _invalid(name, count, f"says that it is row {values[-1]}; rows are missing or were moved")
        total = of
        yield count, values
    if count and total != str(count):
        raise InvalidMap(f"{name} is cut off: it has {count} rows of {total}.", _HINT)


def _add(name: str, row: int, header: _Header, values: list[str], features: dict[int, _Feature]) -> None:
    """Add the descriptor and density of a row's texts ``values`` to ``features``. Raises InvalidMap: contradictions."""
    first = header.first_after
    domain_end = first + 1 + len(header.form.domain_columns)
    domain_texts, place_texts = tuple(values[first + 1 : domain_end]), tuple(values[domain_end:-6])
    channel, descriptor = _descriptor(name, row, values[0])
    number = values[first]
    if not number.isdecimal():
        raise _invalid(name, row, f"has the feature '{number}', which is not a number")
    texts = (str(channel), *place_texts, values[-2])
    feature = features.get(int(number))
    if feature is None:
        place = _floats(name, row, header.columns[domain_end:-6], place_texts)
        feature = _Feature(channel, place[:3], place[3:], texts)
        features[int(number)] = feature
    elif feature.texts != texts:
        raise _invalid(name, row, f"contradicts an earlier row of feature {number}")
    if (descriptor, domain_texts) in feature.rows:
        raise _invalid(name, row, "repeats a descriptor with the same density")
    feature.rows.add((descriptor, domain_texts))
    if descriptor not in feature.descriptors:
        feature.descriptors.append(descriptor)
    domain = _floats(name, row, header.columns[first + 1 : domain_end], domain_texts)
    every = _floats(name, row, header.columns[1:first], values[1:first])
    try:
        coefficients = header.form.kept_coefficients(every, header.degree, feature.landmark, domain)
    except ValueError as error:
        raise _invalid(name, row, str(error)) from error
    known = feature.densities.get(domain_texts)
    if known is None:
        feature.densities[domain_texts] = (domain, coefficients)
    elif not np.array_equal(known[1], coefficients):
        raise _invalid(name, row, f"has other coefficients than an earlier row of feature {number} at that place")


def _descriptor(name: str, row: int, text: str) -> tuple[int, bytes]:
    """Channel and descriptor from hexadecimal digits. Raises InvalidMap for other text, or less than two bytes."""
    try:
        data = bytes.fromhex(text)
    except ValueError:
        data = b""
    if len(data) < 2:
        raise _invalid(name, row, f"has the descriptor '{text[:20]}', which is not hex with a channel before it")
    return data[0], data[1:]


def _floats(name: str, row: int, columns: list[str], texts: list[str] | tuple[str, ...]) -> FloatArray:
    """Finite numbers (N,) from the texts of a row; ``columns`` are their names. Raises InvalidMap if one is not."""
    try:
        values = np.array(texts, dtype=np.float64)
    except ValueError:
        values = np.array([_float_or_nan(text) for text in texts])
    bad = np.flatnonzero(~(np.abs(values) < np.finfo(np.float32).max))
    if len(bad):
        raise _invalid(name, row, f"has '{texts[int(bad[0])][:20]}' in {columns[int(bad[0])]}, not a finite number")
    return values


def _float_or_nan(text: str) -> float:
    """The number that a text says; NaN for any other text."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def _assemble(name: str, header: _Header, shared: list[str], features: dict[int, _Feature]) -> Map:
    """The validated map of all features, by ascending number. ``shared``: texts of the columns ``MAP_COLUMNS``."""
    ordered = [features[number] for number in sorted(features)]
    info = _info(name, header.form.kind, shared)
    length = get_extractor(info.features).descriptor_bytes
    if any(len(descriptor) != length for feature in ordered for descriptor in feature.descriptors):
        raise InvalidMap(f"{name} has descriptors that are not {info.features}'s, of {length} bytes.", _HINT)
    times, poses, views, seen = _views(name, [feature.texts[-1] for feature in ordered])
    map_ = Map(
        info=info,
        landmarks=MapLandmarks(
            channels=np.array([feature.channel for feature in ordered], dtype=np.uint8),
            positions=np.array([feature.landmark for feature in ordered], dtype=np.float32),
            covariances=unpacked_covariances(np.reshape([feature.covariance for feature in ordered], (-1, 6))),
        ),
        descriptors=MapDescriptors(
            np.frombuffer(b"".join(b"".join(f.descriptors) for f in ordered), np.uint8).reshape(-1, length),
            np.repeat(np.arange(len(ordered)), [len(f.descriptors) for f in ordered]).astype(np.int32),
        ),
        views=MapViews(times, unpacked_poses(poses)),
        observations=MapObservations(views, seen),
    )
    map_ = replace(map_, densities=_densities(name, header, map_.landmarks.positions, ordered))
    validate_map(map_)
    return map_


def _densities(name: str, header: _Header, landmarks: FloatArray, ordered: list[_Feature]) -> Densities:
    """Densities of the features ``ordered``, at ``landmarks`` (F, 3). Raises InvalidMap if the form refuses them."""
    owners = np.repeat(np.arange(len(ordered)), [len(feature.densities) for feature in ordered])
    densities = [density for feature in ordered for density in feature.densities.values()]
    rows = DensityRows(owners, np.array([domain for domain, _ in densities], dtype=np.float32))
    try:
        return header.form.from_rows(header.degree, rows, landmarks, [kept for _, kept in densities])
    except ValueError as error:
        raise InvalidMap(f"{name} {error}.", _HINT) from error


def _info(name: str, kind: DensityKind, shared: list[str]) -> MapInfo:
    """Description of a new map from the texts of the columns ``MAP_COLUMNS``. Raises InvalidMap if one is not valid."""
    extractor, metric, upright, camera = shared
    try:
        get_extractor(extractor)
        intrinsics = Camera.from_line(camera)
    except InvalidInput as error:
        raise InvalidMap(f"{name}: {error.message}", error.hint) from error
    except ValueError as error:
        raise InvalidMap(f"{name} has '{camera[:40]}' as a camera, which is not valid.", _HINT) from error
    if {metric, upright} - {"0", "1"}:
        raise InvalidMap(f"{name} has something other than 0 or 1 in metric or upright.", _HINT)
    return MapInfo(
        id=uuid.uuid4().hex,
        version=1,
        density=kind,
        features=extractor,
        metric=metric == "1",
        upright=upright == "1",
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        camera=intrinsics,
        sources=(Source(name),),
    )


def _views(name: str, seen_from: list[str]) -> tuple[FloatArray, FloatArray, IntArray, IntArray]:
    """Times (K,) and poses (K, 7) of the views; view (V,) and feature (V,) of each observation, sorted by view.
    ``seen_from`` has the text of each feature's views. Raises InvalidMap for an invalid view, or one with two poses.
    """
    known: dict[str, int] = {}
    saw: dict[int, list[int]] = {}
    for feature, text in enumerate(seen_from):
        for view in filter(None, text.split(";")):
            number, _, _ = view.partition(" ")
            if not number.isdecimal():
                raise InvalidMap(f"{name} has '{view[:30]}' as a view, which is not valid.", _HINT)
            known.setdefault(view, int(number))
            saw.setdefault(int(number), []).append(feature)
    if len(known) != len(saw):
        raise InvalidMap(f"{name} gives a view two poses.", _HINT)
    values = []
    for view, _ in sorted(known.items(), key=lambda item: item[1]):
        numbers = np.array([_float_or_nan(number) for number in view.split(" ")[1:]])
        if len(numbers) != VIEW_NUMBERS or not np.isfinite(numbers).all():
            raise InvalidMap(f"{name} has '{view[:30]}' as a view, which is not valid.", _HINT)
        values.append(numbers)
    table = np.array(values).reshape(-1, VIEW_NUMBERS)
    lists = [saw[number] for number in sorted(saw)]
    views = np.repeat(np.arange(len(lists)), [len(features) for features in lists]).astype(np.int32)
    every = np.array([feature for features in lists for feature in features], dtype=np.int32)
    return table[:, 0].copy(), table[:, 1:].astype(np.float32), views, every


def _without(names: list[str], others: list[str]) -> list[str]:
    """The ``names`` that are not among ``others``."""
    there = set(others)
    return [name for name in names if name not in there]


def _some(names: list[str]) -> str:
    """The first three names, separated by commas, and how many more there are."""
    return ", ".join(name[:_MAX_SHOWN] for name in names[:3]) + (
        f" and {len(names) - 3} more" if len(names) > 3 else ""
    )


def _either(values: Sequence[int]) -> str:
    """Numbers as "1 or 2 or 3"."""
    return " or ".join(map(str, values))


def _invalid(name: str, row: int, complaint: str) -> InvalidMap:
    """Error for a row of the table ``name``; ``complaint`` follows "row 5" in its message."""
    return InvalidMap(f"{name}, row {row} {complaint}.", _HINT)
