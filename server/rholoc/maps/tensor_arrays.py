"""The arrays that a map with ``tensor`` densities has besides those of every map.

``Map.extras`` holds ``tensor_degree`` () int32, ``tensor_coefficients`` (T, U, X, H) float32, ``tensor_features`` (T,)
int32, sorted, the feature of each density, ``tensor_places`` (T, 3) float32 and ``tensor_radii`` (T,) float32, metres.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from rholoc.density.tensor import DEGREES, TensorDensities, kept_powers
from rholoc.errors import InvalidMap
from rholoc.geometry import IntArray
from rholoc.maps.map import DensityKind, Map

_NAMES = ("tensor_degree", "tensor_coefficients", "tensor_features", "tensor_places", "tensor_radii")
_HINT = "Build it again, or take another copy."


def with_tensors(map_: Map, densities: TensorDensities, features: IntArray) -> Map:
    """The map with ``tensor`` densities, those of ``features`` (T,), which are sorted."""
    extras: dict[str, Any] = {
        "tensor_degree": np.array(densities.degree, dtype=np.int32),
        "tensor_coefficients": densities.coefficients.astype(np.float32),
        "tensor_features": features.astype(np.int32),
        "tensor_places": densities.places.astype(np.float32),
        "tensor_radii": densities.radii.astype(np.float32),
    }
    return replace(map_, info=replace(map_.info, density=DensityKind.TENSOR), extras=map_.extras | extras)


def tensors_of(map_: Map) -> tuple[TensorDensities, IntArray]:
    """The ``tensor`` densities of a map, T of them, and the feature (T,) of each.

    Raises:
        InvalidMap: the map says that it has such densities, but its arrays are missing or contradict each other.
    """
    missing = [name for name in _NAMES if name not in map_.extras]
    if missing:
        raise InvalidMap(f"The map has no {', '.join(missing)}.", _HINT)
    degree, coefficients, features, places, radii = (np.asarray(map_.extras[name]) for name in _NAMES)
    count = len(features) if features.ndim == 1 else -1
    if degree.ndim or int(degree) not in DEGREES:
        raise InvalidMap("The map's densities have an impossible degree.", _HINT)
    sizes = tuple(len(powers) for powers in kept_powers(int(degree)))
    whole = (
        coefficients.shape == (count, *sizes)
        and places.shape == (count, 3)
        and radii.shape == (count,)
        and features.dtype.kind in "iu"
        and all(bool(np.isfinite(array).all()) for array in (coefficients, places, radii))
        and bool(np.all((features >= 0) & (features < len(map_))) and np.all(np.diff(features) >= 0))
        and bool(np.all(radii > 0))
    )
    if not whole:
        raise InvalidMap("The map's densities contradict each other.", _HINT)
    owners = features.astype(np.int64)
    landmarks = map_.landmarks[owners].astype(np.float64)
    if bool((np.linalg.norm(landmarks - places, axis=1) <= 0).any()):
        raise InvalidMap("A density's place is its landmark.", _HINT)
    return (
        TensorDensities(int(degree), coefficients, landmarks, places.astype(np.float64), radii.astype(np.float64)),
        owners,
    )
