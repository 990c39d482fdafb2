"""How much of a recording is placed, and how rightly: rholoc's trajectory beside plain pycolmap on the same recording.

    python benchmarks/placed.py [bedroom_night android_livingroom euroc_v101 redkitchen room building] [--json FILE]
        [--methods rholoc incremental global] [--hz 6] [--seconds 120] [--cache DIR] [--timeout 1800]

Plain pycolmap: its own SIFT, sequential pairs and mappers with default options, the recording's intrinsics where they
are known, ``--hz`` pictures a second; of several models the one with most pictures counts. rholoc: video and IMU as
they are, waypoints and given poses left out, its own choice of keyframes. For each: pictures placed of those given;
the share of the recording within half a second of a placed picture, and the longest gap, which compare the two
whatever pictures they chose; seconds; degrees by which turns over 1, 10 and 60 s are off, against the truth or else
the gyroscope; and where there is truth, centimetres after a similarity alignment. ``room`` and ``building`` are
simulated, the latter ``--seconds`` long. The last lines name every recording of which plain pycolmap places more.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from measuring import (
    SHARED_DATA,
    coverage,
    flat,
    gyroscope_errors,
    measured,
    position_errors,
    print_table,
    rotation_errors,
    rounded,
)
from rholoc.errors import RholocError
from rholoc.geometry import Camera, FloatArray
from rholoc.maps import read_trajectory_csv
from rholoc.recordings import Recording, read_recording
from rholoc.recordings.selection import SelectedFrames
from rholoc.trajectory import PoseMethod, estimate_trajectory
from rholoc_lab.simulation.sites import Site, simulate_site

KITCHEN_CAMERA = "525.505,525.505,320,240"
NAMES = ("bedroom_night", "android_livingroom", "euroc_v101", "redkitchen", "room", "building")
METHODS = ("rholoc", "incremental", "global")
COLUMNS = {
    "recording": "recording",
    "method": "method",
    "placed": "placed",
    "covered_percent": "covered %",
    "longest_gap_s": "gap s",
    "models": "models",
    "seconds": "seconds",
    "against": "against",
    "1s median": "1 s",
    "10s median": "10 s",
    "10s worst": "10 s worst",
    "60s median": "60 s",
    "60s worst": "60 s worst",
    "position median_cm": "median cm",
    "position worst_cm": "worst cm",
    "failed": "failed",
}
_MORE_PERCENT = 2.0  # of a recording, by which plain pycolmap must be ahead to be named


@dataclass(frozen=True, eq=False)
class Walk:
    """A recording and, where known, the true poses of its frames (N, 4, 4)."""

    recording: Recording
    truth: FloatArray | None


def walk_of(name: str, data: Path, cache: Path, seconds: float) -> Walk:
    """A recording at hand, or a simulated one."""
    if name in (Site.ROOM, Site.BUILDING):
        lasting_s, fps = (30.0, 30.0) if name == Site.ROOM else (seconds, 15.0)
        folder = cache / f"{name}-0-walk1-{lasting_s:.0f}s-{fps:g}fps-0ms"
        if not (folder / "made").exists():
            simulate_site(folder, Site(name), seconds=lasting_s, fps=fps)
            (folder / "made").touch()
        return Walk(
            replace(read_recording(folder), waypoints=()), read_trajectory_csv(folder / "truth.csv").T_map_camera
        )
    kitchen = name == "redkitchen"
    recording = read_recording(data / name, *((KITCHEN_CAMERA, "400:1000") if kitchen else ()))
    truth = None if recording.poses is None else recording.poses.T_map_camera
    return Walk(replace(recording, poses=None), truth)


def by_rholoc(recording: Recording, hz: float) -> dict[str, Any]:
    """The poses that rholoc finds: rows, T_map_camera and how many were to be placed."""
    method = PoseMethod.VISUAL if recording.imu is None else PoseMethod.VISUAL_INERTIAL
    found = estimate_trajectory(recording, method)
    return {"rows": found.rows, "T": found.T_map_camera, "asked": found.report.keyframes, "models": 1}


def by_pycolmap(recording: Recording, hz: float, mapper: Callable[..., Any]) -> dict[str, Any]:
    """The poses of the largest of plain pycolmap's models."""
    times = recording.frames.times
    step = max(1, round(1 / hz / float(np.median(np.diff(times)))))
    rows = np.arange(0, len(times), step)
    frames = SelectedFrames(recording.frames, rows)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "images").mkdir()
        for i, image in enumerate(frames.images(range(len(rows)))):
            cv2.imwrite(str(folder / "images" / f"{i:06d}.png"), image)
        reader = pycolmap.ImageReaderOptions()
        if recording.camera is not None:
            reader.camera_model, reader.camera_params = "OPENCV", colmap_intrinsics(recording.camera)
        database = folder / "database.db"
        pycolmap.extract_features(
            database, folder / "images", camera_mode=pycolmap.CameraMode.SINGLE, reader_options=reader
        )
        pycolmap.match_sequential(database)
        models = mapper(database, folder / "images", folder).values()
    best = max(models, key=lambda model: model.num_reg_images(), default=None)
    if best is None:
        return {"rows": rows[:0], "T": np.zeros((0, 4, 4)), "asked": len(rows), "models": 0}
    placed = sorted((image.name, image) for image in best.images.values() if image.has_pose)
    T = [np.vstack([image.cam_from_world().inverse().matrix(), [0, 0, 0, 1]]) for _, image in placed]
    chosen = rows[[int(Path(name).stem) for name, _ in placed]]
    return {"rows": chosen, "T": np.array(T), "asked": len(rows), "models": len(models)}


