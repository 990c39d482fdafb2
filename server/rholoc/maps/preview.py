"""A map at a glance: its landmarks from above, where it was seen from, its waypoints."""

from __future__ import annotations

import io

import numpy as np
from matplotlib.figure import Figure

from rholoc.maps.map import Map

_SHOWN_SHARE = (0.5, 99.5)  # percentiles: a landmark far outside must not shrink the room to a dot


def map_to_png(map_: Map, size_px: int = 800) -> bytes:
    """A top view as PNG, about ``size_px`` wide and high."""
    figure = Figure(figsize=(size_px / 100, size_px / 100), dpi=100, layout="constrained")
    axes = figure.add_subplot()
    if len(map_):
        x, y = map_.landmarks[:, 0], map_.landmarks[:, 1]
        axes.scatter(x, y, s=2, c=map_.landmarks[:, 2], cmap="viridis", linewidths=0, label="landmarks")
    if len(map_.view_poses):
        axes.plot(map_.view_poses[:, 0], map_.view_poses[:, 1], color="tab:red", linewidth=1, label="walk")
    for waypoint in map_.info.waypoints:
        wx, wy = waypoint["position"][:2]
        axes.plot(wx, wy, marker="*", color="black", markersize=9)
        axes.annotate(str(waypoint.get("name", "")), (wx, wy), xytext=(4, 4), textcoords="offset points")
    shown = np.concatenate([map_.landmarks[:, :2], map_.view_poses[:, :2]])
    if len(shown):
        low, high = np.percentile(shown, _SHOWN_SHARE, axis=0)
        middle, half = (low + high) / 2, 0.55 * max(float((high - low).max()), 1.0)
        axes.set_xlim(middle[0] - half, middle[0] + half)
        axes.set_ylim(middle[1] - half, middle[1] + half)
        axes.legend(loc="upper right")
    unit = "m" if map_.info.metric else "units of arbitrary length"
    axes.set_xlabel(f"x ({unit})")
    axes.set_ylabel(f"y ({unit})")
    axes.set_aspect("equal")
    axes.grid(alpha=0.3)
    png = io.BytesIO()
    figure.savefig(png, format="png")
    return png.getvalue()
