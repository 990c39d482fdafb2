"""``.rho``: the native map file, a safetensors file with the arrays of :class:`rholoc.maps.Map`, packed.

Its metadata holds ``format``, ``format_version``, ``info`` (JSON) and ``checksum``: BLAKE2b over the info and all
arrays. It contains no code, and nothing is unpickled. maps/README.md describes every array.
"""

import hashlib
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from rholoc.density import FORMS, Densities, DensityKind
from rholoc.disk import replace_file
from rholoc.errors import InvalidMap, UnknownMap
from rholoc.geometry import FloatArray, IntArray, poses_from_rows, rows_from_poses
from rholoc.maps.display import Cloud, Room
from rholoc.maps.formats.patch_bytes import packed_patches, unpacked_patches
from rholoc.maps.info import MapInfo, info_from_json, info_to_json
from rholoc.maps.kept_observations import packed_pixels, source_cameras, unpacked_pixels
from rholoc.maps.map import Map
from rholoc.maps.map_tables import MapDescriptors, MapLandmarks, MapObservations, MapTable, MapViews
from rholoc.maps.validation import validate_map

SUFFIX = ".rho"
FORMAT = "rholoc-map"
FORMAT_VERSION = 2

_CHECKSUM_BYTES = 16
_HINT = "Take another copy, or build the map again."
_UNIT_TOLERANCE = 1e-3  # of a stored quaternion's length

Kind = tuple[str, tuple[int | None, ...]]  # dtype, and shape with None for any length


@dataclass(frozen=True)
class _Stored:
    """Storage of a table's column in a file.

    Attributes:
        name: of the array in the file.
        kind: of the array in the file.
        pack: column → array.
        unpack: array → column.
    """

    name: str
    kind: Kind
    pack: Callable[[Any], Any] = lambda column: column
    unpack: Callable[[Any], Any] = lambda array: array


def _upper(size: int) -> Callable[[FloatArray], FloatArray]:
    """Function: symmetric matrices (N, size, size) → their upper triangles (N, size · (size + 1) / 2), row by row."""
    rows, columns = np.triu_indices(size)
    return lambda covariances: covariances[:, rows, columns]


def _from_upper(size: int) -> Callable[[FloatArray], FloatArray]:
    """Function that takes upper triangles (N, …), row by row, to symmetric matrices (N, size, size) float32."""
    rows, columns = np.triu_indices(size)

    def unpack(triangles: FloatArray) -> FloatArray:
        covariances = np.zeros((len(triangles), size, size), dtype=np.float32)
        covariances[:, rows, columns] = triangles
        covariances[:, columns, rows] = triangles
        return covariances

    return unpack


unpacked_covariances = _from_upper(3)
"""Rows (F, 6) of xx, xy, xz, yy, yz, zz → covariances (F, 3, 3) float32."""


def unpacked_poses(rows: FloatArray) -> FloatArray:
    """Rows (K, 7) of positions and quaternions → T_map_camera (K, 4, 4).

    Raises:
        InvalidMap: a number is not finite, or a quaternion not of unit length.
    """
    if not np.isfinite(rows).all():
        raise InvalidMap("The map contradicts itself: view_poses has values that are not finite.", _HINT)
    if not np.all(np.abs(np.linalg.norm(rows[:, 3:], axis=1) - 1) <= _UNIT_TOLERANCE):
        raise InvalidMap("The map contradicts itself: a view's quaternion is not of unit length.", _HINT)
    return poses_from_rows(rows)


