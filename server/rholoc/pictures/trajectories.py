"""Plots of trajectories, with matplotlib's object API: no global state, no display."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from rholoc.geometry import FloatArray
from rholoc.pictures.style import AMBER, MARKED, TEAL, figure_of

_TRUTH_COLOUR = "#1a1a1a"
_ESTIMATE_COLOUR = MARKED
_FAILURE_COLOUR = AMBER
_WAYPOINT_COLOUR = TEAL
_ARROWS = 40  # headings drawn along a path: enough to see where it looks, few enough to see the path
_LONGEST_SIDE_INCHES = 10.0
_MARGIN_M = 0.4


def plot_top_view(
    estimated: FloatArray,
    truth: FloatArray | None = None,
    landmarks: FloatArray | None = None,
    waypoints: Sequence[tuple[str, FloatArray]] = (),
    title: str = "",
) -> Figure:
    """The map frame from above, axes in metres and of equal scale.

    Args:
        estimated: (N, 4, 4) T_map_camera in the order of the walk, NaN where a frame has no pose.
        truth: (N, 4, 4) the true poses of the same frames; without them failures cannot be drawn.
        landmarks: (F, 3) of the map, metres; coloured by height.
        waypoints: names and positions (3,) of measured points.
        title: a line above the plot.
    """
    figure = figure_of(None, 150)
    axes = figure.add_subplot()
    if landmarks is not None and len(landmarks):
        _draw_landmarks(figure, axes, landmarks)
    if truth is not None:
        axes.plot(truth[:, 0, 3], truth[:, 1, 3], color=_TRUTH_COLOUR, lw=1.4, zorder=3, label="true path")
    _draw_estimate(axes, estimated, truth)
    _draw_waypoints(axes, waypoints)
    _frame(figure, axes, [a[:, :2, 3] for a in (estimated, truth) if a is not None], landmarks)
    axes.set(xlabel="x (m)", ylabel="y (m)", title=title)
    axes.grid(alpha=0.25, lw=0.5)
    axes.set_axisbelow(True)
    axes.legend(loc="upper left", fontsize=8, framealpha=0.9)
    return figure


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure to ``path``, whose suffix is its format (.png, .svg, .pdf); makes its folder. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    metadata: dict[str, Any] = {"Software": None} if path.suffix == ".png" else {}
    figure.savefig(path, metadata=metadata)


def _draw_landmarks(figure: Figure, axes: Axes, landmarks: FloatArray) -> None:
    """Draw landmarks (F, 3) [m] from above, coloured by height, with a colour scale."""
    low, high = np.percentile(landmarks[:, 2], [2, 98])
    x, y, z = landmarks[np.argsort(landmarks[:, 2])].T
    dots = axes.scatter(
        x,
        y,
        c=z,
        cmap="viridis",
        vmin=float(low),
        vmax=float(high),
        s=5,
        alpha=0.45,
        linewidths=0,
        zorder=1,
        label=f"{len(landmarks)} landmarks",
    )
    bar = figure.colorbar(dots, ax=axes, shrink=0.6, pad=0.02)
    bar.set_label("landmark height z (m)", fontsize=8)
    bar.ax.tick_params(labelsize=7)
    if bar.solids is not None:
        bar.solids.set_alpha(1)


def _draw_estimate(axes: Axes, estimated: FloatArray, truth: FloatArray | None) -> None:
    """Draw estimated positions and headings; with ``truth``, also their errors, and crosses where there is no pose."""
    placed = np.isfinite(estimated).all(axis=(1, 2))
    xy, heading = estimated[placed, :2, 3], estimated[placed, :2, 2]
    axes.plot(*xy.T, ".", color=_ESTIMATE_COLOUR, ms=4, zorder=4, label=f"estimated, {len(xy)} frames")
    some = slice(None, None, max(1, len(xy) // _ARROWS))
    axes.quiver(
        *xy[some].T,
        *heading[some].T,
        color=_ESTIMATE_COLOUR,
        alpha=0.7,
        angles="xy",
        scale_units="xy",
        scale=4.0,
        width=0.0025,
        zorder=4,
    )
    if truth is None:
        return
    axes.add_collection(
        LineCollection(
            list(np.stack([xy, truth[placed, :2, 3]], axis=1)), colors=_ESTIMATE_COLOUR, lw=0.8, alpha=0.8, zorder=4
        )
    )
    if not placed.all():
        lost = truth[~placed, :2, 3]
        axes.plot(*lost.T, "x", color=_FAILURE_COLOUR, ms=6, mew=1.6, zorder=5, label=f"no pose, {len(lost)} frames")


def _draw_waypoints(axes: Axes, waypoints: Sequence[tuple[str, FloatArray]]) -> None:
    """Draw measured waypoints, names and positions (3,), from above."""
    if not waypoints:
        return
    points = np.array([position for _, position in waypoints])
    axes.plot(*points[:, :2].T, "^", color=_WAYPOINT_COLOUR, ms=9, mec="white", zorder=6, label="measured waypoints")
    for name, position in waypoints:
        axes.annotate(
            name,
            (position[0], position[1]),
            xytext=(7, 5),
            textcoords="offset points",
            fontsize=9,
            fontweight="bold",
            color=_WAYPOINT_COLOUR,
            zorder=6,
            bbox={"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.75},
        )


def _frame(figure: Figure, axes: Axes, paths: list[FloatArray], landmarks: FloatArray | None) -> None:
    """Set equal axes and the figure's size so that all of the paths and 98 % of the landmarks are shown."""
    points = np.concatenate([path[np.isfinite(path).all(axis=1)] for path in paths])
    if landmarks is not None and len(landmarks):
        points = np.concatenate([points, np.percentile(landmarks[:, :2], [1, 99], axis=0)])
    if len(points) == 0:
        return
    low, high = points.min(axis=0) - _MARGIN_M, points.max(axis=0) + _MARGIN_M
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axes.set_aspect("equal")
    width, height = high - low
    scale = (_LONGEST_SIDE_INCHES - 2) / max(width, height)
    figure.set_size_inches(max(width * scale + 2, 6), max(height * scale + 1.2, 4.5))
