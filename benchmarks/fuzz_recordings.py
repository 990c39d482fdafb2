"""Whether any recording makes mapping fail otherwise than in one line with advice.

    python benchmarks/fuzz_recordings.py [redkitchen splat_desk …] [--cases 30] [--first 0] [--seed 0] [--pictures 24]
        [--minutes 20] [--json FILE] [--write] [--add]

Each case is a stretch of one recording's pictures, in a folder, to which one to three things have befallen: pictures
were thinned, shuffled, cut out, doubled, rotated, rescaled or blanked, a second camera took some, the camera stood
still; another recording's may be mixed in, and there may be times, wrong poses or wrong intrinsics. It is built into a
map by default options, whose report is not made. A case fails that raises anything but an error of ``rholoc.errors``
with a message and advice, or the one of a reconstruction that broke; and one whose map is trusted, but wrong:
places are off by a tenth of the walk, or another room is part of it.

Prints each case, its processor time and how it ended; exit status 1 where one failed. A case is made from the seed and
its number. No case begins after so many minutes. With ``--write`` the totals go to benchmarks/results/fuzz.json, with
``--add`` together with those of other seeds that are there already.
"""

import argparse
import json
import os
import random
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from figures import RESULTS, Figure, write_results
from measuring import SHARED_DATA
from rholoc.errors import RholocError
from rholoc.geometry import ByteArray, FloatArray, umeyama
from rholoc.mapping import BuildOptions, build_map
from rholoc.recordings import read_recording
from rholoc.trajectory.child import ReconstructionBroken

NAMES = (
    "redkitchen",
    "splat_desk",
    "corridor_lidar/scan",
    "euroc_v101",
    "bedroom_night",
    "android_livingroom",
    "coloured_lights",
)
_WIDTH_PX = 640  # to which pictures are shrunk
_MIN_STRANGERS = 3  # pictures of another room that make a map wrong
_MIN_KNOWN = 5  # positions, for a map to be checked
_MAX_OFF = 0.1  # of the walk's extent, in all but a tenth of the pictures


@dataclass(frozen=True, eq=False)
class Picture:
    """An image, and where it was taken.

    Attributes:
        image: (H, W, 3).
        room: the recording that it is of.
        position: (3,) in the room, NaN where it is not known.
    """

    image: ByteArray
    room: str
    position: FloatArray


@dataclass
class Pictures:
    """Pictures of a case, and the names of what has befallen them."""

    pictures: list[Picture]
    log: list[str]

    @property
    def images(self) -> list[ByteArray]:
        """Of all pictures."""
        return [one.image for one in self.pictures]

    def become(self, images: Sequence[ByteArray]) -> None:
        """Replace the images."""
        self.pictures = [replace(one, image=image) for one, image in zip(self.pictures, images, strict=True)]


Happening = Callable[[Pictures, random.Random], None]


def thinned(case: Pictures, choices: random.Random) -> None:
    """Every second, third or sixth picture."""
    case.pictures = case.pictures[:: choices.choice((2, 3, 6))]


def shuffled(case: Pictures, choices: random.Random) -> None:
    """In any order."""
    choices.shuffle(case.pictures)


