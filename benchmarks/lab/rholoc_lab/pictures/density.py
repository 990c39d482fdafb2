"""Densities as pictures: a feature's ρ, a frame's product with the ascent to its maximum, a density that sharpens."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from rholoc.density.ray import landmarks_from_information, observation_information
from rholoc.geometry import ByteArray, FloatArray, Pose
from rholoc.maps.map import Map
from rholoc.paper.density_localizer import Ascent
from rholoc.paper.landscape import (
    Grid,
    Look,
    over_headings,
    over_picture,
    over_positions,
    product_over_positions,
    seen_from,
)
from rholoc.pictures.style import INK, MARKED, MUTED, draw_scale_bar, figure_of, png_of

_STEPS = 48  # of a grid's longer side
_PICTURE_STEPS = 96
_HEADINGS = 45
_HALF_HEADING_RAD = np.deg2rad(30.0)
_COLOURS = "magma"
_VOLUME_STEPS = 20


def feature_png(map_: Map, look: Look, tolerance_px: float, title: str) -> bytes:
    """ρ of one feature as a PNG: over the picture for a pose, over positions for a pixel, over headings."""
    figure = figure_of((12, 4.4), 110)
    _draw_feature(figure, map_, look, tolerance_px, title)
    return png_of(figure)


def feature_frames(map_: Map, looks: Sequence[Look], tolerance_px: float, title: str) -> Iterator[ByteArray]:
    """The same for one look after another, for a film: pictures (H, W, 3), RGB."""
    for number, look in enumerate(looks, start=1):
        figure = figure_of((9.6, 4.8), 100)
        picture, above = figure.subplots(1, 2)
        figure.suptitle(f"{title}, view {number} of {len(looks)}", x=0.01, ha="left", color=INK, fontweight="bold")
        _draw_picture(picture, map_, look, tolerance_px)
        _draw_positions(above, map_, look, tolerance_px)
        yield _pixels(figure)


def feature_grid(map_: Map, look: Look) -> Grid:
    """The region of space for a feature's density: from the landmark to behind the camera, and as far to the sides."""
    landmark, position = map_.landmarks.positions[look.feature].astype(np.float64), look.T_map_camera[:3, 3]
    distance = float(np.linalg.norm(landmark - position))
    half = max(1.1 * distance, 0.5)
    return Grid.about((landmark + position) / 2, (half, half, min(half, 1.0)), 2 * half / _VOLUME_STEPS)


def _draw_feature(figure: Figure, map_: Map, look: Look, tolerance_px: float, title: str) -> None:
    picture, above, headings = figure.subplots(1, 3)
    figure.suptitle(title, x=0.01, ha="left", color=INK, fontweight="bold")
    shown = _draw_picture(picture, map_, look, tolerance_px)
    _draw_positions(above, map_, look, tolerance_px)
    values, up, aside = over_headings(map_, look, _HALF_HEADING_RAD, _HEADINGS, tolerance_px)
    edges = np.degrees([aside[0], aside[-1], up[0], up[-1]])
    headings.imshow(values, origin="lower", extent=tuple(edges), cmap=_COLOURS, vmin=0, vmax=1)
    headings.plot(0, 0, "+", color="white")
    _label(headings, "over headings, from there, for the pixel", "azimuth, degrees", "elevation, degrees")
    bar = figure.colorbar(shown, ax=[picture, above, headings], shrink=0.8, pad=0.01)
    bar.set_label("ρ", color=MUTED)
    bar.outline.set_visible(False)


def _draw_picture(axes: Axes, map_: Map, look: Look, tolerance_px: float) -> Any:
    camera = look.camera
    values, _ = over_picture(map_, look, tolerance_px, max(camera.width, camera.height) / _PICTURE_STEPS)
    extent = (-0.5, camera.width - 0.5, camera.height - 0.5, -0.5)
    shown = axes.imshow(values, extent=extent, cmap=_COLOURS, vmin=0, vmax=1)
    axes.plot(*look.pixel, "+", color="white")
    _label(axes, "over the picture, for the pose", "u, px", "v, px")
    return shown


