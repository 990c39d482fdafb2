"""A map's report as a picture: coverage, errors of held-out frames, uncertainty of views and landmarks."""

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, PercentFormatter

from rholoc.geometry import FloatArray, IntArray
from rholoc.maps.coverage import SUFFICIENT, Coverage, coverage_of
from rholoc.maps.formats.ply_and_vtp import landmark_sigmas
from rholoc.maps.map import Map
from rholoc.maps.trust import expected_error_m, trust_of
from rholoc.pictures.style import GREEN, INK, MARKED, MUTED, draw_scale_bar, draw_views, figure_of, png_of
from rholoc.reports import MapReport

_SIZE_PX = (1800, 1080)
_DPI = 120
_LEVELS = (0, 1, SUFFICIENT / 4, SUFFICIENT / 2, SUFFICIENT, 2 * SUFFICIENT, 4 * SUFFICIENT, 8 * SUFFICIENT, 10_000)
_COLOURS = ("#e6e4e1", "#a50026", "#e4593c", "#fbae62", "#c6e2c0", "#78c08c", "#2f8f63", "#0b5440")
_RADIUS = 0.47  # of a rose, in steps
_ARC_STEPS = 4
_HIDDEN_SHARE = (0.5, 99.5)  # percentiles that histograms span
_NO_FRAMES = "no errors of single frames are known"
_MIN_ERROR = 1e-4  # where the logarithmic error scale ends


@dataclass(frozen=True, eq=False)
class _HeldOut:
    """Position errors (N,) [m] of held-out frames against the trajectory, infinite if refused; confidences (N,)."""

    errors_m: FloatArray
    confidences: FloatArray


def report_png(map_: Map, title: str = "") -> bytes:
    """The report on a map as a PNG: coverage by position and heading, consistency, landmarks."""
    figure = figure_of((_SIZE_PX[0] / _DPI, _SIZE_PX[1] / _DPI), _DPI)
    figure.set_layout_engine("constrained", w_pad=0.12, h_pad=0.12)
    figure.suptitle(title or "The map's report", x=0.012, ha="left", fontsize=16, fontweight="bold", color=INK)
    grid = figure.add_gridspec(2, 3, width_ratios=(2.15, 1, 1))
    _plot_coverage(figure, figure.add_subplot(grid[:, 0]), map_, coverage_of(map_))
    unit, factor = ("cm", 100.0) if map_.info.metric else ("units", 1.0)
    _plot_errors(figure.add_subplot(grid[0, 1]), map_.info.report, unit, factor)
    if np.isfinite(map_.views.expected_errors_m).any():
        _plot_expected_error(figure.add_subplot(grid[0, 2]), map_, unit, factor)
    else:
        _plot_confidences(figure.add_subplot(grid[0, 2]), _held_out(map_.info.report), unit, factor)
    _plot_sigmas(figure.add_subplot(grid[1, 1]), map_, unit, factor)
    _plot_views_per_landmark(figure.add_subplot(grid[1, 2]), map_)
    return png_of(figure)


def _held_out(report: MapReport) -> _HeldOut | None:
    """Errors and confidences of the report's held-out frames; None if it has none of single frames."""
    frames = report.held_out
    if frames is None or not frames.errors_m or len(frames.errors_m) != len(frames.confidences or ()):
        return None
    errors = [math.inf if error is None else error for error in frames.errors_m]
    return _HeldOut(np.array(errors), np.array(frames.confidences))


