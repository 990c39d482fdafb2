"""A map's description as a page for people, or as JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rholoc.cli.console import output, print_figures, print_json

if TYPE_CHECKING:
    from rholoc.geometry import Camera
    from rholoc.maps import Map, MapInfo
    from rholoc.maps.info import Source

_ROOM_PERCENTILES = (5.0, 95.0)  # of the landmarks along each axis: without those few seen through windows and doors


def print_map(map_: Map, path: Path, as_json: bool) -> None:
    """Print a map's page, or all its figures as JSON."""
    if as_json:
        print_json(map_figures(map_, path))
    else:
        print_page(map_, path)


def print_page(map_: Map, path: Path) -> None:
    """Print whether to trust a map, the room's size, where the map works, and what to do better."""
    print_figures(str(path), map_page(map_, path))
    for walk in map_.info.report.coaching:
        for title, findings in (("problem", walk.warnings), ("next time", walk.advice)):
            for finding in findings:
                output.print(f"{title} ({walk.recording}): {finding.text}", markup=False, soft_wrap=True)


def map_figures(map_: Map, path: Path) -> dict[str, Any]:
    """All that a map in the file ``path`` says about itself, JSON-serialisable: counts, bytes, and its info."""
    from rholoc.maps.info import info_to_json

    counts = {
        "file": str(path),
        "bytes": path.stat().st_size,
        "landmarks": len(map_),
        "descriptors": len(map_.descriptors),
        "views": len(map_.views),
    }
    description: dict[str, Any] = json.loads(info_to_json(map_.info))
    return counts | description


def map_page(map_: Map, path: Path) -> dict[str, str]:
    """The page's lines by their names, the most important first, as texts with units; unknown ones are left out."""
    from rholoc.maps import expected_error_m, trust_of

    info = map_.info
    trust, expected_m = trust_of(info), expected_error_m(info)
    lines = {
        "trusted": trust_line(trust.trusted, trust.reason),
        "expected error": "unknown" if expected_m is None else f"{100 * expected_m:.1f} cm (rms)",
        "room": _room(map_),
        "works": _works(info),
        "consistent": _consistent(info),
        "contents": f"{len(map_)} landmarks, {len(map_.views)} views, {path.stat().st_size / 1000:.0f} kB",
        "landmarks": _landmarks(info),
        "method": f"{info.features} features, {info.density} densities",
        "camera": _camera(info.camera),
        "version": f"{info.version}, made {info.created}, id {info.id}",
        "recordings": "\n".join(map(_source, info.sources)),
        "waypoints": _waypoints(info),
        "names": ", ".join([point.name for point in info.names.points] + [area.name for area in info.names.areas]),
        "labels": ", ".join(filter(None, (info.labels.site, info.labels.floor, *info.labels.tags))),
        "corrected": ", ".join(one.kind for one in info.corrections),
    }
    return {name: line for name, line in lines.items() if line}


def trust_line(trusted: bool | None, reason: str) -> str:
    """ "yes", "no" or "unknown" (None), with the reason, for people."""
    word = {True: "yes", False: "no", None: "unknown"}[trusted]
    return f"{word}. {reason}".strip() if reason else word


def _room(map_: Map) -> str:
    """Extent of nine tenths of the landmarks along x, y and z, as text; empty without landmarks."""
    import numpy as np

    if not len(map_):
        return ""
    low, high = np.percentile(map_.landmarks.positions, _ROOM_PERCENTILES, axis=0)
    size = " × ".join(f"{side:.1f}" for side in high - low)
    upright = "" if map_.info.upright else "; z is not known to be up"
    return f"{size} m (x, y, z){upright}" if map_.info.metric else f"{size} in a unit of unknown length{upright}"


def _works(info: MapInfo) -> str:
    """Coverage in words; empty if it was not measured."""
    seen = info.report.coverage
    if seen is None:
        return ""
    return (
        f"at {seen.positions_sufficient:.0%} of the places around the walk, "
        f"for {seen.share_sufficient:.0%} of places and directions"
    )


def _consistent(info: MapInfo) -> str:
    """Errors of held-out frames in words; empty without any."""
    held_out = info.report.held_out
    if held_out is None:
        return ""
    line = f"{held_out.localized} of {held_out.frames} frames held out were localized"
    if held_out.median_m is None:
        return line
    apart = f"{100 * held_out.median_m:.1f} cm" if info.metric else f"{held_out.median_m:.3g} units"
    return f"{line}, {apart} from the walk (median)"


def _landmarks(info: MapInfo) -> str:
    """Median uncertainty of the landmarks in words; empty if it is unknown."""
    sigma = info.report.landmark_sigma_median_m
    if sigma is None:
        return ""
    return f"known to {100 * sigma:.1f} cm (median)" if info.metric else f"known to {sigma:.3g} units (median)"


def _camera(camera: Camera) -> str:
    """Lens, size, focal length and centre in words."""
    size = f"{camera.width}×{camera.height} px"
    return f"{camera.lens}, {size}, focal length {camera.focal:.1f} px, centre {camera.cx:.1f}, {camera.cy:.1f} px"


def _source(source: Source) -> str:
    """Name, number of views, source of the poses and id of a recording, separated by commas."""
    parts = [source.name]
    if source.views is not None:
        parts.append(f"{source.views} views" + ("" if source.frames is None else f" of {source.frames} frames"))
    if source.poses is not None:
        parts.append(f"poses: {source.poses}")
    if source.id is not None:
        parts.append(f"id {source.id}")
    return ", ".join(parts)


def _waypoints(info: MapInfo) -> str:
    """Names of the waypoints, separated by commas, each with its residual where it is known."""
    return ", ".join(
        point.name if point.residual_m is None else f"{point.name} (missed by {100 * point.residual_m:.1f} cm)"
        for point in info.waypoints
    )
