"""What a prior saves, and what it costs: real and simulated rooms asked with and without one.

    python benchmarks/priors.py --cache FOLDER [--features sift48] [--rooms "building;kitchen, hard"] [--every 2]

Frames of rooms of benchmarks/rooms.py, from JPEG to pose, without a prior and with priors that are off in a random
direction: near, rough, and wrong. For each: the processor time (median and mean, one core), the mean as a multiple of
that without, how many frames are answered within 10 cm and 5°, how many of the answers are farther off, and the median
error of the answers.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from asking import RIGHT_M, RIGHT_RAD
from measuring import jpeg_of, print_table
from prior_kinds import PriorKind, pose_off
from rholoc.geometry import Pose, pose_distances
from rholoc.localization import Localizer, Prior, Query
from rholoc.recordings import decode_image
from rooms import ROOMS, WIDE, NamedRoom, map_of

DEFAULT_ROOMS = (
    "kitchen, easy",
    "kitchen, hard",
    "kitchen, map 700–999",
    "building",
    "bedroom, near end asked",
    "bedroom, far end asked",
)


@dataclass(frozen=True)
class Answer:
    """One frame's: processor time; how far off the pose is, metres and radians, infinite where there is none."""

    cpu_ms: float
    off_m: float
    turned_rad: float

    @property
    def is_given(self) -> bool:
        """Whether there is a pose."""
        return bool(np.isfinite(self.off_m))

    @property
    def is_right(self) -> bool:
        """Whether it is within 10 cm and 5°."""
        return self.off_m < RIGHT_M and self.turned_rad < RIGHT_RAD


def ask(named: NamedRoom, features: str, every: int, kept: Path) -> Iterator[tuple[PriorKind, Answer]]:
    """A room's frames, each asked in every way, one after the other."""
    room, rng = named.make(kept), np.random.default_rng(0)
    localizer, camera = Localizer(map_of(named, room.mapped, features, kept)), room.asked.camera
    assert camera is not None
    for number, (truth, image) in enumerate(room.pictures()):
        if number % every:
            continue
        jpeg = jpeg_of(image)
        for asked in PriorKind:
            expected = pose_off(Pose(truth), asked, rng)
            prior, start = None if expected is None else Prior(expected), time.thread_time()
            query = Query.of_picture(decode_image(jpeg), localizer.extractor, camera)
            pose = localizer.localize(replace(query, prior=prior)).pose
            cpu_ms = 1e3 * (time.thread_time() - start)
            off = (np.inf, np.inf) if pose is None else pose_distances(pose.T_map_camera, truth)
            yield asked, Answer(cpu_ms, float(off[0]), float(off[1]))


def row(name: str, asked: PriorKind, answers: list[Answer], alone_ms: float) -> dict[str, str]:
    """A line of the table."""
    given = [one for one in answers if one.is_given]
    mean_ms = np.mean([one.cpu_ms for one in answers])
    return {
        "room": name,
        "prior": str(asked),
        "median ms": f"{np.median([one.cpu_ms for one in answers]):.0f}",
        "mean ms": f"{mean_ms:.0f}",
        "of none's": f"{mean_ms / alone_ms:.2f}",
        "right": f"{sum(one.is_right for one in given)} of {len(answers)}",
        "wrong": str(sum(not one.is_right for one in given)),
        "median cm": f"{100 * np.median([one.off_m for one in given]):.2f}" if given else "–",
    }


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, required=True)
    parser.add_argument("--features", default="sift48")
    parser.add_argument("--rooms", default=";".join(DEFAULT_ROOMS), help="names divided by semicolons")
    parser.add_argument("--every", type=int, default=1, help="only every n-th frame")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    rows, everywhere = [], {asked: list[Answer]() for asked in PriorKind}
    chosen = args.rooms.split(";")
    for named in (one for one in (*ROOMS, *WIDE) if one.name in chosen):
        answers = {asked: list[Answer]() for asked in PriorKind}
        for asked, answer in ask(named, args.features, args.every, args.cache):
            answers[asked].append(answer)
            everywhere[asked].append(answer)
        rows += table_of(named.name, answers)
    print_table(rows + table_of("all", everywhere), list(rows[0]))


def table_of(name: str, answers: dict[PriorKind, list[Answer]]) -> list[dict[str, str]]:
    """The lines of one room."""
    alone_ms = float(np.mean([one.cpu_ms for one in answers[PriorKind.NONE]]))
    return [row(name, asked, some, alone_ms) for asked, some in answers.items()]


if __name__ == "__main__":
    main()
