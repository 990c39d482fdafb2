"""A recording as a picture: IMU, intervals between frames, waypoints and pauses on one axis of time.

Not imported with the package, for matplotlib's sake.
"""

from __future__ import annotations

import io

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from rholoc.geometry import FloatArray
from rholoc.recordings.recording import FrameSource, Imu, Recording, Waypoint
from rholoc.recordings.stillness import pauses

_SIZE_PX = (1600, 1080)
_DPI = 120
_INK = "#22303c"
_MUTED = "#7b8794"
_MARKED = "#d1495b"
_RESTED = "#e3efe8"
_AXES = (("x", "#d1495b"), ("y", "#1a7f5a"), ("z", "#2a6fb0"))
_MARGIN_S = 1.0  # shown before the first frame and after the last
_MOST_POINTS = 6000  # a line; more cannot be seen


def recording_png(recording: Recording) -> bytes:
    """Acceleration, turning and frame intervals over time as a PNG; waypoints as lines, pauses shaded."""
    figure = Figure(figsize=(_SIZE_PX[0] / _DPI, _SIZE_PX[1] / _DPI), dpi=_DPI, facecolor="white")
    FigureCanvasAgg(figure)
    figure.set_layout_engine("constrained", h_pad=0.08)
    title = f"{recording.name} ({recording.format.value})"
    figure.suptitle(title, x=0.012, ha="left", fontsize=15, fontweight="bold", color=_INK)
    axes = figure.subplots(3, 1, sharex=True)
    start_s = float(recording.frames.times[0])
    _plot_imu(axes[0], axes[1], recording.imu, start_s)
    _plot_intervals(axes[2], recording.frames, start_s)
    for axis in axes:
        _mark(axis, recording, start_s)
        axis.spines[["top", "right"]].set_visible(False)
        axis.tick_params(colors=_MUTED)
    for waypoint in _timed(recording):
        position = (waypoint.time - start_s, 1.02)
        axes[0].annotate(waypoint.name, position, xycoords=("data", "axes fraction"), ha="center", color=_MARKED)
    span_s = float(recording.frames.times[-1]) - start_s
    axes[2].set_xlim(-_MARGIN_S, span_s + _MARGIN_S)
    axes[2].set_xlabel(f"seconds since the first frame, at {start_s:.3f} s", color=_INK)
    png = io.BytesIO()
    figure.savefig(png, format="png")
    return png.getvalue()


def _plot_imu(force: Axes, turn: Axes, imu: Imu | None, start_s: float) -> None:
    force.set_ylabel("acceleration [m/s²]", color=_INK)
    turn.set_ylabel("turning [°/s]", color=_INK)
    if imu is None:
        for axis in (force, turn):
            axis.text(0.5, 0.5, "no IMU", transform=axis.transAxes, ha="center", color=_MUTED)
        return
    step = max(1, len(imu.times) // _MOST_POINTS)
    times = imu.times[::step] - start_s
    _plot_vectors(force, times, imu.acceleration[::step])
    _plot_vectors(turn, times, np.degrees(imu.angular_velocity[::step]))
    turn.legend(loc="upper right", ncols=4, frameon=True, framealpha=0.85, edgecolor="none")


def _plot_vectors(axis: Axes, times: FloatArray, values: FloatArray) -> None:
    for place, (name, colour) in enumerate(_AXES):
        axis.plot(times, values[:, place], color=colour, linewidth=0.8, label=name)
    axis.plot(times, np.linalg.norm(values, axis=1), color=_INK, linewidth=0.6, alpha=0.6, label="length")


def _plot_intervals(axis: Axes, frames: FrameSource, start_s: float) -> None:
    axis.set_ylabel("frame interval [ms]", color=_INK)
    intervals_ms = 1000 * np.diff(frames.times)
    axis.plot(frames.times[1:] - start_s, intervals_ms, ".", markersize=3, color=_INK)
    axis.set_ylim(0, 1.15 * float(intervals_ms.max(initial=1.0)))


def _mark(axis: Axes, recording: Recording, start_s: float) -> None:
    if recording.imu is not None:
        for begin, end in pauses(recording.imu) - start_s:
            axis.axvspan(begin, end, color=_RESTED, zorder=0)
    for waypoint in _timed(recording):
        axis.axvline(waypoint.time - start_s, color=_MARKED, linewidth=1.0, linestyle="--")


def _timed(recording: Recording) -> list[Waypoint]:
    return [waypoint for waypoint in recording.waypoints if not np.isnan(waypoint.time)]
