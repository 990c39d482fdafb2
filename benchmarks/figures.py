"""A short list of figures, measured again: nothing that the documents say may have become worse.

    python benchmarks/figures.py [PART …] [--write] [--cache FOLDER]

With ``--write`` each part's figures go to benchmarks/results/PART.json, with the command, the commit, the date, the
machine and the seeds; without it they are compared with that file, and the exit status is 1 if one is worse by more
than its noise. Documents quote a figure as ``98 %<!-- kitchen.hard.within_2cm_percent -->``; ``--write`` puts the
measured number there, and a test compares each with its file. Speeds are ratios: the machine's own drops out. Parts in
which nothing is timed are measured first, two at once.

The parts: demo (walks of seed 0), kitchen (easy and hard frames, beside LO-RANSAC), few (maps of a few photos), afar
(frames 30 cm and farther from the map's views), density (what its parts add to geometry), wide (frames of the kitchen's
ends in maps of the rest), focal (cameras whose focal length is wrong; ten minutes, only where it is named), strangers
(pictures of other rooms), pictures (a set without times), corridor (pictures and depth without the poses that came with
them), desk (a set without poses), request (what a frame costs), throughput (frames a second of more clients and
servers).
"""

from __future__ import annotations

import argparse
import asyncio
import functools
import json
import multiprocessing
import os
import platform
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import httpx
import numpy as np

import demo_sweep
import density_parts
import load
import rooms
from measuring import SHARED_DATA
from rholoc.evaluation.errors import PoseErrors, trajectory_errors
from rholoc.features import DEFAULT_FEATURES, get_extractor
from rholoc.geometry import Camera, FloatArray, IntArray, align_poses, angles_between, evenly, pose_distances
from rholoc.localization import Localizer, Query
from rholoc.localization.index.map_error import PLACE_M, PLACE_RAD, RIGHT_M
from rholoc.recordings import Recording, read_recording
from rholoc.trajectory import PoseMethod, Scale
from rholoc.trajectory.estimate import estimate_trajectory
from rholoc_lab.evaluation.compare import CompareOptions, SplitResult, compare
from rholoc_lab.evaluation.splits import QuerySet

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"
DOCUMENTS = (
    ROOT / "README.md",
    *sorted((ROOT / "docs").glob("**/*.md")),
    *sorted((ROOT / "server").glob("*.md")),
    ROOT / "ros" / "README.md",
)
QUOTED = re.compile(r"(?P<number>-?\d+(?:\.\d+)?)(?P<between>[^\d\n<]{0,5})<!-- (?P<name>[a-z]+(?:\.\w+)+) -->")
KITCHEN = SHARED_DATA / "redkitchen"
FRAME_PERCENT, AGAIN_CM, AGAIN_RATIO = 2.0, 0.1, 0.25
SEED = 0
REGION_95 = 7.81  # of χ² with three degrees of freedom
LOAD_S = 6.0
METHODS = {"ray": "", "poselib, everywhere": "ransac_"}
FOCAL_FACTORS, FOCAL_EVERY = (0.5, 0.67, 0.8, 0.9, 1.1, 1.25, 1.5, 2.0), 2
FOCAL_ROOMS = (
    "kitchen, easy",
    "kitchen, hard",
    "bedroom, first",
    "bedroom, second",
    "living room, first",
    "living room, second",
)
FEW_WITHIN_M, FEW_WITHIN_RAD, FEW_ASKED = 1.0, np.deg2rad(45.0), 40


@dataclass(frozen=True)
class Figure:
    """A number that was measured.

    Attributes:
        value: in the unit that ends its name.
        noise: by how much it may be worse another time.
        more_is_better: otherwise less is.
    """

    value: float
    noise: float
    more_is_better: bool

    def worse_by(self, before: Figure) -> float:
        """By how much this is worse than a figure measured before, less the noise; positive where it is worse."""
        change = self.value - before.value
        return (-change if self.more_is_better else change) - before.noise


Figures = dict[str, Figure]


def share(found: Any, frames_of_noise: int = 1) -> Figure:
    """The percentage of frames for which something holds."""
    return Figure(round(100 * float(np.mean(found)), 1), 100 * frames_of_noise / len(found), True)


