"""Which of many maps? Retrieval over the views of all maps: short vectors in an inverted file.

A view takes 272 bytes, regardless of its map's size. A search probes a quarter of the lists. Probing fewer lists loses
the right map: a picture also shows things that are not landmarks, so its vector often falls into another list than the
vectors of similar views.
"""

from __future__ import annotations

import threading
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace

import faiss
import numpy as np
from numpy.typing import NDArray

from rholoc.features.picture_vectors import DIMENSIONS, PictureVectors
from rholoc.geometry import ByteArray, FloatArray, IntArray
from rholoc.maps import Map

MAX_VECTORS = 1000
"""Of one map: of a larger one some views are taken, evenly."""

_FEW = 5000  # vectors, below which all are compared
_TRAINING_PER_LIST = 40
_PROBED_SHARE, _MIN_PROBED = 1 / 4, 8  # of the lists
_LIKELY_VIEWS = 200
_VIEWS_THAT_COUNT = 5  # of a map
_GROWTH = 4  # times as many vectors as the lists were made for: they are made anew
_DEAD_SHARE = 1 / 3
_ITERATIONS = 8
_STEPS = 254.0  # of a number's size: it is kept to a 254th, up to a half
_SEED = 1


@dataclass(frozen=True)
class LikelyMap:
    """A map in which a picture may have been taken.

    Attributes:
        name: name of the map.
        score: similarity of its views to the picture, 0 to 1; comparable between maps of one index.
    """

    name: str
    score: float


def view_descriptors(map_: Map) -> list[ByteArray]:
    """First descriptors (N, B) of the landmarks that each view saw, a list entry for each view in order; of more than
    ``MAX_VECTORS`` views, so many evenly spaced ones.
    """
    first = np.searchsorted(map_.descriptors.features, np.arange(len(map_)))
    views = np.arange(len(map_.views))
    if len(views) > MAX_VECTORS:
        views = np.linspace(0, len(views) - 1, MAX_VECTORS).astype(np.int64)
    start, end = map_.view_offsets[views].tolist(), map_.view_offsets[views + 1].tolist()
    return [map_.descriptors.values[first[map_.observations.features[a:b]]] for a, b in zip(start, end, strict=True)]


class ViewIndex:
    """Index of the views of all maps with one kind of features. Thread-safe.

    Args:
        pictures: model that turns a picture's descriptors into a vector.
    """

    def __init__(self, pictures: PictureVectors) -> None:
        self.pictures = pictures
        self._changing = threading.Lock()
        self._using = threading.Lock()  # of what is held; never for longer than a map takes to be added
        self._held = _Held.of(np.zeros((0, DIMENSIONS), np.float32), (), np.zeros(0, np.int32))

    def __len__(self) -> int:
        return int(np.count_nonzero(self._held.owners >= 0))

    @property
    def names(self) -> set[str]:
        """Names of the maps in the index."""
        held = self._held
        return {held.maps[number] for number in np.unique(held.owners[held.owners >= 0]).tolist()}

    def put(self, given: Mapping[str, FloatArray]) -> None:
        """Add the view vectors (V, ``DIMENSIONS``), of unit length, of maps by name, replacing those that a map has."""
        with self._changing:
            held = self._held.without(set(given))
            new = np.concatenate([np.zeros((0, DIMENSIONS), np.float32), *given.values()])
            numbers = np.repeat(np.arange(len(given)) + len(held.maps), [len(some) for some in given.values()])
            owners, maps = np.append(held.owners, numbers).astype(np.int32), (*held.maps, *given)
            if held.is_outgrown_by(owners):
                kept = np.flatnonzero(held.owners >= 0)
                vectors = np.concatenate([held.vectors(kept), new])
                held = _Held.of(vectors, maps, np.append(held.owners[kept], numbers))
            else:
                with self._using:
                    held.index.add(_as_bytes(new))
                held = replace(held, maps=maps, owners=owners)
            with self._using:
                self._held = held

    def drop(self, names: Iterable[str]) -> None:
        """Remove maps. Unknown names are ignored."""
        with self._changing:
            self._held = self._held.without(set(names))

    def likeliest(self, descriptors: ByteArray, most: int, among: Collection[str] | None = None) -> list[LikelyMap]:
        """Rank maps by similarity to a picture with descriptors (N, B): the mean similarity of each map's five best
        views among the 200 best of all maps. Missing views count as 0.

        Returns at most ``most`` maps, best first, of all or of those named in ``among``; an empty list for a picture
        without features.
        """
        query = self.pictures.vectors([descriptors])
        if not query.any():
            return []
        with self._using:
            held = self._held
            alike, rows = held.search(_as_bytes(query), among)
        best: dict[int, list[float]] = defaultdict(list)
        for likeness, row in zip((alike[0] / _STEPS**2).tolist(), rows[0].tolist(), strict=True):
            owner = int(held.owners[row]) if 0 <= row < len(held.owners) else -1
            if owner >= 0 and len(best[owner]) < _VIEWS_THAT_COUNT:
                best[owner].append(max(likeness, 0.0))
        found = [LikelyMap(held.maps[owner], sum(some) / _VIEWS_THAT_COUNT) for owner, some in best.items()]
        return sorted(found, key=lambda one: (-one.score, one.name))[:most]


