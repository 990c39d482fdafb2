"""Table 5: a map as CSV, a descriptor and its density's coefficients a row.

Columns: ``descriptor`` (hex, two digits of the channel first), the coefficients in the order of equation (3) from
``a_0_0_0_0_0_0_0_0`` to ``a_P_P_P_P_P_P_P_P`` (``tensor``), or from ``a_0_0_0_0_0_0`` to ``a_2_2_2_2_2_2`` (``ray``,
s = (b, x)), and those that normalization, the domain and the search for seeds need. A feature with several
descriptors, or seen from several places, has several rows: each of its descriptors and each of its densities stands in
at least one. maps/README.md describes every column.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rholoc.density.polynomial import tensor_powers
from rholoc.density.ray import ray_coefficients
from rholoc.density.tensor import TARGET_RADIUS, VARIABLES
from rholoc.errors import InvalidMap
from rholoc.geometry import Camera, FloatArray, IntArray, rows_from_poses
from rholoc.maps.files import replace_file
from rholoc.maps.info import DensityKind
from rholoc.maps.map import Map
from rholoc.maps.tables import descriptor_hex
from rholoc.maps.validation import validate_map

RAY_VARIABLES = ("bx", "by", "bz", "x", "y", "z")
RAY_DEGREE = 2
DOMAIN_COLUMNS = {
    DensityKind.TENSOR: ("place_x", "place_y", "place_z", "radius"),
    DensityKind.RAY: ("tolerance",),
}
LANDMARK_COLUMNS = ("landmark_x", "landmark_y", "landmark_z")
COVARIANCE_COLUMNS = ("cov_xx", "cov_xy", "cov_xz", "cov_yy", "cov_yz", "cov_zz")
MAP_COLUMNS = ("extractor", "metric", "upright", "camera")
VIEW_NUMBERS = 8  # time, x, y, z, qx, qy, qz, qw


@dataclass(frozen=True, eq=False)
class DensityRows:
    """What the rows of a map's T densities hold.

    Attributes:
        kind: their form.
        degree: P.
        features: (T,) sorted.
        domain: (T, C) float32, the values of the domain's columns.
    """

    kind: DensityKind
    degree: int
    features: IntArray
    domain: FloatArray


def table_columns(kind: DensityKind, degree: int) -> list[str]:
    """The names of all columns, in their order."""
    variables = VARIABLES if kind is DensityKind.TENSOR else RAY_VARIABLES
    coefficients = ["a_" + "_".join(map(str, powers)) for powers in tensor_powers(len(variables), degree).tolist()]
    place = [*DOMAIN_COLUMNS[kind], *LANDMARK_COLUMNS, *COVARIANCE_COLUMNS]
    return ["descriptor", *coefficients, "feature", *place, *MAP_COLUMNS, "seen_from", "row"]


def write_coefficient_table(map_: Map, path: Path) -> None:
    """Write a map as Table 5; a file that was there is replaced whole or not at all.

    Numbers are written so that they read back as they are. Besides what a ``ray`` map needs to be learnt on
    (information sums), its sources and its report, the whole map is in it.

    Raises:
        InvalidMap: the map's arrays contradict each other.
        StorageFull: the disk is full; what was there is unchanged.
        InvalidInput: the folder does not exist or cannot be written to.
    """
    validate_map(map_)
    replace_file(path, (line.encode("ascii") for line in coefficient_table(map_)))


def coefficient_table(map_: Map) -> Iterator[str]:
    """The lines of Table 5, each with its line break, the header first.

    Raises:
        InvalidMap: the map's densities contradict each other, or a feature has no descriptor or density.
    """
    tensors = map_.fitted
    densities = _density_rows(map_)
    pairs = _pairs(map_, densities.features)
    yield ",".join(table_columns(densities.kind, densities.degree)) + "\n"
    map_values = ",".join(
        [map_.info.features, str(int(map_.info.metric)), str(int(map_.info.upright)), camera_text(map_.info.camera)]
    )
    seen_from = _seen_from(map_)
    written, text = -1, ""
    for row, (feature, descriptor, density) in enumerate(pairs):
        if density != written:
            coefficients: FloatArray
            if tensors is not None:
                coefficients = tensors.all_coefficients(np.array([density]))[0]
            else:
                coefficients = ray_coefficients(
                    map_.landmarks[feature : feature + 1].astype(np.float64),
                    densities.domain[density].astype(np.float64),
                )[0]
            written, text = density, _numbers(coefficients)
        yield ",".join(
            [
                descriptor_hex(int(map_.channels[feature]), map_.descriptors[descriptor]),
                text,
                str(feature),
                _numbers(densities.domain[density]),
                _numbers(map_.landmarks[feature]),
                _numbers(map_.covariances[feature][np.triu_indices(3)]),
                map_values,
                seen_from[feature],
                f"{row + 1}/{len(pairs)}\n",
            ]
        )


def camera_text(camera: Camera) -> str:
    """``width height fx fy cx cy`` and the distortion, with blanks between."""
    values = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion)
    return " ".join(repr(value) for value in values)


def _density_rows(map_: Map) -> DensityRows:
    if map_.fitted is not None:
        domain = np.column_stack([map_.fitted.places, map_.fitted.radii]).astype(np.float32)
        return DensityRows(DensityKind.TENSOR, map_.fitted.degree, map_.fitted.features, domain)
    return DensityRows(DensityKind.RAY, RAY_DEGREE, np.arange(len(map_)), _tolerances(map_)[:, None])


def _tolerances(map_: Map) -> FloatArray:
    """r (F,) float32 of the ``ray`` densities: 60 px, as ``tensor``'s, at the mean distance a feature was seen from."""
    seen = map_.observation_features
    away = np.linalg.norm(map_.view_positions[map_.observation_views] - map_.landmarks[seen], axis=1)
    count = np.bincount(seen, minlength=len(map_))
    total = np.bincount(seen, weights=away, minlength=len(map_))
    distance = np.where(count > 0, total / np.maximum(count, 1), 1.0)
    variance = np.trace(map_.covariances.astype(np.float64), axis1=1, axis2=2) / 3
    return np.asarray(np.sqrt((TARGET_RADIUS * distance) ** 2 + variance), dtype=np.float32)


