"""How much of a recording is placed, and how rightly: rholoc's trajectory beside plain pycolmap on the same pictures.

    python benchmarks/placed.py [redkitchen corridor_lidar/scan=1hz,0.5hz splat_desk euroc_v101 bedroom_night
        android_livingroom room building] [--as walk set shuffled 2hz 1hz 0.5hz half mixed]
        [--seeds 0] [--methods rholoc incremental global] [--hz 6] [--seconds 120] [--most 300] [--cache DIR] [--kept]
        [--timeout 1800] [--json FILE] [--write]

``--as``, or after ``=`` for one recording: as they are (``walk``: video and IMU, ``--hz`` pictures a second for
pycolmap), or a folder of pictures without IMU, poses and depth. Without times: two pictures a second (``set``), the
same in any order and without intrinsics (``shuffled``), every second of them (``half``), with another recording's among
them (``mixed``). With times: two, one or half a picture a second. A recording without times counts as a film of 30 Hz
if it has more than 300 pictures, else as one of 2 Hz. ``room`` and ``building`` are simulated, ``--seconds`` long. Any
folder of ``--data`` may be named, with ``truth.csv`` where the truth is known. Sets of more than ``--most`` pictures
are left out. Each of ``--seeds``, 0 to 9, begins as many tenths of the interval later, rounded down to a frame, and
has another order.

Plain pycolmap: its own SIFT, its mappers with default options, the intrinsics that the folder states; all pairs of up
to 100 pictures, sequential pairs of more; of several models the one with most pictures counts. Both of its mappers have
the same matches, whose time counts for the first one. rholoc: default options.

For each: pictures placed of those given, wall-clock seconds and processor seconds (of all cores) a picture; where there
is truth, centimetres after a similarity alignment and the error that rholoc expects, in the same unit. The last lines
judge rholoc beside the better of pycolmap's mappers. With ``--write`` the judgements go to
benchmarks/results/placed.json. ``--cache`` keeps simulated walks and pycolmap's answers; with ``--kept`` rholoc's
answers there count, too, so that sets measured one after the other are judged together.
"""

import argparse
import json
import multiprocessing
import os
import pickle
import queue
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap

from figures import Figure, quote_anew, write_results
from measuring import SHARED_DATA, print_table, rounded
from rholoc.errors import RholocError
from rholoc.geometry import ByteArray, Camera, FloatArray, IntArray, umeyama
from rholoc.maps import read_trajectory_csv
from rholoc.recordings import CameraFile, Recording, read_recording, write_camera_json, write_frames_csv
from rholoc.recordings.frame_slice import SelectedFrames
from rholoc.trajectory import PoseMethod
from rholoc.trajectory.estimate import estimate_trajectory
from rholoc_lab.simulation.sites import Site, simulate_site

KITCHEN_CAMERA = "525.505,525.505,320,240"
KINDS = ("walk", "set", "shuffled", "2hz", "1hz", "0.5hz", "half", "mixed")
NAMES = ("redkitchen", "corridor_lidar/scan", "splat_desk", "euroc_v101", "bedroom_night", "android_livingroom")
METHODS = ("rholoc", "incremental", "global")
COLUMNS = {
    "recording": "recording",
    "as": "as",
    "seed": "seed",
    "method": "method",
    "placed": "placed",
    "given": "of",
    "right": "right",
    "models": "models",
    "s_a_picture": "s/picture",
    "cpu_s_a_picture": "CPU s/picture",
    "median_cm": "median cm",
    "worst_cm": "worst cm",
    "expected_cm": "expected cm",
    "trusted": "trusted",
    "failed": "failed",
}
_JUDGED = ("recording", "as", "seed", "placed", "by pycolmap", "median cm", "pycolmap's", "judgement")
_SET_HZ = 2.0
_MAX_EXHAUSTIVE = 100  # pictures of which pycolmap matches all pairs
_FILM_HZ, _FILM = 30.0, 300  # pictures without times, from which they count as a film
_FEWEST = 8  # pictures of a set that is worth comparing
_RIGHT = 0.05  # of the walk's extent, by which a pose may be off to count as right
_MAX_RATIO = 1.2  # of rholoc's median error to that of the better of pycolmap's mappers
_NEGLIGIBLE_CM = 0.1  # by which rholoc's median may be larger in any case: the truth is not better known
_MAX_SURPRISE = 3.0  # of a trusted map's median error to the one that it expects


