"""The tables of a map. Each column declares its type and shape once, for selection, concatenation and checks."""

from collections.abc import Sequence
from dataclasses import Field, dataclass, field, fields, replace
from typing import Any, Self

import numpy as np

from rholoc.geometry import BoolArray, ByteArray, FloatArray, IntArray, PosedCameras
from rholoc.maps.walks import walk_numbers

UNKNOWN_GREY = 128  # red, green and blue of landmarks with unknown colour


@dataclass(frozen=True)
class Column:
    """Declaration of a table's column.

    Attributes:
        dtype: of its array; ``object`` for a tuple of Python objects.
        shape: of one row; None is any length.
        optional: whether the whole column may be None.
        unknown: value of an unknown row in an optional column; None if all rows are known or none.
    """

    dtype: type[Any]
    shape: tuple[int | None, ...] = ()
    optional: bool = False
    unknown: Any = None


def _column(dtype: type[Any], *shape: int | None) -> dict[str, Column]:
    """Metadata of a field for a required column."""
    return {"column": Column(dtype, shape)}


def _optional(dtype: type[Any], *shape: int | None, unknown: Any = None) -> dict[str, Column]:
    """Metadata of a field for a column that may be None; ``unknown`` as in :class:`Column`."""
    return {"column": Column(dtype, shape, True, unknown)}


@dataclass(frozen=True, eq=False)
class MapTable:
    """Columns of one length: arrays (N, ...), or tuples (N,); an optional column may be None."""

    def __len__(self) -> int:
        return len(getattr(self, _fields(type(self))[0].name))

    @classmethod
    def columns(cls) -> dict[str, Column]:
        """Column name → declaration."""
        return {one.name: one.metadata["column"] for one in _fields(cls)}

    def take(self, rows: IntArray | BoolArray) -> Self:
        """The selected rows of all columns, by numbers (M,) or a mask (N,)."""
        return replace(self, **{one.name: _taken(getattr(self, one.name), rows) for one in _fields(type(self))})

    @classmethod
    def concat(cls, tables: Sequence[Self]) -> Self:
        """The rows of all tables (at least one), one after the other. A column that no table has is None, and so is one
        that only some have unless it has a value for unknown rows.
        """
        joined = {}
        for name, column in cls.columns().items():
            if column.unknown is None:
                parts = [getattr(table, name) for table in tables]
            else:
                parts = [table.known(name) for table in tables]
            nowhere = all(getattr(table, name) is None for table in tables)
            joined[name] = None if nowhere or any(part is None for part in parts) else _joined(parts)
        return cls(**joined)

    def known(self, name: str) -> Any:
        """An optional column; if it is None, filled with its ``unknown`` value."""
        values, column = getattr(self, name), self.columns()[name]
        if values is not None:
            return values
        if column.dtype is object:
            return (column.unknown,) * len(self)
        return np.full((len(self), *column.shape), column.unknown, dtype=column.dtype)


def _fields(table: type[MapTable]) -> tuple[Field[Any], ...]:
    """The columns of a table as dataclass fields, in order."""
    return fields(table)


def _taken(values: Any, rows: IntArray | BoolArray) -> Any:
    """The rows of a column, by numbers or a mask; None for None."""
    if isinstance(values, tuple):
        return tuple(values[row] for row in np.arange(len(values))[rows].tolist())
    return None if values is None else values[rows]


def _joined(parts: Sequence[Any]) -> Any:
    """One column of the rows of several, all tuples or all arrays."""
    return sum(parts, start=()) if isinstance(parts[0], tuple) else np.concatenate(parts)


@dataclass(frozen=True, eq=False)
class MapLandmarks(MapTable):
    """F features of a map.

    A feature's landmark is m = Λ⁻¹ η, of the information sums Λ = Σ w (I − b bᵀ) and η = Σ w (I − b bᵀ) x over its
    observations (:mod:`rholoc.density.ray`).

    Attributes:
        channels: (F,) uint8, the channel of each feature.
        positions: (F, 3) float32, metres, map frame.
        covariances: (F, 3, 3) float32, m², of the positions.
        colours: (F, 3) uint8, red, green and blue in the pictures; None if they are not known.
        patches: (F, 3) float32, for each feature a vector in the map frame along the orientation of its described
            patch, with the patch's diameter as length [m] (:mod:`rholoc.geometry.patches`); NaN if unknown. None if
            all are unknown.
    """

    channels: ByteArray = field(metadata=_column(np.uint8))
    positions: FloatArray = field(metadata=_column(np.float32, 3))
    covariances: FloatArray = field(metadata=_column(np.float32, 3, 3))
    colours: ByteArray | None = field(default=None, metadata=_optional(np.uint8, 3, unknown=UNKNOWN_GREY))
    patches: FloatArray | None = field(default=None, metadata=_optional(np.float32, 3, unknown=np.nan))

    @property
    def known_colours(self) -> ByteArray:
        """``colours`` (F, 3); mid-grey (128) if None."""
        return np.asarray(self.known("colours"))

    @property
    def known_patches(self) -> FloatArray:
        """``patches`` (F, 3), all NaN if None."""
        return np.asarray(self.known("patches"))


