"""A map's stored observations, for learning and forgetting.

A ``ray`` density is a sum over observations (:mod:`rholoc.density.ray`). A map keeps the observations themselves, so
that another recording adds its own to the sums and forgetting a recording takes them away; either way the landmarks are
those of a map built that way from the start. It keeps observations rather than sums so that their weights, which fall
with an observation's distance from its landmark, can be recomputed: sums of fixed weights would depend on the order of
learning.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from rholoc.errors import InvalidInput, InvalidMap
from rholoc.geometry import Camera, FloatArray, IntArray

if TYPE_CHECKING:
    from rholoc.maps.info import MapInfo
    from rholoc.maps.map import Map

_STEPS = 65536


@dataclass(frozen=True, eq=False)
class Memory:
    """Per-recording data of a map for learning and forgetting.

    Attributes:
        pixels: (V, 2) u and v of each observation, in whole steps of :func:`packed_pixels`.
        view_sources: (K,) int32, the row of ``info.sources`` that each view comes from.
        descriptor_sources: (D,) int32, the same for each descriptor.
    """

    pixels: FloatArray
    view_sources: IntArray
    descriptor_sources: IntArray


def packed_pixels(pixels: FloatArray, camera: Camera) -> IntArray:
    """Pixels (N, 2) as map files keep them: (N, 2) uint16, in 1/65536 of the image's size from its top left corner."""
    size = np.array([camera.width, camera.height])
    steps = np.round((np.asarray(pixels, dtype=np.float64) + 0.5) / size * _STEPS)
    return np.asarray(np.clip(steps, 0, _STEPS - 1).astype(np.uint16))


def unpacked_pixels(packed: IntArray, camera: Camera) -> FloatArray:
    """Pixels (N, 2) that :func:`packed_pixels` packed: exact to 1/131072 of the image's size, clipped to the image."""
    return np.asarray(packed / _STEPS * np.array([camera.width, camera.height]) - 0.5)


def memory_of(map_: Map) -> Memory | None:
    """A map's memory; None if pixels, view sources or descriptor sources are missing."""
    pixels, views, descriptors = map_.observations.pixels, map_.views.sources, map_.descriptors.sources
    if pixels is None or views is None or descriptors is None:
        return None
    return Memory(pixels, views, descriptors)


def without_memory(map_: Map) -> Map:
    """The map without its memory: it localizes as before, but cannot learn."""
    return replace(
        map_,
        descriptors=replace(map_.descriptors, sources=None),
        views=replace(map_.views, sources=None),
        observations=replace(map_.observations, pixels=None, ranges_m=None),
    )


def check_memory(map_: Map, what: str) -> Memory:
    """The memory of a map, checked before learning or forgetting; error messages call the map ``what``.

    Raises:
        InvalidInput: it has no memory.
        InvalidMap: its memory contradicts the rest of it.
    """
    memory = memory_of(map_)
    if memory is None:
        raise InvalidInput(
            f"{what} does not keep what it was built from.",
            "Build it again from its recordings, with this version.",
        )
    if not memory_fits(map_, memory):
        raise InvalidMap(f"The memory of {what} contradicts itself.", "Build it again, or take another copy.")
    return memory


def memory_fits(map_: Map, memory: Memory) -> bool:
    """Whether a memory's lengths and source numbers agree with its map, and every source has an id and a camera."""
    count = len(map_.info.sources)
    return (
        memory.pixels.shape == (len(map_.observations), 2)
        and memory.view_sources.shape == (len(map_.views),)
        and memory.descriptor_sources.shape == (len(map_.descriptors),)
        and all(bool(((rows >= 0) & (rows < count)).all()) for rows in (memory.view_sources, memory.descriptor_sources))
        and all(source.id is not None and source.camera is not None for source in map_.info.sources)
    )


def source_cameras(info: MapInfo) -> list[Camera]:
    """The camera of each source; the map's own if a source has none."""
    return [source.camera or info.camera for source in info.sources]