def length_cm(value: float, noise_cm: float = AGAIN_CM) -> Figure:
    """A length, less of which is better."""
    return Figure(round(value, 2), noise_cm, False)


# -- parts -----------------------------------------------------------------------------------------------------------


def demo(cache: Path) -> Figures:
    """What `rholoc demo` prints, of seed 0."""
    found = demo_sweep.run(cache, SEED)
    return {
        "demo.within_5cm_percent": Figure(round(100 * found.within_5cm_5deg, 1), FRAME_PERCENT, True),
        "demo.median_cm": length_cm(found.median_cm or np.inf, 0.3),
        "demo.map_error_cm": length_cm(found.map_error_rms_cm, 0.3),
    }


def kitchen(_: Path) -> Figures:
    """Frames of a real kitchen, beside geometry alone on the same features."""
    queries = [
        QuerySet(name, one, np.arange(len(one.frames.times)))
        for name, frames in (("hard", "100:200:2"), ("easy", "200:400:4"))
        for one in (read_recording(KITCHEN, rooms.KITCHEN_CAMERA, frames),)
    ]
    mapped = read_recording(KITCHEN, rooms.KITCHEN_CAMERA, "400:1000")
    compared = compare([mapped], queries, CompareOptions(tensor=False, retrieval=False))
    figures = {}
    for split in compared.splits:
        for method, prefix in METHODS.items():
            figures |= {f"kitchen.{split.label}.{prefix}{name}": one for name, one in _of_method(split, method).items()}
    return figures | {"kitchen.map_mb": Figure(round(compared.splits[0].methods[0].map_bytes / 1e6, 2), 0.05, False)}


def _of_method(split: SplitResult, method: str) -> Figures:
    """How exact the answers of a method are."""
    errors = next(one for one in split.methods if one.name == method).errors
    return _exactness(errors) | {
        "median_deg": Figure(round(float(np.degrees(np.median(errors.rotation_rad))), 2), 0.05, False),
    }


def _exactness(errors: PoseErrors) -> Figures:
    return {
        "within_5cm_percent": share(errors.within(0.05, 5.0)),
        "within_2cm_percent": share(errors.within(0.02, 2.0)),
        "median_cm": length_cm(100 * float(np.median(errors.position_m))),
    }


