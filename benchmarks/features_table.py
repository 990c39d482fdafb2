"""The table that the default features are chosen by: every extractor on the same recordings.

    python benchmarks/features_table.py --walk FOLDER --camera fx,fy,cx,cy \\
        --split far=700:1000/100:400:6 --split easy=400:1000/200:400:6 --split hard=400:1000/100:200:4 \\
        --split blur~9=400:1000/200:400:8 --halves WALK --building 30 --cache FOLDER \\
        --pairs LIGHTING_PAIRS --coloured COLOURED_LIGHTS --features gray,lab,lab3,sift,sift48

A split NAME=MAP/ASKED builds a map of some frames of a posed walk and asks it by others: the share within 5 cm and 5°,
answers more than 10 cm off among those given, bytes of the map, CPU milliseconds from JPEG to pose on one core
(median), and of those to extract. ``NAME~N`` blurs what is asked along the rows, over N px.

``--halves``: of a walk without truth, each half makes a map and is asked by the other's frames; right is what is within
10 cm and 5° of where the walk as a whole has the frame. Parts of a half that the other never saw cannot be found.
``--building SECONDS``: a simulated building with doors and furniture that look alike, mapped with true poses, asked by
another walk through it (10 cm and 5°). Right stereo matches by
changed light are listed for each scene of ``--pairs``. For ``--coloured``, pictures by coloured light are matched with
each one by white light from the other place: the median of matches that agree with the pair's epipolar geometry.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import poselib

from rholoc.evaluation.lighting_pairs import compare_lighting_pairs
from rholoc.features import extractor_names, get_extractor
from rholoc.features.matching import LIMITS, mutual_matches
from rholoc.geometry import Pose, pose_distances
from rholoc.localization import Localizer, Query
from rholoc.mapping import BuildOptions, build_map
from rholoc.maps import Map, map_to_bytes, read_trajectory_csv
from rholoc.recordings import GivenPoses, Recording, decode_image, read_image, read_recording
from rholoc.recordings.selection import SelectedFrames
from rholoc.simulation import Site, simulate_recording
from rholoc.trajectory import PoseMethod, estimate_trajectory

NEAR_M, NEAR_RAD = 0.05, np.deg2rad(5.0)
RIGHT_M = 0.10
HALVES_ASKED = 60  # frames of each half, about
BUILDING_FPS, BUILDING_ASKED_FPS = 15.0, 1.0
EPIPOLAR_PX = 2.0
JPEG_QUALITY = 92


@dataclass(frozen=True)
class Split:
    """Frames that make a map, frames that ask it, and over how many pixels what is asked is blurred."""

    name: str
    mapped: str
    asked: str
    blur_px: int

    @classmethod
    def parse(cls, text: str) -> Split:
        """Read ``NAME[~PX]=MAP/ASKED``."""
        name, frames = text.split("=")
        mapped, asked = frames.split("/")
        return cls(name, mapped, asked, int(name.partition("~")[2] or 1))


@dataclass(frozen=True)
class SplitFigures:
    """One extractor on one split."""

    queries: int
    recall: float
    given: float
    wrong_of_given: float
    map_bytes: int
    cpu_ms: float
    extract_ms: float


def measure_split(args: argparse.Namespace, split: Split, features: str) -> SplitFigures:
    """Build the map of a split and ask it."""
    mapped = read_recording(args.walk, camera=args.camera, frames=split.mapped)
    asked = read_recording(args.walk, camera=args.camera, frames=split.asked)
    return ask(map_of(mapped, features), asked, NEAR_M, split.blur_px)


def map_of(recording: Recording, features: str) -> Map:
    """The map of a recording whose poses are given."""
    return build_map([recording], BuildOptions(features=features, poses=PoseMethod.GIVEN, report=False))


def ask(map_: Map, asked: Recording, near_m: float, blur_px: int = 1) -> SplitFigures:
    """Ask a map by a recording whose poses are given."""
    localizer = Localizer(map_)
    assert asked.poses is not None
    assert asked.camera is not None
    rows = np.flatnonzero(asked.poses.known)
    errors: list[tuple[float, float] | None] = []
    whole_ms, extract_ms = [], []
    for row, image in zip(rows, asked.frames.images(rows.tolist()), strict=True):
        blurred = cv2.blur(image, (blur_px, 1)) if blur_px > 1 else image
        jpeg = cv2.imencode(".jpg", blurred, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()
        start = time.thread_time()
        decoded = decode_image(jpeg)
        begun = time.thread_time()
        found = localizer.extractor.extract(decoded)
        extract_ms.append(1e3 * (time.thread_time() - begun))
        pose: Pose | None = localizer.localize(Query(found, asked.camera)).pose
        whole_ms.append(1e3 * (time.thread_time() - start))
        truth = asked.poses.T_map_camera[row]
        errors.append(None if pose is None else pose_distances(pose.T_map_camera, truth))
    given = [error for error in errors if error is not None]
    return SplitFigures(
        len(errors),
        sum(apart < near_m and turned < NEAR_RAD for apart, turned in given) / len(errors),
        len(given) / len(errors),
        sum(apart > RIGHT_M for apart, _ in given) / max(len(given), 1),
        len(map_to_bytes(map_)),
        float(np.median(whole_ms)),
        float(np.median(extract_ms)),
    )


def halves(path: Path) -> tuple[Recording, Recording]:
    """Both halves of a walk, its keyframes with the poses that the whole walk gives them."""
    recording = read_recording(path)
    found = estimate_trajectory(replace(recording, poses=None), PoseMethod.VISUAL_INERTIAL)
    first = found.times < np.median(found.times)
    return tuple(
        replace(
            recording,
            camera=found.camera,
            frames=SelectedFrames(recording.frames, found.rows[half]),
            poses=GivenPoses(np.ones(int(half.sum()), dtype=bool), found.T_map_camera[half]),
            frame_intrinsics=None,
        )
        for half in (first, ~first)
    )  # type: ignore[return-value]


def measure_halves(parts: tuple[Recording, Recording], features: str) -> dict[str, SplitFigures]:
    """Each half's map, asked by the other."""
    return {
        name: ask(map_of(mapped, features), thinned(asked, HALVES_ASKED), RIGHT_M)
        for name, mapped, asked in (("first asks second", parts[1], parts[0]), ("second asks first", *parts))
    }