def colmap_intrinsics(camera: Camera) -> str:
    """fx, fy, cx, cy, k1, k2, p1, p2: COLMAP's pixels begin half a pixel earlier."""
    distortion = (*camera.distortion, 0.0, 0.0, 0.0, 0.0)[:4]
    return ",".join(str(value) for value in (camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5, *distortion))


def _work(name: str, method: str, options: argparse.Namespace, cache: Path, answers: Any) -> None:
    """In a process of its own: a mapper may crash or never end."""
    pycolmap.logging.minloglevel = 3  # fatal errors alone
    recording = walk_of(name, options.data, cache, options.seconds).recording
    try:
        if method == "rholoc":
            answers.put(by_rholoc(recording, options.hz))
        else:
            mapper = pycolmap.incremental_mapping if method == "incremental" else pycolmap.global_mapping
            answers.put(by_pycolmap(recording, options.hz, mapper))
    except RholocError as error:
        answers.put({"failed": str(error)})


def measure(name: str, method: str, options: argparse.Namespace, cache: Path) -> dict[str, Any]:
    """One row of the table."""
    walk = walk_of(name, options.data, cache, options.seconds)
    spawn = multiprocessing.get_context("spawn")
    answers = spawn.Queue()
    process = spawn.Process(target=_work, args=(name, method, options, cache, answers))
    with measured() as cost:
        process.start()
        found: dict[str, Any] = {"failed": f"did not end within {options.timeout:.0f} s"}
        waited_s = 0.0
        while waited_s < options.timeout:
            try:
                found = answers.get(timeout=1.0)
                break
            except Exception:
                waited_s += 1.0
                if not process.is_alive() and answers.empty():
                    found = {"failed": f"crashed with exit status {process.exitcode}"}
                    break
        if process.is_alive() and "failed" in found:
            process.terminate()
        process.join()
    row: dict[str, Any] = {"recording": name, "method": method, "seconds": rounded(cost.seconds, 0)}
    row["peak_mb"] = rounded(cost.peak_mb, 0)
    if "failed" in found:
        return {**row, "failed": found["failed"], "covered_percent": 0.0}
    rows, T, times = found["rows"], found["T"], walk.recording.frames.times
    row |= {"placed": f"{len(rows)}/{found['asked']}", "models": found["models"], **coverage(times, times[rows])}
    if len(rows) < 3:
        return row
    known = np.ones(len(rows), bool) if walk.truth is None else np.isfinite(walk.truth[rows]).all(axis=(1, 2))
    if walk.truth is not None and known.sum() >= 3:
        truth = walk.truth[rows[known]]
        row |= {"against": "truth", "position": position_errors(T[known], truth)}
        row |= rotation_errors(times[rows[known]], T[known, :3, :3], Rotation.from_matrix(truth[:, :3, :3]))
    elif walk.recording.imu is not None:
        row |= {"against": "gyroscope", **gyroscope_errors(times[rows], T[:, :3, :3], walk.recording.imu)}
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", nargs="*", default=NAMES, help=", ".join(NAMES) + ", or a folder of the data")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=METHODS)
    parser.add_argument("--data", type=Path, default=SHARED_DATA)
    parser.add_argument("--hz", type=float, default=6.0, help="pictures a second that plain pycolmap is given")
    parser.add_argument("--seconds", type=float, default=120.0, help="of the building's walk")
    parser.add_argument("--timeout", type=float, default=1800.0, help="seconds that one of them may take")
    parser.add_argument("--cache", type=Path, help="where the simulated recordings are kept")
    parser.add_argument("--json", type=Path, help="where the table goes as JSON, too")
    arguments = parser.parse_args()
    table: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        for name in arguments.recordings:
            for method in arguments.methods:
                table.append(flat(measure(name, method, arguments, arguments.cache or Path(folder))))
                row = table[-1]
                placed = f"{row['placed']} placed" if "placed" in row else row["failed"]
                print(f"{name}, {method}: {placed}, covers {row['covered_percent']} %, {row['seconds']} s", flush=True)
    if arguments.json:
        arguments.json.write_text(json.dumps(table, indent=2) + "\n")
    shown = [{title: row[key] for key, title in COLUMNS.items() if key in row} for row in table]
    print_table(shown, list(COLUMNS.values()))
    for name in arguments.recordings:
        covered = {row["method"]: row["covered_percent"] for row in table if row["recording"] == name}
        for method in set(covered) - {"rholoc"} if "rholoc" in covered else ():
            if covered[method] > covered["rholoc"] + _MORE_PERCENT:
                print(f"{name}: pycolmap's {method} mapper covers {covered[method]} %, rholoc {covered['rholoc']} %")


if __name__ == "__main__":
    main()