@dataclass(frozen=True)
class Case:
    """A recording and how its pictures are taken from it."""

    recording: str
    kind: str
    seed: int

    @property
    def slug(self) -> str:
        """Name for files."""
        return f"{self.recording.replace('/', '-')}-{self.kind}-{self.seed}"


@dataclass(frozen=True, eq=False)
class Walk:
    """A recording and, where known, the true poses of its frames (N, 4, 4)."""

    recording: Recording
    truth: FloatArray | None


def walk_of(name: str, data: Path, cache: Path, seconds: float) -> Walk:
    """A recording at hand, or a simulated one."""
    path = data / name
    if name in (Site.ROOM, Site.BUILDING):
        fps = 30.0 if name == Site.ROOM else 15.0
        path = cache / f"{name}-0-walk1-{seconds:.0f}s-{fps:g}fps-0ms"
        if not (path / "made").exists():
            simulate_site(path, Site(name), seconds=seconds, fps=fps)
            (path / "made").touch()
    kitchen = name == "redkitchen"
    recording = read_recording(path, *((KITCHEN_CAMERA, "400:1000") if kitchen else ()))
    truth = None if recording.poses is None else recording.poses.T_map_camera
    if (path / "truth.csv").exists():
        truth = read_trajectory_csv(path / "truth.csv").T_map_camera
    return Walk(replace(recording, poses=None, waypoints=()), truth)


def as_pictures(walk: Walk, case: Case, folder: Path, other: Recording | None) -> Walk:
    """The walk as a folder of pictures, see the head of this file; ``other`` is mixed with it."""
    recording, kind = walk.recording, case.kind
    hz = float(kind.removesuffix("hz")) if kind.endswith("hz") else _SET_HZ
    rows = _rows_at(recording, hz, case.seed)[:: 2 if kind == "half" else 1]
    numbers = np.random.default_rng(case.seed).permutation(len(rows)) if kind == "shuffled" else np.arange(len(rows))
    folder.mkdir(exist_ok=True)
    for number, image in zip(numbers.tolist(), recording.frames.images(rows.tolist()), strict=True):
        _write(folder, number, image)
    truth = None if walk.truth is None else walk.truth[rows[np.argsort(numbers)]]
    if other is not None:
        added = _rows_at(other, _SET_HZ, case.seed)
        for number, image in enumerate(other.frames.images(added.tolist()), len(rows)):
            _write(folder, number, image)
        if truth is not None:
            truth = np.concatenate([truth, np.full((len(added), 4, 4), np.nan)])
    elif recording.camera is not None and kind != "shuffled":
        write_camera_json(folder / "camera.json", CameraFile(recording.camera))
    if kind.endswith("hz"):
        times = recording.frames.times[rows] if recording.frames.timed else np.arange(len(rows)) / hz
        write_frames_csv(folder / "frames.csv", np.arange(len(rows)), times)
    return Walk(read_recording(folder), truth)


def _write(folder: Path, number: int, image: ByteArray) -> None:
    cv2.imwrite(str(folder / f"{number:05d}.jpg"), image, [cv2.IMWRITE_JPEG_QUALITY, 95])


