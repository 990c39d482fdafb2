"""The table that the default features are chosen by: every kind of features in the same rooms.

    python benchmarks/features_table.py --cache FOLDER [--features "sift48;lab3;..."] [--minutes 10] [--json FILE]

Of every room of benchmarks/rooms.py: the share of its frames within 5 cm and 5° (10 cm where poses are no better known
than that: halves of a walk, the building), and how many of the answers given are more than 10 cm
off; and in the mean over what is asked from far and across a walk's halves. Then of frames that are asked from places
beside which nothing was mapped, by how far off the nearest view is that looks about the same way, the share that is
answered within 10 cm and 5°, and the share for which such a pose is found, given out or too doubtful for that; frames
that show next to nothing of the map count apart. Of each kind of features also the bytes of the kitchen's map, and for
the kitchen's easy frames the processor time from JPEG to pose (median, one core) and of that to extract: compare it
where the machine was as busy all along.

Then right stereo matches across changed lights (../shared/data/lighting_pairs), and across coloured lights the median
number of matches that agree with the pair's epipolar geometry, each coloured picture held against the white ones from
the other place (../shared/data/coloured_lights).

Cells are kept in the cache until the code that they depend on changes. After ``--minutes`` of processor time the
command ends; asking again goes on there.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import poselib

from asking import Answered, Case, Kind, answers_of, code_digest
from measuring import SHARED_DATA, jpeg_of, print_table
from rholoc.features import extractor_names, get_extractor
from rholoc.features.matching import LIMITS, mutual_matches
from rholoc.localization import MIN_RECOGNIZED, Localizer, Query
from rholoc.maps import map_to_bytes
from rholoc.recordings import decode_image, read_image
from rholoc_lab.evaluation.lighting_pairs import compare_lighting_pairs
from rooms import ROOMS, WIDE, map_of, nearest_views

NEAR_M, NEAR_RAD = 0.05, np.deg2rad(5.0)
RIGHT_M = 0.10
TRUE_TO_CENTIMETRES = ("redkitchen", "another light", *(f"room {seed}" for seed in range(10)))
TIMED = "kitchen, easy"
LIGHTS, COLOURS, COST, DISTANCE = "lighting pairs", "coloured pairs", "cost", "by distance"
NEAREST_M = (0.5, 1.0, 2.0)
DISTANCES = ("view within 0.5 m", "view within 0.5–1 m", "view within 1–2 m", "no view that looks so, or nothing shown")
MEANS = {
    "from far": ("kitchen, map 600–999", "kitchen, map 700–999"),
    "across a walk's halves": tuple(one.name for one in ROOMS if one.name.endswith("half mapped")),
}
EPIPOLAR_PX = 2.0
OUT_OF_TIME = 3


@dataclass(frozen=True)
class Cost:
    """What one kind of features costs in the kitchen.

    Attributes:
        map_bytes: of the map.
        cpu_ms: median processor time from JPEG to pose.
        extract_ms: of that, to decode and to extract what every frame needs.
    """

    map_bytes: int
    cpu_ms: float
    extract_ms: float


def cost(features: str, kept: Path) -> Cost:
    """Ask the kitchen's map by its easy frames, as a service would: JPEG to pose."""
    named = next(one for one in ROOMS if one.name == TIMED)
    room = named.make(kept)
    camera = room.asked.camera
    assert camera is not None
    map_ = map_of(named, room.mapped, features, kept)
    localizer = Localizer(map_)
    whole_ms, extract_ms = [], []
    for _, image in room.pictures():
        jpeg = jpeg_of(image)
        start = time.thread_time()
        query = Query.of_picture(decode_image(jpeg), localizer.extractor, camera)
        extract_ms.append(1e3 * (time.thread_time() - start))
        localizer.localize(query)
        whole_ms.append(1e3 * (time.thread_time() - start))
    return Cost(len(map_to_bytes(map_)), float(np.median(whole_ms)), float(np.median(extract_ms)))


@dataclass(frozen=True)
class Answers:
    """One kind of features in one room.

    Attributes:
        queries: how many frames asked.
        near: how many of them are answered within 5 cm (or 10) and 5°.
        given: how many are answered.
        wrong: how many of the answers are more than 10 cm off.
        found: how many frames a pose is found for within 5 cm (or 10) and 5°, given out or too doubtful for that.
    """

    queries: int
    near: int
    given: int
    wrong: int
    found: int

    @classmethod
    def of(cls, answered: Answered) -> Answers:
        """What a room's frames are answered with."""
        near_m = NEAR_M if answered.recording in TRUE_TO_CENTIMETRES else RIGHT_M
        frames = [case for case in answered.cases if case.kind is Kind.WHOLE]
        return cls.of_frames(frames, answered.features, near_m)

    @classmethod
    def of_frames(cls, frames: Sequence[Case], features: str, near_m: float) -> Answers:
        """What frames are answered with by one kind of features, at the confidence that is asked of an answer."""
        given = [case for case in frames if case.belief().recognized >= MIN_RECOGNIZED]
        return cls(
            len(frames),
            sum(case.is_within(near_m, NEAR_RAD) for case in given),
            len(given),
            sum(not case.is_within(RIGHT_M, np.inf) for case in given),
            sum(case.is_within(near_m, NEAR_RAD) for case in frames),
        )


