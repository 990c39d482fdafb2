"""Recording → map: the pipeline, the report, and learning that goes on."""

from rholoc.mapping.build import DEFAULT_FEATURES, BuildOptions, build_map
from rholoc.mapping.forgetting import forget_recording
from rholoc.mapping.learning import UpdateOptions, update_map
from rholoc.mapping.merging import merge_maps
from rholoc.mapping.observation_table import observation_table

__all__ = [
    "DEFAULT_FEATURES",
    "BuildOptions",
    "UpdateOptions",
    "build_map",
    "forget_recording",
    "merge_maps",
    "observation_table",
    "update_map",
]
