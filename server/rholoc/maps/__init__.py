"""The map, its file formats, the library of maps on disk."""

from rholoc.maps.cameras import CameraLibrary, CameraProfile
from rholoc.maps.coefficient_reading import read_coefficient_table
from rholoc.maps.coefficient_table import write_coefficient_table
from rholoc.maps.coverage import Coverage, coverage_of
from rholoc.maps.export import landmark_sigmas, map_to_ply, map_to_vtp, preview_png
from rholoc.maps.library import MapLibrary, MapStat, check_map_name
from rholoc.maps.map import DensityKind, Map, MapInfo
from rholoc.maps.report_picture import report_png
from rholoc.maps.rho_file import load_map, map_to_bytes, save_map
from rholoc.maps.surfaces import map_surfaces_vtp
from rholoc.maps.tables import ObservationTable, observations_csv
from rholoc.maps.trajectory_table import TrajectoryTable, read_trajectory_csv, trajectory_csv, write_trajectory_csv
from rholoc.maps.validation import validate_map

__all__ = [
    "CameraLibrary",
    "CameraProfile",
    "Coverage",
    "DensityKind",
    "Map",
    "MapInfo",
    "MapLibrary",
    "MapStat",
    "ObservationTable",
    "TrajectoryTable",
    "check_map_name",
    "coverage_of",
    "landmark_sigmas",
    "load_map",
    "map_surfaces_vtp",
    "map_to_bytes",
    "map_to_ply",
    "map_to_vtp",
    "observations_csv",
    "preview_png",
    "read_coefficient_table",
    "read_trajectory_csv",
    "report_png",
    "save_map",
    "trajectory_csv",
    "validate_map",
    "write_coefficient_table",
    "write_trajectory_csv",
]