@dataclass(frozen=True, eq=False)
class MapDescriptors(MapTable):
    """D descriptors of a map's features, sorted by feature, of which each has one or more.

    Attributes:
        values: (D, B) uint8.
        features: (D,) int32, the feature that each belongs to.
        sources: (D,) int32, the row of ``info.sources`` that each comes from; None if the map does not keep it.
    """

    values: ByteArray = field(metadata=_column(np.uint8, None))
    features: IntArray = field(metadata=_column(np.int32))
    sources: IntArray | None = field(default=None, metadata=_optional(np.int32))


@dataclass(frozen=True, eq=False)
class MapViews(MapTable, PosedCameras):
    """K views (keyframes) of a map.

    Attributes:
        times: (K,) float64, seconds.
        T_map_camera: (K, 4, 4) float64.
        covariances: (K, 6, 6) float32 of the poses: x, y, z in metres, then a small rotation about the map's axes, from
            the left, in radians; NaN for views whose uncertainty is not known. None if no view's is.
        pictures: (K,) a small JPEG of each, empty for views without one. None if no view has one.
        sources: (K,) int32, the row of ``info.sources`` that each comes from; None if the map does not keep it.
        second_positions: (K, 3) float32, metres, map frame: positions by a second reconstruction that checked the
            map's, NaN where it has none. None if no view has one.
    """

    times: FloatArray = field(metadata=_column(np.float64))
    T_map_camera: FloatArray = field(metadata=_column(np.float64, 4, 4))
    covariances: FloatArray | None = field(default=None, metadata=_optional(np.float32, 6, 6, unknown=np.nan))
    pictures: tuple[bytes, ...] | None = field(default=None, metadata=_optional(object, unknown=b""))
    sources: IntArray | None = field(default=None, metadata=_optional(np.int32))
    second_positions: FloatArray | None = field(default=None, metadata=_optional(np.float32, 3, unknown=np.nan))

    @property
    def known_sources(self) -> IntArray:
        """``sources`` (K,), all 0 if None."""
        return np.zeros(len(self), np.int32) if self.sources is None else self.sources

    @property
    def known_pictures(self) -> tuple[bytes, ...]:
        """``pictures`` (K,), all empty if None."""
        return tuple(self.known("pictures"))

    @property
    def known_covariances(self) -> FloatArray:
        """``covariances`` (K, 6, 6), all NaN if None."""
        return np.asarray(self.known("covariances"))

    @property
    def expected_errors_m(self) -> FloatArray:
        """Expected RMS position error (K,) of each view [m]; NaN if unknown."""
        variances = np.trace(self.known_covariances[:, :3, :3].astype(np.float64), axis1=1, axis2=2)
        return np.asarray(np.sqrt(variances))

    @property
    def walks(self) -> IntArray:
        """Number (K,) of the walk that each view belongs to; see :func:`rholoc.maps.walks.walk_numbers`."""
        return walk_numbers(self.positions, self.known_sources)

    @property
    def by_walk(self) -> list[IntArray]:
        """The rows of the views of each walk."""
        walks = self.walks
        return [np.flatnonzero(walks == number) for number in np.unique(walks)]


@dataclass(frozen=True, eq=False)
class MapObservations(MapTable):
    """V observations of features in views, sorted by view.

    Attributes:
        views: (V,) int32, the view of each, never decreasing.
        features: (V,) int32, its feature.
        pixels: (V, 2) float64, u and v, in whole steps of
            :func:`rholoc.maps.kept_observations.packed_pixels`; None if the map does not keep them.
        ranges_m: (V,) float32, measured distances of the features from the cameras, NaN where unknown; None if all are.
    """

    views: IntArray = field(metadata=_column(np.int32))
    features: IntArray = field(metadata=_column(np.int32))
    pixels: FloatArray | None = field(default=None, metadata=_optional(np.float64, 2))
    ranges_m: FloatArray | None = field(default=None, metadata=_optional(np.float32, unknown=np.nan))
