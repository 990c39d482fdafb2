"""Frame → pose: search the map for a place, find the pose there, and decide how much to believe it."""

from rholoc.localization.belief.confidence import MIN_RECOGNIZED
from rholoc.localization.diagnosis import TOO_LITTLE_TIME, Cause
from rholoc.localization.index.map_finder import VECTORS_FILE, MapFinder
from rholoc.localization.large_map import AnyLocalizer, LargeMapLocalizer, localizer_of
from rholoc.localization.localizer import Localizer
from rholoc.localization.several_frames import (
    MAX_FRAMES,
    JointLocalization,
    SeveralFrames,
    check_frame_count,
    localize_together,
)
from rholoc.localization.similar_views import likeliest_views
from rholoc.localization.types import (
    NO_BELIEF,
    Alternative,
    Belief,
    Dof,
    Intrinsics,
    Localization,
    Prior,
    Query,
    Reason,
)

__all__ = [
    "MAX_FRAMES",
    "MIN_RECOGNIZED",
    "NO_BELIEF",
    "TOO_LITTLE_TIME",
    "VECTORS_FILE",
    "Alternative",
    "AnyLocalizer",
    "Belief",
    "Cause",
    "Dof",
    "Intrinsics",
    "JointLocalization",
    "LargeMapLocalizer",
    "Localization",
    "Localizer",
    "MapFinder",
    "Prior",
    "Query",
    "Reason",
    "SeveralFrames",
    "check_frame_count",
    "likeliest_views",
    "localize_together",
    "localizer_of",
]
