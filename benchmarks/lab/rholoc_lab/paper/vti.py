"""Values on a regular grid as a VTK XML ImageData file, which ParaView opens as a volume."""

from collections.abc import Mapping

import numpy as np

from rholoc.geometry import FloatArray


def image_data(origin: FloatArray, spacing: tuple[float, float, float], fields: Mapping[str, FloatArray]) -> bytes:
    """The file for named fields of values (Z, Y, X) of one shape on a grid with a corner (3,) and a spacing (x, y, z)
    [m].

    ParaView shows the first field.
    """
    names = list(fields)
    z, y, x = fields[names[0]].shape
    extent = f"0 {x - 1} 0 {y - 1} 0 {z - 1}"
    arrays = "\n".join(
        f'<DataArray type="Float32" Name="{name}" format="ascii">\n{_numbers(values)}\n</DataArray>'
        for name, values in fields.items()
    )
    place = f'Origin="{_row(origin)}" Spacing="{_row(np.array(spacing))}"'
    text = f"""<?xml version="1.0"?>
<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian">
<ImageData WholeExtent="{extent}" {place}>
<Piece Extent="{extent}">
<PointData Scalars="{names[0]}">
{arrays}
</PointData>
</Piece>
</ImageData>
</VTKFile>
"""
    return text.encode("ascii")


def _numbers(values: FloatArray) -> str:
    rows = values.reshape(-1, values.shape[-1])
    return "\n".join(" ".join(f"{value:.4g}" for value in row) for row in rows)


def _row(values: FloatArray) -> str:
    return " ".join(f"{value:.6f}" for value in values)
