"""Recording → map: the pipeline and the report."""

from rholoc.mapping.build import DEFAULT_FEATURES, BuildOptions, build_map

__all__ = ["DEFAULT_FEATURES", "BuildOptions", "build_map"]