_LANDMARKS = {
    "channels": _Stored("channels", ("u1", (None,))),
    "positions": _Stored("landmarks", ("f4", (None, 3))),
    "covariances": _Stored("covariances", ("f4", (None, 6)), _upper(3), unpacked_covariances),
    "colours": _Stored("colours", ("u1", (None, 3))),
    "patches": _Stored("patches", ("i1", (None, 3)), packed_patches, unpacked_patches),
}
_DESCRIPTORS = {
    "values": _Stored("descriptors", ("u1", (None, None))),
    "features": _Stored("descriptor_features", ("i4", (None,))),
    "sources": _Stored("extras/descriptor_sources", ("i4", (None,))),
}
_VIEWS = {
    "times": _Stored("view_times", ("f8", (None,))),
    "T_map_camera": _Stored("view_poses", ("f4", (None, 7)), rows_from_poses, unpacked_poses),
    "covariances": _Stored("view_covariances", ("f4", (None, 21)), _upper(6), _from_upper(6)),
    "sources": _Stored("extras/view_sources", ("i4", (None,))),
    "second_positions": _Stored("extras/view_second_positions", ("f4", (None, 3))),
}
_PICTURES: dict[str, Kind] = {
    "picture_bytes": ("u1", (None,)),  # one JPEG after the other
    "picture_offsets": ("i8", (None,)),
}
_OBSERVATIONS: dict[str, Kind] = {
    "view_offsets": ("i4", (None,)),  # the observations of view k are rows view_offsets[k] : view_offsets[k + 1]
    "view_features": ("i4", (None,)),
}
_PIXELS: dict[str, Kind] = {
    "extras/observation_pixels": ("u2", (None, 2)),
}
_RANGES: dict[str, Kind] = {
    "extras/observation_ranges": ("f4", (None,)),
}
_CLOUD: dict[str, Kind] = {
    "cloud_positions": ("f4", (None, 3)),
    "cloud_colours": ("u1", (None, 3)),
    "cloud_sources": ("i4", (None,)),
}
_ROOM: dict[str, Kind] = {
    "room_positions": ("f4", (None, 3)),
    "room_colours": ("u1", (None, 3)),
    "room_sources": ("i4", (None,)),
    "room_faces": ("i4", (None, 4)),
}
_PLAN: dict[str, Kind] = {
    "plan_bytes": ("u1", (None,)),
}
_MEMORY = ("extras/observation_pixels", "extras/view_sources", "extras/descriptor_sources")
_KINDS = {stored.name: stored.kind for table in (_LANDMARKS, _DESCRIPTORS, _VIEWS) for stored in table.values()} | (
    _PICTURES | _OBSERVATIONS | _PIXELS | _RANGES | _CLOUD | _ROOM | _PLAN
)
# int32 in memory; in a file of the smallest type that holds them
_INDICES = tuple(name for name, (number, _) in _KINDS.items() if number == "i4")
Arrays = dict[str, NDArray[Any]]
Table = TypeVar("Table", bound=MapTable)
_ABSENT = {"shape": [0]}
LENGTH_BYTES = 8  # at the start of a file, with the length of its header
_MAX_HEADER_BYTES = 2**25  # twice the longest description: it is text within text
_MAX_HEADER_TOKENS = 5000  # a map has a few dozen arrays of five texts each
_TOKEN = re.compile(rb'"(?:[^"\\]++|\\.)*+"', re.DOTALL)


def save_map(map_: Map, path: Path | str) -> None:
    """Write a map; an existing file is replaced atomically.

    Raises:
        InvalidMap: the map's arrays contradict each other.
        StorageFull: the disk is full; an existing file is unchanged.
        InvalidInput: the folder does not exist or cannot be written to.
    """
    replace_file(Path(path), map_to_bytes(map_))


def map_to_bytes(map_: Map) -> bytes:
    """A map → the content of its ``.rho`` file.

    Raises:
        InvalidMap: the map's arrays contradict each other.
    """
    validate_map(map_)
    arrays = _packed(map_)
    info = info_to_json(map_.info)
    metadata = {
        "format": FORMAT,
        "format_version": str(FORMAT_VERSION),
        "info": info,
        "checksum": _checksum(info, arrays),
    }
    return bytes(save(arrays, metadata))


