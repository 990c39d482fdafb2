"""``.rho``: the native map file, a safetensors file with the arrays of :class:`rholoc.maps.Map`.

Its metadata holds ``format``, ``format_version``, ``info`` (JSON) and ``checksum``: BLAKE2b over the info and all
arrays. There is no code in it, and nothing is unpickled.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from rholoc.errors import InvalidMap, UnknownMap
from rholoc.maps.files import replace_file
from rholoc.maps.info_json import info_from_json, info_to_json
from rholoc.maps.map import Map
from rholoc.maps.validation import ARRAY_NAMES, validate_map

SUFFIX = ".rho"
FORMAT = "rholoc-map"
FORMAT_VERSION = 1

_EXTRAS = "extras/"
_CHECKSUM_BYTES = 16
_EXTRA_KINDS = "biuf"  # bool, integers, floats
_HINT = "Take another copy, or build the map again."


def save_map(map_: Map, path: Path) -> None:
    """Write a map; a file that was there is replaced whole or not at all.

    Raises:
        InvalidMap: the map's arrays contradict each other.
        StorageFull: the disk is full; what was there is unchanged.
        InvalidInput: the folder does not exist or cannot be written to.
    """
    replace_file(path, map_to_bytes(map_))


def map_to_bytes(map_: Map) -> bytes:
    """A map → the content of its ``.rho`` file.

    Raises:
        InvalidMap: the map's arrays contradict each other.
    """
    validate_map(map_)
    arrays = {name: _storable(name, getattr(map_, name)) for name in ARRAY_NAMES}
    arrays |= {_EXTRAS + name: _storable(name, array) for name, array in map_.extras.items()}
    info = info_to_json(map_.info)
    metadata = {
        "format": FORMAT,
        "format_version": str(FORMAT_VERSION),
        "info": info,
        "checksum": _checksum(info, arrays),
    }
    return bytes(save(arrays, metadata))


def load_map(path: Path, called: str | None = None) -> Map:
    """Read a map. The file is mapped while it is read and not needed afterwards, so it may be overwritten at any time.

    Args:
        path: the file.
        called: what errors call it, if not by its own name.

    Raises:
        UnknownMap: there is no such file.
        InvalidMap: the file is corrupt, truncated, of a later version, or not a map.
    """
    if not path.is_file():
        raise UnknownMap(f"There is no map {path}.", "Check the path.")
    called = called or path.name
    try:
        with safe_open(path, framework="numpy") as file:
            metadata = file.metadata() or {}
            _check_format(called, metadata)
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise InvalidMap(f"{called} is corrupt, truncated, or not a map: {error}.", _HINT) from error
    info = metadata.get("info", "")
    if metadata.get("checksum") != _checksum(info, arrays):
        raise InvalidMap(f"{called} is corrupt: its checksum does not match its content.", _HINT)
    missing = [name for name in ARRAY_NAMES if name not in arrays]
    if missing:
        raise InvalidMap(f"{called} has no {', '.join(missing)}.", _HINT)
    map_ = Map(
        info=info_from_json(info),
        **{name: arrays[name] for name in ARRAY_NAMES},
        extras={name.removeprefix(_EXTRAS): array for name, array in arrays.items() if name.startswith(_EXTRAS)},
    )
    validate_map(map_)
    return map_


def _check_format(called: str, metadata: Mapping[str, str]) -> None:
    if metadata.get("format") != FORMAT:
        raise InvalidMap(f"{called} is not a map of rholoc.", "Give a .rho file.")
    version = metadata.get("format_version", "")
    if version != str(FORMAT_VERSION):
        raise InvalidMap(
            f"{called} is of format version {version}; this rholoc reads {FORMAT_VERSION}.", "Update rholoc."
        )


def _storable(name: str, array: Any) -> np.ndarray[Any, np.dtype[Any]]:
    """The array in C order and little-endian, which is how safetensors takes it to be."""
    array = np.asarray(array)
    if array.dtype.kind not in _EXTRA_KINDS or array.dtype.itemsize > 8:
        raise InvalidMap(f"The array {name} is of {array.dtype}, which a map file cannot hold.")
    return np.asarray(array, dtype=array.dtype.newbyteorder("<"), order="C")


def _checksum(info: str, arrays: Mapping[str, np.ndarray[Any, np.dtype[Any]]]) -> str:
    digest = hashlib.blake2b(info.encode(), digest_size=_CHECKSUM_BYTES)
    for name in sorted(arrays):
        array = arrays[name]
        digest.update(f"\0{name}\0{array.dtype.str}\0{array.shape}\0".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
