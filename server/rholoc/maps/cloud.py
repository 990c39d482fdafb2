"""Points of a room for display only; localization does not use them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from rholoc.geometry import BoolArray, ByteArray, FloatArray, IntArray, Similarity


@dataclass(frozen=True, eq=False)
class Cloud:
    """P points.

    Attributes:
        positions: (P, 3) float32, metres, map frame.
        colours: (P, 3) uint8, red, green and blue in the pictures.
        sources: (P,) int32, row of the map's sources for each point.
    """

    positions: FloatArray = field(default_factory=lambda: np.zeros((0, 3), dtype=np.float32))
    colours: ByteArray = field(default_factory=lambda: np.zeros((0, 3), dtype=np.uint8))
    sources: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int32))

    def __len__(self) -> int:
        return len(self.positions)

    def keep(self, kept: BoolArray | IntArray) -> Cloud:
        """The points selected by ``kept``, a mask (P,) or rows."""
        return Cloud(self.positions[kept], self.colours[kept], self.sources[kept])

    def moved(self, similarity: Similarity) -> Cloud:
        """The points with their positions in the frame that ``similarity`` leads to."""
        positions = similarity.points(self.positions.astype(np.float64)).astype(np.float32)
        return Cloud(positions, self.colours, self.sources)

    def without_source(self, source: int) -> Cloud:
        """Without the points of one of the map's sources; the numbers of the sources after it decrease by one."""
        left = self.keep(self.sources != source)
        return Cloud(left.positions, left.colours, (left.sources - (left.sources > source)).astype(np.int32))

    def renumbered(self, numbers: IntArray) -> Cloud:
        """The points with ``numbers[source]`` as source, int32."""
        return Cloud(self.positions, self.colours, numbers[self.sources])

    @staticmethod
    def joined(*clouds: Cloud) -> Cloud:
        """All points of at least one cloud, in the order given."""
        return Cloud(
            np.concatenate([one.positions for one in clouds]),
            np.concatenate([one.colours for one in clouds]),
            np.concatenate([one.sources for one in clouds]),
        )