def _rows_at(recording: Recording, hz: float, seed: int = 0) -> IntArray:
    """Rows of so many pictures a second, at most all; the first is ``seed`` tenths of the interval late."""
    frames = recording.frames
    untimed_s = 1 / (_FILM_HZ if len(frames.times) > _FILM else _SET_HZ)
    between_s = float(np.median(np.diff(frames.times))) if frames.timed else untimed_s
    interval = max(1, round(1 / hz / between_s))
    return np.arange(seed * interval // 10, len(frames.times), interval)


def by_rholoc(recording: Recording, hz: float | None) -> dict[str, Any]:
    """The poses that rholoc finds: rows, T_map_camera and how many were given."""
    found = estimate_trajectory(recording, PoseMethod.AUTO)
    given = len(recording.frames.times) if hz is None else found.report.keyframes
    placed = {"rows": found.rows, "T": found.T_map_camera, "given": given, "models": 1, "trusted": found.report.trusted}
    if found.covariances is not None:
        variances = np.nan_to_num(np.trace(found.covariances[:, :3, :3], axis1=1, axis2=2), nan=np.inf)
        placed["expected"] = float(np.median(np.sqrt(variances)))
    return placed


def by_pycolmap(recording: Recording, hz: float | None, mapper: Callable[..., Any], folder: Path) -> dict[str, Any]:
    """The poses of the largest of plain pycolmap's models; its matches stay in ``folder``."""
    times = recording.frames.times
    step = 1 if hz is None else max(1, round(1 / hz / float(np.median(np.diff(times)))))
    rows = np.arange(0, len(times), step)
    frames = SelectedFrames(recording.frames, rows)
    database, images = folder / "database.db", folder / "images"
    if not database.exists():
        images.mkdir(parents=True, exist_ok=True)
        _match(recording, [*frames.images(range(len(rows)))], images, folder / "begun.db")
        (folder / "begun.db").rename(database)
    models = mapper(database, images, folder).values()
    best = max(models, key=lambda model: model.num_reg_images(), default=None)
    if best is None:
        return {"rows": rows[:0], "T": np.zeros((0, 4, 4)), "given": len(rows), "models": 0}
    placed = sorted((image.name, image) for image in best.images.values() if image.has_pose)
    T = [np.vstack([image.cam_from_world().inverse().matrix(), [0, 0, 0, 1]]) for _, image in placed]
    chosen = rows[[int(Path(name).stem) for name, _ in placed]]
    return {"rows": chosen, "T": np.array(T), "given": len(rows), "models": len(models)}


def _match(recording: Recording, pictures: Sequence[ByteArray], folder: Path, database: Path) -> None:
    """Features and matches of pictures, which are written to ``folder``, in a new database."""
    for i, image in enumerate(pictures):
        cv2.imwrite(str(folder / f"{i:06d}.png"), image)
    reader = pycolmap.ImageReaderOptions()
    if recording.camera is not None:
        reader.camera_model, reader.camera_params = "OPENCV", colmap_intrinsics(recording.camera)
    mode = pycolmap.CameraMode.SINGLE if len({one.shape for one in pictures}) == 1 else pycolmap.CameraMode.AUTO
    database.unlink(missing_ok=True)
    pycolmap.extract_features(database, folder, camera_mode=mode, reader_options=reader)
    if len(pictures) > _MAX_EXHAUSTIVE:
        pycolmap.match_sequential(database)
    else:
        pycolmap.match_exhaustive(database)


def colmap_intrinsics(camera: Camera) -> str:
    """fx, fy, cx, cy, k1, k2, p1, p2: COLMAP's pixels begin half a pixel earlier."""
    distortion = (*camera.distortion, 0.0, 0.0, 0.0, 0.0)[:4]
    return ",".join(str(value) for value in (camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5, *distortion))


def made(case: Case, options: argparse.Namespace, cache: Path) -> Walk:
    """A recording as it is asked for."""
    walk = walk_of(case.recording, options.data, cache, options.seconds)
    if case.kind == "walk":
        return walk
    other = "splat_desk" if case.recording != "splat_desk" else "android_livingroom"
    mixed = walk_of(other, options.data, cache, options.seconds).recording if case.kind == "mixed" else None
    return as_pictures(walk, case, cache / case.slug, mixed)


def _work(case: Case, method: str, options: argparse.Namespace, cache: Path, answers: Any) -> None:
    """In a process of its own: a mapper may crash or never end."""
    pycolmap.logging.minloglevel = 3  # fatal errors alone
    recording = made(case, options, cache).recording
    hz = options.hz if case.kind == "walk" else None
    begun, busy = time.monotonic(), os.times()
    try:
        if method == "rholoc":
            found = by_rholoc(recording, hz)
        else:
            mapper = pycolmap.incremental_mapping if method == "incremental" else pycolmap.global_mapping
            found = by_pycolmap(recording, hz, mapper, cache / f"{case.slug}-pycolmap")
    except RholocError as error:
        found = {"failed": f"{error.message} {error.hint}", "given": len(recording.frames.times)}
    found["seconds"] = time.monotonic() - begun
    found["cpu_seconds"] = sum(now - before for now, before in zip(os.times()[:4], busy[:4], strict=True))
    answers.put(found)


def answer_of(case: Case, method: str, options: argparse.Namespace, cache: Path) -> dict[str, Any]:
    """A method's answer; pycolmap's is kept in the cache, rholoc's counts from there if asked for."""
    kept = cache / f"{case.slug}-{method}.pickle"
    if (options.kept or method != "rholoc") and kept.exists():
        return dict(pickle.loads(kept.read_bytes()))
    spawn = multiprocessing.get_context("spawn")
    answers = spawn.Queue()
    process = spawn.Process(target=_work, args=(case, method, options, cache, answers))
    process.start()
    found: dict[str, Any] = {"failed": f"did not end within {options.timeout:.0f} s"}
    deadline = time.monotonic() + options.timeout
    while time.monotonic() < deadline:
        try:
            found = answers.get(timeout=1.0)
            break
        except queue.Empty:
            if not process.is_alive() and answers.empty():
                found = {"failed": f"crashed with exit status {process.exitcode}"}
                break
    if process.is_alive() and "seconds" not in found:
        process.terminate()
    process.join()
    if "seconds" in found:
        kept.write_bytes(pickle.dumps(found))
    return found


def measure(case: Case, method: str, options: argparse.Namespace, cache: Path) -> dict[str, Any]:
    """One row of the table."""
    found = answer_of(case, method, options, cache)
    walk = made(case, options, cache)
    row: dict[str, Any] = {"recording": case.recording, "as": case.kind, "seed": case.seed, "method": method}
    row["placed"] = len(found.get("rows", ()))
    if "given" in found:
        row["given"] = found["given"]
    if "seconds" in found:
        row["s_a_picture"] = rounded(found["seconds"] / found["given"])
        row["cpu_s_a_picture"] = rounded(found["cpu_seconds"] / found["given"])
    row |= {key: found[key] for key in ("failed", "models", "trusted") if key in found}
    if row["placed"] < 3:
        return row
    rows, T = found["rows"], found["T"]
    known = np.zeros(len(rows), bool) if walk.truth is None else np.isfinite(walk.truth[rows]).all(axis=(1, 2))
    if known.sum() >= 3:
        positions, true = T[known, :3, 3], walk.truth[rows[known]][:, :3, 3]
        to_truth = umeyama(positions, true)
        off_m = np.linalg.norm(to_truth.points(positions) - true, axis=1)
        row |= {"median_cm": rounded(100 * np.median(off_m)), "worst_cm": rounded(100 * off_m.max())}
        row["right"] = int((off_m <= _RIGHT * np.linalg.norm(np.ptp(true, axis=0))).sum())
        if "expected" in found:
            row["expected_cm"] = rounded(100 * to_truth.scale * found["expected"])
    return row


def judged(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """How rholoc compares with the better of pycolmap's mappers on the same pictures: the one that places most.

    Where the truth is known, pictures count that are placed about right. Of mappers that place as many to one in
    twenty, the one with the smaller median error is the better.
    """
    placed = {row["method"]: row.get("right", row["placed"]) for row in rows}
    by_method = {row["method"]: row for row in rows}
    ours, others = by_method["rholoc"], [by_method[name] for name in METHODS[1:] if name in by_method]
    most = max(placed[row["method"]] for row in others)
    own_cm = ours.get("median_cm")
    better_cm = min(
        (row["median_cm"] for row in others if "median_cm" in row and placed[row["method"]] >= 0.95 * most),
        default=None,
    )
    found = {key: ours[key] for key in ("recording", "as", "seed")}
    found |= {"placed": placed["rholoc"], "by pycolmap": most}
    found |= {"median cm": own_cm, "pycolmap's": better_cm} if own_cm is not None else {}
    judgement = [] if placed["rholoc"] >= most else ["fewer"]
    allowed_cm = np.inf if better_cm is None else max(_MAX_RATIO * better_cm, better_cm + _NEGLIGIBLE_CM)
    if own_cm is not None and own_cm > allowed_cm:
        judgement.append("less exact")
    if ours.get("trusted") and own_cm is not None and own_cm > _MAX_SURPRISE * ours.get("expected_cm", np.inf):
        judgement.append("trusted, but wrong")
    return found | {"judgement": ", ".join(judgement) or "as good"}


def figures_of(judgements: Sequence[dict[str, Any]], table: Sequence[dict[str, Any]]) -> dict[str, Figure]:
    """What the documents quote."""

    def share(word: str) -> Figure:
        found = [word not in one["judgement"] for one in judgements]
        return Figure(round(100 * float(np.mean(found)), 1), 5.0, True)

    ratios = [one["median cm"] / one["pycolmap's"] for one in judgements if one.get("pycolmap's")] or [np.nan]
    seconds = [row["cpu_s_a_picture"] for row in table if row["method"] == "rholoc" and "cpu_s_a_picture" in row]
    return {
        "placed.cases": Figure(len(judgements), 0, True),
        "placed.as_many_percent": share("fewer"),
        "placed.as_exact_percent": share("less exact"),
        "placed.honest_percent": share("wrong"),
        "placed.worst_error_ratio": Figure(round(max(ratios), 2), 0.2, False),
        "placed.cpu_s_a_picture": Figure(round(float(np.median(seconds)), 2), 0.3, False),
    }


def _is_worth_comparing(case: Case, options: argparse.Namespace, cache: Path) -> bool:
    """Whether the case is a walk, or a set of neither too few pictures nor more than ``--most``."""
    if case.kind == "walk":
        return True
    recording = walk_of(case.recording, options.data, cache, options.seconds).recording
    if len(_rows_at(recording, _SET_HZ)) < 2 * _FEWEST and case.kind not in ("set", "shuffled"):
        return False
    pictures = len(made(case, options, cache).recording.frames.times)
    return pictures <= options.most


def _options() -> argparse.Namespace:
    """Options of the command line, with ``seeds`` as numbers, the ``cases`` to compare, and the ``command`` itself."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", nargs="*", default=NAMES, help=", ".join(NAMES) + ", or a folder of the data")
    parser.add_argument("--as", nargs="+", choices=KINDS, default=KINDS[1:], dest="kinds")
    parser.add_argument("--seeds", default="0", help="0 to 9, with commas between them")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=METHODS)
    parser.add_argument("--data", type=Path, default=SHARED_DATA)
    parser.add_argument("--hz", type=float, default=6.0, help="pictures a second of a walk that pycolmap is given")
    parser.add_argument("--seconds", type=float, default=120.0, help="of the building's walk")
    parser.add_argument("--most", type=int, default=300, help="pictures of a set")
    parser.add_argument("--timeout", type=float, default=1800.0, help="seconds that one of them may take")
    parser.add_argument("--cache", type=Path, help="where simulated walks and pycolmap's answers are kept")
    parser.add_argument("--kept", action="store_true", help="take rholoc's answers from the cache, too")
    parser.add_argument("--json", type=Path, help="where the table goes as JSON, too")
    parser.add_argument("--write", action="store_true", help="write benchmarks/results/placed.json")
    options = parser.parse_args()
    if options.kept and options.cache is None:
        parser.error("--kept needs --cache: rholoc's answers are taken from there.")
    options.command = (
        f"python benchmarks/placed.py {' '.join(options.recordings)} --as {' '.join(options.kinds)} "
        f"--seeds {options.seeds} --most {options.most} --write"
    )
    options.seeds = [int(seed) for seed in options.seeds.split(",")]
    options.cases = []
    for recording in options.recordings:
        name, _, own = recording.partition("=")
        kinds = own.split(",") if own else options.kinds
        if not set(kinds) <= set(KINDS):
            parser.error(f"{recording}: after = come some of {', '.join(KINDS)}")
        options.cases += [Case(name, kind, seed) for kind in kinds for seed in options.seeds]
    return options


def compared(options: argparse.Namespace, cache: Path) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Measure and judge the cases, and print each result at once. Returns the table's rows and the judgements."""
    table: list[dict[str, Any]] = []
    judgements: list[dict[str, Any]] = []
    for case in options.cases:
        if not _is_worth_comparing(case, options, cache):
            continue
        rows = []
        for method in options.methods:
            rows.append(measure(case, method, options, cache))
            shown = {key: value for key, value in rows[-1].items() if key in COLUMNS}
            print(" ".join(f"{key}={value}" for key, value in shown.items()), flush=True)
        table += rows
        if "rholoc" in options.methods and len(rows) > 1:
            judgements.append(judged(rows))
            print(judgements[-1], flush=True)
    return table, judgements


def main() -> None:
    options = _options()
    with tempfile.TemporaryDirectory() as folder:
        cache = options.cache or Path(folder)
        cache.mkdir(parents=True, exist_ok=True)
        table, judgements = compared(options, cache)
    if options.json:
        options.json.write_text(json.dumps(table, indent=2) + "\n")
    print_table([{COLUMNS[key]: row[key] for key in COLUMNS if key in row} for row in table], list(COLUMNS.values()))
    print_table(judgements, _JUDGED)
    if options.write:
        write_results("placed", figures_of(judgements, table), options.command, options.seeds)
        quote_anew()


if __name__ == "__main__":
    main()
