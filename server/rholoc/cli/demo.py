"""``rholoc demo``: the whole flow on simulated recordings, over HTTP, with the server's own worker."""

from __future__ import annotations

import shutil
import signal
import time
import webbrowser
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from rholoc.cli import options
from rholoc.cli.console import (
    fraction_progress,
    frame_progress,
    job_progress,
    print_figures,
    print_json,
    print_notice,
)
from rholoc.cli.localize import trajectory_table
from rholoc.cli.maps.page import trust_line
from rholoc.cli.server_process import RunningServer, in_background, running_server
from rholoc.errors import RholocError
from rholoc.processes.interrupts import interruptible

if TYPE_CHECKING:
    from rholoc.evaluation import Evaluation
    from rholoc.maps import TrajectoryTable
    from rholoc_client import Client, Job, MapSummary

MAP_NAME = "testsite"
_JPEG_QUALITY = 95
_WORKER_FAILS = "worker_fails"  # an obstacle of jobs
_TITLE = "Walk 2, localized in the map of walk 1"


class _Files:
    """Files that the demo writes to its folder. True poses are kept apart from the recordings: uploads hold none."""

    def __init__(self, folder: Path) -> None:
        self.recordings, self.truth = folder / "recordings", folder / "truth"
        self.maps, self.data, self.log = folder / "maps", folder / "data", folder / "server.log"
        self.trajectory, self.top_view = folder / "trajectory.csv", folder / "top_view.png"

    def clear(self) -> None:
        """Remove the demo's own files and folders, and make the folders anew, empty; others in its folder stay."""
        for folder in (self.recordings, self.truth, self.maps, self.data):
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
        for file in (self.log, self.trajectory, self.top_view):
            file.unlink(missing_ok=True)


def demo(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Where everything goes.")] = Path("demo-output"),
    seconds: Annotated[float, typer.Option(min=30, max=120, help="The length of each walk: 30, or longer.")] = 30.0,
    every: Annotated[int, typer.Option(min=1, help="Localize every N-th frame of the second walk.")] = 3,
    seed: options.Seed = 0,
    leave_open: Annotated[
        bool, typer.Option("--open", help="Leave the server running and open its pages, until Ctrl-C.")
    ] = False,
    as_json: options.Json = False,
) -> None:
    """Simulate two walks, map the first through the server, localize the second over HTTP, print the errors."""
    import fastapi  # noqa: F401 - of the extra "server": a demo without it would end after its simulation

    files = _Files(out)
    with interruptible():
        files.clear()
        _run(files, seconds, every, seed, leave_open, as_json)


def _run(files: _Files, seconds: float, every: int, seed: int, leave_open: bool, as_json: bool) -> None:
    """Simulate both walks, map the first, localize the second and print the errors. Raises RholocError."""
    from rholoc.simulation import simulate_recording
    from rholoc_client import Client, RholocClientError

    start_s = time.perf_counter()
    first, second = files.recordings / "walk-1", files.recordings / "walk-2"
    with fraction_progress("simulating walk 1") as progress:
        simulate_recording(first, walk=1, seconds=seconds, seed=seed, progress=progress)
    _put_truth_apart(first, files)
    with (
        in_background("rholoc.simulation", second, 2, seconds, seed) as second_is_simulated,
        running_server(files.maps, files.data, files.log) as server,
    ):
        try:
            with Client(server.url, timeout_s=60.0) as client:
                map_start_s = time.perf_counter()
                job = _map(client, first)
                build_s = time.perf_counter() - map_start_s
                second_is_simulated()
                _put_truth_apart(second, files)
                table, frame_ms = _localize(client, second, every)
                published = client.map(MAP_NAME)
        except RholocClientError as error:
            raise RholocError(str(error), f"The server's log is {files.log}.") from error
        evaluation, median_ms = _evaluation(files, table, every), float(np.median(frame_ms))
        total_s = time.perf_counter() - start_s
        figures = DemoFigures(evaluation, published, job.warnings, median_ms, build_s, total_s)
        _print(figures, files, as_json)
        if leave_open:
            _stay(server)


def _put_truth_apart(recording: Path, files: _Files) -> None:
    """Move the true poses out of a recording, so that they are not uploaded, and print that it is simulated."""
    (recording / "truth.csv").rename(files.truth / f"{recording.name}.csv")
    print_notice(f"simulated {recording.name}: video, IMU, waypoints")


def _map(client: Client, recording: Path) -> Job:
    """Upload a recording; wait until its map is published. Raises RholocClientError, or RholocError if workers fail."""
    job = client.upload_recording(recording, MAP_NAME)
    with job_progress() as progress:

        def look(seen: Job) -> None:
            if seen.obstacle == _WORKER_FAILS:
                raise RholocError(f"The walk cannot be mapped, {seen.message}.")
            progress(seen)

        return client.wait_for_job(job.id, poll_s=0.5, progress=look)


