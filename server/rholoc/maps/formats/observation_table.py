"""Table 4: observations as CSV."""

from collections.abc import Iterator
from dataclasses import dataclass

from rholoc.geometry import ByteArray, FloatArray

OBSERVATION_COLUMNS = ("descriptor", "u", "v", "x", "y", "z", "hx", "hy", "hz")
TIME_COLUMN, ROLL_COLUMN = "timestamp", "roll"  # optional first and last column


@dataclass(frozen=True, eq=False)
class ObservationTable:
    """N rows of Table 4: features seen at pixels from poses.

    Attributes:
        channels: (N,) uint8, values of :class:`rholoc.features.Channel`.
        descriptors: (N, B) uint8.
        pixels: (N, 2), u and v.
        positions: (N, 3), of the camera, metres, map frame.
        headings: (N, 3), unit vectors of the optical axis, map frame.
        times: (N,) of the frames [s]; None if unknown.
        rolls: (N,) about the heading against the upright camera [rad]; None if all are zero, as in the paper.
    """

    channels: ByteArray
    descriptors: ByteArray
    pixels: FloatArray
    positions: FloatArray
    headings: FloatArray
    times: FloatArray | None = None
    rolls: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.channels)


def descriptor_hex(channel: int, descriptor: ByteArray) -> str:
    """A descriptor (B,) in the tables' notation: two hex digits for its channel, then two for each byte."""
    return f"{channel:02x}{descriptor.tobytes().hex()}"


def observations_csv(table: ObservationTable) -> Iterator[str]:
    """The lines of Table 4, each with its line break, the header first; times and rolls where there are any.

    Times are written to microseconds, pixels to hundredths, positions to tenths of a millimetre, directions to 1e-6.
    """
    first = () if table.times is None else (TIME_COLUMN,)
    last = () if table.rolls is None else (ROLL_COLUMN,)
    yield ",".join((*first, *OBSERVATION_COLUMNS, *last)) + "\n"
    rows = zip(table.channels, table.descriptors, table.pixels, table.positions, table.headings, strict=True)
    for row, (channel, descriptor, (u, v), (x, y, z), (hx, hy, hz)) in enumerate(rows):
        time = "" if table.times is None else f"{table.times[row]:.6f},"
        roll = "" if table.rolls is None else f",{table.rolls[row]:.6f}"
        pose = f"{x:.4f},{y:.4f},{z:.4f},{hx:.6f},{hy:.6f},{hz:.6f}"
        yield f"{time}{descriptor_hex(int(channel), descriptor)},{u:.2f},{v:.2f},{pose}{roll}\n"
