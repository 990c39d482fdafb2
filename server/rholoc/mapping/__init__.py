"""Recording → map: the pipeline, the report, and learning that goes on.

What makes maps is loaded when it is first asked for: a service that only describes and edits maps needs no solvers.
"""

from typing import TYPE_CHECKING

from rholoc.lazy import loader

if TYPE_CHECKING:
    from rholoc.mapping.build.pipeline import BuildOptions, build_map
    from rholoc.mapping.learn.from_recordings import UpdateOptions, update_map

__all__ = ["BuildOptions", "UpdateOptions", "build_map", "update_map"]

__getattr__ = loader(
    __name__,
    {
        "BuildOptions": "rholoc.mapping.build.pipeline",
        "UpdateOptions": "rholoc.mapping.learn.from_recordings",
        "build_map": "rholoc.mapping.build.pipeline",
        "update_map": "rholoc.mapping.learn.from_recordings",
    },
)