def load_map(path: Path | str, called: str | None = None) -> Map:
    """Read a map. The file is not needed afterwards.

    Args:
        path: the file.
        called: name of the file in error messages, by default its own.

    Raises:
        UnknownMap: there is no such file.
        InvalidMap: the file is corrupt, truncated, of a later version, or not a map.
    """
    path = Path(path)
    if not path.is_file():
        raise UnknownMap(f"There is no map {called or path.name}.", "It may have been deleted or renamed.")
    called = called or path.name
    outline_of(_header(path, called), called)
    try:
        with safe_open(path, framework="numpy") as file:
            metadata = file.metadata() or {}
            _check_format(called, metadata)
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise InvalidMap(f"{called} is corrupt, truncated, or not a map: {_reason(error)}.", _HINT) from error
    info = metadata.get("info", "")
    if metadata.get("checksum") != _checksum(info, arrays):
        raise InvalidMap(f"{called} is corrupt: its checksum does not match its content.", _HINT)
    try:
        map_ = _unpacked(info_from_json(info), _widened(arrays))
        validate_map(map_)
    except InvalidMap as error:
        raise InvalidMap(f"{called}: {error.message}", error.hint or _HINT) from error
    return map_


@dataclass(frozen=True)
class MapOutline:
    """Content of the header of a map's file.

    Attributes:
        info: the map's description.
        landmarks, views: their numbers.
        room: number of vertices of the room's surfaces.
        checksum: of the description and all arrays.
    """

    info: MapInfo
    landmarks: int
    views: int
    checksum: str = ""
    room: int = 0


def load_outline(path: Path) -> MapOutline:
    """Read the description in a map's file and the lengths of its arrays, but not the arrays.

    Raises:
        InvalidMap: it is not a map, of another version, or cannot be read.
    """
    return outline_of(_header(path, path.name), path.name)


def header_bytes(start: bytes, called: str) -> int:
    """Length in bytes of the header that follows the first :data:`LENGTH_BYTES` of a map's file.

    Raises:
        InvalidMap: it is longer than any map's, or ``start`` is shorter than its length.
    """
    length = int.from_bytes(start[:LENGTH_BYTES], "little")
    if len(start) < LENGTH_BYTES or length > _MAX_HEADER_BYTES:
        raise InvalidMap(f"{called} is corrupt, truncated, or has a header that no map has.", _HINT)
    return length


def outline_of(header: bytes, called: str) -> MapOutline:
    """Description, array lengths and checksum from the header of a map's file (without the length before it).

    ``called`` names the file in messages.

    Raises:
        InvalidMap: it is not a map's, of another format version, or holds more than 5000 texts.
    """
    for count, _ in enumerate(_TOKEN.finditer(header)):
        if count > _MAX_HEADER_TOKENS:
            raise InvalidMap(f"{called} has a header of more than {_MAX_HEADER_TOKENS} texts.", _HINT)
    try:
        arrays = json.loads(header)
        metadata = arrays.get("__metadata__", {})
        _check_format(called, metadata)
        lengths = ("landmarks", "view_times", "room_positions")
        landmarks, views, room = (int(arrays.get(name, _ABSENT)["shape"][0]) for name in lengths)
        info = info_from_json(metadata.get("info", ""))
        return MapOutline(info, landmarks, views, metadata.get("checksum", ""), room)
    except (ValueError, TypeError, LookupError, AttributeError, RecursionError) as error:
        raise InvalidMap(f"{called} is corrupt, truncated, or not a map.", _HINT) from error


def _header(path: Path, called: str) -> bytes:
    """The header of a map's file, without the length before it. Raises InvalidMap if too long or unreadable."""
    try:
        with path.open("rb") as file:
            header = file.read(header_bytes(file.read(LENGTH_BYTES), called))
    except OSError as error:
        raise InvalidMap(f"{called} cannot be read: {error.strerror}.", _HINT) from error
    return header


def _reason(error: Exception) -> str:
    """Text of an exception; of an operating-system error its reason only, without the path."""
    return error.strerror or type(error).__name__ if isinstance(error, OSError) else str(error)


