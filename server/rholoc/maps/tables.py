"""Table 4: observations as CSV."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from rholoc.geometry import ByteArray, FloatArray

OBSERVATION_COLUMNS = ("descriptor", "u", "v", "x", "y", "z", "hx", "hy", "hz")


@dataclass(frozen=True, eq=False)
class ObservationTable:
    """N rows of Table 4: features seen at pixels from poses.

    Attributes:
        channels: (N,) uint8, values of :class:`rholoc.features.Channel`.
        descriptors: (N, B) uint8.
        pixels: (N, 2), u and v.
        positions: (N, 3), of the camera, metres, map frame.
        headings: (N, 3), unit vectors of the optical axis, map frame.
    """

    channels: ByteArray
    descriptors: ByteArray
    pixels: FloatArray
    positions: FloatArray
    headings: FloatArray


def descriptor_hex(channel: int, descriptor: ByteArray) -> str:
    """A descriptor (B,) as the tables write it: two hex digits of its channel, then two a byte."""
    return f"{channel:02x}{descriptor.tobytes().hex()}"


def observations_csv(table: ObservationTable) -> Iterator[str]:
    """The lines of Table 4, each with its line break, the header first.

    Pixels are written to hundredths, positions to tenths of a millimetre, headings to 1e-6.
    """
    yield ",".join(OBSERVATION_COLUMNS) + "\n"
    rows = zip(table.channels, table.descriptors, table.pixels, table.positions, table.headings, strict=True)
    for channel, descriptor, (u, v), (x, y, z), (hx, hy, hz) in rows:
        pose = f"{x:.4f},{y:.4f},{z:.4f},{hx:.6f},{hy:.6f},{hz:.6f}"
        yield f"{descriptor_hex(int(channel), descriptor)},{u:.2f},{v:.2f},{pose}\n"
