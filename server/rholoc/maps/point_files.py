"""A map's landmarks as point files for other programs: PLY (MeshLab, CloudCompare) and VTP (ParaView)."""

from __future__ import annotations

import base64

import numpy as np
from numpy.typing import NDArray

from rholoc.geometry import FloatArray, IntArray
from rholoc.maps.map import Map


def landmark_sigmas(map_: Map) -> FloatArray:
    """(F,) float32: the standard deviation of each landmark's position along one axis, in metres, averaged."""
    variances = map_.covariances[:, [0, 3, 5]].mean(axis=1)
    return np.asarray(np.sqrt(variances), dtype=np.float32)


def view_counts(map_: Map) -> IntArray:
    """(F,) int32: from how many views each feature was seen."""
    return np.bincount(map_.view_features, minlength=len(map_)).astype(np.int32)


def map_to_ply(map_: Map) -> bytes:
    """Binary PLY: one vertex per landmark with x, y, z and sigma in metres, channel and number of views."""
    vertex = np.dtype([("xyz", "<f4", 3), ("sigma", "<f4"), ("views", "<i4"), ("channel", "u1")])
    vertices = np.zeros(len(map_), vertex)
    vertices["xyz"] = map_.landmarks
    vertices["sigma"] = landmark_sigmas(map_)
    vertices["views"] = view_counts(map_)
    vertices["channel"] = map_.channels
    header = "\n".join(
        [
            "ply",
            "format binary_little_endian 1.0",
            f"comment rholoc map {map_.info.id} version {map_.info.version}",
            f"element vertex {len(map_)}",
            *(f"property {kind} {name}" for kind, name in _PLY_PROPERTIES),
            "end_header\n",
        ]
    )
    return header.encode("ascii") + vertices.tobytes()


_PLY_PROPERTIES = (
    ("float", "x"),
    ("float", "y"),
    ("float", "z"),
    ("float", "sigma"),
    ("int", "views"),
    ("uchar", "channel"),
)


def map_to_vtp(map_: Map) -> bytes:
    """VTK PolyData (XML): one vertex per landmark, in metres, with the arrays sigma_m, views and channel."""
    n = len(map_)
    return f"""<?xml version="1.0"?>
<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64">
<PolyData><Piece NumberOfPoints="{n}" NumberOfVerts="{n}">
<PointData>
{_data_array("sigma_m", "Float32", landmark_sigmas(map_).astype("<f4"))}
{_data_array("views", "Int32", view_counts(map_).astype("<i4"))}
{_data_array("channel", "UInt8", map_.channels)}
</PointData>
<Points>{_data_array("points", "Float32", map_.landmarks.astype("<f4"), components=3)}</Points>
<Verts>
{_data_array("connectivity", "Int64", np.arange(n, dtype="<i8"))}
{_data_array("offsets", "Int64", np.arange(1, n + 1, dtype="<i8"))}
</Verts>
</Piece></PolyData>
</VTKFile>
""".encode("ascii")


def _data_array(name: str, kind: str, values: NDArray[np.generic], components: int = 1) -> str:
    content = values.tobytes()
    coded = base64.b64encode(np.uint64(len(content)).astype("<u8").tobytes() + content).decode("ascii")
    return (
        f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{components}" format="binary">{coded}</DataArray>'
    )
