"""The map, its file formats, the library of maps on disk."""

from rholoc.maps.library import MapLibrary, MapStat, check_map_name
from rholoc.maps.map import DensityKind, Map, MapInfo
from rholoc.maps.rho_file import load_map, map_to_bytes, save_map
from rholoc.maps.validation import validate_map

__all__ = [
    "DensityKind",
    "Map",
    "MapInfo",
    "MapLibrary",
    "MapStat",
    "check_map_name",
    "load_map",
    "map_to_bytes",
    "save_map",
    "validate_map",
]