def few(_: Path) -> Figures:
    """Frames near maps of a few photos with poses, beside geometry alone on the same features."""
    walk = read_recording(KITCHEN, rooms.KITCHEN_CAMERA, "400:1000")
    scan = read_recording(SHARED_DATA / "corridor_lidar" / "scan")
    figures: Figures = {}
    for name, recording, rows in (
        ("kitchen_of_5", walk, np.linspace(0, len(walk.frames.times) - 1, 5)),
        ("kitchen_of_10", walk, np.linspace(0, len(walk.frames.times) - 1, 10)),
        ("corridor", scan, np.arange(0, len(scan.frames.times), 8)),
    ):
        photos = rows.astype(int)
        asked = _near(recording, photos)
        query = QuerySet(name, recording, asked[:: max(1, len(asked) // FEW_ASKED)])
        options = CompareOptions(tensor=False, retrieval=False)
        split = compare([rooms.chosen(recording, photos)], [query], options).splits[0]
        figures[f"few.{name}.photos"] = Figure(len(photos), 0, True)
        for method, prefix in METHODS.items():
            errors = next(one for one in split.methods if one.name == method).errors
            figures[f"few.{name}.{prefix}within_10cm_percent"] = share(errors.within(0.10, 5.0), 2)
            wrong = errors.localized & ~errors.within(PLACE_M, np.inf)
            figures[f"few.{name}.{prefix}wrong_percent"] = Figure(
                round(100 * float(wrong.mean()), 1), FRAME_PERCENT, False
            )
    return figures


def _near(recording: Recording, photos: IntArray) -> IntArray:
    """The rows of frames within a metre and 45° of a photo, but for the photos."""
    assert recording.poses is not None
    T = recording.poses.T_map_camera
    apart_m = np.linalg.norm(T[:, None, :3, 3] - T[photos, :3, 3], axis=2)
    turned_rad = angles_between(T[:, None, :3, 2], T[photos, :3, 2])
    near = ((apart_m < FEW_WITHIN_M) & (turned_rad < FEW_WITHIN_RAD)).any(axis=1)
    return np.setdiff1d(np.flatnonzero(near & recording.poses.known), photos)


def afar(cache: Path) -> Figures:
    """Frames of the kitchen's first part in a map of its last."""
    room, localizer = _kitchen_map(cache, "kitchen, map 700–999")
    truth, estimated = [], []
    for T, image in room.pictures():
        truth.append(T)
        estimated.append(_pose(localizer, image, room))
    errors = trajectory_errors(np.array(estimated), np.array(truth))
    wrong = errors.localized & ~errors.within(0.10, np.inf)
    return {
        "afar.within_5cm_percent": share(errors.within(0.05, 5.0)),
        "afar.within_2cm_percent": share(errors.within(0.02, 2.0), 2),
        "afar.over_10cm_percent": Figure(round(100 * float(wrong.mean()), 1), FRAME_PERCENT, False),
    }


def density(cache: Path) -> Figures:
    """What the parts of the density add to geometry, from the same features in the same place."""
    room, localizer = _kitchen_map(cache, "kitchen, map 700–999")
    errors = density_parts.errors(localizer, room)
    return {f"density.{way}.{name}": one for way in errors for name, one in _exactness(errors[way]).items()}


def wide(cache: Path) -> Figures:
    """Frames of either end of the kitchen in a map of the rest of it: their places, and whether 95 % regions hold."""
    rows = [row for named in rooms.WIDE if named.recording == "redkitchen" for row in _asked_afar(named, cache)]
    answered = np.array([row is not None for row in rows])
    off_m, off_rad, mahalanobis = np.array([row for row in rows if row is not None]).T
    right = (off_m < PLACE_M) & (off_rad < PLACE_RAD)
    return {
        "wide.frames": Figure(len(rows), 0, True),
        "wide.right_percent": Figure(round(100 * right.sum() / len(rows), 1), FRAME_PERCENT, True),
        "wide.wrong_percent": Figure(round(100 * (~right).sum() / answered.sum(), 1), FRAME_PERCENT, False),
        "wide.within_10cm_percent": Figure(round(100 * (off_m < 0.1).sum() / len(rows), 1), FRAME_PERCENT, True),
        "wide.in_95_region_percent": Figure(round(100 * float(np.mean(mahalanobis < REGION_95)), 1), 4.0, True),
    }


def _asked_afar(named: rooms.NamedRoom, cache: Path) -> Iterator[tuple[float, float, float] | None]:
    """Of each frame how far its answer is off [m, rad], and the position's squared Mahalanobis distance."""
    room = named.make(cache)
    localizer = Localizer(rooms.map_of(named, room.mapped, DEFAULT_FEATURES, cache))
    assert room.asked.camera is not None
    for T, image in room.pictures():
        answer = localizer.localize(Query.of_picture(image, localizer.extractor, room.asked.camera))
        if answer.pose is None or answer.covariance is None:
            yield None
            continue
        off_m, off_rad = pose_distances(answer.pose.T_map_camera, T)
        error = answer.pose.position - T[:3, 3]
        yield float(off_m), float(off_rad), float(error @ np.linalg.solve(answer.covariance[:3, :3], error))


def focal(cache: Path) -> Figures:
    """Frames asked by cameras whose focal lengths, or ``fx`` alone, are off by some factor: how many get a pose more
    than 10 cm off that is said to be within 10 cm with a probability of at least one half.
    """
    tried = {"given": (1.0, 1.0)}
    for factor in FOCAL_FACTORS:
        percent = round(100 * factor)
        tried |= {f"both_at_{percent}": (factor, factor), f"fx_at_{percent}": (factor, 1.0)}
    found: dict[str, list[tuple[bool, bool]]] = {name: [] for name in tried}
    for named in (*(one for one in rooms.ROOMS if one.name.startswith(FOCAL_ROOMS)), *rooms.ALTERNATE):
        room = named.make(cache)
        localizer = Localizer(rooms.map_of(named, room.mapped, DEFAULT_FEATURES, cache))
        camera = room.asked.camera
        assert camera is not None
        for T, image in islice(room.pictures(), 0, None, FOCAL_EVERY):
            query = Query.of_picture(image, localizer.extractor, camera)
            if query.more_features is not None:
                query = replace(query, more_features=functools.cache(query.more_features))
            for name, (x, y) in tried.items():
                wrong = replace(camera, fx=x * camera.fx, fy=y * camera.fy)
                answer = localizer.localize(replace(query, camera=wrong))
                is_right = answer.pose is not None and pose_distances(answer.pose.T_map_camera, T)[0] < RIGHT_M
                is_sure = answer.pose is not None and answer.confidence >= 0.5
                found[name].append((bool(is_right), bool(is_sure and not is_right)))
    figures = {
        f"focal.{name}.wrong_and_sure_percent": Figure(
            round(100 * float(np.mean([wrong for _, wrong in of])), 1), FRAME_PERCENT, False
        )
        for name, of in found.items()
    }
    return figures | {
        "focal.frames": Figure(len(found["given"]), 0, True),
        "focal.given.right_percent": share([right for right, _ in found["given"]]),
    }


def _pose(localizer: Localizer, image: np.ndarray, room: rooms.Room) -> FloatArray:
    camera = room.asked.camera
    assert camera is not None
    answer = localizer.localize(Query.of_picture(image, localizer.extractor, camera))
    return np.full((4, 4), np.nan) if answer.pose is None else answer.pose.T_map_camera


def _ask(localizer: Localizer, image: np.ndarray, camera: Camera) -> tuple[bool, float, float]:
    """Whether a picture has no pose, and the CPU time of its features and of the whole answer [s]."""
    begun = time.thread_time()
    query = Query.of_picture(image, localizer.extractor, camera)
    extracted = time.thread_time()
    refused = localizer.localize(query).pose is None
    return refused, extracted - begun, time.thread_time() - begun


def _kitchen_map(cache: Path, name: str = "kitchen, easy") -> tuple[rooms.Room, Localizer]:
    named = next(one for one in rooms.ROOMS if one.name == name)
    room = named.make(cache)
    return room, Localizer(rooms.map_of(named, room.mapped, DEFAULT_FEATURES, cache))


@functools.cache
def _asked_strangers(cache: Path) -> list[tuple[bool, float, float]]:
    """Pictures of other rooms asked in the kitchen's map, once for all parts."""
    _, localizer = _kitchen_map(cache)
    return [_ask(localizer, image, camera) for image, camera in rooms.strangers(rooms.ROOMS[0].recording, 4)]


def strangers(cache: Path) -> Figures:
    """Pictures of other rooms in the kitchen's map."""
    refused = [one for one, *_ in _asked_strangers(cache)]
    return {"strangers.refused_percent": share(refused, 0), "strangers.pictures": Figure(len(refused), 0, True)}


def pictures(_: Path) -> Figures:
    """Every tenth picture of the kitchen, shuffled, without times, poses or intrinsics."""
    with tempfile.TemporaryDirectory() as name:
        truth = shuffled_pictures(Path(name))
        found = estimate_trajectory(read_recording(Path(name)), PoseMethod.AUTO)
    T = truth[found.rows]
    placed = align_poses(found.T_map_camera, T).poses(found.T_map_camera)
    off_cm = 100 * np.linalg.norm(placed[:, :3, 3] - T[:, :3, 3], axis=1)
    return {
        "pictures.placed_percent": share(np.isin(np.arange(len(truth)), found.rows), 0),
        "pictures.median_cm": length_cm(float(np.median(off_cm)), 0.2),
    }


def shuffled_pictures(folder: Path) -> FloatArray:
    """Put every tenth picture of the kitchen into a folder as 0000.jpg …, shuffled; returns their poses (N, 4, 4)."""
    known = read_recording(KITCHEN, rooms.KITCHEN_CAMERA, "400:1000:10")
    assert known.poses is not None
    order = np.random.default_rng(SEED).permutation(len(known.frames.times))
    for number, row in enumerate(order):
        source = KITCHEN / "frames" / f"frame-{known.frames.numbers[row]:06d}.jpg"
        (folder / f"{number:04d}.jpg").symlink_to(source)
    return known.poses.T_map_camera[order]


def corridor(_: Path) -> Figures:
    """A corridor with doors that look alike, from pictures and LiDAR alone, against the poses that ARKit had."""
    return _without_poses("corridor", SHARED_DATA / "corridor_lidar" / "scan")


def desk(_: Path) -> Figures:
    """A desk from pictures alone, against COLMAP's model."""
    return _without_poses("desk", SHARED_DATA / "splat_desk")


def _extracting_s(recording: Recording) -> float:
    """Processor time of a picture's default features [s], mean of twenty."""
    extractor = get_extractor(DEFAULT_FEATURES)
    images = list(recording.frames.images(evenly(len(recording.frames.times), 20).tolist()))
    begun = time.process_time()
    for image in images:
        extractor.extract(image)
    return (time.process_time() - begun) / len(images)


def _without_poses(part: str, path: Path) -> Figures:
    """How much of a recording is placed without the poses that came with it, and how far from them."""
    known = read_recording(path)
    assert known.poses is not None
    camera = known.camera if known.depth is not None else None
    begun = os.times()
    found = estimate_trajectory(replace(known, poses=None, camera=camera), PoseMethod.AUTO)
    busy_s = sum(now - before for now, before in zip(os.times()[:4], begun[:4], strict=True))
    to_extracting = busy_s / len(known.frames.times) / _extracting_s(known)
    T = known.poses.T_map_camera[found.rows]
    aligned = align_poses(found.T_map_camera, T)
    off = np.linalg.norm(aligned.poses(found.T_map_camera)[:, :3, 3] - T[:, :3, 3], axis=1)
    extent = float(np.linalg.norm(np.ptp(T[:, :3, 3], axis=0)))
    figures = {
        f"{part}.placed_percent": share(np.isin(np.arange(len(known.frames.times)), found.rows), 0),
        f"{part}.off_percent_of_extent": Figure(round(100 * float(np.median(off)) / extent, 2), 0.1, False),
        f"{part}.cpu_to_extracting_ratio": Figure(round(to_extracting, 1), round(0.25 * to_extracting, 1), False),
    }
    if found.scale is Scale.METRIC:
        figures[f"{part}.scale_off_percent"] = Figure(round(100 * abs(aligned.scale - 1), 1), 0.5, False)
    return figures


def request(cache: Path) -> Figures:
    """What an easy frame and a stranger's picture cost, in multiples of what finding an easy frame's features costs."""
    room, localizer = _kitchen_map(cache)
    assert room.asked.camera is not None
    easy = [_ask(localizer, image, room.asked.camera) for _, image in room.pictures()]
    extract_s, answered_s = np.median([times for _, *times in easy], axis=0)
    refused_s = float(np.median([whole_s for *_, whole_s in _asked_strangers(cache)]))
    return {
        "request.answered_to_extracting_ratio": Figure(round(answered_s / extract_s, 2), AGAIN_RATIO, False),
        "request.refused_to_answered_ratio": Figure(round(refused_s / answered_s, 2), 1.0, False),
    }


def throughput(_: Path) -> Figures:
    """How many more frames a second eight clients get than one, of one server and of two that share a storage."""
    cores = len(os.sched_getaffinity(0))
    return {
        f"throughput.{name}_ratio": _gain(number, cores) for number, name in ((1, "one_server"), (2, "two_servers"))
    }


def _gain(servers: int, cores: int) -> Figure:
    async def rates(started: Sequence[load.Server]) -> list[float]:
        async with httpx.AsyncClient(timeout=load.PATIENCE_S) as client:
            asker = load.Asker(started, client)
            await asker.warm_up()
            return [(await asker.always(clients, LOAD_S)).frames_a_second for clients in (1, 8)]

    with load.serving(servers, cores) as started:
        one, eight = asyncio.run(rates(started))
    return Figure(round(eight / one, 2), AGAIN_RATIO, True)


PARTS: dict[str, Callable[[Path], Figures]] = {
    "demo": demo,
    "kitchen": kitchen,
    "few": few,
    "afar": afar,
    "density": density,
    "wide": wide,
    "focal": focal,
    "strangers": strangers,
    "pictures": pictures,
    "corridor": corridor,
    "desk": desk,
    "request": request,
    "throughput": throughput,
}
ONLY_NAMED = ("focal",)  # parts that take too long to be measured each time
UNTIMED = ("demo", "kitchen", "few", "afar", "density", "wide", "focal", "pictures")  # may be measured beside another


# -- files and documents ---------------------------------------------------------------------------------------------


def read_results() -> Figures:
    """All figures that were written."""
    found = {}
    for path in sorted(RESULTS.glob("*.json")):
        found |= {name: Figure(**one) for name, one in json.loads(path.read_text())["figures"].items()}
    return found


def write_results(part: str, figures: Figures, command: str, seeds: Sequence[int] = (SEED,)) -> None:
    """Write the file of a part; ``command`` is what measured it."""
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True)
    described = {
        "command": command,
        "commit": commit.stdout.strip(),
        "date": f"{datetime.now(UTC):%Y-%m-%d}",
        "machine": f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}",
        "seeds": list(seeds),
        "figures": {name: asdict(one) for name, one in figures.items()},
    }
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / f"{part}.json").write_text(json.dumps(described, indent=1) + "\n")


