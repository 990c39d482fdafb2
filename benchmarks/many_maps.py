"""How a frame finds its map among ten thousand.

    OMP_NUM_THREADS=1 python benchmarks/many_maps.py FOLDER --asked MAP.rho WALK [FRAMES [CAMERA]] [--asked ...]
        [--others MAP.rho ...] [--sizes 100,1000,10000] [--views 40] [--own] [--every 6]

``--asked`` names a map and another walk through its room, whose frames are asked; ``--others`` are further maps.
FOLDER, which should be empty at first and is not cleaned up, gets these maps and copies of them until there are enough.
A copy lies elsewhere, has at most so many ``--views`` of its original, and looks otherwise: each of its pieces, some
hundred landmarks that lie side by side, looks like a piece drawn from all maps of the same features. So every copy is
a room laid out and seen as a real room is, furnished with what stands in real rooms, and with the very things that
the frames show among them. With ``--own`` pieces are drawn from the copy's own original: rooms furnished with nothing
but the same things in other places, a case that no campus has, and the hardest. Frames are asked of the originals
alone; what is right is known of them.

For each size: how long all maps take to be indexed, and a start with the index at hand; memory, of a process that holds
the index alone and of one that has answered; milliseconds of processor time of an answer from a picture in JPEG, its
map being named and with ``maps=all``, maps being in memory, and their ratio; what choosing takes of it; what a first
request to a map that is not in memory takes to load it; how often the index has the right map first by a quick look and
by all features, among five by all, and the answer is of the right map; and answers of a wrong map. The slope says by
which power of the number of maps choosing takes longer.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar
from uuid import uuid4

import cv2
import faiss
import numpy as np

from measuring import print_table, resident_mb
from rholoc.features import get_extractor
from rholoc.localization import VECTORS_FILE, MapFinder
from rholoc.maps import Map, MapLibrary, load_map, map_to_bytes, part_of, without_memory
from rholoc.recordings import read_recording
from rholoc.service.frames.frame_features import FrameFeatures
from rholoc.service.frames.localizers import Localizers
from rholoc.service.frames.map_choice import MOST_ASKED, MapChoice
from rholoc.service.frames.queries import Frame
from rholoc.service.frames.requests import CameraChoice, LocalizeOptions
from rholoc.service.frames.single_frame import localize_frame
from rholoc.service.frames.stopwatch import Stopwatch
from rholoc.service.settings import Settings

COPY_PITCH_M = 100.0
PIECE_LANDMARKS = 100
T = TypeVar("T")


@dataclass(frozen=True)
class Asked:
    """A picture, its camera, and the map of the room that it was taken in."""

    name: str
    picture: bytes
    camera: CameraChoice

    @property
    def frame(self) -> Frame:
        """As a request sends it."""
        return Frame(LocalizeOptions(camera=self.camera, deadline_ms=60_000), image=self.picture)


# -- maps ------------------------------------------------------------------------------------------------------------


def fill(folder: Path, originals: dict[str, Map], size: int, views: int, own: bool) -> None:
    """Copies until there are so many maps in a folder; those that are there already stay."""
    names = list(originals)
    pools = {name: furniture([originals[name]] if own else alike(originals, originals[name])) for name in names}
    pieces = {name: pieces_of(originals[name]) for name in names}
    for number in range(len(originals), size):
        name = names[number % len(names)]
        path = folder / f"copy-{number:05}-{name}.rho"
        if not path.exists():
            path.write_bytes(map_to_bytes(copied(originals[name], number, views, pieces[name], pools[name])))


def alike(originals: dict[str, Map], map_: Map) -> list[Map]:
    """The maps of the same features."""
    return [one for one in originals.values() if one.info.features == map_.info.features]


def pieces_of(map_: Map) -> np.ndarray:
    """(L,) the number of the piece that each landmark belongs to: those that lie side by side."""
    points = np.ascontiguousarray(map_.landmarks.positions, dtype=np.float32)
    kmeans = faiss.Kmeans(3, max(1, len(points) // PIECE_LANDMARKS), niter=10, seed=0, min_points_per_centroid=1)
    kmeans.train(points)
    return np.asarray(kmeans.assign(points)[1])


def furniture(maps: Sequence[Map]) -> list[np.ndarray]:
    """(N, B) the first descriptor of each landmark of a piece, of all pieces of some maps."""
    found = []
    for map_ in maps:
        first = map_.descriptors.values[np.searchsorted(map_.descriptors.features, np.arange(len(map_)))]
        numbers = pieces_of(map_)
        found += [first[numbers == number] for number in np.unique(numbers)]
    return found


def copied(map_: Map, number: int, views: int, pieces: np.ndarray, pool: Sequence[np.ndarray]) -> Map:
    """A room that is laid out as that of a map, and looks otherwise."""
    rng = np.random.default_rng(number)
    kept = np.unique(np.linspace(0, len(map_.views) - 1, min(views, len(map_.views.times))).astype(np.int64))
    descriptors = map_.descriptors.values[np.searchsorted(map_.descriptors.features, np.arange(len(map_)))]
    for piece in np.unique(pieces):
        rows, look = np.flatnonzero(pieces == piece), pool[rng.integers(len(pool))]
        descriptors[rows] = look[rng.permutation(max(len(rows), len(look)))[: len(rows)] % len(look)]
    looks = replace(
        map_, descriptors=replace(map_.descriptors, values=descriptors, features=np.arange(len(map_), dtype=np.int32))
    )
    part = part_of(looks, kept).map
    shift = np.array([COPY_PITCH_M * number, 0.0, 0.0])
    T_map_camera = part.views.T_map_camera.copy()
    T_map_camera[:, :3, 3] += shift
    return without_memory(
        replace(
            part,
            info=replace(part.info, id=uuid4().hex),
            landmarks=replace(
                part.landmarks, positions=(part.landmarks.positions + shift).astype(np.float32), colours=None
            ),
            views=replace(part.views, T_map_camera=T_map_camera, pictures=None),
        )
    )


def pictures(map_path: Path, walk: str, frames: str | None, camera: str | None, every: int) -> list[Asked]:
    """Frames of a walk."""
    recording = read_recording(Path(walk), camera=camera, frames=frames)
    assert recording.camera is not None
    intrinsics = recording.camera.to_dict()
    rows = list(range(0, len(recording.frames.times), every))
    return [
        Asked(map_path.stem, cv2.imencode(".jpg", image)[1].tobytes(), CameraChoice(**intrinsics))
        for image in recording.frames.images(rows)
    ]


# -- figures ---------------------------------------------------------------------------------------------------------


def indexed(folder: Path) -> dict[str, Any]:
    """Make the index of what is new in a folder."""
    finder = MapFinder(MapLibrary(folder), folder / VECTORS_FILE)
    begun = time.perf_counter()
    finder.refresh()
    assert not finder.unknown, finder.trouble
    return {"index s": round(time.perf_counter() - begun, 1)}


def started(folder: Path) -> dict[str, Any]:
    """Start with the index at hand."""
    before = resident_mb()
    finder = MapFinder(MapLibrary(folder), folder / VECTORS_FILE)
    begun = time.perf_counter()
    finder.refresh()
    views = sum(map(len, finder._indexes.values()))
    return {
        "views": views,
        "start s": round(time.perf_counter() - begun, 1),
        "index MB": round(resident_mb() - before),
    }


def answered(folder: Path, asked: Sequence[Asked]) -> dict[str, Any]:
    """Ask, the maps being named and not."""
    settings, library = Settings(maps_dir=folder), MapLibrary(folder, cache_bytes=2**29)
    localizers = Localizers(library, settings.min_recognized)
    finder = MapFinder(library, folder / VECTORS_FILE)
    finder.refresh()
    everywhere = MapChoice(finder.present, named=False, finder=finder, is_all=True)
    cold: dict[str, float] = {}
    named_ms, all_ms, choose_ms = [], [], []
    first, first_of_all, among, right, wrong = 0, 0, 0, 0, 0
    for one in asked:
        clock = Stopwatch()
        localize_frame(one.frame, MapChoice([one.name]), localizers, settings, clock)
        cold.setdefault(one.name, clock.stages_ms["load"])
        localize_frame(one.frame, everywhere, localizers, settings, Stopwatch())  # its candidates are loaded
        begun = time.thread_time()
        localize_frame(one.frame, MapChoice([one.name]), localizers, settings, Stopwatch())
        between, clock = time.thread_time(), Stopwatch()
        answer = localize_frame(one.frame, everywhere, localizers, settings, clock)
        named_ms.append(1e3 * (between - begun))
        all_ms.append(1e3 * (time.thread_time() - between))
        choose_ms.append(clock.stages_ms["choose"])
        features = FrameFeatures(one.frame, settings, Stopwatch(), math.inf)
        quick, full = (
            [like.name for like in finder.likeliest(by, MOST_ASKED)] for by in (features.by_quick, features.by)
        )
        first += quick[:1] == [one.name]
        first_of_all += full[:1] == [one.name]
        among += one.name in full
        right += answer.localized and answer.map == one.name
        wrong += answer.localized and answer.map != one.name
    share = 100 / len(asked)
    return {
        "named ms": round(float(np.median(named_ms)), 1),
        "all ms": round(float(np.median(all_ms)), 1),
        "ratio": round(float(np.median(all_ms) / np.median(named_ms)), 2),
        "choose ms": round(float(np.median(choose_ms)), 2),
        "cold ms": round(float(np.median(list(cold.values())))),
        "quick first %": round(share * first, 1),
        "first %": round(share * first_of_all, 1),
        "in five %": round(share * among, 1),
        "right %": round(share * right, 1),
        "wrong %": round(share * wrong, 1),
        "peak MB": round(resident_mb()),
    }


def alone(work: Callable[..., T], *given: Any) -> T:
    """What work in a process of its own comes to."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as process:
        return process.submit(work, *given).result()


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--asked", nargs="+", action="append", required=True, metavar="MAP.rho WALK [FRAMES [CAMERA]]")
    parser.add_argument("--others", type=Path, nargs="+", default=[])
    parser.add_argument("--sizes", default="100,1000,10000")
    parser.add_argument("--views", type=int, default=40)
    parser.add_argument("--own", action="store_true")
    parser.add_argument("--every", type=int, default=6)
    args = parser.parse_args()
    asked: list[Asked] = []
    originals: dict[str, Map] = {}
    args.folder.mkdir(parents=True, exist_ok=True)
    for path in [*(Path(given[0]) for given in args.asked), *args.others]:
        originals[path.stem] = load_map(path)
        get_extractor(originals[path.stem].info.features)
        (args.folder / path.name).write_bytes(path.read_bytes())
    for given in args.asked:
        asked += pictures(Path(given[0]), given[1], *[*given[2:4], None, None][:2], args.every)
    rows: list[dict[str, Any]] = []
    for size in map(int, args.sizes.split(",")):
        fill(args.folder, originals, size, args.views, args.own)
        figures = {"maps": size, **alone(indexed, args.folder), **alone(started, args.folder)}
        figures |= alone(answered, args.folder, asked)
        if rows:
            longer = max(figures["choose ms"], 1e-3) / max(rows[-1]["choose ms"], 1e-3)
            figures["slope"] = round(math.log(longer) / math.log(size / rows[-1]["maps"]), 2)
        rows.append(figures)
        print_table(rows, list(dict.fromkeys(name for row in rows for name in row)))


if __name__ == "__main__":
    main()
