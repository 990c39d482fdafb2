"""Recording → map: the pipeline, the report, and learning that goes on."""

from rholoc.mapping.build.frame_features import small_picture
from rholoc.mapping.build.pipeline import DEFAULT_FEATURES, BuildOptions, build_map
from rholoc.mapping.edit.correcting import (
    lay_over_plan,
    remove_region,
    remove_views,
    set_distance,
    set_earth,
    set_floor_plan,
    set_labels,
    set_names,
    set_north,
    set_origin,
    set_up,
    set_wall,
)
from rholoc.mapping.edit.forgetting import forget_recording
from rholoc.mapping.edit.frame_from_people import levelled
from rholoc.mapping.learn.answered_query import AnsweredQuery
from rholoc.mapping.learn.from_queries import MIN_QUERIES, learn_from_queries, too_few_queries
from rholoc.mapping.learn.from_recordings import UpdateOptions, update_map
from rholoc.mapping.learn.merging import merge_maps
from rholoc.mapping.room.drawing import draw_room
from rholoc.mapping.sites.linking import SearchedPair, add_links, map_state, search_links
from rholoc.mapping.sites.poses import find_link, pose_in_site, solve_site, with_link

__all__ = [
    "DEFAULT_FEATURES",
    "MIN_QUERIES",
    "AnsweredQuery",
    "BuildOptions",
    "SearchedPair",
    "UpdateOptions",
    "add_links",
    "build_map",
    "draw_room",
    "find_link",
    "forget_recording",
    "lay_over_plan",
    "learn_from_queries",
    "levelled",
    "map_state",
    "merge_maps",
    "pose_in_site",
    "remove_region",
    "remove_views",
    "search_links",
    "set_distance",
    "set_earth",
    "set_floor_plan",
    "set_labels",
    "set_names",
    "set_north",
    "set_origin",
    "set_up",
    "set_wall",
    "small_picture",
    "solve_site",
    "too_few_queries",
    "update_map",
    "with_link",
]
