"""The map, its file formats, the library of maps on disk."""

from rholoc.maps.map import DensityKind, Map, MapInfo

__all__ = ["DensityKind", "Map", "MapInfo"]
