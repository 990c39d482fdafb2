"""A tracker's run as a plot: its error at every frame, and how far it expected to be off."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from rholoc.geometry import FloatArray
from rholoc.pictures.style import AMBER, BLUE, GREEN, INK, MARKED, MUTED, figure_of


def plot_track(
    times: FloatArray,
    T_map_camera: FloatArray,
    sigma_m: FloatArray,
    asked: Sequence[int],
    jumps: Sequence[int],
    truth: FloatArray | None = None,
    title: str = "",
) -> Figure:
    """The error over time beside the expected one, where the tracker asked and jumped; and the path from above.

    Args:
        times: (N,) seconds.
        T_map_camera: (N, 4, 4), NaN where there is no pose.
        sigma_m: (N,) how far each pose is expected to be off, metres.
        asked: rows of the frames that it asked with.
        jumps: rows at which its reset counter went up.
        truth: (N, 4, 4) the true poses, or None.
        title: a line above the plot.
    """
    figure = figure_of((11, 4.5), 120)
    over_time, above = figure.subplots(1, 2, width_ratios=(1.6, 1))
    seconds = times - times[0]
    over_time.plot(seconds, 100 * sigma_m, color=MUTED, lw=1, label="expected (root mean square)")
    if truth is not None:
        error_m = np.linalg.norm(T_map_camera[:, :3, 3] - truth[:, :3, 3], axis=1)
        over_time.plot(seconds, 100 * error_m, color=MARKED, lw=1.3, label="error")
        above.plot(*truth[:, :2, 3].T, color=INK, lw=1.2, label="true path")
    over_time.plot(seconds[list(asked)], np.zeros(len(asked)), "|", color=BLUE, ms=9, label="asked")
    for row in jumps:
        over_time.axvline(seconds[row], color=AMBER, lw=1)
    over_time.set(xlabel="s", ylabel="cm", ylim=(0, None), title=title)
    over_time.grid(alpha=0.25, lw=0.5)
    over_time.legend(loc="upper right", fontsize=8)
    above.plot(*T_map_camera[:, :2, 3].T, color=GREEN, lw=1.2, label="tracked")
    above.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    above.grid(alpha=0.25, lw=0.5)
    above.legend(loc="upper left", fontsize=8)
    return figure
