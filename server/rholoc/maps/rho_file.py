"""``.rho``: the native map file, a safetensors file with the arrays of :class:`rholoc.maps.Map`, packed.

Its metadata holds ``format``, ``format_version``, ``info`` (JSON) and ``checksum``: BLAKE2b over the info and all
arrays. It contains no code, and nothing is unpickled. maps/README.md describes every array.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from rholoc.density import FORMS, Densities, DensityKind
from rholoc.errors import InvalidMap, UnknownMap
from rholoc.geometry import FloatArray, IntArray, poses_from_rows, rows_from_poses
from rholoc.maps.cloud import Cloud
from rholoc.maps.files import replace_file
from rholoc.maps.info import MapInfo, info_from_json, info_to_json
from rholoc.maps.map import Map
from rholoc.maps.observations import Observations, packed_pixels, source_cameras, unpacked_pixels
from rholoc.maps.patches import packed_patches, unpacked_patches
from rholoc.maps.validation import validate_map

SUFFIX = ".rho"
FORMAT = "rholoc-map"
FORMAT_VERSION = 2
_READ_VERSIONS = ("1", "2")  # 1 has all indices as int32

_CHECKSUM_BYTES = 16
_HINT = "Take another copy, or build the map again."
_UPPER = np.triu_indices(3)
_UPPER_OF_POSE = np.triu_indices(6)
_UNIT_TOLERANCE = 1e-3  # of a stored quaternion's length

# name: kind of number, and the shape's known part; None is any length
_ARRAYS: dict[str, tuple[str, tuple[int | None, ...]]] = {
    "channels": ("u1", (None,)),
    "landmarks": ("f4", (None, 3)),
    "covariances": ("f4", (None, 6)),  # xx, xy, xz, yy, yz, zz
    "descriptors": ("u1", (None, None)),
    "descriptor_features": ("i4", (None,)),
    "view_times": ("f8", (None,)),
    "view_poses": ("f4", (None, 7)),  # x, y, z and the quaternion x, y, z, w
    "view_offsets": ("i4", (None,)),
    "view_features": ("i4", (None,)),
}
_VIEW_COVARIANCES: dict[str, tuple[str, tuple[int | None, ...]]] = {
    "view_covariances": ("f4", (None, 21)),  # the upper triangle, row by row; older files have none
}
_COLOURS: dict[str, tuple[str, tuple[int | None, ...]]] = {
    "colours": ("u1", (None, 3)),  # red, green, blue; older files have none
}
_PATCHES: dict[str, tuple[str, tuple[int | None, ...]]] = {
    "patches": ("i1", (None, 3)),  # as :mod:`rholoc.maps.patches` packs them; older files have none
}
_CLOUD: dict[str, tuple[str, tuple[int | None, ...]]] = {
    "cloud_positions": ("f4", (None, 3)),
    "cloud_colours": ("u1", (None, 3)),
    "cloud_sources": ("i4", (None,)),
}
_PICTURES: dict[str, tuple[str, tuple[int | None, ...]]] = {
    "picture_bytes": ("u1", (None,)),  # one JPEG after the other
    "picture_offsets": ("i8", (None,)),
}
_PLAN: dict[str, tuple[str, tuple[int | None, ...]]] = {
    "plan_bytes": ("u1", (None,)),
}
_OBSERVATIONS: dict[str, tuple[str, tuple[int | None, ...]]] = {
    "extras/observation_pixels": ("u2", (None, 2)),
    "extras/view_sources": ("i4", (None,)),
    "extras/descriptor_sources": ("i4", (None,)),
}
# int32 in memory; in a file of the smallest type that holds them
_INDICES = (
    "descriptor_features",
    "view_offsets",
    "view_features",
    "cloud_sources",
    "extras/view_sources",
    "extras/descriptor_sources",
)
Arrays = dict[str, NDArray[Any]]


def save_map(map_: Map, path: Path) -> None:
    """Write a map; an existing file is replaced atomically.

    Raises:
        InvalidMap: the map's arrays contradict each other.
        StorageFull: the disk is full; an existing file is unchanged.
        InvalidInput: the folder does not exist or cannot be written to.
    """
    replace_file(path, map_to_bytes(map_))


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


def load_map(path: Path, called: str | None = None) -> Map:
    """Read a map. The file is memory-mapped while it is read and not needed afterwards: it may be overwritten any time.

    Args:
        path: the file.
        called: what error messages call it, by default its name.

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
    try:
        map_ = _unpacked(info_from_json(info), _widened(arrays))
        validate_map(map_)
    except InvalidMap as error:
        raise InvalidMap(f"{called}: {error.message}", error.hint or _HINT) from error
    return map_


def load_info(path: Path) -> MapInfo:
    """The description in a map's file, without its arrays.

    Raises:
        InvalidMap: it is not a map, or cannot be read.
    """
    try:
        with safe_open(path, framework="numpy") as file:
            metadata = file.metadata() or {}
    except (SafetensorError, OSError, ValueError) as error:
        raise InvalidMap(f"{path.name} is corrupt, truncated, or not a map: {error}.", _HINT) from error
    _check_format(path.name, metadata)
    return info_from_json(metadata.get("info", ""))


