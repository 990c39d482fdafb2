"""The map and its file formats; sites of maps."""

from rholoc.density import DensityKind
from rholoc.maps.coverage import coverage_of
from rholoc.maps.display import Cloud, Room
from rholoc.maps.floor_plan import MAX_PLAN_BYTES, FloorPlan, check_plan
from rholoc.maps.formats.coefficient_reading import is_coefficient_table, read_coefficient_table
from rholoc.maps.formats.coefficient_table import coefficient_table, write_coefficient_table
from rholoc.maps.formats.gltf import map_to_gltf
from rholoc.maps.formats.observation_table import ObservationTable, observations_csv
from rholoc.maps.formats.patch_bytes import moved_patches, packed_patches, storable_patches, unpacked_patches
from rholoc.maps.formats.ply_and_vtp import landmark_sigmas, map_to_ply, map_to_vtp
from rholoc.maps.formats.rho_file import MapOutline, load_map, map_to_bytes, save_map
from rholoc.maps.formats.scene import cloud_to_bytes, map_to_scene, room_to_bytes
from rholoc.maps.formats.surfaces import map_surfaces_vtp
from rholoc.maps.formats.trajectory_table import (
    TrajectoryTable,
    read_trajectory_csv,
    trajectory_csv,
    view_trajectory,
    write_trajectory_csv,
)
from rholoc.maps.info import Correction, CorrectionKind, MapInfo, MapWaypoint, Source
from rholoc.maps.kept_observations import (
    check_memory,
    memory_of,
    packed_pixels,
    source_cameras,
    unpacked_pixels,
    without_memory,
)
from rholoc.maps.map import Map, MapPart, part_of
from rholoc.maps.map_tables import MapDescriptors, MapLandmarks, MapObservations, MapViews
from rholoc.maps.name_rules import check_map_name
from rholoc.maps.place_names import (
    MapLabels,
    MapNames,
    NamedArea,
    NamedPoint,
    areas_at,
    check_labels,
    check_names,
    check_outline,
    points_near,
    within_outline,
)
from rholoc.maps.sites import (
    MAX_MAPS,
    FramePose,
    LinkOrigin,
    Site,
    SiteLink,
    SiteMap,
    SiteOnEarth,
    check_earth,
    check_site,
)
from rholoc.maps.trust import Trust, consistency_m, expected_error_m, trust_of
from rholoc.maps.validation import check_usable, validate_map

__all__ = [
    "MAX_MAPS",
    "MAX_PLAN_BYTES",
    "Cloud",
    "Correction",
    "CorrectionKind",
    "DensityKind",
    "FloorPlan",
    "FramePose",
    "LinkOrigin",
    "Map",
    "MapDescriptors",
    "MapInfo",
    "MapLabels",
    "MapLandmarks",
    "MapNames",
    "MapObservations",
    "MapOutline",
    "MapPart",
    "MapViews",
    "MapWaypoint",
    "NamedArea",
    "NamedPoint",
    "ObservationTable",
    "Room",
    "Site",
    "SiteLink",
    "SiteMap",
    "SiteOnEarth",
    "Source",
    "TrajectoryTable",
    "Trust",
    "areas_at",
    "check_earth",
    "check_labels",
    "check_map_name",
    "check_memory",
    "check_names",
    "check_outline",
    "check_plan",
    "check_site",
    "check_usable",
    "cloud_to_bytes",
    "coefficient_table",
    "consistency_m",
    "coverage_of",
    "expected_error_m",
    "is_coefficient_table",
    "landmark_sigmas",
    "load_map",
    "map_surfaces_vtp",
    "map_to_bytes",
    "map_to_gltf",
    "map_to_ply",
    "map_to_scene",
    "map_to_vtp",
    "memory_of",
    "moved_patches",
    "observations_csv",
    "packed_patches",
    "packed_pixels",
    "part_of",
    "points_near",
    "read_coefficient_table",
    "read_trajectory_csv",
    "room_to_bytes",
    "save_map",
    "source_cameras",
    "storable_patches",
    "trajectory_csv",
    "trust_of",
    "unpacked_patches",
    "unpacked_pixels",
    "validate_map",
    "view_trajectory",
    "within_outline",
    "without_memory",
    "write_coefficient_table",
    "write_trajectory_csv",
]
