"""Plots of a comparison: recall curves, error by distance to the nearest view, the top view."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from rholoc.geometry import FloatArray
from rholoc.pictures.style import AMBER, MARKED, TEAL, figure_of
from rholoc_lab.evaluation.compare import RETRIEVAL, Comparison, MethodResult, SplitResult
from rholoc_lab.evaluation.pnp_baselines import MatchSet, Solver

_COLOURS = {
    "ray": MARKED,
    "tensor": "#7b2d8b",
    Solver.CV2: TEAL,
    Solver.POSELIB: "#2e7d32",
    RETRIEVAL: AMBER,
}
_DASHES = {MatchSet.EVERYWHERE: ":", MatchSet.DISTINCT: "--", MatchSet.PLACE: "-."}
_SMALLEST_CM, _LARGEST_CM = 0.3, 100.0
_MAX_ROTATION_DEG = 10.0
_BINS = 6


def plot_recall(split: SplitResult) -> Figure:
    """The share of queries within a position error, against that error; rotation within 10°.

    Two panels: methods as they are, and PnP refined by the density; ``ray`` stands in both.
    """
    figure = _figure((11, 4.6))
    panels = figure.subplots(1, 2, sharey=True)
    for axes, refined in zip(panels, (False, True), strict=True):
        for method in split.methods:
            plain = method.name in ("ray", "tensor", RETRIEVAL)
            if method.name == "ray" or (plain and not refined) or (not plain and _is_refined(method) == refined):
                _draw_recall(axes, method)
        axes.set(xscale="log", xlim=(_SMALLEST_CM, _LARGEST_CM), ylim=(0, 1.02), xlabel="position error (cm)")
        axes.set_title("PnP refined by the density" if refined else "without refinement by the density", fontsize=10)
        axes.set_xticks([0.5, 1, 2, 5, 10, 25, 100], ["0.5", "1", "2", "5", "10", "25", "100"])
        axes.grid(alpha=0.25, lw=0.5)
        axes.legend(fontsize=7, loc="lower right")
    panels[0].set_ylabel(f"share of {len(split.truth)} queries within it (and 10°)")
    figure.suptitle(f"queries {split.label}", fontsize=11)
    return figure


def plot_error_by_distance(split: SplitResult) -> Figure:
    """Position errors against the distance to the map's nearest view: every query of ``ray``, and medians of all."""
    figure = _figure((8, 5))
    axes = figure.add_subplot()
    edges = np.quantile(split.view_distance, np.linspace(0, 1, _BINS + 1))
    centres = 0.5 * (edges[1:] + edges[:-1])
    bins = np.clip(np.searchsorted(edges, split.view_distance, side="right") - 1, 0, _BINS - 1)
    for method in _main_methods(split):
        error_cm = np.clip(100 * method.errors.position_m, _SMALLEST_CM, _LARGEST_CM)
        medians = [np.median(error_cm[bins == b]) if (bins == b).any() else np.nan for b in range(_BINS)]
        axes.plot(centres, medians, marker="o", ms=4, label=method.name, **_style(method))
        if method.name == "ray":
            axes.plot(split.view_distance, error_cm, ".", ms=4, alpha=0.4, color=_COLOURS["ray"], zorder=1)
    axes.axhline(_LARGEST_CM, color="0.6", lw=0.8)
    axes.text(edges[0], _LARGEST_CM * 0.93, "no pose, or 1 m and more", fontsize=7, color="0.4", va="top")
    axes.set(yscale="log", xlabel="distance to the nearest view of the map (m + rad)", ylabel="position error (cm)")
    axes.set_yticks([0.5, 1, 2, 5, 10, 25, 100], ["0.5", "1", "2", "5", "10", "25", "100"])
    axes.set_title(f"queries {split.label}: dots are ray's, lines the medians of {_BINS} equal groups", fontsize=10)
    axes.grid(alpha=0.25, lw=0.5)
    axes.legend(fontsize=8)
    return figure