def _check_format(called: str, metadata: Mapping[str, str]) -> None:
    if metadata.get("format") != FORMAT:
        raise InvalidMap(f"{called} is not a rholoc map.", "Give a .rho file.")
    version = metadata.get("format_version", "")
    if version not in _READ_VERSIONS:
        raise InvalidMap(
            f"{called} has format version {version}; this rholoc reads up to {FORMAT_VERSION}.", "Update rholoc."
        )


def _packed(map_: Map) -> Arrays:
    """The arrays of a map's file, in C order and little-endian, as safetensors expects them."""
    arrays: dict[str, Any] = {
        "channels": map_.channels,
        "landmarks": map_.landmarks,
        "covariances": map_.covariances[:, _UPPER[0], _UPPER[1]],
        "descriptors": map_.descriptors,
        "descriptor_features": map_.descriptor_features,
        "view_times": map_.view_times,
        "view_poses": rows_from_poses(map_.T_map_camera),
        "view_offsets": map_.view_offsets,
        "view_features": map_.observation_features,
    }
    if map_.view_covariances is not None:
        arrays["view_covariances"] = map_.view_covariances[:, _UPPER_OF_POSE[0], _UPPER_OF_POSE[1]]
    if map_.colours is not None:
        arrays["colours"] = map_.colours
    if map_.patches is not None:
        arrays["patches"] = packed_patches(map_.patches)
    if len(map_.cloud):
        arrays |= {
            "cloud_positions": map_.cloud.positions,
            "cloud_colours": map_.cloud.colours,
            "cloud_sources": map_.cloud.sources,
        }
    if map_.pictures is not None:
        ends = np.cumsum([len(picture) for picture in map_.pictures], dtype=np.int64)
        arrays |= {
            "picture_bytes": np.frombuffer(b"".join(map_.pictures), dtype=np.uint8),
            "picture_offsets": np.concatenate([[0], ends]),
        }
    if map_.plan:
        arrays["plan_bytes"] = np.frombuffer(map_.plan, dtype=np.uint8)
    if map_.observations is not None:
        arrays |= {
            "extras/observation_pixels": _packed_pixels(map_, map_.observations),
            "extras/view_sources": map_.observations.view_sources,
            "extras/descriptor_sources": map_.observations.descriptor_sources,
        }
    kinds = _ARRAYS | _VIEW_COVARIANCES | _COLOURS | _PATCHES | _CLOUD | _PICTURES | _PLAN | _OBSERVATIONS
    packed = {name: np.asarray(array, dtype=f"<{kinds[name][0]}", order="C") for name, array in arrays.items()}
    for name, array in map_.densities.arrays().items():
        little_endian = array.dtype.newbyteorder("<")
        packed[_prefix(map_.info.density) + name] = np.asarray(array, dtype=little_endian, order="C")
    return packed | {name: _narrowed(packed[name]) for name in _INDICES if name in packed}


def _narrowed(indices: IntArray) -> IntArray:
    """Indices, none of them negative, as the smallest of uint8, uint16 and int32 that holds them all."""
    greatest = indices.max(initial=0)
    fitting = (kind for kind in ("<u1", "<u2") if greatest <= np.iinfo(kind).max)
    return indices.astype(next(fitting, "<i4"))


def _widened(arrays: Arrays) -> Arrays:
    """A file's arrays with those indices as int32 that were narrowed."""
    narrow = (name for name in _INDICES if name in arrays and arrays[name].dtype in (np.uint8, np.uint16))
    return arrays | {name: arrays[name].astype(np.int32) for name in narrow}


def _prefix(kind: DensityKind) -> str:
    """What the names of a form's arrays begin with."""
    return f"extras/{kind.value}_"


def _unpacked(info: MapInfo, arrays: Arrays) -> Map:
    """The map of a file's arrays; unknown arrays are ignored.

    Raises:
        InvalidMap: one is missing, of another type or shape, or contradicts another in length.
    """
    _check_arrays(arrays, _ARRAYS)
    if "colours" in arrays:
        _check_arrays(arrays, _COLOURS)
    map_ = Map(
        info=info,
        channels=arrays["channels"],
        landmarks=arrays["landmarks"],
        covariances=unpacked_covariances(arrays["covariances"]),
        descriptors=arrays["descriptors"],
        descriptor_features=arrays["descriptor_features"],
        view_times=arrays["view_times"],
        T_map_camera=unpacked_poses(arrays["view_poses"]),
        observation_views=_views_of(arrays["view_offsets"], len(arrays["view_times"]), len(arrays["view_features"])),
        observation_features=arrays["view_features"],
        view_covariances=_unpacked_view_covariances(arrays),
        colours=arrays.get("colours"),
        patches=_unpacked_patches(arrays),
        cloud=_unpacked_cloud(arrays),
        pictures=_unpacked_pictures(arrays, len(arrays["view_times"])),
        plan=_unpacked_plan(arrays),
        densities=_unpacked_densities(info.density, arrays),
        observations=None,
    )
    if not _OBSERVATIONS.keys() <= arrays.keys():
        return map_
    _check_arrays(arrays, _OBSERVATIONS)
    return replace(map_, observations=_unpacked_observations(map_, arrays))


