"""``rholoc evaluate-track``: runs a tracker over a recording."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rholoc.cli import options
from rholoc.cli.console import frame_progress, output, print_figures, print_json, print_notice
from rholoc.cli.localize import recording_camera
from rholoc.errors import InvalidInput

if TYPE_CHECKING:
    import numpy as np

    from rholoc.geometry import FloatArray
    from rholoc.recordings import FrameSource
    from rholoc_lab.evaluation.tracking import Outage, TrackRun

_UNITS = {"median_cm": "cm", "p90_cm": "cm", "worst_cm": "cm", "worst_deg": "°", "answer_ms": "ms"}


def evaluate_track(
    map_file: options.MapFile,
    source: options.Source,
    motion: options.MotionOption = None,
    odometry: Annotated[
        Path | None,
        typer.Option(metavar="POSES", help="Poses by odometry, in a frame of their own: poses.txt or Table 6 CSV."),
    ] = None,
    drift: Annotated[
        float | None,
        typer.Option(min=0, max=50, metavar="PERCENT", help="Simulate odometry: the truth, with this much drift."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="--drift: another seed drifts another way.")] = 0,
    truth: Annotated[
        Path | None,
        typer.Option(metavar="POSES", help="True poses: poses.txt or Table 6 CSV; default: the recording's own."),
    ] = None,
    latency: Annotated[
        float | None,
        typer.Option(min=0, metavar="MS", help="How late answers come; default: as long as they take here."),
    ] = None,
    outage: Annotated[
        list[str] | None,
        typer.Option(metavar="START:STOP", help="Seconds between which nothing is answered; may be given again."),
    ] = None,
    frames: options.Frames = None,
    camera: options.Camera = None,
    topic: options.Topics = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="CSV", help="Where the trajectory goes (Table 6).")
    ] = None,
    plot: Annotated[Path | None, typer.Option(metavar="PNG", help="Where a plot of the errors goes.")] = None,
    as_json: options.Json = False,
) -> None:
    """Track a camera through a recording as a robot would, and print the error at every frame."""
    import numpy as np

    from rholoc.localization import localizer_of
    from rholoc.maps import load_map
    from rholoc.recordings import read_recording
    from rholoc.tracking.moments import Motion
    from rholoc_lab.evaluation.tracking import drifting_odometry, run_tracker

    localizer = localizer_of(load_map(map_file))
    recording = read_recording(source, camera=options.named_camera(camera), frames=frames, topics=topic or ())
    true_poses = None if recording.poses is None else recording.poses.T_map_camera
    if truth is not None:
        true_poses = _poses_of(truth, recording.frames)
    moves = None if odometry is None else _poses_of(odometry, recording.frames)
    if drift is not None:
        if true_poses is None or not np.isfinite(true_poses).all():
            raise InvalidInput("Odometry cannot be simulated: not every frame's true pose is known.", "Give --truth.")
        moves = drifting_odometry(true_poses, drift / 100, seed)
    if motion is None:
        chosen = Motion.PICTURES if moves is None else Motion.ODOMETRY
    else:
        chosen = options.choice(Motion, motion, "--motion")
    if chosen is Motion.ODOMETRY and moves is None:
        if recording.poses is None:
            raise InvalidInput("There is no odometry.", "Give --odometry or --drift, or a recording with poses.")
        moves, true_poses = recording.poses.T_map_camera, None if truth is None else true_poses
    with frame_progress("tracking", len(recording.frames.times)) as advance:
        run = run_tracker(
            localizer,
            recording,
            recording_camera(recording, localizer.map.info),
            chosen,
            odometry=moves if chosen is Motion.ODOMETRY else None,
            truth=true_poses,
            latency_s=None if latency is None else latency / 1000,
            outages=tuple(_outage(text) for text in outage or ()),
            advance=advance,
        )
    if out is not None:
        _write(out, run, recording.frames.numbers)
    if plot is not None:
        _plot(plot, run, true_poses, f"{source.name} in {map_file.name}, {chosen}")
    rows = _rows(run, recording.frames.numbers)
    figures = {"motion": str(chosen), **run.figures()}
    if as_json:
        print_json({**figures, "each": rows})
        return
    for row in rows:
        output.print(_line(row), markup=False, soft_wrap=True)
    shown = {
        name: "–" if value is None else f"{value} {_UNITS.get(name, '')}".strip() for name, value in figures.items()
    }
    print_figures(f"{source} in {map_file.name}", shown)
    if true_poses is None:
        print_notice("The true poses are not known: there are no errors. Give --truth.")


def _outage(text: str) -> Outage:
    from rholoc_lab.evaluation.tracking import Outage

    found = re.fullmatch(r"(\d+(?:\.\d+)?):(\d+(?:\.\d+)?)", text)
    if found is None or float(found[1]) >= float(found[2]):
        raise typer.BadParameter(f"'{text}' is not START:STOP in seconds.", param_hint="--outage")
    return Outage(float(found[1]), float(found[2]))


def _poses_of(path: Path, frames: FrameSource) -> FloatArray:
    """The poses (N, 4, 4) of a table for the recording's frames, by number or time; NaN where it has none."""
    import numpy as np

    from rholoc.evaluation import FramePoses, pair_poses, read_frame_poses

    nothing = np.zeros((len(frames.times), 4, 4))
    rows = np.arange(len(frames.times))
    nothing[:, 0, 3] = rows  # which frame each pair is of
    table = read_frame_poses(path)
    own = FramePoses(nothing, frames.numbers if table.frames is not None else None, frames.times)
    pairs = pair_poses(own, table)
    found = np.full((len(frames.times), 4, 4), np.nan)
    known = np.isfinite(pairs.estimated[:, 0, 3])
    found[pairs.estimated[known, 0, 3].astype(np.int64)] = pairs.truth[known]
    return found