def _plot_coverage(figure: Figure, axes: Axes, map_: Map, coverage: Coverage) -> None:
    """Draw the map from above, with a wedge for each place and heading, coloured by the number of landmarks in view."""
    colours: Colormap = ListedColormap(_COLOURS)
    norm = BoundaryNorm(_LEVELS, colours.N)
    landmarks, places = map_.landmarks.positions @ coverage.axes.T, map_.views.positions @ coverage.axes.T
    axes.scatter(landmarks[:, 0], landmarks[:, 1], s=2.0, color=MUTED, alpha=0.35, linewidths=0, zorder=1)
    axes.add_collection(
        PolyCollection(
            _wedges(coverage),
            array=coverage.counts.ravel(),
            cmap=colours,
            norm=norm,
            edgecolors="white",
            linewidths=0.3,
            zorder=2,
        )
    )
    _plot_path(axes, places, map_.views.walks, map_.views.headings @ coverage.axes.T)
    _plot_waypoints(axes, map_, coverage)
    _frame(axes, coverage, places, "m" if map_.info.metric else "units")
    axes.set_title(_caption(map_, coverage), loc="left", fontsize=9, linespacing=1.5, color=MUTED)
    axes.set_anchor("N")
    bar = figure.colorbar(
        ScalarMappable(norm, colours), ax=axes, orientation="horizontal", shrink=0.75, aspect=45, pad=0.01
    )
    bar.set_ticks(_LEVELS[1:-1], labels=[f"{level:g}" for level in _LEVELS[1:-1]])
    bar.set_label("landmarks in view, a wedge for each heading of the camera", fontsize=9, color=INK)
    bar.ax.tick_params(labelsize=8, colors=MUTED, length=0)
    bar.outline.set_visible(False)


def _wedges(coverage: Coverage) -> list[FloatArray]:
    """For each position and heading the centre and four points of the arc, (5, 2) [m], in the plane of the coverage."""
    centres = coverage.positions @ coverage.axes.T
    width = 360.0 / len(coverage.headings_deg)
    arcs = np.deg2rad(coverage.headings_deg[:, None] + np.linspace(-width / 2, width / 2, _ARC_STEPS))
    rim = _RADIUS * coverage.step_m * np.stack([np.cos(arcs), np.sin(arcs)], axis=-1)
    return [np.vstack([centre, centre + arc]) for centre in centres for arc in rim]


