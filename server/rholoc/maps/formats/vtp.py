"""VTK's XML PolyData (VTP), written as text."""

from __future__ import annotations

import io
from collections.abc import Sequence
from enum import StrEnum

import numpy as np

from rholoc.geometry import FloatArray, IntArray


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
    """A DataArray element: ``values`` (N,) or (N, components), written with ``form``."""
    text = io.StringIO()
    np.savetxt(text, values, fmt=form)
    opening = f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{components}" format="ascii">'
    return f"{opening}\n{text.getvalue()}</DataArray>"