def cut(case: Pictures, choices: random.Random) -> None:
    """A piece is missing."""
    start = choices.randrange(len(case.pictures))
    del case.pictures[start : start + choices.randint(1, max(1, len(case.pictures) // 2))]


def doubled(case: Pictures, choices: random.Random) -> None:
    """Some pictures come again, next to themselves or at the end."""
    again = choices.sample(case.pictures, k=min(len(case.pictures), choices.randint(1, 6)))
    case.pictures += again
    if choices.random() < 0.5:
        case.pictures += case.pictures


def rotated(case: Pictures, choices: random.Random) -> None:
    """Some or all were taken with the camera turned."""
    turn, share = choices.choice((cv2.ROTATE_90_CLOCKWISE, cv2.ROTATE_180)), choices.choice((0.3, 1.0))
    case.become([np.asarray(cv2.rotate(one, turn)) if choices.random() < share else one for one in case.images])


def rescaled(case: Pictures, choices: random.Random) -> None:
    """Some or all are smaller, maybe tiny, maybe of another shape."""
    factors, share = (choices.uniform(0.05, 0.9), choices.uniform(0.05, 0.9)), choices.choice((0.3, 1.0))
    across, down = factors if choices.random() < 0.3 else (factors[0], factors[0])
    case.become(
        [
            np.asarray(cv2.resize(one, None, fx=across, fy=down)) if choices.random() < share else one
            for one in case.images
        ]
    )


def second_camera(case: Pictures, choices: random.Random) -> None:
    """A longer lens took the second half."""
    images = case.images
    middle, factor = len(images) // 2, choices.uniform(0.4, 0.9)
    for k, one in enumerate(images[middle:], middle):
        height, width = (round(factor * side) for side in one.shape[:2])
        top, left = (one.shape[0] - height) // 2, (one.shape[1] - width) // 2
        images[k] = one[top : top + height, left : left + width].copy()
    case.become(images)


def blanked(case: Pictures, choices: random.Random) -> None:
    """Some pictures are black, white or of noise."""
    rng = np.random.default_rng(choices.randrange(2**32))
    images = case.images
    for k in choices.sample(range(len(images)), k=choices.randint(1, len(images))):
        shape = images[k].shape
        kind = choices.randrange(3)
        images[k] = np.full(shape, 255 * kind, np.uint8) if kind < 2 else rng.integers(0, 255, shape, np.uint8)
    case.become(images)


def standing(case: Pictures, choices: random.Random) -> None:
    """The camera did not move: one picture, over and over, with noise."""
    rng = np.random.default_rng(choices.randrange(2**32))
    picture = choices.choice(case.pictures)
    one = picture.image.astype(np.int16)
    case.pictures = [
        replace(picture, image=np.clip(one + rng.integers(-4, 5, one.shape, np.int16), 0, 255).astype(np.uint8))
        for _ in case.pictures
    ]


HAPPENINGS: tuple[Happening, ...] = (
    thinned,
    shuffled,
    cut,
    doubled,
    rotated,
    rescaled,
    second_camera,
    blanked,
    standing,
)


def stretch(name: str, pictures: int, choices: random.Random) -> list[Picture]:
    """Consecutive pictures of a recording, some steps apart."""
    recording = read_recording(SHARED_DATA / name)
    frames = recording.frames
    count = len(frames.times)
    step = choices.randint(1, max(1, min(12, count // pictures)))
    first = choices.randrange(max(1, count - step * pictures))
    rows = list(range(first, count, step))[:pictures]
    factor = min(1.0, _WIDTH_PX / frames.size[0])
    known = np.full((count, 3), np.nan) if recording.poses is None else recording.poses.T_map_camera[:, :3, 3]
    return [
        Picture(np.asarray(cv2.resize(one, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)), name, known[row])
        for row, one in zip(rows, frames.images(rows), strict=True)
    ]


def make_case(names: list[str], number: int, seed: int, pictures: int, folder: Path) -> tuple[list[Picture], str]:
    """Write a case's recording; returns its pictures, and what has befallen them."""
    choices = random.Random(f"{seed} {number}")
    name = choices.choice(names)
    case = Pictures(stretch(name, pictures, choices), [name])
    if choices.random() < 0.25:
        other = choices.choice(names)
        at = choices.randrange(len(case.pictures))
        case.pictures[at:at] = stretch(other, choices.randint(1, pictures), choices)
        case.log.append(f"mixed with {other}")
    for happening in choices.sample(HAPPENINGS, k=choices.randint(1, 3)):
        if case.pictures:
            happening(case, choices)
            case.log.append(happening.__name__)
    for k, image in enumerate(case.images):
        assert cv2.imwrite(str(folder / f"{k:04d}.jpg"), image)
    _add_tables(case, choices, folder)
    return case.pictures, ", ".join(case.log) + f": {len(case.pictures)} pictures"


def _add_tables(case: Pictures, choices: random.Random, folder: Path) -> None:
    rng = np.random.default_rng(choices.randrange(2**32))
    count = len(case.images)
    if choices.random() < 0.3:
        rate_hz = choices.choice((0.5, 2.0, 10.0, 30.0))
        rows = [f"{k},{k / rate_hz}" for k in range(count)]
        (folder / "frames.csv").write_text("\n".join(["frame,timestamp", *rows]) + "\n")
        case.log.append(f"at {rate_hz:g} Hz")
    if choices.random() < 0.2:
        poses = np.column_stack([np.arange(count), rng.normal(0, 1, (count, 3)), np.tile([0, 0, 0, 1], (count, 1))])
        (folder / "poses.txt").write_text("\n".join(" ".join(map(str, row)) for row in poses.tolist()) + "\n")
        case.log.append("wrong poses")
    if choices.random() < 0.2:
        (folder / "camera.json").write_text(_camera_of(case.images, choices.uniform(0.3, 3.0)))
        case.log.append("wrong intrinsics")


def _camera_of(images: list[ByteArray], focal: float) -> str:
    height, width = images[0].shape[:2] if images else (480, 640)
    focal_px = focal * max(width, height)
    members = {"width": width, "height": height, "fx": focal_px, "fy": focal_px, "cx": width / 2, "cy": height / 2}
    return json.dumps(members)


def mistake(pictures: Sequence[Picture], T_map_camera: FloatArray) -> str:
    """What is wrong with the poses (N, 4, 4) of pictures; empty if nothing is, or if the truth is not known."""
    rooms = Counter(one.room for one in pictures)
    if len(rooms) > 1 and rooms.most_common(2)[1][1] >= _MIN_STRANGERS:
        return f"pictures of {' and '.join(rooms)} in one map"
    true = np.array([one.position for one in pictures])
    known = np.isfinite(true).all(axis=1)
    extent = np.linalg.norm(np.ptp(true[known], axis=0)) if known.sum() >= _MIN_KNOWN else 0.0
    if extent == 0:
        return ""
    found = T_map_camera[known, :3, 3]
    off = np.linalg.norm(umeyama(found, true[known]).points(found) - true[known], axis=1)
    wrong = float(np.quantile(off, 0.9)) / extent
    return f"a tenth of the pictures are off by {wrong:.0%} of the walk's extent" if wrong > _MAX_OFF else ""


def outcome(folder: Path, pictures: Sequence[Picture]) -> tuple[bool, str]:
    """Whether a recording ends well, and how."""
    try:
        recording = read_recording(folder)
        built = build_map([recording], BuildOptions(report=False))
    except RholocError as error:
        fine = bool(error.message and error.hint) and not isinstance(error, ReconstructionBroken)
        return fine, f"{type(error).__name__}: {error.message} {error.hint}"
    except Exception as error:
        return False, f"{type(error).__name__}: {error}"
    (report,) = built.info.report.trajectories
    rows = np.searchsorted(recording.frames.times, built.views.times - 1e-6)
    wrong = mistake([pictures[row] for row in rows.tolist()], built.views.T_map_camera)
    ends = f"map: {report.frames} of {report.keyframes} placed, {'' if report.trusted else 'not '}trusted"
    return not (wrong and report.trusted), f"{ends}, {wrong}" if wrong else ends


def main() -> int:
    """Run the cases."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=list(NAMES))
    parser.add_argument("--cases", type=int, default=30)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--pictures", type=int, default=24)
    parser.add_argument("--minutes", type=float, default=np.inf)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--add", action="store_true")
    arguments = parser.parse_args()
    before = _written(arguments.seed) if arguments.add else None
    found, ends, begun = [], Counter[str](), time.monotonic()
    for number in range(arguments.first, arguments.first + arguments.cases):
        if time.monotonic() - begun > 60 * arguments.minutes:
            break
        with tempfile.TemporaryDirectory() as folder:
            pictures, what = make_case(arguments.names, number, arguments.seed, arguments.pictures, Path(folder))
            start = os.times()
            fine, how = outcome(Path(folder), pictures)
        cpu_s = round(sum(os.times()[:4]) - sum(start[:4]), 1)
        ends[how.split(":")[0] if fine else "FAILED"] += 1
        found.append({"case": number, "what": what, "fine": fine, "how": how, "cpu_s": cpu_s})
        print(f"{number:4d} {cpu_s:6.1f} CPU s  {'' if fine else 'FAILED '}{what}\n          {how}", flush=True)
    print(", ".join(f"{count} {end}" for end, count in ends.most_common()))
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(found, indent=1))
    if arguments.write:
        _write_totals(arguments, len(found), ends, before)
    return 1 if ends["FAILED"] else 0


def _written(seed: int) -> dict[str, Any]:
    """What fuzz.json has of other seeds' cases."""
    before: dict[str, Any] = json.loads((RESULTS / "fuzz.json").read_text())
    if seed in before["seeds"]:
        raise SystemExit(f"The cases of seed {seed} are in fuzz.json already: choose another --seed.")
    return before


def _write_totals(asked: argparse.Namespace, cases: int, ends: Counter[str], before: dict[str, Any] | None) -> None:
    """Write the totals of one seed's cases, with those ``before``."""
    totals = {"recordings": cases, "maps": ends["map"], "ended_otherwise": ends["FAILED"]}
    command = f"python benchmarks/fuzz_recordings.py --seed {asked.seed} --pictures {asked.pictures} --write"
    seeds = [asked.seed]
    if before is not None:
        totals = {name: count + before["figures"][f"fuzz.{name}"]["value"] for name, count in totals.items()}
        command, seeds = f"{command} --add", [*before["seeds"], *seeds]
    noise = {"recordings": totals["recordings"], "maps": totals["recordings"], "ended_otherwise": 0}
    figures = {f"fuzz.{name}": Figure(totals[name], noise[name], name != "ended_otherwise") for name in totals}
    write_results("fuzz", figures, command, seeds)


if __name__ == "__main__":
    sys.exit(main())
