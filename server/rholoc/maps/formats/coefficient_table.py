"""Table 5: a map as CSV, with a descriptor and its density's coefficients in each row.

Columns: ``descriptor`` (hex, two digits of the channel first), the coefficients in the order of equation (3) from
``a_0_0_0_0_0_0_0_0`` to ``a_P_P_P_P_P_P_P_P`` (``tensor``), or from ``a_0_0_0_0_0_0`` to ``a_2_2_2_2_2_2`` (``ray``,
s = (b, x)), and what normalization, the domain and the search for seeds need. A feature with several descriptors, or
seen from several places, has several rows: each of its descriptors and each of its densities is in at least one.
maps/README.md describes every column.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from rholoc.density import Densities, Sightings
from rholoc.density.polynomial import tensor_powers
from rholoc.disk import replace_file
from rholoc.errors import InvalidMap
from rholoc.geometry import FloatArray, IntArray, rows_from_poses
from rholoc.maps.formats.observation_table import descriptor_hex
from rholoc.maps.map import Map
from rholoc.maps.validation import validate_map

LANDMARK_COLUMNS = ("landmark_x", "landmark_y", "landmark_z")
COVARIANCE_COLUMNS = ("cov_xx", "cov_xy", "cov_xz", "cov_yy", "cov_yz", "cov_zz")
MAP_COLUMNS = ("extractor", "metric", "upright", "camera")
VIEW_NUMBERS = 8  # time, x, y, z, qx, qy, qz, qw


def table_columns(form: type[Densities], degree: int) -> list[str]:
    """The names of all columns of a table of this form and degree P, in order."""
    powers = tensor_powers(len(form.variables), degree).tolist()
    coefficients = ["a_" + "_".join(map(str, of_one)) for of_one in powers]
    place = [*form.domain_columns, *LANDMARK_COLUMNS, *COVARIANCE_COLUMNS]
    return ["descriptor", *coefficients, "feature", *place, *MAP_COLUMNS, "seen_from", "row"]


def write_coefficient_table(map_: Map, path: Path) -> None:
    """Write a map as Table 5; an existing file is replaced atomically.

    Numbers read back exactly. Contains features, densities and the views' poses. Leaves out the observations' pixels
    and ranges (for learning), the landmarks' colours and patches, the views' pictures and covariances, cloud, room,
    names, labels, waypoints, floor plan, place on Earth, corrections, sources and report.

    Raises:
        InvalidMap: the map's arrays contradict each other.
        StorageFull: the disk is full; an existing file is unchanged.
        InvalidInput: the folder does not exist or cannot be written to.
    """
    validate_map(map_)
    replace_file(path, (line.encode("ascii") for line in coefficient_table(map_)))


def coefficient_table(map_: Map) -> Iterator[str]:
    """The lines of Table 5, each with its line break, the header first.

    Raises:
        InvalidMap: the map's densities contradict each other, or a feature has no descriptor or density.
    """
    densities = map_.densities
    rows = densities.rows(
        _sightings(map_), np.trace(map_.landmarks.covariances.astype(np.float64), axis1=1, axis2=2) / 3
    )
    pairs = _pairs(map_, rows.features)
    yield ",".join(table_columns(type(densities), densities.degree)) + "\n"
    map_values = ",".join(
        [map_.info.features, str(int(map_.info.metric)), str(int(map_.info.upright)), map_.info.camera.to_line()]
    )
    seen_from = _seen_from(map_)
    written, text = -1, ""
    for row, (feature, descriptor, density) in enumerate(pairs):
        if density != written:
            coefficients = densities.coefficients_of(density, map_.landmarks.positions[feature], rows.domain[density])
            written, text = density, _numbers(coefficients)
        yield ",".join(
            [
                descriptor_hex(int(map_.landmarks.channels[feature]), map_.descriptors.values[descriptor]),
                text,
                str(feature),
                _numbers(rows.domain[density]),
                _numbers(map_.landmarks.positions[feature]),
                _numbers(map_.landmarks.covariances[feature][np.triu_indices(3)]),
                map_values,
                seen_from[feature],
                f"{row + 1}/{len(pairs)}\n",
            ]
        )


def _sightings(map_: Map) -> Sightings:
    """All observations of the map as features and camera positions, without bearings."""
    seen_from = map_.views.positions[map_.observations.views]
    return Sightings(map_.landmarks.positions, map_.observations.features, seen_from)


def _pairs(map_: Map, density_features: IntArray) -> list[tuple[int, int, int]]:
    """Feature, descriptor and density of every row; each descriptor and density of a feature occurs at least once.
    Raises InvalidMap for a feature without one.
    """
    features = np.arange(len(map_) + 1)
    of_descriptors = np.searchsorted(map_.descriptors.features, features)
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
    """The views of each feature: number, time, position and quaternion separated by spaces, views by semicolons."""
    poses = rows_from_poses(map_.views.T_map_camera).astype(np.float32)
    views = [
        f"{k} {float(time)!r} {' '.join(_each(pose))}"
        for k, (time, pose) in enumerate(zip(map_.views.times, poses, strict=True))
    ]
    seen: list[list[str]] = [[] for _ in range(len(map_))]
    for view, feature in zip(map_.observations.views.tolist(), map_.observations.features.tolist(), strict=True):
        seen[feature].append(views[view])
    return [";".join(of_feature) for of_feature in seen]


def _numbers(values: FloatArray) -> str:
    """Numbers (N,) as one text, separated by commas, as :func:`_each` writes them."""
    return ",".join(_each(values))


def _each(values: Any) -> list[str]:
    """Text of each number (N,), with 9 digits if float32, else 17: exact when read back."""
    digits = ".9g" if values.dtype == np.float32 else ".17g"
    return [format(value, digits) for value in values.tolist()]
