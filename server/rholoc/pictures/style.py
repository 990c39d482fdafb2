"""The style of all pictures: colours, figures, scale bars."""

import io

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import findfont
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from rholoc.geometry import FloatArray, IntArray

INK = "#22303c"
MUTED = "#7b8794"
MARKED = "#d1495b"
GREEN = "#1a7f5a"
BLUE = "#2a6fb0"
TEAL = "#00798c"
AMBER = "#f2a71b"

_BAR_LENGTHS_M = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500)


def figure_of(size_inches: tuple[float, float] | None, dpi: int) -> Figure:
    """A white figure that is drawn without a display; ``size_inches`` is width and height, None: matplotlib's own."""
    figure = Figure(figsize=size_inches, dpi=dpi, facecolor="white")
    FigureCanvasAgg(figure)
    figure.set_layout_engine("constrained")
    return figure


def missing_fonts() -> list[str]:
    """Names of the fonts that pictures need (DejaVu Sans and DejaVu Sans Mono) and that are not installed."""
    missing = []
    for family in ("DejaVu Sans", "DejaVu Sans Mono"):
        try:
            findfont(family, fallback_to_default=False)
        except ValueError:
            missing.append(family)
    return missing


def png_of(figure: Figure) -> bytes:
    """Content of a PNG file of a figure."""
    png = io.BytesIO()
    figure.savefig(png, format="png")
    return png.getvalue()


def draw_views(
    axes: Axes, places: FloatArray, walks: IntArray, linewidth: float, zorder: int, halo: float = 0.0
) -> None:
    """Draw the positions ``places`` (N, 2) of views with walk numbers ``walks`` (N,).

    A walk of several views is a line with a ring at its start; a walk of one view is a point. ``halo`` is the total
    width of a white border around the lines, 0 for none.
    """
    around = [withStroke(linewidth=halo, foreground="white")] if halo else []
    numbers, counts = np.unique(walks, return_counts=True)
    for number in numbers[counts > 1]:
        walk = places[walks == number]
        axes.plot(*walk.T, color=INK, linewidth=linewidth, zorder=zorder, path_effects=around)
        axes.plot(*walk[0], marker="o", markersize=6, color=INK, markerfacecolor="white", zorder=zorder + 2)
    if np.any(counts == 1):
        single = places[np.isin(walks, numbers[counts == 1])]
        axes.plot(*single.T, ".", color=INK, markersize=5, zorder=zorder)


def draw_scale_bar(axes: Axes, x: float, y: float, width: float, unit: str, fontsize: float = 9) -> None:
    """Draw a bar from (x, y) to the right, of a round length up to ``width`` / 4 (but at least 0.1), data units."""
    length = max((bar for bar in _BAR_LENGTHS_M if bar <= width / 4), default=_BAR_LENGTHS_M[0])
    axes.add_line(Line2D([x, x + length], [y, y], color=INK, linewidth=2.5, solid_capstyle="butt"))
    axes.annotate(
        f"{length:g} {unit}", (x + length, y), (5, 0), textcoords="offset points", va="center", fontsize=fontsize
    )
