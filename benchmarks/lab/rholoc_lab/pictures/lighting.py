"""Heat maps of the lighting experiments."""

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rholoc.geometry import FloatArray
from rholoc.pictures.style import figure_of
from rholoc_lab.evaluation.lighting import LightPair
from rholoc_lab.evaluation.lighting_pairs import ScenePair

_DARK = 0.55  # of the scale: text turns white above


def plot_lights(pairs: Sequence[LightPair]) -> Figure:
    """For every extractor (columns) and figure (rows) a matrix: map's light down, queries' light across."""
    names = list(dict.fromkeys(pair.features for pair in pairs))
    lights = list(dict.fromkeys(pair.map_light for pair in pairs))
    asked = list(dict.fromkeys(pair.query_light for pair in pairs))
    rows: list[tuple[str, Callable[[LightPair], float | None], float, str]] = [
        ("repeatability (%)", lambda p: _percent(p.redetection.repeatability), 100, "{:.0f}"),
        ("match precision (%)", lambda p: _percent(p.redetection.precision), 100, "{:.0f}"),
        ("within 5 cm, 5° (%)", lambda p: 100 * p.recall, 100, "{:.0f}"),
        ("median error (cm)", lambda p: p.median_cm, 5, "{:.1f}"),
    ]
    figure = figure_of((2.1 * len(names) + 1.2, 8.2), 130)
    panels = figure.subplots(len(rows), len(names), squeeze=False)
    for row, (line, (title, value, top, form)) in enumerate(zip(panels, rows, strict=True)):
        for column, (axes, name) in enumerate(zip(line, names, strict=True)):
            is_last = row == len(rows) - 1
            cells = {(p.map_light, p.query_light): value(p) for p in pairs if p.features == name}
            matrix = np.array([[_or_nan(cells.get((a, b))) for b in asked] for a in lights])
            _draw_matrix(axes, matrix, top, form)
            axes.set_xticks(range(len(asked)), asked if is_last else [""] * len(asked), fontsize=7)
            axes.set_yticks(range(len(lights)), lights if column == 0 else [""] * len(lights), fontsize=7)
            if row == 0:
                axes.set_title(name, fontsize=10)
        line[0].set_ylabel(f"{title}\nmap by", fontsize=8)
    figure.supxlabel("queries by", fontsize=8)
    return figure


def plot_scenes(pairs: Sequence[ScenePair]) -> Figure:
    """Scenes down, extractors across: repeatability and precision where registered, precision in stereo."""
    names = list(dict.fromkeys(pair.features for pair in pairs))
    scenes = list(dict.fromkeys(pair.scene for pair in pairs))
    figures: list[tuple[str, Callable[[ScenePair], float | None]]] = [
        ("repeatability, registered (%)", lambda p: None if p.registered is None else p.registered.repeatability),
        ("match precision, registered (%)", lambda p: None if p.registered is None else p.registered.precision),
        ("match precision, stereo (%)", lambda p: p.stereo_precision),
    ]
    figure = figure_of((11, 1.0 + 0.75 * len(scenes)), 130)
    for axes, (title, value) in zip(figure.subplots(1, len(figures), squeeze=False)[0], figures, strict=True):
        cells = {(p.scene, p.features): _percent(value(p)) for p in pairs}
        matrix = np.array([[_or_nan(cells.get((scene, name))) for name in names] for scene in scenes])
        _draw_matrix(axes, matrix, 100, "{:.0f}")
        axes.set_xticks(range(len(names)), names, fontsize=8)
        axes.set_yticks(range(len(scenes)), scenes, fontsize=8)
        axes.set_title(title, fontsize=9)
    return figure


def _draw_matrix(axes: Axes, matrix: FloatArray, top: float, form: str) -> None:
    axes.set_facecolor("0.93")  # where there is no figure
    axes.imshow(matrix, cmap="YlGnBu", vmin=0, vmax=top, aspect="auto")
    for (i, j), value in np.ndenumerate(matrix):
        text = "–" if np.isnan(value) else form.format(value)
        dark = not np.isnan(value) and value > _DARK * top
        axes.text(j, i, text, ha="center", va="center", fontsize=8, color="white" if dark else "black")
    axes.tick_params(length=0)


def _percent(share: float | None) -> float | None:
    return None if share is None else 100 * share


def _or_nan(value: float | None) -> float:
    return float("nan") if value is None else value