def _check_format(called: str, metadata: Mapping[str, str]) -> None:
    """Raise InvalidMap unless a file's metadata name this format and this version of it; ``called`` names the file."""
    if metadata.get("format") != FORMAT:
        raise InvalidMap(f"{called} is not a rholoc map.", "Give a .rho file.")
    version = metadata.get("format_version", "")
    if version != str(FORMAT_VERSION):
        raise InvalidMap(
            f"{called} has format version {version}; this rholoc reads {FORMAT_VERSION}.",
            "Update rholoc, or build the map again.",
        )


def _packed(map_: Map) -> Arrays:
    """The arrays of a map's file by name, in C order and little-endian, as safetensors wants them; indices narrowed."""
    arrays: dict[str, Any] = {
        **_packed_table(map_.landmarks, _LANDMARKS),
        **_packed_table(map_.descriptors, _DESCRIPTORS),
        **_packed_table(map_.views, _VIEWS),
        "view_offsets": map_.view_offsets,
        "view_features": map_.observations.features,
    }
    if map_.observations.pixels is not None:
        arrays["extras/observation_pixels"] = _packed_pixels(map_, map_.observations.pixels)
        if map_.observations.ranges_m is not None:
            arrays["extras/observation_ranges"] = map_.observations.ranges_m
    if map_.views.pictures is not None:
        ends = np.cumsum([len(picture) for picture in map_.views.pictures], dtype=np.int64)
        arrays["picture_bytes"] = np.frombuffer(b"".join(map_.views.pictures), dtype=np.uint8)
        arrays["picture_offsets"] = np.concatenate([[0], ends])
    if len(map_.cloud):
        arrays["cloud_positions"] = map_.cloud.positions
        arrays["cloud_colours"] = map_.cloud.colours
        arrays["cloud_sources"] = map_.cloud.sources
    if len(map_.room):
        vertices = map_.room.vertices
        columns = (vertices.positions, vertices.colours, vertices.sources, map_.room.faces)
        arrays |= dict(zip(_ROOM, columns, strict=True))
    if map_.plan:
        arrays["plan_bytes"] = np.frombuffer(map_.plan, dtype=np.uint8)
    packed = {name: np.asarray(array, dtype=f"<{_KINDS[name][0]}", order="C") for name, array in arrays.items()}
    for name, array in map_.densities.arrays().items():
        little_endian = array.dtype.newbyteorder("<")
        packed[_prefix(map_.info.density) + name] = np.asarray(array, dtype=little_endian, order="C")
    return packed | {name: _narrowed(packed[name]) for name in _INDICES if name in packed}


def _packed_table(table: MapTable, columns: Mapping[str, _Stored]) -> dict[str, Any]:
    """A table's columns in the file's representation, without those that are None."""
    found = ((stored, getattr(table, column)) for column, stored in columns.items())
    return {stored.name: stored.pack(values) for stored, values in found if values is not None}


def _narrowed(indices: IntArray) -> IntArray:
    """Non-negative indices in the smallest sufficient type of uint8, uint16 and int32."""
    greatest = indices.max(initial=0)
    fitting = (kind for kind in ("<u1", "<u2") if greatest <= np.iinfo(kind).max)
    return indices.astype(next(fitting, "<i4"))


def _widened(arrays: Arrays) -> Arrays:
    """A file's arrays with narrowed indices as int32."""
    narrow = (name for name in _INDICES if name in arrays and arrays[name].dtype in (np.uint8, np.uint16))
    return arrays | {name: arrays[name].astype(np.int32) for name in narrow}


def _prefix(kind: DensityKind) -> str:
    """``extras/KIND_``, with which the names of a form's arrays begin."""
    return f"extras/{kind.value}_"