def by_distance(answered: Sequence[Answered], kept: Path) -> dict[str, dict[str, int]]:
    """What frames of the wide rooms are answered with, by how far the nearest view is; all within 10 cm are near."""
    features = answered[0].features
    cases = [case for one in answered for case in one.cases if case.kind is Kind.WHOLE]
    distance = np.digitize(np.concatenate([nearest_views(named, kept) for named in WIDE]), NEAREST_M)
    return {
        label: asdict(Answers.of_frames([cases[row] for row in np.flatnonzero(distance == number)], features, RIGHT_M))
        for number, label in enumerate(DISTANCES)
    }


def right_across_lights(features: str) -> dict[str, int]:
    """Right stereo matches of each scene whose light changed between the two pictures."""
    pairs = compare_lighting_pairs(SHARED_DATA / "lighting_pairs", [features])
    return {pair.scene: pair.stereo_right for pair in pairs if pair.stereo_right is not None}


def agreeing_across_colours(features: str) -> dict[str, float]:
    """For each coloured light the median, over white pictures from the other place, of epipolar matches."""
    extractor = get_extractor(features)
    folder = SHARED_DATA / "coloured_lights"
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


def measure(features: list[str], kept: Path, is_late: Callable[[], bool]) -> dict[str, dict[str, Any]]:
    """All cells that are kept or can be measured in time, by kind of features and by name."""
    table: dict[str, dict[str, Any]] = {name: {} for name in features}
    for name, row in table.items():
        for named in ROOMS:
            answered = answers_of(named, name, kept, is_late, frames_alone=True)
            if answered is not None:
                row[named.name] = asdict(Answers.of(answered))
        wide = [answers_of(named, name, kept, is_late, frames_alone=True) for named in WIDE]
        if all(wide):
            row[DISTANCE] = by_distance([answered for answered in wide if answered], kept)
        others: dict[str, Callable[[str], dict[str, Any]]] = {
            LIGHTS: right_across_lights,
            COLOURS: agreeing_across_colours,
            COST: lambda features: asdict(cost(features, kept)),
        }
        for cell, measured in others.items():
            path = kept / "features" / f"{name}-{cell}-{code_digest(name)}.json".replace(" ", "-")
            if not path.is_file():
                if is_late():
                    continue
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(json.dumps(measured(name)))
                print(f"measured: {name}, {cell}", flush=True)
            row[cell] = json.loads(path.read_text())
    return table


def shown(table: dict[str, dict[str, Any]]) -> list[dict[str, str]]:
    """A line a figure, a column a kind of features."""
    lines = []
    for named in ROOMS:
        lines.append(
            {"": named.name} | {name: _share(row[named.name]) for name, row in table.items() if named.name in row}
        )
    for label, rooms in MEANS.items():
        means = {
            name: f"{np.mean([100 * row[room]['near'] / row[room]['queries'] for room in rooms]):.0f} %"
            for name, row in table.items()
            if all(room in row for room in rooms)
        }
        lines.append({"": label} | means)
    lines += [_of_distance(label, table) for label in DISTANCES]
    for cell in (LIGHTS, COLOURS):
        for key in dict.fromkeys(key for row in table.values() for key in row.get(cell, {})):
            counts = {name: f"{row[cell][key]:.0f}" for name, row in table.items() if cell in row}
            lines.append({"": f"{cell}: {key}"} | counts)
    for label, key, unit in (
        ("map, kB", "map_bytes", 1e3),
        ("whole, ms", "cpu_ms", 1),
        ("extract, ms", "extract_ms", 1),
    ):
        lines.append({"": label} | {name: f"{row[COST][key] / unit:.0f}" for name, row in table.items() if COST in row})
    return lines


def _of_distance(label: str, table: dict[str, dict[str, Any]]) -> dict[str, str]:
    """How many frames there are at one distance; the share answered and the share for which a right pose is found."""
    cells = {name: row[DISTANCE][label] for name, row in table.items() if DISTANCE in row}
    queries = max((cell["queries"] for cell in cells.values()), default=0)
    found = {name: f"found {100 * cell['found'] / cell['queries']:.0f} %" for name, cell in cells.items()}
    return {"": f"{label} ({queries})"} | {name: f"{_share(cell)}; {found[name]}" for name, cell in cells.items()}


def _share(cell: dict[str, Any]) -> str:
    wrong = f", {cell['wrong']} wrong" if cell["wrong"] else ""
    return f"{100 * cell['near'] / cell['queries']:.0f} %{wrong}"


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, required=True)
    parser.add_argument("--features", help="names divided by semicolons; all where left out")
    parser.add_argument("--minutes", type=float, default=np.inf, help="of processor time, after which it ends")
    parser.add_argument("--json", type=Path, help="where to write the figures")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    features = args.features.split(";") if args.features else extractor_names()
    table = measure(features, args.cache, lambda: time.process_time() > 60 * args.minutes)
    print_table(shown(table), ["", *table])
    if args.json:
        args.json.write_text(json.dumps(table, indent=2) + "\n")
    missing = sum(len(ROOMS) + len((LIGHTS, COLOURS, COST, DISTANCE)) - len(row) for row in table.values())
    if missing:
        print(f"{missing} cells are still to be measured: run it again.")
        raise SystemExit(OUT_OF_TIME)


if __name__ == "__main__":
    main()
