"""What makes arrays a map: shapes, types, finite values and indices that agree."""

from __future__ import annotations

import numpy as np

from rholoc.errors import InvalidMap
from rholoc.geometry import FloatArray, IntArray
from rholoc.maps.map import Map

_QUATERNION_TOLERANCE = 1e-3

# name: dtype and the shape's known part; None is any length
_ARRAYS: dict[str, tuple[type[np.generic], tuple[int | None, ...]]] = {
    "channels": (np.uint8, (None,)),
    "landmarks": (np.float32, (None, 3)),
    "covariances": (np.float32, (None, 6)),
    "descriptors": (np.uint8, (None, None)),
    "descriptor_features": (np.int32, (None,)),
    "view_times": (np.float64, (None,)),
    "view_poses": (np.float32, (None, 7)),
    "view_offsets": (np.int32, (None,)),
    "view_features": (np.int32, (None,)),
}
ARRAY_NAMES = tuple(_ARRAYS)


def validate_map(map_: Map) -> None:
    """Check that the map's arrays are what :class:`rholoc.maps.Map` says.

    Raises:
        InvalidMap: an array has another shape or type, holds values that are not finite, or contradicts another.
    """
    for name, (dtype, shape) in _ARRAYS.items():
        _check_array(name, getattr(map_, name), dtype, shape)
    features, views = len(map_.landmarks), len(map_.view_times)
    _check(len(map_.channels) == features, "channels and landmarks differ in number")
    _check(len(map_.covariances) == features, "covariances and landmarks differ in number")
    _check(bool(np.all(map_.covariances[:, [0, 3, 5]] >= 0)), "a landmark has a negative variance")
    _check(len(map_.descriptors) == len(map_.descriptor_features), "descriptors and their features differ in number")
    _check(_all_in_range(map_.descriptor_features, features), "a descriptor belongs to a feature that is not there")
    _check(bool(np.all(np.diff(map_.descriptor_features) >= 0)), "descriptors are not sorted by feature")
    _check(len(map_.view_poses) == views, "view poses and times differ in number")
    _check(_all_unit(map_.view_poses[:, 3:]), "a view's quaternion is not of unit length")
    _check(_is_partition(map_.view_offsets, views, len(map_.view_features)), "the views' lists of features are broken")
    _check(_all_in_range(map_.view_features, features), "a view saw a feature that is not there")


def _check(condition: bool, complaint: str) -> None:
    if not condition:
        raise InvalidMap(f"The map contradicts itself: {complaint}.", "Build it again, or take another copy.")


def _check_array(name: str, array: object, dtype: type[np.generic], shape: tuple[int | None, ...]) -> None:
    fits = (
        isinstance(array, np.ndarray)
        and array.dtype == dtype
        and len(array.shape) == len(shape)
        and all(wanted is None or wanted == length for wanted, length in zip(shape, array.shape, strict=True))
    )
    _check(fits, f"{name} is not an array of {np.dtype(dtype).name} of the right shape")
    if isinstance(array, np.ndarray) and np.issubdtype(dtype, np.floating):
        _check(bool(np.isfinite(array).all()), f"{name} has values that are not finite")


def _all_in_range(index: IntArray, length: int) -> bool:
    return bool(np.all((index >= 0) & (index < length)))


def _all_unit(quaternions: FloatArray) -> bool:
    return bool(np.all(np.abs(np.linalg.norm(quaternions, axis=1) - 1) <= _QUATERNION_TOLERANCE))


def _is_partition(offsets: IntArray, parts: int, total: int) -> bool:
    return bool(
        len(offsets) == parts + 1 and offsets[0] == 0 and offsets[-1] == total and np.all(np.diff(offsets) >= 0)
    )
