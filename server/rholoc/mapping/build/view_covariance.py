"""Covariances of a map's view poses: when built, when learning, and when moved."""

import numpy as np

from rholoc.geometry import FloatArray
from rholoc.localization.index.map_error import map_covariance_at
from rholoc.maps import Map
from rholoc.reports import ExpectedError

_NEAREST = 10  # views of a map that say how uncertain it is at a place
_NEAR_M = 0.1  # closer than this, a view is not nearer than another


def storable_covariances(covariances: FloatArray) -> FloatArray:
    """Covariances (K, 6, 6) as stored: symmetric float32, all NaN if a number is not finite."""
    symmetric = ((covariances + covariances.transpose(0, 2, 1)) / 2).astype(np.float32)
    symmetric[~np.isfinite(symmetric).all(axis=(1, 2))] = np.nan
    return symmetric


def uncertainty_in(
    map_: Map, T_map_camera: FloatArray, residual_m: float = 0.0, residual_rad: float = 0.0
) -> FloatArray:
    """Covariances (K, 6, 6) float32 of poses (K, 4, 4) that were localized in a map.

    The map's own covariance at each pose, the mean of the ten nearest views' by inverse squared distance, plus
    ``residual_m`` and ``residual_rad``, the standard deviations per axis of the poses relative to the map. NaN if the
    map has no covariances.
    """
    covariances, positions = map_.views.known_covariances.astype(np.float64), map_.views.positions
    own = np.diag([residual_m**2] * 3 + [residual_rad**2] * 3)
    found = np.full((len(T_map_camera), 6, 6), np.nan)
    for k, at in enumerate(T_map_camera[:, :3, 3]):
        distances = np.linalg.norm(positions - at, axis=1)
        nearest = np.argsort(distances, kind="stable")[:_NEAREST]
        weights = 1 / np.maximum(distances[nearest], _NEAR_M) ** 2
        of_map = map_covariance_at(covariances[nearest], positions[nearest], weights, at)
        if of_map is not None:
            found[k] = of_map + own
    return storable_covariances(found)


def expected_error(map_: Map) -> ExpectedError | None:
    """Expected errors of a map's views: root mean square, worst with its time, and all. None if no view's is known."""
    errors_m = map_.views.expected_errors_m
    known = np.flatnonzero(np.isfinite(errors_m))
    if len(known) == 0:
        return None
    worst = int(known[np.argmax(errors_m[known])])
    return ExpectedError(
        rms_m=float(np.sqrt(np.mean(errors_m[known] ** 2))),
        worst_m=float(errors_m[worst]),
        worst_time_s=float(map_.views.times[worst]),
        views_m=tuple(round(float(error), 5) if np.isfinite(error) else None for error in errors_m),
    )
