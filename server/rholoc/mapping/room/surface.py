"""Signed distances → a mesh of quadrilaterals, by surface nets (Gibson, MICCAI 1998)."""

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components

from rholoc.geometry import BoolArray, FloatArray, IntArray
from rholoc.mapping.room.fusion import DistanceGrid

_CORNERS = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
_EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if np.abs(_CORNERS[a] - _CORNERS[b]).sum() == 1]
_SMOOTHINGS = 2
_LARGE_PIECE = 0.15  # of the vertices of the largest piece
_AROUND = 0.05  # of the largest piece's extent, around it


class Quads(NamedTuple):
    """Vertices (V, 3) in the grid's axes, and quadrilaterals (Q, 4), counter-clockwise as seen from the free side."""

    vertices: FloatArray
    faces: IntArray


def surface_of(grid: DistanceGrid, smallest: float) -> Quads:
    """The zero crossing of a grid's distances, smoothed, without pieces that hang in the air; in the grid's axes.

    A piece's size is its number of vertices. Pieces smaller than ``smallest`` × the largest are left out. Those below
    0.15 × the largest stay only if their centre is within its horizontal box, widened by 5 %.
    """
    d, known = grid.distances, grid.known
    cells = np.ones([n - 1 for n in d.shape], dtype=bool)
    positive = np.zeros(cells.shape, dtype=np.int8)
    for corner in _CORNERS:
        at = tuple(slice(c, c + n) for c, n in zip(corner, cells.shape, strict=True))
        cells &= known[at]
        positive += d[at] > 0
    cells &= (positive > 0) & (positive < 8)
    number = np.full(cells.shape, -1, dtype=np.int64)
    number[cells] = np.arange(int(cells.sum()))
    return _without_small_pieces(Quads(_vertices(grid, np.argwhere(cells)), _faces(d, number)), smallest)


def _vertices(grid: DistanceGrid, cells: IntArray) -> FloatArray:
    """A vertex (V, 3) in the grid's axes in each cell (V, 3): the mean of the crossings on the cell's edges."""
    at = cells[:, None] + _CORNERS
    d = grid.distances[at[..., 0], at[..., 1], at[..., 2]].astype(np.float64)
    sums, count = np.zeros((len(cells), 3)), np.zeros(len(cells))
    for a, b in _EDGES:
        crosses = (d[:, a] > 0) != (d[:, b] > 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(crosses, d[:, a] / (d[:, a] - d[:, b]), 0.0)[:, None]
        sums += np.where(crosses[:, None], _CORNERS[a] + share * (_CORNERS[b] - _CORNERS[a]), 0.0)
        count += crosses
    return np.asarray(grid.origin + grid.size * (cells + sums / np.maximum(count, 1)[:, None]))


def _faces(d: FloatArray, number: IntArray) -> IntArray:
    """The quadrilateral (Q, 4) around each edge of the grid on which the distance ``d`` (X, Y, Z) changes its sign.
    ``number`` holds each cell's vertex, -1 for none; quadrilaterals that lack one are left out.
    """
    found = []
    for axis in range(3):
        b, c = (axis + 1) % 3, (axis + 2) % 3
        here = tuple(slice(1, -1) if k != axis else slice(0, -1) for k in range(3))
        there = tuple(slice(1, -1) if k != axis else slice(1, None) for k in range(3))
        first = d[here] > 0
        edges = np.argwhere(first != (d[there] > 0))
        outwards = first[tuple(edges.T)]
        edges += [0 if k == axis else 1 for k in range(3)]
        ring = []
        for step_b, step_c in ((1, 1), (0, 1), (0, 0), (1, 0)):
            cell = edges.copy()
            cell[:, b] -= step_b
            cell[:, c] -= step_c
            ring.append(number[tuple(cell.T)])
        quads = np.column_stack(ring)
        quads[outwards] = quads[outwards][:, ::-1]
        found.append(quads[(quads >= 0).all(axis=1)])
    return np.concatenate(found)


def _without_small_pieces(mesh: Quads, smallest: float) -> Quads:
    """The mesh, smoothed twice, without small connected components and unconnected vertices.

    A component needs at least ``smallest`` × the largest one's vertices if its centre is inside the largest one's
    bounding box in x and y (plus 5 %), else at least 0.15 × them. A mesh without faces is returned unchanged.
    """
    count = len(mesh.vertices)
    neighbours = neighbours_of(mesh.faces, count)
    degree = np.asarray(neighbours.sum(axis=1)).reshape(-1, 1)
    if not degree.any():
        return mesh
    _, piece = connected_components(neighbours, directed=False)
    smoothed = mesh.vertices
    for _ in range(_SMOOTHINGS):
        smoothed = 0.5 * smoothed + 0.5 * (neighbours @ smoothed) / np.maximum(degree, 1)
    sizes = np.bincount(piece)
    main = smoothed[piece == np.argmax(sizes), :2]
    margin = _AROUND * np.ptp(main, axis=0)
    middles = np.column_stack([np.bincount(piece, smoothed[:, k]) / sizes for k in range(2)])
    inside = np.all((middles > main.min(axis=0) - margin) & (middles < main.max(axis=0) + margin), axis=1)
    stays = (sizes >= _LARGE_PIECE * sizes.max()) | (inside & (sizes >= smallest * sizes.max()))
    return _kept_vertices(mesh._replace(vertices=smoothed), (degree.ravel() > 0) & stays[piece])


def neighbours_of(faces: IntArray, count: int) -> csr_matrix:
    """Matrix (V, V) of a mesh of polygons (Q, 4) with ``count`` vertices: 1 between the ends of each edge, else 0."""
    a, b = faces.ravel(), np.roll(faces, 1, axis=1).ravel()
    ends = np.concatenate([a, b]), np.concatenate([b, a])
    matrix = csr_matrix(coo_matrix((np.ones(2 * len(a)), ends), (count, count)))
    matrix.data[:] = 1.0
    return matrix


def _kept_vertices(mesh: Quads, kept: BoolArray) -> Quads:
    """The mesh with only the vertices where ``kept`` (V,) is true, and the faces between them."""
    number = np.cumsum(kept) - 1
    faces = mesh.faces[kept[mesh.faces].all(axis=1)]
    return Quads(mesh.vertices[kept], number[faces])


def normals_of(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Unit normals (V, 3) of the vertices (V, 3) of quadrilaterals (Q, 4), towards the side from which these are
    counter-clockwise; 0 without a face.
    """
    diagonals = vertices[faces[:, 2]] - vertices[faces[:, 0]], vertices[faces[:, 3]] - vertices[faces[:, 1]]
    across = np.cross(*diagonals)
    sums = np.zeros_like(vertices)
    for corner in range(4):
        np.add.at(sums, faces[:, corner], across)
    return np.asarray(sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-12))
