"""Check a map's arrays: shapes, types, finite values, consistent indices."""

import numpy as np

from rholoc.errors import InvalidMap, RholocError
from rholoc.geometry import FloatArray, IntArray
from rholoc.maps.display import Cloud
from rholoc.maps.floor_plan import FloorPlan, check_plan
from rholoc.maps.kept_observations import memory_fits, memory_of
from rholoc.maps.map import Map
from rholoc.maps.map_tables import MapTable

_ROTATION_TOLERANCE = 1e-3
_COVARIANCE_TOLERANCE = 1e-5  # rounding error of an eigenvalue, relative to the largest
_JPEG = b"\xff\xd8\xff"  # the first bytes of every JPEG
_HINT = "Build it again, or take another copy."


def validate_map(map_: Map) -> None:
    """Check the map's arrays against :class:`rholoc.maps.Map`.

    Raises:
        InvalidMap: an array has another shape or type, holds values that are not finite, or contradicts another.
    """
    for table in (map_.landmarks, map_.descriptors, map_.views, map_.observations):
        _check_table(table)
    landmarks, descriptors, views, observations = map_.landmarks, map_.descriptors, map_.views, map_.observations
    features = len(landmarks)
    _check(
        bool(np.all(np.diagonal(landmarks.covariances, axis1=1, axis2=2) >= 0)), "a landmark has a negative variance"
    )
    _check(_all_in_range(descriptors.features, features), "a descriptor belongs to a feature that is not there")
    _check(bool(np.all(np.diff(descriptors.features) >= 0)), "descriptors are not sorted by feature")
    _check(_all_rotations(views.T_map_camera[:, :3, :3]), "a view's pose is not a rotation and a position")
    _check(_all_in_range(observations.views, len(views)), "an observation is from a view that is not there")
    _check(bool(np.all(np.diff(observations.views) >= 0)), "observations are not sorted by view")
    _check(_all_in_range(observations.features, features), "a view saw a feature that is not there")
    if landmarks.patches is not None:
        _check(_all_patches(landmarks.patches), "its landmarks' patches are not valid")
    for name, cloud in (("cloud", map_.cloud), ("room", map_.room.vertices)):
        _check_cloud(name, cloud, len(map_.info.sources))
    _check_array("room_faces", map_.room.faces, np.int32, (None, 4))
    _check(_all_in_range(map_.room.faces, len(map_.room)), "a face of the room has a vertex that is not there")
    if views.pictures is not None:
        _check(all(one.startswith(_JPEG) for one in views.pictures if one), "a view's picture is not a JPEG")
    _check(bool(map_.plan) == (map_.info.plan is not None), "its floor plan and what it says of it do not fit together")
    if map_.info.plan is not None:
        _check(_is_plan(map_.plan, map_.info.plan), "its floor plan is not one")
    if views.covariances is not None:
        _check(_all_covariances(views.covariances), "its views' covariances are not valid")
    parts = (observations.pixels, views.sources, descriptors.sources)
    if any(part is not None for part in parts):
        memory = memory_of(map_)
        fits = memory is not None and memory_fits(map_, memory)
        _check(fits, "its observations and its recordings do not fit together")
    _check(map_.densities.kind is map_.info.density, "it has densities of another form")
    _check(not (problem := map_.densities.problem(features)), problem)


def _is_plan(content: bytes, plan: FloorPlan) -> bool:
    """Whether a file may be kept as this floor plan (:func:`check_plan`)."""
    try:
        check_plan(content, plan)
    except RholocError:
        return False
    return True


def _check_cloud(name: str, cloud: Cloud, sources: int) -> None:
    """Raise InvalidMap unless a cloud's arrays fit together and its source numbers are below ``sources``."""
    if not len(cloud):
        return
    _check_array(f"{name}_positions", cloud.positions, np.float32, (None, 3))
    _check_array(f"{name}_colours", cloud.colours, np.uint8, (len(cloud), 3))
    _check_array(f"{name}_sources", cloud.sources, np.int32, (len(cloud),))
    _check(_all_in_range(cloud.sources, sources), f"a point of the {name} is from a recording that is not there")


def check_usable(map_: Map) -> None:
    """Check that a camera can be localized in a map.

    Raises:
        InvalidMap: it has no landmarks, no descriptors or no views.
    """
    if not (len(map_) and len(map_.descriptors) and len(map_.views)):
        raise InvalidMap("The map has no landmarks, descriptors or views to localize in.", "Build it from a recording.")


def _check(condition: bool, complaint: str) -> None:
    """Raise InvalidMap with ``complaint`` unless the condition holds."""
    if not condition:
        raise InvalidMap(f"The map contradicts itself: {complaint}.", _HINT)


def _check_table(table: MapTable) -> None:
    """Check a table's columns against their declarations; NaN is allowed where it means unknown. Raises InvalidMap."""
    for name, column in table.columns().items():
        values = getattr(table, name)
        if values is None and column.optional:
            continue
        called = f"{type(table).__name__.removeprefix('Map').lower()}.{name}"
        if column.dtype is object:
            _check(isinstance(values, tuple) and len(values) == len(table), f"{called} has not one entry for each row")
        else:
            _check_array(called, values, column.dtype, (None, *column.shape), nan_allowed=column.unknown is not None)
            _check(len(values) == len(table), f"{called} is not as long as the other columns")


def _check_array(
    name: str, array: object, dtype: type[np.generic], shape: tuple[int | None, ...], nan_allowed: bool = False
) -> None:
    """Raise InvalidMap unless an array has this dtype and shape (None: any length) and is finite, or NaN if allowed."""
    fits = (
        isinstance(array, np.ndarray)
        and array.dtype == dtype
        and len(array.shape) == len(shape)
        and all(wanted is None or wanted == length for wanted, length in zip(shape, array.shape, strict=True))
    )
    _check(fits, f"{name} is not an array of {np.dtype(dtype).name} of the right shape")
    if isinstance(array, np.ndarray) and np.issubdtype(dtype, np.floating):
        allowed = np.isfinite(array) | (np.isnan(array) & nan_allowed)
        _check(bool(allowed.all()), f"{name} has values that are not finite")


def _all_patches(patches: FloatArray) -> bool:
    """Whether each patch (F, 3) is a finite vector with a length, or all NaN."""
    known = patches[~np.isnan(patches).all(axis=1)]
    return bool(np.isfinite(known).all() and known.any(axis=1).all())


def _all_covariances(covariances: FloatArray) -> bool:
    """Whether each covariance (K, 6, 6) is symmetric without negative eigenvalues (but for rounding), or all NaN."""
    known = covariances[~np.isnan(covariances).all(axis=(1, 2))].astype(np.float64)
    if not np.isfinite(known).all() or not np.array_equal(known, known.transpose(0, 2, 1)):
        return False
    least, greatest = np.linalg.eigvalsh(known)[:, [0, -1]].T
    return bool(np.all(least >= -_COVARIANCE_TOLERANCE * greatest))


def _all_in_range(index: IntArray, length: int) -> bool:
    """Whether all indices are from 0 to ``length`` - 1."""
    return bool(np.all((index >= 0) & (index < length)))


def _all_rotations(R: FloatArray) -> bool:
    """Whether all matrices (N, 3, 3) are rotations, to 1e-3."""
    products = R @ np.swapaxes(R, 1, 2)
    return bool(np.all(np.abs(products - np.eye(3)) <= _ROTATION_TOLERANCE) and np.all(np.linalg.det(R) > 0))