def _unpacked(info: MapInfo, arrays: Arrays) -> Map:
    """The map of a file's arrays; unknown arrays are ignored, and an incomplete memory of the recordings dropped.
    Raises InvalidMap: one is missing, of another type or shape, or contradicts another in length.
    """
    if not all(name in arrays for name in _MEMORY):
        arrays = {name: array for name, array in arrays.items() if name not in _MEMORY}
    _check_arrays(arrays, _OBSERVATIONS)
    views = _unpacked_table(MapViews, arrays, _VIEWS)
    views = replace(views, pictures=_unpacked_pictures(arrays, len(views)))
    seen_from = _views_of(arrays["view_offsets"], len(views), len(arrays["view_features"]))
    return Map(
        info=info,
        landmarks=_unpacked_table(MapLandmarks, arrays, _LANDMARKS),
        descriptors=_unpacked_table(MapDescriptors, arrays, _DESCRIPTORS),
        views=views,
        observations=MapObservations(
            seen_from,
            arrays["view_features"],
            _unpacked_pixels(info, views, seen_from, arrays),
            _unpacked_ranges(arrays),
        ),
        cloud=_unpacked_cloud(arrays),
        room=_unpacked_room(arrays),
        plan=_unpacked_plan(arrays),
        densities=_unpacked_densities(info.density, arrays),
    )


def _unpacked_table(table: type[Table], arrays: Arrays, columns: Mapping[str, _Stored]) -> Table:
    """A map's table from the arrays of its file. Raises InvalidMap: one that is required is missing, or one is of
    another type or shape.
    """
    optional = {column for column, described in table.columns().items() if described.optional}
    kept = {column: stored for column, stored in columns.items() if stored.name in arrays or column not in optional}
    _check_arrays(arrays, {stored.name: stored.kind for stored in kept.values()})
    return table(**{column: stored.unpack(arrays[stored.name]) for column, stored in kept.items()})


def _unpacked_cloud(arrays: Arrays) -> Cloud:
    """The cloud of a file's arrays, empty if it has none. Raises InvalidMap if one is missing or of another type."""
    if _CLOUD.keys().isdisjoint(arrays):
        return Cloud()
    _check_arrays(arrays, _CLOUD)
    return Cloud(arrays["cloud_positions"], arrays["cloud_colours"], arrays["cloud_sources"])


def _unpacked_room(arrays: Arrays) -> Room:
    """The room of a file's arrays, empty if it has none. Raises InvalidMap if one is missing or of another type."""
    if _ROOM.keys().isdisjoint(arrays):
        return Room()
    _check_arrays(arrays, _ROOM)
    positions, colours, sources, faces = (arrays[name] for name in _ROOM)
    return Room(Cloud(positions, colours, sources), faces)


def _unpacked_pictures(arrays: Arrays, views: int) -> tuple[bytes, ...] | None:
    """The picture of each view (K,), empty for none; None if the file has no pictures. Raises InvalidMap: there are not
    as many as views, or their offsets are broken.
    """
    if _PICTURES.keys().isdisjoint(arrays):
        return None
    _check_arrays(arrays, _PICTURES)
    whole, offsets = arrays["picture_bytes"].tobytes(), arrays["picture_offsets"]
    fit = len(offsets) == views + 1 and offsets[0] == 0 and offsets[-1] == len(whole)
    if not (fit and np.all(np.diff(offsets) >= 0)):
        raise InvalidMap("The map contradicts itself: the views' pictures are broken.", _HINT)
    return tuple(whole[start:end] for start, end in pairwise(offsets.tolist()))


def _unpacked_plan(arrays: Arrays) -> bytes:
    """Content of the floor plan's file; empty if the map has none."""
    if "plan_bytes" not in arrays:
        return b""
    _check_arrays(arrays, _PLAN)
    return bytes(arrays["plan_bytes"].tobytes())


def _views_of(offsets: IntArray, views: int, observations: int) -> IntArray:
    """View (V,) of each of V observations, from the offsets (K + 1,) of K views. Raises InvalidMap if these misfit."""
    parts = np.diff(offsets)
    if not (len(offsets) == views + 1 and offsets[0] == 0 and offsets[-1] == observations and np.all(parts >= 0)):
        raise InvalidMap("The map contradicts itself: the views' lists of features are broken.", _HINT)
    return np.repeat(np.arange(views, dtype=np.int32), parts)