def _draw_positions(axes: Axes, map_: Map, look: Look, tolerance_px: float) -> None:
    """At the camera's height, from above."""
    landmark, position = map_.landmarks.positions[look.feature].astype(np.float64), look.T_map_camera[:3, 3]
    half = max(1.1 * float(np.linalg.norm(landmark[:2] - position[:2])), 0.5)
    centre = np.array([*(landmark[:2] + position[:2]) / 2, position[2]])
    grid = Grid.about(centre, (half, half, 0.0), 2 * half / _STEPS)
    values = over_positions(map_, look, grid, tolerance_px)[0]
    x, y, _ = grid.axes
    axes.imshow(values, origin="lower", extent=(x[0], x[-1], y[0], y[-1]), cmap=_COLOURS, vmin=0, vmax=1)
    may = seen_from(map_, look.feature, grid)[0]
    if may.any() and not may.all():
        axes.contour(x, y, may, levels=[0.5], colors="white", linewidths=0.8, linestyles=":")
    mine = np.unique(map_.observations.views[map_.observations.features == look.feature])
    axes.plot(*map_.views.positions[mine, :2].T, ".", color="#7fd1c7", markersize=3)
    axes.plot(*landmark[:2], "*", color="white", markersize=9)
    _draw_camera(axes, look.T_map_camera, half)
    axes.set_xlim(x[0], x[-1])
    axes.set_ylim(y[0], y[-1])
    axes.set_aspect("equal")
    draw_scale_bar(axes, x[0] + 0.1 * half, y[0] + 0.12 * half, 2 * half, _unit(map_))
    axes.lines[-1].set_color("white")
    axes.texts[-1].set_color("white")
    _label(axes, "over positions, at its height, for the pixel", "", "")
    axes.set_xticks([])
    axes.set_yticks([])


@dataclass(frozen=True)
class _Shot:
    """One picture of a film: an ascent, and how many of its steps have been made."""

    ascent: int
    steps: int


def ascent_frames(map_: Map, ascents: Sequence[Ascent], title: str) -> Iterator[ByteArray]:
    """A localization as a film: the product (2) over positions while each start climbs; pictures (H, W, 3), RGB.

    The ascents come in the order in which they are shown, the best last. The landscape is that of cameras turned as the
    one that climbs is at that moment, with the tolerance of that moment.
    """
    grid = _around(ascents)
    for number, ascent in enumerate(ascents):
        for done in range(1, len(ascent.steps) + 1):
            yield _pixels(_ascent_figure(map_, ascents, _Shot(number, done), grid, title))


def ascent_png(map_: Map, ascents: Sequence[Ascent], title: str) -> bytes:
    """Where the ascents of a frame led, over the product (2) at the end of the best of them, the last: a PNG."""
    shot = _Shot(len(ascents) - 1, len(ascents[-1].steps))
    return png_of(_ascent_figure(map_, ascents, shot, _around(ascents), title))