def _rows(run: TrackRun, numbers: np.ndarray) -> list[dict[str, float | int | str | None]]:
    asked = set(run.asked)
    return [
        {
            "frame": int(number),
            "time_s": round(float(run.times[row]), 4),
            "status": str(said.status),
            "error_cm": _rounded(100 * run.position_m[row]),
            "error_deg": _rounded(run.rotation_rad[row] * 57.29578),
            "expected_cm": _rounded(100 * sigma),
            "asked": row in asked,
            "reset_counter": said.reset_counter,
        }
        for row, (number, said, sigma) in enumerate(zip(numbers, run.tracked, run.sigma_m, strict=True))
    ]


def _rounded(value: float) -> float | None:
    return None if value != value else round(float(value), 2)


def _line(row: dict[str, float | int | str | None]) -> str:
    def shown(name: str, unit: str) -> str:
        value = row[name]
        return f"{'–':>6} {unit}" if value is None else f"{value:6.2f} {unit}"

    parts = [f"{row['frame']:6} {row['time_s']:9.3f} s  {row['status']:9}", shown("error_cm", "cm")]
    parts += [shown("error_deg", "°"), f"expected {shown('expected_cm', 'cm')}", "asked" if row["asked"] else ""]
    return "  ".join(parts).rstrip()


def _write(path: Path, run: TrackRun, numbers: np.ndarray) -> None:
    import numpy as np

    from rholoc.maps import TrajectoryTable, write_trajectory_csv

    T = run.T_map_camera
    placed = np.flatnonzero(np.isfinite(T).all(axis=(1, 2)))
    nothing = np.full(len(placed), np.nan)
    table = TrajectoryTable(
        run.times[placed], numbers[placed], T[placed], nothing, np.zeros(len(placed), dtype=np.int64), nothing,
        run.sigma_m[placed],
    )  # fmt: skip
    write_trajectory_csv(path, table)


def _plot(path: Path, run: TrackRun, truth: FloatArray | None, title: str) -> None:
    import numpy as np

    from rholoc.pictures.trajectories import save_figure
    from rholoc_lab.pictures.tracks import plot_track

    jumps = np.flatnonzero(np.diff([one.reset_counter for one in run.tracked])) + 1
    save_figure(plot_track(run.times, run.T_map_camera, run.sigma_m, run.asked, jumps.tolist(), truth, title), path)