def quote_anew() -> None:
    """Put the figures that were written into the documents that quote them."""
    for path in DOCUMENTS:
        path.write_text(with_figures(path.read_text(encoding="utf-8"), read_results()), encoding="utf-8")


def as_quoted(value: float, like: str) -> str:
    """A value with as many decimals as a number has."""
    return f"{value:.{len(like.partition('.')[2])}f}"


def quotes(text: str) -> Iterator[tuple[str, str]]:
    """The figures that a document quotes: their names, and the numbers as they stand there."""
    for found in QUOTED.finditer(text):
        yield found["name"], found["number"]


def with_figures(text: str, figures: Figures) -> str:
    """A document with the numbers that were measured; names that are not among the figures stay as they are."""

    def measured(found: re.Match[str]) -> str:
        name = found["name"]
        number = as_quoted(figures[name].value, found["number"]) if name in figures else found["number"]
        return f"{number}{found['between']}<!-- {name} -->"

    return QUOTED.sub(measured, text)


def _measure(part: Callable[[Path], Figures], cache: Path) -> tuple[Figures, float]:
    """What a part gives, and the seconds that it took."""
    cv2.setNumThreads(1)
    begun = time.monotonic()
    return part(cache), time.monotonic() - begun


def _measured(
    parts: dict[str, Callable[[Path], Figures]], names: Sequence[str], cache: Path
) -> Iterator[tuple[str, Figures, float]]:
    """Name, figures and seconds of parts, those in ``UNTIMED`` first."""
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        beside = {name: pool.submit(_measure, parts[name], cache) for name in names if name in UNTIMED}
        for name, found in beside.items():
            yield (name, *found.result())
    for name in names:
        if name not in beside:
            yield (name, *_measure(parts[name], cache))


