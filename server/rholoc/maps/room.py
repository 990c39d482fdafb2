"""Surfaces of a room, for display only; localization does not use them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from rholoc.geometry import BoolArray, IntArray, Similarity
from rholoc.maps.cloud import Cloud


@dataclass(frozen=True, eq=False)
class Room:
    """A mesh.

    Attributes:
        vertices: V coloured points.
        faces: (Q, 4) int32, rows of the vertices of each quadrilateral, counter-clockwise as seen from the free side.
    """

    vertices: Cloud = Cloud()  # noqa: RUF009 - it is frozen
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