def _pairs(map_: Map, density_features: IntArray) -> list[tuple[int, int, int]]:
    """Feature, descriptor and density of every row: each descriptor and each density of a feature at least once."""
    features = np.arange(len(map_) + 1)
    of_descriptors = np.searchsorted(map_.descriptor_features, features)
    of_densities = np.searchsorted(density_features, features)
    pairs = []
    for feature in range(len(map_)):
        first, second = int(of_descriptors[feature]), int(of_densities[feature])
        descriptors = int(of_descriptors[feature + 1]) - first
        densities = int(of_densities[feature + 1]) - second
        if descriptors == 0 or densities == 0:
            raise InvalidMap(f"Feature {feature} has no descriptor or no density.", "Build the map again.")
        pairs += [
            (feature, first + i % descriptors, second + i % densities) for i in range(max(descriptors, densities))
        ]
    return pairs


def _seen_from(map_: Map) -> list[str]:
    """The views of each feature: number, time, position and quaternion, blanks between, semicolons between views."""
    poses = rows_from_poses(map_.T_map_camera).astype(np.float32)
    views = [
        f"{k} {float(time)!r} {' '.join(_each(pose))}"
        for k, (time, pose) in enumerate(zip(map_.view_times, poses, strict=True))
    ]
    seen: list[list[str]] = [[] for _ in range(len(map_))]
    for view, feature in zip(map_.observation_views.tolist(), map_.observation_features.tolist(), strict=True):
        seen[feature].append(views[view])
    return [";".join(of_feature) for of_feature in seen]


def _numbers(values: FloatArray) -> str:
    return ",".join(_each(values))


def _each(values: Any) -> list[str]:
    digits = ".9g" if values.dtype == np.float32 else ".17g"
    return [format(value, digits) for value in values.tolist()]
