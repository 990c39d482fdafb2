"""A map's landmarks and views as PLY and VTP (VTK's XML PolyData), for ParaView."""

import io
from collections.abc import Sequence
from enum import StrEnum

import numpy as np

from rholoc.geometry import FloatArray, IntArray
from rholoc.maps.map import Map
from rholoc.maps.walks import consecutive


class Cells(StrEnum):
    """Kind of a piece's cells."""

    POINTS = "Verts"
    LINES = "Lines"
    TRIANGLES = "Polys"


class Owner(StrEnum):
    """Owner of a data array: points or cells."""

    POINTS = "PointData"
    CELLS = "CellData"


def polydata(*pieces: str) -> bytes:
    """Content of a VTP file with these pieces, written by :func:`piece`."""
    lines = [
        '<?xml version="1.0"?>',
        '<VTKFile type="PolyData" version="0.1" byte_order="LittleEndian">',
        "<PolyData>",
        *pieces,
        "</PolyData>",
        "</VTKFile>",
    ]
    return ("\n".join(lines) + "\n").encode("ascii")


def piece(
    points: FloatArray, cells: IntArray, kind: Cells, owner: Owner, active: str, data: Sequence[str], form: str = "%.5f"
) -> str:
    """A piece of PolyData.

    Args:
        points: (N, 3), written with ``form``.
        cells: (C, L) the points of C cells of one length.
        kind: what they are.
        owner: what the data belong to.
        active: the attributes that say which data ParaView shows first.
        data: arrays as :func:`data_array` writes them.
        form: of the points' coordinates.
    """
    offsets = np.arange(1, len(cells) + 1) * cells.shape[1]
    return "\n".join(
        [
            f'<Piece NumberOfPoints="{len(points)}" NumberOf{kind}="{len(cells)}">',
            f"<{owner} {active}>",
            *data,
            f"</{owner}>",
            "<Points>",
            data_array("position", "Float32", points, form, components=3),
            "</Points>",
            f"<{kind}>",
            data_array("connectivity", "Int32", cells.ravel(), "%d"),
            data_array("offsets", "Int32", offsets, "%d"),
            f"</{kind}>",
            "</Piece>",
        ]
    )


def data_array(name: str, kind: str, values: FloatArray | IntArray, form: str, components: int = 1) -> str:
    """A DataArray element: ``values`` (N,) or (N, components) of VTK's type ``kind``, written with ``form``."""
    text = io.StringIO()
    np.savetxt(text, values, fmt=form)
    opening = f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{components}" format="ascii">'
    return f"{opening}\n{text.getvalue()}</DataArray>"


def landmark_sigmas(map_: Map) -> FloatArray:
    """Standard deviation (F,) [m] of each landmark, root mean square over the axes: √(tr Σ / 3)."""
    return np.asarray(np.sqrt(np.trace(map_.landmarks.covariances.astype(np.float64), axis1=1, axis2=2) / 3))


def view_sigmas(map_: Map) -> FloatArray:
    """Standard deviation (K,) [m] of each view's position, root mean square over the axes; 0 if unknown."""
    return np.asarray(np.nan_to_num(map_.views.expected_errors_m) / np.sqrt(3))


def map_to_ply(map_: Map) -> bytes:
    """The map as an ASCII PLY file: landmarks, then views, as vertices; the walks from view to view as edges.

    Vertex properties: ``x y z`` in metres, ``sigma_m`` (0 for views that do not know theirs), ``channel`` (255 for
    views), the heading ``nx ny nz`` (0 for landmarks), and where the map knows its colours, ``red green blue`` (black
    for views).
    """
    features, views = len(map_), len(map_.views)
    edges = consecutive(map_.views.walks)
    header = [
        "ply",
        "format ascii 1.0",
        f"comment rholoc map {map_.info.id} version {map_.info.version}",
        f"comment {features} landmarks, then {views} views; metres, z up",
        f"element vertex {features + views}",
        *(f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz", "sigma_m")),
        "property uchar channel",
        *(f"property uchar {name}" for name in ("red", "green", "blue") if map_.landmarks.colours is not None),
        f"element edge {len(edges)}",
        "property int vertex1",
        "property int vertex2",
        "end_header",
    ]
    text = io.StringIO()
    text.write("\n".join(header) + "\n")
    landmarks = np.column_stack(
        [map_.landmarks.positions, np.zeros((features, 3)), landmark_sigmas(map_), map_.landmarks.channels]
    )
    path = np.column_stack([map_.views.positions, map_.views.headings, view_sigmas(map_), np.full(views, 255)])
    if map_.landmarks.colours is not None:
        landmarks, path = (
            np.column_stack([landmarks, map_.landmarks.colours]),
            np.column_stack([path, np.zeros((views, 3))]),
        )
    np.savetxt(text, np.vstack([landmarks, path]), fmt=["%.5f"] * 7 + ["%d"] * (landmarks.shape[1] - 7))
    np.savetxt(text, features + edges, fmt="%d")
    return text.getvalue().encode("ascii")


def map_to_vtp(map_: Map) -> bytes:
    """The map as a VTK XML PolyData file with two pieces: landmarks (vertices), and views with lines from each to the
    next of its walk.

    Point data of both: ``sigma_m``, ``channel`` and ``heading``, as in :func:`map_to_ply`.
    """
    features, views = len(map_), len(map_.views)
    landmarks = _piece(
        map_.landmarks.positions,
        landmark_sigmas(map_),
        map_.landmarks.channels,
        np.zeros((features, 3)),
        np.arange(features)[:, None],
        Cells.POINTS,
    )
    path = _piece(
        map_.views.positions,
        view_sigmas(map_),
        np.full(views, 255),
        map_.views.headings,
        consecutive(map_.views.walks),
        Cells.LINES,
    )
    return polydata(landmarks, path)


def _piece(
    points: FloatArray,
    sigmas: FloatArray,
    channels: IntArray,
    headings: FloatArray,
    cells: IntArray,
    kind: Cells,
) -> str:
    """A piece of points with sigmas (N,) [m], channels (N,) and headings (N, 3), and their cells."""
    data = [
        data_array("sigma_m", "Float32", sigmas, "%.5f"),
        data_array("channel", "UInt8", channels, "%d"),
        data_array("heading", "Float32", headings, "%.5f", components=3),
    ]
    return piece(points, cells, kind, Owner.POINTS, 'Scalars="sigma_m" Vectors="heading"', data)