def _packed_pixels(map_: Map, pixels: FloatArray) -> IntArray:
    """Pixels (N, 2) of all observations, packed to uint16 by their sources' cameras."""
    assert map_.views.sources is not None
    packed = np.zeros(pixels.shape, dtype=np.uint16)
    sources = map_.views.sources[map_.observations.views]
    for source, camera in enumerate(source_cameras(map_.info)):
        rows = np.flatnonzero(sources == source)
        packed[rows] = packed_pixels(pixels[rows], camera)
    return packed


def _unpacked_ranges(arrays: Arrays) -> FloatArray | None:
    """The ranges (V,) of observations; None if the file has none. Raises InvalidMap: they are not as many as the
    observations, or not positive.
    """
    if "extras/observation_ranges" not in arrays:
        return None
    _check_arrays(arrays, _RANGES)
    ranges_m = arrays["extras/observation_ranges"]
    if len(ranges_m) != len(arrays["view_features"]) or not (np.isnan(ranges_m) | (ranges_m > 0)).all():
        raise InvalidMap("The ranges of the map's observations are inconsistent.", "Take another copy.")
    return ranges_m


def _unpacked_pixels(info: MapInfo, views: MapViews, seen_from: IntArray, arrays: Arrays) -> FloatArray | None:
    """The pixels (V, 2) of observations from views (V,); None without any. Raises InvalidMap for other lengths."""
    if _PIXELS.keys().isdisjoint(arrays):
        return None
    _check_arrays(arrays, _PIXELS)
    packed = arrays["extras/observation_pixels"]
    assert views.sources is not None
    if len(packed) != len(seen_from) or len(views.sources) != len(views):
        raise InvalidMap("The map contradicts itself: its arrays of observations differ in length.", _HINT)
    pixels = np.zeros(packed.shape)
    sources = views.sources[seen_from]
    for source, camera in enumerate(source_cameras(info)):
        rows = np.flatnonzero(sources == source)
        pixels[rows] = unpacked_pixels(packed[rows], camera)
    return pixels


def _unpacked_densities(kind: DensityKind, arrays: Arrays) -> Densities:
    """Densities of the form ``kind`` from a file's arrays. Raises InvalidMap if these do not fit the form."""
    prefix = _prefix(kind)
    own = {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}
    try:
        return FORMS[kind].from_arrays(own, arrays["landmarks"])
    except ValueError as error:
        raise InvalidMap(f"The map contradicts itself: {error}.", _HINT) from error


def _check_arrays(arrays: Arrays, kinds: Mapping[str, Kind]) -> None:
    """Raise InvalidMap unless a file has all arrays named in ``kinds``, each of its dtype and shape."""
    missing = [name.removeprefix("extras/") for name in kinds if name not in arrays]
    if missing:
        raise InvalidMap(f"The map has no {', '.join(missing)}.", _HINT)
    for name, (kind, shape) in kinds.items():
        array = arrays[name]
        fits = (
            array.dtype == np.dtype(kind)
            and array.ndim == len(shape)
            and all(wanted in (None, length) for wanted, length in zip(shape, array.shape, strict=True))
        )
        if not fits:
            raise InvalidMap(f"The map contradicts itself: {name} is not of the right type and shape.", _HINT)


def _checksum(info: str, arrays: Arrays) -> str:
    """32 hex digits of a hash of the description and of all arrays: names, types, shapes and content."""
    digest = hashlib.blake2b(info.encode(), digest_size=_CHECKSUM_BYTES)
    for name in sorted(arrays):
        array = arrays[name]
        digest.update(f"\0{name}\0{array.dtype.str}\0{array.shape}\0".encode())
        flat: Any = np.ascontiguousarray(array).reshape(-1)
        digest.update(flat.view(np.uint8))  # not a copy: a map may be large
    return digest.hexdigest()
