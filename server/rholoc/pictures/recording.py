"""A recording as a picture: IMU, intervals between frames, waypoints and pauses on one axis of time."""

import numpy as np
from matplotlib.axes import Axes

from rholoc.geometry import FloatArray
from rholoc.pictures.style import BLUE, GREEN, INK, MARKED, MUTED, figure_of, png_of
from rholoc.recordings.recording import FrameSource, Imu, Recording, Waypoint
from rholoc.recordings.walk.stillness import pauses

_SIZE_PX = (1600, 1080)
_DPI = 120
_RESTED = "#e3efe8"
_AXES = (("x", MARKED), ("y", GREEN), ("z", BLUE))
_MARGIN_S = 1.0  # shown before the first frame and after the last
_MAX_POINTS = 6000  # a line; more cannot be seen


def recording_png(recording: Recording) -> bytes:
    """PNG of acceleration, angular velocity and frame intervals over time; waypoints as lines, pauses shaded."""
    figure = figure_of((_SIZE_PX[0] / _DPI, _SIZE_PX[1] / _DPI), _DPI)
    figure.set_layout_engine("constrained", h_pad=0.08)
    title = f"{recording.name} ({recording.format.value})"
    figure.suptitle(title, x=0.012, ha="left", fontsize=15, fontweight="bold", color=INK)
    axes = figure.subplots(3, 1, sharex=True)
    start_s = float(recording.frames.times[0])
    _plot_imu(axes[0], axes[1], recording.imu, start_s)
    _plot_intervals(axes[2], recording.frames, start_s)
    for axis in axes:
        _mark(axis, recording, start_s)
        axis.spines[["top", "right"]].set_visible(False)
        axis.tick_params(colors=MUTED)
    for waypoint in _timed(recording):
        position = (waypoint.time - start_s, 1.02)
        axes[0].annotate(waypoint.name, position, xycoords=("data", "axes fraction"), ha="center", color=MARKED)
    span_s = float(recording.frames.times[-1]) - start_s
    axes[2].set_xlim(-_MARGIN_S, span_s + _MARGIN_S)
    axes[2].set_xlabel(f"seconds since the first frame, at {start_s:.3f} s", color=INK)
    return png_of(figure)


def _plot_imu(force: Axes, turn: Axes, imu: Imu | None, start_s: float) -> None:
    """Plot acceleration and angular velocity over the seconds since ``start_s``, or say that there is no IMU."""
    force.set_ylabel("acceleration [m/s²]", color=INK)
    turn.set_ylabel("turning [°/s]", color=INK)
    if imu is None:
        for axis in (force, turn):
            axis.text(0.5, 0.5, "no IMU", transform=axis.transAxes, ha="center", color=MUTED)
        return
    step = max(1, len(imu.times) // _MAX_POINTS)
    times = imu.times[::step] - start_s
    _plot_vectors(force, times, imu.acceleration[::step])
    _plot_vectors(turn, times, np.degrees(imu.angular_velocity[::step]))
    turn.legend(loc="upper right", ncols=4, frameon=True, framealpha=0.85, edgecolor="none")


def _plot_vectors(axis: Axes, times: FloatArray, values: FloatArray) -> None:
    """Plot the components and lengths of vectors (N, 3) over times (N,) [s]."""
    for place, (name, colour) in enumerate(_AXES):
        axis.plot(times, values[:, place], color=colour, linewidth=0.8, label=name)
    axis.plot(times, np.linalg.norm(values, axis=1), color=INK, linewidth=0.6, alpha=0.6, label="length")


def _plot_intervals(axis: Axes, frames: FrameSource, start_s: float) -> None:
    """Plot the intervals between frames [ms] over the seconds since ``start_s``, or say that there are no times."""
    axis.set_ylabel("frame interval [ms]", color=INK)
    if not frames.timed:
        axis.text(0.5, 0.5, "no times", transform=axis.transAxes, ha="center", color=MUTED)
        return
    intervals_ms = 1000 * np.diff(frames.times)
    axis.plot(frames.times[1:] - start_s, intervals_ms, ".", markersize=3, color=INK)
    axis.set_ylim(0, 1.15 * float(intervals_ms.max(initial=1.0)))


def _mark(axis: Axes, recording: Recording, start_s: float) -> None:
    """Draw pauses and waypoints, at seconds after ``start_s``."""
    if recording.imu is not None:
        for begin, end in pauses(recording.imu) - start_s:
            axis.axvspan(begin, end, color=_RESTED, zorder=0)
    for waypoint in _timed(recording):
        axis.axvline(waypoint.time - start_s, color=MARKED, linewidth=1.0, linestyle="--")


def _timed(recording: Recording) -> list[Waypoint]:
    """The waypoints whose time is known."""
    return [waypoint for waypoint in recording.waypoints if not np.isnan(waypoint.time)]