def plot_errors_from_above(comparison: Comparison, split: SplitResult) -> Figure:
    """The map's landmarks and views from above, and the queries coloured by their error, ``ray`` and its best rival."""
    rivals = sorted(
        (m for m in split.methods if m.name not in ("ray", "tensor") and not _is_refined(m)), key=_recall, reverse=True
    )
    shown = [method for method in split.methods if method.name == "ray"] + rivals[:1]
    low, high = _extent(comparison, split)
    across = high - low
    beside = across[0] < 1.3 * across[1]
    scale = 5.0 / max(across)
    size = across * scale + (1.6, 0.9)  # inches, room for the labels
    figure = _figure((2 * size[0] + 1, size[1] + 0.3) if beside else (size[0] + 2, 2 * size[1]))
    norm = LogNorm(0.5, 50)
    panels = figure.subplots(1, 2) if beside else figure.subplots(2, 1)
    for axes, method in zip(panels, shown, strict=True):
        _draw_from_above(axes, comparison, split, method, norm)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x (m)", ylabel="y (m)", aspect="equal")
    bar = figure.colorbar(ScalarMappable(norm, "plasma_r"), ax=figure.axes, shrink=0.7)
    bar.set_label("position error (cm)")
    bar.set_ticks([0.5, 1, 2, 5, 10, 25, 50], labels=["0.5", "1", "2", "5", "10", "25", "50"])
    return figure


def _draw_recall(axes: Axes, method: MethodResult) -> None:
    rotated = np.degrees(method.errors.rotation_rad) > _MAX_ROTATION_DEG
    error_cm = np.sort(np.where(rotated, np.inf, 100 * method.errors.position_m))
    share = np.arange(1, len(error_cm) + 1) / len(error_cm)
    finite = np.isfinite(error_cm)
    x = np.concatenate([[_SMALLEST_CM], error_cm[finite], [_LARGEST_CM]])
    y = np.concatenate([[0.0], share[finite], [share[finite][-1] if finite.any() else 0.0]])
    axes.step(x, y, where="post", label=method.name, **_style(method))


def _draw_from_above(
    axes: Axes, comparison: Comparison, split: SplitResult, method: MethodResult, norm: LogNorm
) -> None:
    map_ = comparison.map_
    views, truth = map_.views.positions, split.truth
    axes.plot(*map_.landmarks.positions[:, :2].T, ".", ms=1, color="0.75", zorder=1)
    axes.plot(*views[:, :2].T, ".", ms=3, color="0.3", zorder=2, label=f"{len(views)} views of the map")
    placed = method.errors.localized
    axes.quiver(
        *truth[placed, :2, 3].T,
        *truth[placed, :2, 2].T,
        100 * method.errors.position_m[placed],
        norm=norm,
        cmap="plasma_r",
        angles="xy",
        width=0.006,
        scale=25,
        zorder=3,
    )
    if not placed.all():
        axes.plot(*truth[~placed, :2, 3].T, "x", color=MARKED, ms=6, zorder=4, label=f"{(~placed).sum()} no pose")
    axes.set_title(f"{method.name}: {100 * _recall(method):.0f} % within 5 cm and 5°", fontsize=10)
    axes.legend(fontsize=7, loc="upper left")


def _extent(comparison: Comparison, split: SplitResult) -> tuple[FloatArray, FloatArray]:
    """The corners (2,) of the picture: it shows all views and queries, and nearly all landmarks, without outliers that
    would shrink the rest."""
    map_ = comparison.map_
    bulk = np.percentile(map_.landmarks.positions[:, :2], [3, 97], axis=0)
    points = np.concatenate([map_.views.positions[:, :2], split.truth[:, :2, 3], bulk])
    return points.min(axis=0) - 0.2, points.max(axis=0) + 0.2


def _main_methods(split: SplitResult) -> Sequence[MethodResult]:
    """Without those refined by the density, and without the matches with which RANSAC does badly."""
    return [m for m in split.methods if not _is_refined(m) and MatchSet.EVERYWHERE not in m.name]


def _recall(method: MethodResult) -> float:
    return float(method.errors.within(0.05, 5.0).mean())


def _is_refined(method: MethodResult) -> bool:
    return method.name.endswith("+ density")


def _style(method: MethodResult) -> dict[str, Any]:
    name = method.name
    colour = next(colour for key, colour in _COLOURS.items() if name == key or name.startswith(f"{key},"))
    dash = next((dash for key, dash in _DASHES.items() if f", {key}" in name), "-")
    return {"color": colour, "ls": dash, "lw": 2.2 if name == "ray" else 1.3}


def _figure(size_inches: tuple[float, float]) -> Figure:
    return figure_of(size_inches, 130)
