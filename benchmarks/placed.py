"""How much of a recording is placed, and how rightly: rholoc's trajectory beside plain pycolmap on the same recording.

    python benchmarks/placed.py [bedroom_night android_livingroom euroc_v101 redkitchen room building] [--json FILE]
        [--as walk set shuffled half 1hz 0.5hz mixed] [--methods rholoc incremental global] [--hz 6] [--seconds 120]
        [--cache DIR] [--timeout 1800]

Plain pycolmap: its own SIFT, sequential pairs and mappers with default options, the recording's intrinsics where they
are known, ``--hz`` pictures a second; of several models the one with most pictures counts. rholoc: video and IMU as
they are, waypoints and given poses left out, its own choice of keyframes. For each: pictures placed of those given;
the share of the recording within half a second of a placed picture, and the longest gap, which compare the two
whatever pictures they chose; seconds; degrees by which turns over 1, 10 and 60 s are off, against the truth or else
the gyroscope; and where there is truth, centimetres after a similarity alignment. ``room`` and ``building`` are
simulated, the latter ``--seconds`` long. The last lines name every recording of which plain pycolmap places more.

``--as``: as they are (``walk``), or a folder of pictures without IMU. Without times: two pictures a second, or some
forty (``set``), the same in any order (``shuffled``), every second of them (``half``), with the desk's among them
(``mixed``). With times: one or half a picture a second. pycolmap then tries all pairs of up to 100 untimed pictures.
"""

from __future__ import annotations

import argparse
import itertools
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
from rholoc.recordings import CameraFile, Recording, read_recording, write_camera_json, write_frames_csv
from rholoc.recordings.selection import SelectedFrames
from rholoc.trajectory import PoseMethod, estimate_trajectory
from rholoc.trajectory.visual.loop_candidates import MAX_EXHAUSTIVE
from rholoc_lab.simulation.sites import Site, simulate_site

KITCHEN_CAMERA = "525.505,525.505,320,240"
KINDS = ("walk", "set", "shuffled", "half", "1hz", "0.5hz", "mixed")
NAMES = ("bedroom_night", "android_livingroom", "euroc_v101", "redkitchen", "room", "building")
METHODS = ("rholoc", "incremental", "global")
COLUMNS = {
    "recording": "recording",
    "as": "as",
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
    "trusted": "trusted",
    "expected_cm": "expected cm",
    "failed": "failed",
}
_UNTIMED = 40  # pictures of a set of a recording without times, which count as taken at 2 Hz
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


def as_pictures(walk: Walk, kind: str, folder: Path) -> Walk:
    """The walk as a folder of pictures, see the head of this file."""
    recording, frames = walk.recording, walk.recording.frames
    hz = 0.5 if kind == "0.5hz" else 1.0 if kind == "1hz" else 2.0
    between_s = float(np.median(np.diff(frames.times))) if frames.timed else _UNTIMED / (2 * len(frames.times))
    step = max(1, round(1 / hz / between_s))
    rows = np.arange(0, len(frames.times), step)[:: 2 if kind == "half" else 1]
    numbers = np.random.default_rng(0).permutation(len(rows)) if kind == "shuffled" else np.arange(len(rows))
    folder.mkdir(exist_ok=True)
    for number, image in zip(numbers.tolist(), frames.images(rows.tolist()), strict=True):
        cv2.imwrite(str(folder / f"{number:05d}.jpg"), image, [cv2.IMWRITE_JPEG_QUALITY, 95])
    truth = np.full((len(rows), 4, 4), np.nan) if walk.truth is None else walk.truth[rows[np.argsort(numbers)]]
    if kind == "mixed":
        for number, image in enumerate(read_recording(SHARED_DATA / "splat_desk").frames.images(range(29)), len(rows)):
            cv2.imwrite(str(folder / f"{number:05d}.jpg"), image)
        truth = np.concatenate([truth, np.full((29, 4, 4), np.nan)])
    elif recording.camera is not None:
        write_camera_json(folder / "camera.json", CameraFile(recording.camera))
    if kind.endswith("hz") and frames.timed:
        write_frames_csv(folder / "frames.csv", np.arange(len(rows)), frames.times[rows])
    return Walk(read_recording(folder), None if walk.truth is None else truth)


