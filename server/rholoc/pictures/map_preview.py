"""A map from above, as a picture."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from rholoc.maps.formats.ply_and_vtp import landmark_sigmas
from rholoc.maps.map import Map
from rholoc.maps.walks import consecutive
from rholoc.pictures.style import INK, MARKED, MUTED, draw_scale_bar, draw_views, figure_of, png_of

_MIN_SIGMA_M = 1e-3  # the colour scale's lower end at least
_MARGIN = 0.06  # of the plotted width, around it
_VISIBLE_SHARE = (1.0, 99.0)  # percentiles of the landmarks that the picture is made to hold


def preview_png(map_: Map, title: str = "") -> bytes:
    """The map from above as a PNG: landmarks coloured by uncertainty, the view path with its headings, waypoints."""
    figure = figure_of((8, 6), 150)
    figure.set_layout_engine("constrained", w_pad=0.15, h_pad=0.15)
    axes = figure.add_subplot()
    shown = _plot_landmarks(axes, map_)
    _plot_path(axes, map_)
    _plot_waypoints(axes, map_)
    _frame(axes, map_)
    axes.set_title(title or "Map from above", loc="left", pad=22, fontsize=13, fontweight="bold", color=INK)
    axes.annotate(
        _caption(map_), (0, 1), (0, 7), xycoords="axes fraction", textcoords="offset points", fontsize=8, color=MUTED
    )
    if shown is not None:
        _plot_colour_scale(figure, axes, shown, "cm" if map_.info.metric else "units")
    return png_of(figure)


def _plot_landmarks(axes: Axes, map_: Map) -> PathCollection | None:
    """Draw the landmarks from above, coloured by standard deviation [cm, or units]; None without landmarks."""
    if len(map_) == 0:
        return None
    sigmas = (100 if map_.info.metric else 1) * np.maximum(landmark_sigmas(map_), _MIN_SIGMA_M)
    low, high = np.percentile(sigmas, _VISIBLE_SHARE)
    order = np.argsort(-sigmas)  # the best on top
    return axes.scatter(
        map_.landmarks.positions[order, 0],
        map_.landmarks.positions[order, 1],
        c=sigmas[order],
        s=float(np.clip(12000 / len(map_), 2, 14)),
        cmap="viridis",
        norm=LogNorm(low, max(high, 1.5 * low)),
        linewidths=0,
        alpha=0.8,
    )


def _plot_colour_scale(figure: Figure, axes: Axes, shown: PathCollection, unit: str) -> None:
    """Draw the colour scale of the landmarks' standard deviations, which are in ``unit``."""
    bar = figure.colorbar(shown, ax=axes, shrink=0.55, aspect=28, pad=0.01)
    bar.set_label(f"landmark uncertainty, {unit}", fontsize=8, color=MUTED)
    bar.ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    bar.ax.yaxis.set_minor_formatter(NullFormatter())
    bar.ax.tick_params(which="both", labelsize=7, colors=MUTED)
    bar.outline.set_visible(False)


def _plot_path(axes: Axes, map_: Map) -> None:
    """Draw the views from above with their headings."""
    if len(map_.views) == 0:
        return
    x, y = map_.views.positions[:, :2].T
    hx, hy = map_.views.headings[:, :2].T
    draw_views(axes, map_.views.positions[:, :2], map_.views.walks, 1.2, 3)
    axes.quiver(x, y, hx, hy, color=INK, angles="xy", scale=28, width=0.002, headwidth=4, zorder=3)


def _plot_waypoints(axes: Axes, map_: Map) -> None:
    """Draw the waypoints from above with their names."""
    for waypoint in map_.info.waypoints:
        x, y = waypoint.position[:2]
        axes.plot(x, y, marker="D", markersize=6, color=MARKED, markeredgecolor="white", zorder=5)
        axes.annotate(
            waypoint.name,
            (x, y),
            (6, 6),
            textcoords="offset points",
            fontsize=9,
            color=MARKED,
            fontweight="bold",
            path_effects=[withStroke(linewidth=2.5, foreground="white")],
        )


def _frame(axes: Axes, map_: Map) -> None:
    """Set equal axes around 98 % of the landmarks and all views, without a box, with a scale bar and a legend."""
    ground = np.vstack([map_.landmarks.positions[:, :2], map_.views.positions[:, :2], np.zeros((1, 2))])
    low, high = np.percentile(ground, _VISIBLE_SHARE, axis=0)
    if len(map_.views):
        low = np.minimum(low, map_.views.positions[:, :2].min(axis=0))
        high = np.maximum(high, map_.views.positions[:, :2].max(axis=0))
    margin = _MARGIN * max(float((high - low).max()), 1.0)
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - 2 * margin, high[1] + margin)
    axes.set_aspect("equal")
    axes.set_axis_off()
    width = float(high[0] - low[0]) + 2 * margin
    unit = "m" if map_.info.metric else "units"
    draw_scale_bar(axes, low[0] - margin / 2, low[1] - 1.3 * margin, width, unit, fontsize=8)
    in_order = len(consecutive(map_.views.walks)) > 0
    axes.plot([], [], "-" if in_order else ".", color=INK, linewidth=1.2, label="view path" if in_order else "views")
    if map_.info.waypoints:
        axes.plot([], [], marker="D", linestyle="", color=MARKED, label="waypoints")
    axes.legend(loc="lower right", fontsize=8, frameon=False, labelcolor=INK)


def _caption(map_: Map) -> str:
    """One line on the map: counts, features, density, median uncertainty of a landmark, and doubts."""
    parts = [
        f"{len(map_)} landmarks",
        f"{len(map_.views)} views",
        f"{map_.info.features}, {map_.info.density.value}",
    ]
    if len(map_):
        unit, factor = ("cm", 100.0) if map_.info.metric else ("units", 1.0)
        parts.append(f"median uncertainty {factor * float(np.median(landmark_sigmas(map_))):.2g} {unit}")
    if not map_.info.metric:
        parts.append("scale arbitrary")
    if not map_.info.upright:
        parts.append("not upright")
    return " · ".join(parts)
