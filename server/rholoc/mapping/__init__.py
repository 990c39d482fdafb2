"""Recording → map: the pipeline, the report, and learning that goes on."""

from rholoc.mapping.build import DEFAULT_FEATURES, BuildOptions, build_map
from rholoc.mapping.export import ExportFormat, export_map, parse_features
from rholoc.mapping.forgetting import forget_recording
from rholoc.mapping.learning import UpdateOptions, update_map
from rholoc.mapping.merging import merge_maps
from rholoc.mapping.observation_table import observation_table

__all__ = [
    "DEFAULT_FEATURES",
    "BuildOptions",
    "ExportFormat",
    "UpdateOptions",
    "build_map",
    "export_map",
    "forget_recording",
    "merge_maps",
    "observation_table",
    "parse_features",
    "update_map",
]