def _around(ascents: Sequence[Ascent]) -> Grid:
    """A square, at the height of the best optimum, that holds the ways of all ascents that end near it."""
    best = ascents[-1].optimum.T_map_camera[:3, 3]
    return Grid.around_ways(best, [ascent.positions for ascent in ascents], _STEPS // 2)


def _ascent_figure(map_: Map, ascents: Sequence[Ascent], shot: _Shot, grid: Grid, title: str) -> Figure:
    ascent = ascents[shot.ascent]
    step = ascent.steps[shot.steps - 1]
    figure = figure_of((7.2, 6.4), 100)
    axes = figure.add_subplot()
    values = product_over_positions(map_, ascent.evidence, step.T_map_camera, grid, step.tolerance_px)[0]
    x, y, _ = grid.axes
    shown = axes.imshow(values, origin="lower", extent=(x[0], x[-1], y[0], y[-1]), cmap=_COLOURS, vmin=0)
    for number in range(shot.ascent + 1):
        steps = ascents[number].steps[: shot.steps] if number == shot.ascent else ascents[number].steps
        way = np.array([one.T_map_camera[:3, 3] for one in steps])
        colour = "#7fd1c7" if number == shot.ascent else "#9aa5b1"
        axes.plot(way[:, 0], way[:, 1], ".-", color=colour, linewidth=1.2, markersize=4)
        axes.plot(*way[0, :2], "o", color=colour, markerfacecolor="none", markersize=8)
    _draw_camera(axes, step.T_map_camera, float(x[-1] - x[0]) / 2)
    axes.set_xlim(x[0], x[-1])
    axes.set_ylim(y[0], y[-1])
    draw_scale_bar(axes, x[0] + 0.05 * (x[-1] - x[0]), y[0] + 0.06 * (y[-1] - y[0]), float(x[-1] - x[0]), _unit(map_))
    axes.lines[-1].set_color("white")
    axes.texts[-1].set_color("white")
    start = f"start {shot.ascent + 1} of {len(ascents)}, step {shot.steps - 1}, tolerance {step.tolerance_px:g} px"
    _label(axes, f"{title}: {start}", "", "")
    axes.set_xticks([])
    axes.set_yticks([])
    bar = figure.colorbar(shown, ax=axes, shrink=0.7, pad=0.02)
    bar.set_label("Σ log((ε + ρ) / ε), nats", color=MUTED)
    bar.outline.set_visible(False)
    return figure


def sharpening_png(
    bearings: FloatArray, positions: FloatArray, sigma_rad: float, counts: Sequence[int], title: str
) -> bytes:
    """A ``ray`` density that sharpens with observations: over positions in the landmark's plane, a panel per count.

    What is drawn is where the landmark may be, by the information sums over the first observations: three standard
    deviations wide.

    Args:
        bearings: (N, 3) unit vectors in the map frame, in the order that they came.
        positions: (N, 3) metres.
        sigma_rad: of a bearing.
        counts: after how many observations to draw.
        title: above it.
    """
    whole, _ = _estimate(bearings, positions, sigma_rad, len(bearings))
    estimates = [_estimate(bearings, positions, sigma_rad, count) for count in counts]
    half = 1.3 * max(float(np.sqrt(np.linalg.eigvalsh(estimates[0][1][:2, :2])[-1])) * 3, 0.02)
    half = min(half, 1.5 * float(np.linalg.norm(positions - whole, axis=1).max()))
    figure = figure_of((2.9 * len(counts) + 3.4, 3.6), 110)
    panels = figure.subplots(1, len(counts) + 1, width_ratios=[*([1.0] * len(counts)), 1.2])
    figure.suptitle(title, x=0.01, ha="left", color=INK, fontweight="bold")
    line = np.linspace(-half, half, 161)
    gx, gy = np.meshgrid(whole[0] + line, whole[1] + line)
    for axes, count, (mean, covariance) in zip(panels[:-1], counts, estimates, strict=True):
        offset = np.stack([gx - mean[0], gy - mean[1]], axis=-1)
        squared = np.einsum("...i,ij,...j->...", offset, np.linalg.inv(covariance[:2, :2]), offset)
        extent = (-100 * half, 100 * half, -100 * half, 100 * half)
        axes.imshow(np.maximum(1 - squared / 9, 0), origin="lower", extent=extent, cmap=_COLOURS, vmin=0, vmax=1)
        axes.plot(0, 0, "+", color="white")
        _label(axes, f"{count} observations", "cm", "")
    numbers = np.arange(max(2, counts[0]), len(bearings) + 1)
    found = [_estimate(bearings, positions, sigma_rad, int(count)) for count in numbers]
    sigmas = [100 * float(np.sqrt(np.trace(covariance) / 3)) for _, covariance in found]
    off = [100 * float(np.linalg.norm(mean - whole)) for mean, _ in found]
    panels[-1].loglog(numbers, sigmas, color=INK, label="one sigma, by Λ⁻¹")
    panels[-1].loglog(numbers[:-1], off[:-1], color=MARKED, label="from where all have it")
    for axis in (panels[-1].xaxis, panels[-1].yaxis):
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
    panels[-1].legend(fontsize=7, frameon=False)
    _label(panels[-1], "the landmark, cm", "observations", "")
    return png_of(figure)


def _estimate(
    bearings: FloatArray, positions: FloatArray, sigma_rad: float, count: int
) -> tuple[FloatArray, FloatArray]:
    """The landmark (3,) and its covariance (3, 3) by the first ``count`` observations."""
    weights = np.ones(count)
    for _ in range(3):  # a bearing's error is an angle: its weight follows from the distance
        information, eta = observation_information(bearings[:count], positions[:count], weights)
        means, covariances = landmarks_from_information(information.sum(axis=0)[None], eta.sum(axis=0)[None])
        weights = 1 / (sigma_rad * np.linalg.norm(means[0] - positions[:count], axis=1)) ** 2
        if not np.isfinite(weights).all():
            break
    return means[0], covariances[0]


def _draw_camera(axes: Axes, T_map_camera: FloatArray, half: float) -> None:
    pose = Pose(T_map_camera)
    x, y = pose.position[:2]
    hx, hy = 0.18 * half * pose.heading[:2]
    axes.plot(x, y, "o", color=MARKED, markersize=5)
    axes.annotate("", (x + hx, y + hy), (x, y), arrowprops={"arrowstyle": "->", "color": MARKED, "linewidth": 1.5})


def _label(axes: Axes, title: str, x: str, y: str) -> None:
    axes.set_title(title, loc="left", fontsize=9, color=INK)
    axes.set_xlabel(x, fontsize=8, color=MUTED)
    axes.set_ylabel(y, fontsize=8, color=MUTED)
    axes.tick_params(labelsize=7, colors=MUTED)


def _unit(map_: Map) -> str:
    return "m" if map_.info.metric else "units"


def _pixels(figure: Figure) -> ByteArray:
    canvas: Any = figure.canvas
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[:, :, :3].copy()
