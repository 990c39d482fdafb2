"""Coloured points and surfaces of a room, for display only; localization does not use them."""

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


@dataclass(frozen=True, eq=False)
class Room:
    """A mesh.

    Attributes:
        vertices: V coloured points.
        faces: (Q, 4) int32, rows of the vertices of each quadrilateral, counter-clockwise as seen from the free side.
    """

    vertices: Cloud = Cloud()
    faces: IntArray = field(default_factory=lambda: np.zeros((0, 4), dtype=np.int32))

    def __len__(self) -> int:
        return len(self.vertices)

    def keep(self, kept: BoolArray) -> Room:
        """The vertices selected by the mask ``kept`` (V,), and the faces between them."""
        number = (np.cumsum(kept) - 1).astype(np.int32)
        return Room(self.vertices.keep(kept), number[self.faces[kept[self.faces].all(axis=1)]])

    def moved(self, similarity: Similarity) -> Room:
        """The mesh with its vertices in the frame that ``similarity`` leads to."""
        return Room(self.vertices.moved(similarity), self.faces)

    def without_source(self, source: int) -> Room:
        """Without the vertices of one of the map's sources; the numbers of the sources after it decrease by one."""
        left = self.keep(self.vertices.sources != source)
        return Room(left.vertices.without_source(source), left.faces)

    def joined(self, other: Room) -> Room:
        """This mesh and, after it, another."""
        return Room(Cloud.joined(self.vertices, other.vertices), np.concatenate([self.faces, other.faces + len(self)]))