def run(description: str | None, parts: dict[str, Callable[[Path], Figures]], seeds: Sequence[int] = (SEED,)) -> None:
    """The command of a benchmark that measures parts: print what each gives beside its file, or write it there."""
    script = Path(sys.argv[0]).name
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    usual = [part for part in parts if part not in ONLY_NAMED]
    parser.add_argument("parts", nargs="*", help=f"default: {', '.join(usual)}")
    parser.add_argument("--write", action="store_true", help="what is measured is what documents quote from now on")
    parser.add_argument("--cache", type=Path, help="where simulated walks and maps are kept")
    asked = parser.parse_args()
    if unknown := set(asked.parts) - set(parts):
        parser.error(f"there is no part {', '.join(sorted(unknown))}")
    before, worse = read_results(), []
    with tempfile.TemporaryDirectory() as name:
        cache = asked.cache or Path(name)
        cache.mkdir(parents=True, exist_ok=True)
        for part, figures, took_s in _measured(parts, asked.parts or usual, cache):
            print(f"{part}, {took_s:.0f} s")
            for title, one in figures.items():
                known = before.get(title)
                was = "new" if known is None else f"was {known.value:g} ± {known.noise:g}"
                print(f"  {title:44} {one.value:8g}   {was}", flush=True)
                if known is not None and one.worse_by(known) > 0:
                    worse.append(f"{title}: {one.value:g}, {was}")
            if asked.write:
                write_results(part, figures, f"python benchmarks/{script} {part} --write", seeds)
    if asked.write:
        quote_anew()
    elif worse:
        sys.exit("Worse than what the documents say:\n" + "\n".join(worse))


if __name__ == "__main__":
    run(__doc__, PARTS)