def _localize(client: Client, recording: Path, every: int) -> tuple[TrajectoryTable, list[float]]:
    """Localize every ``every``-th frame over HTTP; returns the trajectory and each request's milliseconds."""
    import cv2

    from rholoc.recordings import read_recording
    from rholoc_client import Camera

    walk = read_recording(recording)
    assert walk.camera is not None
    camera = Camera(**walk.camera.to_dict())
    rows = range(0, len(walk.frames.times), every)
    answers, frame_ms = [], []
    with frame_progress("localizing walk 2", len(rows)) as advance:
        for image in walk.frames.images(rows):
            _, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
            start_s = time.perf_counter()
            answers.append(client.localize(MAP_NAME, jpeg.tobytes(), camera=camera))
            frame_ms.append(1000 * (time.perf_counter() - start_s))
            advance()
    return trajectory_table(walk.frames, rows, answers), frame_ms


@dataclass(frozen=True)
class DemoFigures:
    """Figures measured by the demo.

    Attributes:
        evaluation: of the second walk, against the truth.
        map: what the server says about the map.
        warnings: the job's reasons why the map is not to be trusted.
        median_ms: of a frame, over HTTP.
        build_s: from the upload to the published map.
        total_s: of the whole demo.
    """

    evaluation: Evaluation
    map: MapSummary
    warnings: tuple[str, ...]
    median_ms: float
    build_s: float
    total_s: float

    def as_dict(self) -> dict[str, Any]:
        """The figures by name, JSON-serialisable."""
        return self.evaluation.as_dict() | {
            "trusted": self.map.trusted,
            "trust_reason": self.map.trust_reason,
            "expected_error_m": self.map.expected_error_m,
            "warnings": list(self.warnings),
            "map_bytes": self.map.size_bytes,
            "landmarks": self.map.landmarks,
            "median_ms": round(self.median_ms, 1),
            "build_s": round(self.build_s, 1),
            "total_s": round(self.total_s, 1),
        }

    def rows(self) -> dict[str, str]:
        """The figures for people: texts with units, by name."""
        expected_m = self.map.expected_error_m
        return self.evaluation.rows() | {
            "the map's expected error": "unknown" if expected_m is None else f"{100 * expected_m:.2f} cm (rms)",
            "trusted": trust_line(self.map.trusted, self.map.trust_reason),
            "time a frame": f"{self.median_ms:.0f} ms (median, over HTTP)",
            "map": f"{self.map.size_bytes / 1000:.0f} kB, {self.map.landmarks} landmarks, "
            f"built in {self.build_s:.0f} s",
            "whole demo": f"{self.total_s:.0f} s",
        }


def _evaluation(files: _Files, table: TrajectoryTable, every: int) -> Evaluation:
    """Compare the trajectory ``table`` of each ``every``-th frame with the truth; writes it and a top view to files."""
    from rholoc.evaluation import evaluate, pair_poses, read_frame_poses, trajectory_errors
    from rholoc.maps import load_map, write_trajectory_csv
    from rholoc.pictures.trajectories import plot_top_view, save_figure

    write_trajectory_csv(files.trajectory, table)
    truth = read_frame_poses(files.truth / "walk-2.csv")
    pairs = pair_poses(read_frame_poses(files.trajectory), truth, slice(0, None, every))
    map_ = load_map(files.maps / f"{MAP_NAME}.rho")
    waypoints = [(point.name, np.asarray(point.position)) for point in map_.info.waypoints]
    save_figure(
        plot_top_view(pairs.estimated, pairs.truth, map_.landmarks.positions, waypoints, _TITLE), files.top_view
    )
    return evaluate(trajectory_errors(pairs.estimated, pairs.truth))


def _print(figures: DemoFigures, files: _Files, as_json: bool) -> None:
    """Print warnings and figures, as JSON or as a table with the paths of the results."""
    for warning in figures.warnings:
        print_notice(f"warning: {warning}")
    if as_json:
        print_json(figures.as_dict())
        return
    print_figures(_TITLE, figures.rows())
    print_notice(f"The trajectory is in {files.trajectory}, the picture in {files.top_view}.")


def _stay(server: RunningServer) -> None:
    """Print the server's address, open it in a browser, and wait for Ctrl-C."""
    print_notice(f"The server stays at {server.url} (the API: {server.url}/docs). Ctrl-C ends it.")
    webbrowser.open(f"{server.url}/docs")
    with suppress(KeyboardInterrupt):
        signal.pause()
