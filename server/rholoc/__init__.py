"""rholoc: indoor localization by densities of visual features.

Two flows, each a straight line: recording → trajectory → observations → densities → map, and
frame → features → matches → seeds → ascent → pose.

What most programs need can be imported from here; each name is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rholoc.lazy import loader

if TYPE_CHECKING:
    from rholoc.evaluation import evaluate as evaluate
    from rholoc.evaluation import trajectory_errors as trajectory_errors
    from rholoc.geometry import Camera as Camera
    from rholoc.geometry import Pose as Pose
    from rholoc.localization import Localizer as Localizer
    from rholoc.localization import Query as Query
    from rholoc.mapping.build.pipeline import build_map as build_map
    from rholoc.mapping.learn.from_recordings import update_map as update_map
    from rholoc.maps import load_map as load_map
    from rholoc.maps import save_map as save_map
    from rholoc.recordings import read_image as read_image
    from rholoc.recordings import read_recording as read_recording

__version__ = "1.0.0"

_HOMES = {
    "Camera": "rholoc.geometry",
    "Localizer": "rholoc.localization",
    "Pose": "rholoc.geometry",
    "Query": "rholoc.localization",
    "build_map": "rholoc.mapping",
    "evaluate": "rholoc.evaluation",
    "load_map": "rholoc.maps",
    "read_image": "rholoc.recordings",
    "read_recording": "rholoc.recordings",
    "save_map": "rholoc.maps",
    "trajectory_errors": "rholoc.evaluation",
    "update_map": "rholoc.mapping",
}

__all__ = [
    "Camera",
    "Localizer",
    "Pose",
    "Query",
    "build_map",
    "evaluate",
    "load_map",
    "read_image",
    "read_recording",
    "save_map",
    "trajectory_errors",
    "update_map",
]


__getattr__ = loader(__name__, _HOMES)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