@dataclass(frozen=True, eq=False)
class _Held:
    """An immutable set of vectors and their maps.

    Attributes:
        index: inverted file of V vectors, one byte per number.
        maps: map names by number.
        owners: (V,) number of each vector's map; -1 once that map was removed.
        made_for: number of vectors that the lists were sized for.
    """

    index: faiss.Index
    maps: tuple[str, ...]
    owners: IntArray
    made_for: int

    @classmethod
    def of(cls, vectors: FloatArray, maps: tuple[str, ...], owners: IntArray) -> _Held:
        """Index vectors (V, ``DIMENSIONS``), with a number of lists that suits their count.

        ``owners`` (V,) number the vectors' maps in ``maps``; maps without vectors are dropped and the others
        renumbered.
        """
        used, numbers = np.unique(owners, return_inverse=True)
        named = tuple(maps[number] for number in used.tolist())
        index = _empty_index(vectors)
        index.add(_as_bytes(vectors))
        return cls(index, named, numbers.astype(np.int32), len(vectors))

    def is_outgrown_by(self, owners: IntArray) -> bool:
        """Whether the lists should be built anew for vectors with these owners (V,): more than four times as many as
        they were made for, or more than a third of removed maps (-1), and either more than 5000.
        """
        dead = np.count_nonzero(owners < 0)
        return bool(len(owners) > max(_FEW, _GROWTH * self.made_for) or dead > max(_FEW, _DEAD_SHARE * len(owners)))

    def without(self, names: set[str]) -> _Held:
        """A copy that no longer finds the given maps."""
        gone = [number for number, name in enumerate(self.maps) if name in names]
        owners = np.where(np.isin(self.owners, gone), -1, self.owners) if gone else self.owners
        return replace(self, owners=owners)

    def search(self, query: FloatArray, among: Collection[str] | None) -> tuple[FloatArray, IntArray]:
        """Inner products (1, 200) of a query (1, D) with the nearest vectors, in units of 1/254², and their rows; -1
        for none.

        Searches all maps, or only those named in ``among``.
        """
        if among is None:
            return self.index.search(query, _LIKELY_VIEWS)
        named = set(among)
        numbers = [number for number, name in enumerate(self.maps) if name in named]
        allowed = faiss.IDSelectorBatch(np.flatnonzero(np.isin(self.owners, numbers)))
        if isinstance(self.index, faiss.IndexIVF):
            in_lists = faiss.SearchParametersIVF()
            in_lists.sel, in_lists.nprobe = allowed, self.index.nprobe
            return self.index.search(query, _LIKELY_VIEWS, params=in_lists)
        chosen = faiss.SearchParameters()
        chosen.sel = allowed
        return self.index.search(query, _LIKELY_VIEWS, params=chosen)

    def vectors(self, rows: IntArray) -> FloatArray:
        """(R, ``DIMENSIONS``) vectors in the given rows (R,), as quantized, on their original scale."""
        if len(rows) == 0:
            return np.zeros((0, DIMENSIONS), np.float32)
        return unpacked_vectors(self.index.reconstruct_batch(rows))


def _empty_index(vectors: FloatArray) -> faiss.Index:
    """Empty index for vectors like these (V, ``DIMENSIONS``): exhaustive up to 5000, above that √V trained lists."""
    kind, metric = faiss.ScalarQuantizer.QT_8bit_direct_signed, faiss.METRIC_INNER_PRODUCT
    if len(vectors) <= _FEW:
        return faiss.IndexScalarQuantizer(DIMENSIONS, kind, metric)
    lists = int(np.sqrt(len(vectors)))
    index = faiss.IndexIVFScalarQuantizer(faiss.IndexFlatIP(DIMENSIONS), DIMENSIONS, lists, kind, metric, False)
    index.cp.niter, index.cp.seed, index.cp.spherical = _ITERATIONS, _SEED, True
    index.cp.min_points_per_centroid, index.cp.max_points_per_centroid = 1, _TRAINING_PER_LIST
    index.train(_as_bytes(vectors))
    index.make_direct_map()
    index.nprobe = max(_MIN_PROBED, int(_PROBED_SHARE * lists))
    return index


def _as_bytes(vectors: FloatArray) -> FloatArray:
    """Vectors (V, D) times 254, rounded and clipped to -128…127, as float32, which the index expects."""
    return np.ascontiguousarray(packed_vectors(vectors), dtype=np.float32)


def packed_vectors(vectors: FloatArray) -> NDArray[np.int8]:
    """Vectors (V, D) quantized to one byte per number: times 254, rounded, clipped to -128…127."""
    return np.asarray(np.clip(np.round(vectors * _STEPS), -128, 127), dtype=np.int8)


def unpacked_vectors(packed: NDArray[np.int8] | FloatArray) -> FloatArray:
    """Float32 vectors from the bytes of :func:`packed_vectors` (or their values as floats): divided by 254."""
    return np.asarray(packed / np.float32(_STEPS), dtype=np.float32)