def thinned(recording: Recording, count: int) -> Recording:
    """About ``count`` frames of a posed recording."""
    assert recording.poses is not None
    rows = np.arange(len(recording.frames.times))[:: max(1, len(recording.frames.times) // count)]
    poses = GivenPoses(recording.poses.known[rows], recording.poses.T_map_camera[rows])
    return replace(recording, frames=SelectedFrames(recording.frames, rows), poses=poses)


def building(cache: Path, seconds: float) -> tuple[Recording, Recording]:
    """Two walks through a simulated building with their true poses."""
    walks = []
    for walk, fps in ((1, BUILDING_FPS), (2, BUILDING_ASKED_FPS)):
        folder = cache / f"building-0-walk{walk}-{seconds:.0f}s-{fps:g}fps-0ms"
        if not (folder / "made").exists():
            simulate_recording(folder, walk=walk, seconds=seconds, seed=0, fps=fps, site=Site.BUILDING)
            (folder / "made").touch()
        recording, truth = read_recording(folder), read_trajectory_csv(folder / "truth.csv")
        nearest = np.abs(truth.times[:, None] - recording.frames.times).argmin(axis=0)
        poses = GivenPoses(np.ones(len(nearest), dtype=bool), truth.T_map_camera[nearest])
        walks.append(replace(recording, poses=poses))
    return walks[0], walks[1]


def right_across_lights(folder: Path, features: str) -> dict[str, int]:
    """Right stereo matches of each scene whose light changed between the two pictures."""
    pairs = compare_lighting_pairs(folder, [features])
    return {pair.scene: pair.stereo_right for pair in pairs if pair.stereo_right is not None}


def agreeing_across_colours(folder: Path, features: str) -> dict[str, float]:
    """For each coloured light the median, over white pictures from the other place, of epipolar matches."""
    extractor = get_extractor(features)
    found = {path.stem: extractor.extract(read_image(path)) for path in sorted(folder.glob("*.jpg"))}
    agreeing: dict[str, float] = {}
    for stem, coloured in found.items():
        light, place = stem.rsplit("_", 1)
        if light.startswith("white") or place != "left":
            continue
        counts = []
        for other, white in found.items():
            if not (other.startswith("white") and other.endswith("_right")):
                continue
            pairs = mutual_matches(coloured, white, extractor.metric, LIMITS[extractor.metric].loose)
            counts.append(_epipolar_inliers(coloured.pixels[pairs[:, 0]], white.pixels[pairs[:, 1]]))
        agreeing[light] = float(np.median(counts))
    return agreeing


def _epipolar_inliers(a: np.ndarray, b: np.ndarray) -> int:
    if len(a) < 8:
        return 0
    options = {"max_epipolar_error": EPIPOLAR_PX, "max_iterations": 2000}
    _, report = poselib.estimate_fundamental(a.astype(np.float64), b.astype(np.float64), options)
    return int(report["num_inliers"])


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--walk", type=Path)
    parser.add_argument("--camera")
    parser.add_argument("--split", type=Split.parse, action="append", default=[])
    parser.add_argument("--halves", type=Path, help="a walk without truth")
    parser.add_argument("--building", type=float, metavar="SECONDS", help="of each walk through it")
    parser.add_argument("--cache", type=Path, help="where the simulated walks are kept")
    parser.add_argument("--pairs", type=Path)
    parser.add_argument("--coloured", type=Path)
    parser.add_argument("--features", default=",".join(extractor_names()))
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as folder:
        measure(args, args.cache or Path(folder))


def measure(args: argparse.Namespace, cache: Path) -> None:
    """All columns of all extractors."""
    parts = halves(args.halves) if args.halves else None
    walks = building(cache, args.building) if args.building else None
    table: dict[str, dict[str, Any]] = {}
    for features in args.features.split(","):
        row: dict[str, Any] = table.setdefault(features, {})
        for split in args.split:
            row[split.name] = asdict(measure_split(args, split, features))
        if parts is not None:
            row |= {name: asdict(figures) for name, figures in measure_halves(parts, features).items()}
        if walks is not None:
            row["building"] = asdict(ask(map_of(walks[0], features), walks[1], RIGHT_M))
        if args.pairs:
            row["lighting pairs"] = right_across_lights(args.pairs, features)
        if args.coloured:
            row["coloured lights"] = agreeing_across_colours(args.coloured, features)
        if not args.json:
            print(features)
            for name, figures in row.items():
                print(f"  {name:16}", "  ".join(f"{key} {_short(value)}" for key, value in figures.items()), flush=True)
    if args.json:
        print(json.dumps(table, indent=2))


def _short(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:.3g}"


if __name__ == "__main__":
    main()