def by_rholoc(recording: Recording, hz: float) -> dict[str, Any]:
    """The poses that rholoc finds: rows, T_map_camera and how many were to be placed."""
    method = PoseMethod.VISUAL if recording.imu is None else PoseMethod.VISUAL_INERTIAL
    found = estimate_trajectory(recording, method)
    placed = {"rows": found.rows, "T": found.T_map_camera, "asked": found.report.keyframes, "models": 1}
    return placed | {"trusted": found.report.trusted, "expected_m": found.report.expected_error_m}


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
        if recording.frames.timed or len(rows) > MAX_EXHAUSTIVE:
            pycolmap.match_sequential(database)
        else:
            pycolmap.match_exhaustive(database)
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


def made(name: str, kind: str, options: argparse.Namespace, cache: Path) -> Walk:
    """A recording as it is asked for."""
    walk = walk_of(name, options.data, cache, options.seconds)
    return walk if kind == "walk" else as_pictures(walk, kind, cache / f"{name.replace('/', '-')}-{kind}")


def _work(name: str, kind: str, method: str, options: argparse.Namespace, cache: Path, answers: Any) -> None:
    """In a process of its own: a mapper may crash or never end."""
    pycolmap.logging.minloglevel = 3  # fatal errors alone
    recording = made(name, kind, options, cache).recording
    try:
        if method == "rholoc":
            answers.put(by_rholoc(recording, options.hz))
        else:
            mapper = pycolmap.incremental_mapping if method == "incremental" else pycolmap.global_mapping
            answers.put(by_pycolmap(recording, options.hz, mapper))
    except RholocError as error:
        answers.put({"failed": str(error)})


def measure(name: str, kind: str, method: str, options: argparse.Namespace, cache: Path) -> dict[str, Any]:
    """One row of the table."""
    walk = made(name, kind, options, cache)
    spawn = multiprocessing.get_context("spawn")
    answers = spawn.Queue()
    process = spawn.Process(target=_work, args=(name, kind, method, options, cache, answers))
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
    row: dict[str, Any] = {"recording": name, "as": kind, "method": method, "seconds": rounded(cost.seconds, 0)}
    row["peak_mb"] = rounded(cost.peak_mb, 0)
    if "failed" in found:
        return {**row, "failed": found["failed"], "covered_percent": 0.0}
    rows, T, times = found["rows"], found["T"], walk.recording.frames.times
    row |= {"placed": f"{len(rows)}/{found['asked']}", "models": found["models"], **coverage(times, times[rows])}
    if not walk.recording.frames.timed:
        row["covered_percent"] = rounded(100 * len(rows) / found["asked"], 1)
    if found.get("expected_m") is not None:
        row |= {"trusted": found["trusted"], "expected_cm": rounded(100 * found["expected_m"], 1)}
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
    parser.add_argument("--as", nargs="+", choices=KINDS, default=["walk"], dest="kinds")
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
            for kind, method in itertools.product(arguments.kinds, arguments.methods):
                table.append(flat(measure(name, kind, method, arguments, arguments.cache or Path(folder))))
                row = table[-1]
                placed = f"{row['placed']} placed" if "placed" in row else row["failed"]
                covers = f"covers {row['covered_percent']} %, {row['seconds']} s"
                print(f"{name} as {kind}, {method}: {placed}, {covers}", flush=True)
    if arguments.json:
        arguments.json.write_text(json.dumps(table, indent=2) + "\n")
    shown = [{title: row[key] for key, title in COLUMNS.items() if key in row} for row in table]
    print_table(shown, list(COLUMNS.values()))
    for name, kind in itertools.product(arguments.recordings, arguments.kinds):
        some = [row for row in table if (row["recording"], row["as"]) == (name, kind)]
        covered = {row["method"]: row["covered_percent"] for row in some}
        for method in set(covered) - {"rholoc"} if "rholoc" in covered else ():
            if covered[method] > covered["rholoc"] + _MORE_PERCENT:
                both = f"{covered[method]} %, rholoc {covered['rholoc']} %"
                print(f"{name} as {kind}: pycolmap's {method} mapper covers {both}")


if __name__ == "__main__":
    main()
