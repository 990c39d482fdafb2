"""``rholoc recording flow``: a recording's optical flow, sparse and dense, and the odometry that follows from it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rholoc.cli import options
from rholoc.cli.console import print_figures, print_json, print_notice, stage_progress
from rholoc.errors import MappingFailed

if TYPE_CHECKING:
    from rholoc.progress import ProgressListener
    from rholoc.recordings import Recording
    from rholoc.trajectory import Trajectory
    from rholoc.trajectory.visual.flow import Flow


def flow(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="A video, a folder of images, a recording's folder or ZIP file.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="DIR", help="A folder for tables and pictures.")],
    pictures: Annotated[int, typer.Option(min=0, max=1000, help="Of how many frames, evenly spread.")] = 10,
    fields: Annotated[bool, typer.Option("--fields", help="Write the dense fields too, as .flo files.")] = False,
    odometry: Annotated[bool, typer.Option(help="Also find the poses that follow from the tracks.")] = True,
    frames: options.Frames = None,
    camera: options.Camera = None,
    as_json: options.Json = False,
) -> None:
    """Write a recording's optical flow: tracks, dense fields, and the odometry that follows from the tracks."""
    import numpy as np

    from rholoc.recordings import read_recording
    from rholoc.trajectory.visual.flow import track_corners

    read = read_recording(recording, options.named_camera(camera), frames)
    with stage_progress() as progress:
        found = track_corners(read.frames, progress, camera=read.camera)
        out.mkdir(parents=True, exist_ok=True)
        _write_tracks(found, read, out)
        off_px = _write_dense(found, read, out, pictures, fields)
        posed, why = _odometry(read, found, progress) if odometry else (None, "")
    lengths = np.bincount(found.tracks)
    figures: dict[str, Any] = {
        "frames": len(found.times),
        "tracks": len(np.unique(found.tracks)),
        "corners_a_frame": float(np.median(np.diff(found.starts))),
        "track_length_frames": float(np.median(lengths[lengths > 0])) if lengths.any() else 0.0,
        "motion_a_frame_px": round(float(np.median(found.motion[1:])) * max(found.size), 2)
        if len(found.times) > 1
        else 0.0,
        **{f"{method}_off_tracks_px": off for method, off in off_px.items()},
        "odometry": None if posed is None else _write_odometry(posed, read, out),
        "folder": str(out),
    }
    if as_json:
        print_json(figures)
    else:
        rows = {name: f"{value}" for name, value in figures.items() if name != "odometry" and value is not None}
        rows |= {f"odometry {name}": f"{value}" for name, value in (figures["odometry"] or {}).items()}
        print_figures(f"{recording}: optical flow", rows)
    if why:
        print_notice(f"No odometry: {why}")


def _write_tracks(found: Flow, read: Recording, out: Path) -> None:
    import numpy as np

    of_frame = np.repeat(read.frames.numbers, np.diff(found.starts))
    rows = np.column_stack([of_frame, found.tracks, found.pixels])
    with (out / "tracks.csv").open("w", encoding="utf-8") as file:
        file.write("frame,track,u,v\n")
        np.savetxt(file, rows, fmt=["%d", "%d", "%.3f", "%.3f"], delimiter=",")


def _write_dense(found: Flow, read: Recording, out: Path, pictures: int, fields: bool) -> dict[str, float | None]:
    """Write pictures of tracks and dense fields, and a table. Returns each method's error against the tracks [px]."""
    import cv2
    import numpy as np

    from rholoc.disk import replace_file
    from rholoc_lab.evaluation.dense_flow import DenseMethod, dense_flow, off_tracks
    from rholoc_lab.pictures.flow import dense_png, tracks_png

    numbers, last = read.frames.numbers, len(read.frames.numbers) - 1
    chosen = np.unique(np.linspace(1, last, min(pictures, last)).astype(np.int64)).tolist() if last > 0 else []
    lines = ["frame,method,motion_px,off_tracks_px,off_tracks_p90_px\n"]
    apart_px: dict[str, list[float]] = {method.value: [] for method in DenseMethod}
    for row in chosen:
        before, after = read.frames.images([row - 1, row])
        _, was, now = found.shared(row - 1, row)
        replace_file(out / f"tracks-{numbers[row]:06d}.png", tracks_png(after, was, now))
        for method in DenseMethod:
            field = dense_flow(before, after, method)
            name = f"{method}-{numbers[row]:06d}"
            replace_file(out / f"{name}.png", dense_png(field))
            if fields:
                cv2.writeOpticalFlow(str(out / f"{name}.flo"), field.astype(np.float32))
            off_px = off_tracks(field, was, now)
            apart_px[method] += off_px.tolist()
            motion_px = float(np.median(np.linalg.norm(field, axis=2)))
            off = [f"{value:.3f}" for value in np.percentile(off_px, [50, 90])] if len(off_px) else ["", ""]
            lines.append(f"{numbers[row]},{method},{motion_px:.3f},{','.join(off)}\n")
    replace_file(out / "dense.csv", "".join(lines).encode("ascii"))
    return {method: round(float(np.median(off)), 3) if off else None for method, off in apart_px.items()}


def _odometry(read: Recording, found: Flow, progress: ProgressListener) -> tuple[Trajectory | None, str]:
    """The trajectory that follows from the tracks, or why there is none."""
    from rholoc.trajectory.estimate import odometry_from_flow

    try:
        return odometry_from_flow(read, found, progress), ""
    except MappingFailed as failure:
        return None, f"{failure.message} {failure.hint}".strip()


def _write_odometry(posed: Trajectory, read: Recording, out: Path) -> dict[str, Any]:
    """Write Table 6 and, with known truth, a plot; returns their figures."""
    import numpy as np

    from rholoc.maps import write_trajectory_csv
    from rholoc.maps.formats.trajectory_table import TrajectoryTable
    from rholoc.pictures.trajectories import plot_top_view, save_figure
    from rholoc_lab.evaluation.odometry import measure_odometry
    from rholoc_lab.evaluation.splits import poses_or_truth

    count = len(posed.rows)
    table = TrajectoryTable(
        times=posed.times,
        frames=read.frames.numbers[posed.rows],
        T_map_camera=posed.T_map_camera,
        confidences=np.full(count, np.nan),
        inliers=np.zeros(count, dtype=np.int64),
    )
    write_trajectory_csv(out / "odometry.csv", table)
    figures: dict[str, Any] = {"keyframes": count, "scale": posed.scale.value, "upright": posed.upright}
    known = poses_or_truth(read)
    if known is None:
        return figures
    there = np.flatnonzero(known.known[posed.rows])
    measured = measure_odometry(posed.T_map_camera[there], known.T_map_camera[posed.rows[there]], posed.upright)
    if measured is None:
        return figures
    title = f"odometry by optical flow, drawn at {measured.scale:.3f} of its size"
    save_figure(
        plot_top_view(measured.aligned, known.T_map_camera[posed.rows[there]], title=title), out / "odometry.png"
    )
    return figures | measured.figures()