def _plot_path(axes: Axes, places: FloatArray, walks: IntArray, headings: FloatArray) -> None:
    """Draw views at ``places`` (N, 2) with walk numbers (N,) and about 60 of their headings (N, 2), in the plane."""
    if len(places) == 0:
        return
    draw_views(axes, places, walks, 1.0, 3, halo=2.6)
    every = max(1, len(places) // 60)
    axes.quiver(
        *places[::every].T,
        *headings[::every].T,
        color=INK,
        angles="xy",
        scale=34,
        width=0.0022,
        headwidth=4.5,
        zorder=4,
    )


def _plot_waypoints(axes: Axes, map_: Map, coverage: Coverage) -> None:
    """Draw the waypoints with their names, in the plane of the coverage."""
    for waypoint in map_.info.waypoints:
        place = coverage.axes @ np.array(waypoint.position, dtype=np.float64)
        axes.plot(*place, marker="D", markersize=6, color=MARKED, markeredgecolor="white", zorder=6)
        axes.annotate(
            waypoint.name,
            (float(place[0]), float(place[1])),
            (6, 6),
            textcoords="offset points",
            fontsize=9,
            color=MARKED,
            fontweight="bold",
            zorder=6,
            path_effects=[withStroke(linewidth=2.5, foreground="white")],
        )


def _frame(axes: Axes, coverage: Coverage, places: FloatArray, unit: str) -> None:
    """Set equal axes around the roses and the path, without a box, with a scale bar."""
    shown = np.vstack([coverage.positions @ coverage.axes.T, places, np.zeros((0 if len(places) else 1, 2))])
    low, high = shown.min(axis=0) - 3 * coverage.step_m, shown.max(axis=0) + 3 * coverage.step_m
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    axes.set_axis_off()
    x, y = low[0] + coverage.step_m / 2, low[1] + coverage.step_m / 2
    draw_scale_bar(axes, x, y, high[0] - low[0], unit)


def _caption(map_: Map, coverage: Coverage) -> str:
    """Three lines: size and kind of the map, coverage, trust."""
    unit = "m" if map_.info.metric else "units"
    info = map_.info
    scale = "" if info.metric else " · scale arbitrary"
    upright = "" if info.upright else " · not upright"
    return (
        f"{len(map_)} landmarks · {len(map_.views)} views · {info.features}, {info.density.value}"
        f"{scale}{upright}\n"
        f"{coverage.share_sufficient:.0%} of positions and headings see {SUFFICIENT} landmarks or more (green); "
        f"{coverage.step_m:.2g} {unit} grid, camera {coverage.pitch_deg:+.0f}°\n"
        f"{_trust(map_)}"
    )


def _trust(map_: Map) -> str:
    """One line with the map's trust (yes, no, unknown) and its expected error [cm]."""
    expected_m, trust = expected_error_m(map_.info), trust_of(map_.info)
    expected = "unknown" if expected_m is None else f"{100 * expected_m:.1f} cm"
    trusted = {True: "yes", False: "no", None: "unknown"}[trust.trusted]
    return f"trusted: {trusted} · expected error {expected}"


def _plot_errors(axes: Axes, report: MapReport, unit: str, factor: float) -> None:
    """Plot the distribution function of held-out frames' errors × ``factor`` in ``unit``, or say why there is none."""
    _panel(
        axes,
        "Consistency of frames of the walk",
        f"from the walk's own position, {unit}",
        "share of the frames",
    )
    held_out = _held_out(report)
    if held_out is None:
        _say(axes, _quantiles(report, unit, factor))
        return
    errors = factor * np.sort(np.maximum(held_out.errors_m, _MIN_ERROR))
    found = errors[np.isfinite(errors)]
    if len(found) == 0:
        _say(axes, f"none of {len(errors)} frames was localized")
        return
    shares = np.arange(1, len(found) + 1) / len(errors)
    axes.step(np.append(found, 2 * found[-1]), np.append(shares, shares[-1]), where="post", color=GREEN, linewidth=1.8)
    axes.fill_between(found, shares, step="post", color=GREEN, alpha=0.12, linewidth=0)
    for share in (0.5, 0.9):
        if shares[-1] >= share:
            error = float(found[np.searchsorted(shares, share - 1e-9)])
            axes.plot([error, error], [0, share], color=INK, linewidth=0.8, linestyle=":")
            label = f"{share:.0%}: {error:.2g} {unit}"
            axes.annotate(label, (error, share), (5, -10), textcoords="offset points", fontsize=8.5, color=INK)
    axes.set_ylim(0, 1.04)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    _logarithmic(axes, 0.7 * found[0], 2 * found[-1])
    axes.annotate(
        f"{len(found)} of {len(errors)} localized",
        (1, 0.03),
        xycoords="axes fraction",
        ha="right",
        fontsize=8.5,
        color=MUTED,
    )


def _quantiles(report: MapReport, unit: str, factor: float) -> str:
    """Text with the report's median and 90th percentile of errors × ``factor`` in ``unit``, or that none are known."""
    frames = report.held_out
    if frames is None or frames.median_m is None or frames.p90_m is None:
        return _NO_FRAMES
    median, p90 = factor * frames.median_m, factor * frames.p90_m
    return f"{frames.localized} of {frames.frames} localized\n50%: {median:.2g}, 90%: {p90:.2g} {unit}"


def _plot_confidences(axes: Axes, held_out: _HeldOut | None, unit: str, factor: float) -> None:
    """Plot confidences of held-out frames over their errors × ``factor`` in ``unit``, or say why there are none."""
    _panel(axes, "… and their confidence", f"from the walk's own position, {unit}", "confidence")
    if held_out is None:
        _say(axes, _NO_FRAMES)
        return
    found = np.isfinite(held_out.errors_m)
    if not found.any():
        _say(axes, "none was localized")
        return
    errors = factor * np.maximum(held_out.errors_m[found], _MIN_ERROR)
    axes.scatter(errors, held_out.confidences[found], s=22, color=GREEN, alpha=0.6, linewidths=0, clip_on=False)
    axes.set_ylim(0, 1.04)
    _logarithmic(axes, 0.7 * float(errors.min()), 1.4 * float(errors.max()))


def _plot_expected_error(axes: Axes, map_: Map, unit: str, factor: float) -> None:
    """Plot the expected error of each view, times ``factor`` in ``unit``."""
    _panel(axes, "Expected error over the walk", "view", f"root mean square, {unit}")
    errors = factor * map_.views.expected_errors_m
    numbers = np.arange(len(errors))
    axes.plot(numbers, errors, color=GREEN, linewidth=1.5)
    axes.fill_between(numbers, errors, color=GREEN, alpha=0.12, linewidth=0)
    axes.set_ylim(0, 1.15 * float(np.nanmax(errors)))
    axes.set_xlim(0, max(len(errors) - 1, 1))


def _plot_sigmas(axes: Axes, map_: Map, unit: str, factor: float) -> None:
    """Plot a histogram of the landmarks' standard deviations, times ``factor`` in ``unit``."""
    _panel(axes, "Landmark uncertainty", f"standard deviation, {unit}", "landmarks")
    if len(map_) == 0:
        _say(axes, "no landmarks")
        return
    sigmas = factor * np.maximum(landmark_sigmas(map_), _MIN_ERROR)
    low, high = _range(sigmas)
    axes.hist(sigmas, bins=np.geomspace(low, high, 36).tolist(), color=GREEN, alpha=0.75)
    _median_line(axes, float(np.median(sigmas)), f" {unit}")
    _logarithmic(axes, low, high)


def _plot_views_per_landmark(axes: Axes, map_: Map) -> None:
    """Plot a histogram of the numbers of views that see a landmark."""
    _panel(axes, "Views of a landmark", "views", "landmarks")
    if len(map_) == 0:
        _say(axes, "no landmarks")
        return
    views = np.bincount(map_.observations.features, minlength=len(map_))
    last = int(np.ceil(np.percentile(views, _HIDDEN_SHARE[1]))) + 1
    width = -(-last // 40)
    axes.hist(views, bins=(np.arange(1, last + width + 1, width) - 0.5).tolist(), color=GREEN, alpha=0.75)
    _median_line(axes, float(np.median(views)), "")


def _range(values: FloatArray) -> tuple[float, float]:
    """Limits of a logarithmic axis for values (N,), a little beyond their percentiles 0.5 and 99.5."""
    low, high = (float(value) for value in np.percentile(values, _HIDDEN_SHARE))
    return low / 1.1, max(high, 1.5 * low) * 1.1


def _median_line(axes: Axes, median: float, unit: str) -> None:
    """Mark and write the median; ``unit`` follows the number."""
    axes.axvline(median, color=INK, linewidth=0.8, linestyle=":")
    axes.annotate(
        f"median {median:.3g}{unit}",
        (median, 0.97),
        (5, 0),
        xycoords=axes.get_xaxis_transform(),
        textcoords="offset points",
        va="top",
        fontsize=8.5,
        color=INK,
        path_effects=[withStroke(linewidth=2.5, foreground="white")],
    )
    axes.margins(y=0.12)


def _logarithmic(axes: Axes, low: float, high: float) -> None:
    """Make the x axis logarithmic from ``low`` to ``high``, with plain numbers."""
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    axes.xaxis.set_major_locator(
        LogLocator(subs=(1, 2, 5) if high < 60 * low else (1, 3) if high < 600 * low else (1,))
    )
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _panel(axes: Axes, title: str, x: str, y: str) -> None:
    """Title, axis labels and style of a plot."""
    axes.set_title(title, loc="left", fontsize=11, fontweight="bold", color=INK)
    axes.set_xlabel(x, fontsize=9, color=MUTED)
    axes.set_ylabel(y, fontsize=9, color=MUTED)
    axes.tick_params(which="both", labelsize=8, colors=MUTED)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(MUTED)


def _say(axes: Axes, what: str) -> None:
    """Show the text ``what`` instead of a plot."""
    axes.set_xticks([])
    axes.set_yticks([])
    axes.text(0.5, 0.5, what, transform=axes.transAxes, ha="center", va="center", fontsize=9, color=MUTED)