def unpacked_covariances(rows: FloatArray) -> FloatArray:
    """Rows (F, 6) of xx, xy, xz, yy, yz, zz → covariances (F, 3, 3) float32."""
    covariances = np.zeros((len(rows), 3, 3), dtype=np.float32)
    covariances[:, _UPPER[0], _UPPER[1]] = rows
    covariances[:, _UPPER[1], _UPPER[0]] = rows
    return covariances


def _unpacked_view_covariances(arrays: Arrays) -> FloatArray | None:
    if "view_covariances" not in arrays:
        return None
    _check_arrays(arrays, _VIEW_COVARIANCES)
    rows = arrays["view_covariances"]
    covariances = np.zeros((len(rows), 6, 6), dtype=np.float32)
    covariances[:, _UPPER_OF_POSE[0], _UPPER_OF_POSE[1]] = rows
    covariances[:, _UPPER_OF_POSE[1], _UPPER_OF_POSE[0]] = rows
    return covariances


def _unpacked_patches(arrays: Arrays) -> FloatArray | None:
    if "patches" not in arrays:
        return None
    _check_arrays(arrays, _PATCHES)
    return unpacked_patches(arrays["patches"])


def _unpacked_cloud(arrays: Arrays) -> Cloud:
    if _CLOUD.keys().isdisjoint(arrays):
        return Cloud()
    _check_arrays(arrays, _CLOUD)
    return Cloud(arrays["cloud_positions"], arrays["cloud_colours"], arrays["cloud_sources"])


def _unpacked_pictures(arrays: Arrays, views: int) -> tuple[bytes, ...] | None:
    """The picture (K,) of each view.

    Raises:
        InvalidMap: there are not as many as views, or their offsets are broken.
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
    if "plan_bytes" not in arrays:
        return b""
    _check_arrays(arrays, _PLAN)
    return bytes(arrays["plan_bytes"].tobytes())


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


def _views_of(offsets: IntArray, views: int, observations: int) -> IntArray:
    """The view (V,) of each observation, from the offsets (K + 1,) of the views' lists."""
    parts = np.diff(offsets)
    if not (len(offsets) == views + 1 and offsets[0] == 0 and offsets[-1] == observations and np.all(parts >= 0)):
        raise InvalidMap("The map contradicts itself: the views' lists of features are broken.", _HINT)
    return np.repeat(np.arange(views, dtype=np.int32), parts)


def _packed_pixels(map_: Map, observations: Observations) -> IntArray:
    packed = np.zeros(observations.pixels.shape, dtype=np.uint16)
    sources = observations.view_sources[map_.observation_views]
    for source, camera in enumerate(source_cameras(map_)):
        rows = np.flatnonzero(sources == source)
        packed[rows] = packed_pixels(observations.pixels[rows], camera)
    return packed


def _unpacked_observations(map_: Map, arrays: Arrays) -> Observations:
    packed, view_sources = arrays["extras/observation_pixels"], arrays["extras/view_sources"]
    if len(packed) != len(map_.observation_views) or len(view_sources) != len(map_.view_times):
        raise InvalidMap("The map contradicts itself: its arrays of observations differ in length.", _HINT)
    pixels = np.zeros(packed.shape)
    sources = view_sources[map_.observation_views]
    for source, camera in enumerate(source_cameras(map_)):
        rows = np.flatnonzero(sources == source)
        pixels[rows] = unpacked_pixels(packed[rows], camera)
    return Observations(pixels, view_sources, arrays["extras/descriptor_sources"])


def _unpacked_densities(kind: DensityKind, arrays: Arrays) -> Densities:
    prefix = _prefix(kind)
    own = {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}
    try:
        return FORMS[kind].from_arrays(own, arrays["landmarks"])
    except ValueError as error:
        raise InvalidMap(f"The map contradicts itself: {error}.", _HINT) from error


def _check_arrays(arrays: Arrays, kinds: Mapping[str, tuple[str, tuple[int | None, ...]]]) -> None:
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
    digest = hashlib.blake2b(info.encode(), digest_size=_CHECKSUM_BYTES)
    for name in sorted(arrays):
        array = arrays[name]
        digest.update(f"\0{name}\0{array.dtype.str}\0{array.shape}\0".encode())
        flat: Any = np.ascontiguousarray(array).reshape(-1)
        digest.update(flat.view(np.uint8))  # not a copy: a map may be large
    return digest.hexdigest()
