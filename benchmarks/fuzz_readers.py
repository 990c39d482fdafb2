"""Whether any file makes a reader fail: damaged recordings, tables, maps, pictures, archives and backups.

    python benchmarks/fuzz_readers.py [--cases 100000] [--seconds 600] [--seed 0] [--only NAME …] [--json FILE]

Each case is a good file (or a recording's folder) to which one to three things have befallen: a value became another, a
line was lost or doubled, bytes were changed, it was cut off or grew, or there is something else in its place. A reader
has to read it or refuse it by an error of ``rholoc.errors`` in one line, without a numerical warning, within five
seconds of processor time, by a process that may hold 2 GiB. The cases are divided among the readers and made from the
seed, the reader's name and the case's number.

Prints how many were read and refused, the slowest case and the most memory by reader; exit status 1 where one failed.
"""

from __future__ import annotations

import argparse
import io
import json
import multiprocessing
import random
import resource
import sys
import tempfile
import time
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any

sys.path += [str(Path(__file__).parents[1] / "tests" / part) for part in ("", "recordings")]
import cv2
import numpy as np
import phone_recordings as phone

from fake_pipeline import tiny_map
from rholoc.density.tensor import fit_tensors
from rholoc.errors import RholocError
from rholoc.evaluation.reading import read_frame_poses
from rholoc.exports import ExportFormat, export_map
from rholoc.library.cameras import CameraLibrary
from rholoc.library.maps import MapLibrary
from rholoc.library.sites import SiteLibrary
from rholoc.library.stores import Stores
from rholoc.maps import (
    DensityKind,
    FloorPlan,
    FramePose,
    Map,
    Site,
    SiteLink,
    SiteMap,
    SiteOnEarth,
    read_coefficient_table,
)
from rholoc.maps.floor_plan import MEDIA_TYPES, check_plan
from rholoc.maps.formats.rho_file import load_map
from rholoc.maps.formats.trajectory_table import read_trajectory_csv
from rholoc.processes.limits import limit_own_memory
from rholoc.recordings import (
    check_archive,
    decode_image,
    read_camera_json,
    read_frames_csv,
    read_imu_csv,
    read_pose_table,
    read_recording,
)
from rholoc.recordings.tables.own_tables import read_odometry_csv
from rholoc.service.operate.backup import back_up, unpack_backup
from rholoc_lab.paper.table_reading import read_observations

SHIPPED = Path(__file__).resolve().parents[1] / "maps"
ODOMETRY = "timestamp,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n0.5,0.1,0,0,0,0,0,1\n1,0.2,0,0,0,0,0,1\n"
MOST_MEMORY_BYTES = 2 * 2**30
MOST_SECONDS = 5.0  # of processor time
MOST_CHARACTERS = 2000
BATCH = 500
SHOWN = 20  # problems
IMAGES, IMAGES_CHOSEN = (".png", ".jpg"), 0.2  # a folder has dozens of them, and few tables
FORK = multiprocessing.get_context("fork")
STRANGE = (
    b"", b"nan", b"-inf", b"1e999", b"-1", b"0", b"1", b"1e308", b"-1e-320", b"9" * 400, b"1_000", b"0x10", b"true",
    b"null", b'"', b"[", b"{}", "é".encode(), b"\xed\xa0\x80", b"\x00", b"a" * 10_000, b"[" * 100_000, b"1,2,3", b"..",
    b"/etc/hostname", "１".encode(), b"2147483648", b"-2147483649", b"18446744073709551616", b"1e18", b"[]", b"\r",
)  # fmt: skip
SEPARATORS = b',;: \t\n"[]{}'
OTHERS = (b"", b"\n", b"[]", b"{}", b"null", b"\x00" * 100, b"," * 1000, b"[" * 100_000, b"\xef\xbb\xbf", b"PK\x05\x06")


@dataclass(frozen=True)
class Reader:
    """A reader, and what it can read.

    Attributes:
        name: for people.
        make: returns good files, by path; a single one where the reader takes a file.
        read: called with the folder of the files.
    """

    name: str
    make: Callable[[], Mapping[str, bytes]]
    read: Callable[[Path], object]

    @cached_property
    def files(self) -> Mapping[str, bytes]:
        """The good files."""
        return self.make()


@dataclass
class Tally:
    """What came of a reader's cases."""

    read: int = 0
    refused: int = 0
    slowest_s: float = 0.0
    slowest_case: int = 0
    memory_mib: float = 0.0
    problems: list[str] = field(default_factory=list)

    def add(self, other: Tally) -> None:
        """Count more cases."""
        self.read += other.read
        self.refused += other.refused
        if other.slowest_s > self.slowest_s:
            self.slowest_s, self.slowest_case = other.slowest_s, other.slowest_case
        self.memory_mib = max(self.memory_mib, other.memory_mib)
        self.problems += other.problems


def damaged(content: bytes, choices: random.Random) -> bytes:
    """A file to which something has befallen."""
    how = choices.choice(("value", "value", "number", "line", "bytes", "bytes", "cut", "grown", "other"))
    at = choices.randrange(max(1, len(content)))
    if how in ("value", "number"):
        value = choices.choice(STRANGE) if how == "value" else number(choices)
        start = max(content.rfind(SEPARATORS[i : i + 1], 0, at) for i in range(len(SEPARATORS))) + 1
        ends = (content.find(SEPARATORS[i : i + 1], start) for i in range(len(SEPARATORS)))
        end = min((end for end in ends if end >= 0), default=len(content))
        return content[:start] + value + content[end:]
    if how == "line":
        lines = content.split(b"\n")
        row = choices.randrange(len(lines))
        changed = (lines[:row] + lines[row + 1 :], lines[: row + 1] + lines[row:], lines[::-1])
        return b"\n".join(choices.choice(changed))
    if how == "bytes":
        length = choices.randrange(1, 20)
        return content[:at] + choices.randbytes(length) + content[at + choices.choice((0, 1, length)) :]
    if how == "cut":
        return content[:at]
    if how == "grown":
        return content + choices.choice((content, b"\n\n", b"\xff\xfe", b"{", b",", choices.randbytes(50)))
    return choices.choice(OTHERS)


def number(choices: random.Random) -> bytes:
    """A number that is nothing special."""
    value = choices.gauss(0, 10 ** choices.uniform(-3, 6))
    return str(choices.choice((round(value), abs(round(value)), round(value, 4)))).encode()


def readers() -> list[Reader]:
    """All readers of what users hand in."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        found = [Reader(f"recording {layout}", partial(_recording, layout), _use_recording) for layout in phone.WRITERS]
        own = own_recording()
        (folder / "empty").mkdir()
        library = MapLibrary(folder / "maps")
        library.put("room", tiny_map())
        library.put("tensors", _tensor_map())
        stores = Stores(folder / "maps", folder / "empty")
        back_up(folder / "a.backup", stores)
        stores.close()
        return [
            *found,
            Reader("recording images", partial(_images, own), _use_recording),
            _of_file("recording video", "walk.mp4", own["video.mp4"], _use_recording),
            _of_file("recording archive", "walk.zip", zipped(own), _use_recording),
            _of_file("imu table", "imu.csv", own["imu.csv"], read_imu_csv),
            _of_file("odometry table", "odometry.csv", ODOMETRY.encode(), read_odometry_csv),
            _of_file("frames table", "frames.csv", own["frames.csv"], read_frames_csv),
            _of_file("camera.json", "camera.json", own["camera.json"], read_camera_json),
            _of_file("pose table", "poses.txt", b"0 0 0 0 0 0 0 1\n0.5 1 0 0 0 0 0 1\n", read_pose_table),
            _of_file("trajectory (Table 6)", "t.csv", _exported(ExportFormat.TRAJECTORY), read_trajectory_csv),
            _of_file("ground truth", "t.txt", b"0 0 0 0 0 0 0 1\n0.5 1 0 0 0 0 0 1\n", read_frame_poses),
            Reader("observations (Table 4)", _observations, lambda folder: read_observations(folder / "o.csv")),
            _of_file("map (Table 5)", "m.csv", _exported(ExportFormat.CSV), read_coefficient_table),
            _of_file("tensors (Table 5)", "m.csv", _exported(ExportFormat.CSV, _tensor_map()), read_coefficient_table),
            _of_file("map", "room.rho", library.path("room").read_bytes(), load_map),
            _of_file("map of tensors", "room.rho", library.path("tensors").read_bytes(), load_map),
            _of_file("archive", "a.zip", zipped(own), check_archive),
            _of_file("backup", "a.backup", (folder / "a.backup").read_bytes(), _use_backup),
            _of_file("stored camera", "cameras/c.json", own["camera.json"], _use_camera),
            _of_file("site", "sites/s.json", _site(folder), _use_site),
            *(_of_file(f"floor plan {kind}", "plan", content, partial(_use_plan, kind)) for kind, content in _plans()),
            *(_of_file(f"picture {ending}", "p", content, _use_picture) for ending, content in _pictures()),
        ]


def _of_file(name: str, path: str, content: bytes, read: Callable[[Path], object]) -> Reader:
    return Reader(name, lambda: {path: content}, lambda folder: read(folder / path))


@cache
def _recording(layout: str) -> Mapping[str, bytes]:
    with tempfile.TemporaryDirectory() as name:
        return _contents(phone.write_complete_recording(layout, Path(name) / "walk"))


def _images(own: Mapping[str, bytes]) -> dict[str, bytes]:
    """rholoc's own folder, with images instead of the video, and poses."""
    images = {f"frames/frame-{i:04d}.png": drawing(".png") for i in range(phone.FRAMES)}
    poses = "".join(f"{i} {0.1 * i} 0 0 0 0 0 1\n" for i in range(phone.FRAMES))
    waypoints = "name,frame,x,y,z,sigma\nA,2,0,0,1.5,0.02\nB,12,1,0,1.5,\nC,22,1,1,1.5,0.05\n"
    tables = {name: own[name] for name in ("imu.csv", "frames.csv", "camera.json")}
    texts = {"poses.txt": poses, "waypoints.csv": waypoints, "odometry.csv": ODOMETRY}
    return {**images, **tables, **{name: text.encode() for name, text in texts.items()}}


def _site(folder: Path) -> bytes:
    pose = FramePose((1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    covariance = tuple(tuple(row) for row in np.diag([1e-4] * 6).tolist())
    members = (SiteMap("room", "0", given=pose, pose=pose, covariance=covariance), SiteMap("hall"))
    links = (SiteLink("room", "hall", pose),)
    SiteLibrary(folder).put("s", Site(maps=members, links=links, earth=SiteOnEarth(52.5, 13.4)))
    return (folder / "sites" / "s.json").read_bytes()


def _contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def _exported(form: ExportFormat, map_: Map | None = None) -> bytes:
    pieces = export_map(map_ or tiny_map(), form, title="room")
    return b"".join(piece if isinstance(piece, bytes) else piece.encode() for piece in pieces)


def _tensor_map() -> Map:
    map_ = tiny_map()
    info = replace(map_.info, density=DensityKind.TENSOR)
    fitted = fit_tensors(np.ones((1, 3)), np.zeros((1, 3)), np.full(1, 1.5), degree=1)
    return replace(map_, info=info, densities=replace(fitted, features=np.zeros(1, np.int64)))


def _observations() -> dict[str, bytes]:
    """The first rows of those of the shipped map."""
    table = _exported(ExportFormat.OBSERVATIONS, load_map(SHIPPED / "testsite.rho"))
    return {"o.csv": b"".join(table.splitlines(keepends=True)[:40])}


def own_recording() -> Mapping[str, bytes]:
    """The files of a small recording in rholoc's own layout."""
    return _recording("rholoc")


def zipped(files: Mapping[str, bytes]) -> bytes:
    """A ZIP file of them."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as packed:
        for name, content in files.items():
            packed.writestr(name, content)
    return out.getvalue()


def _plans() -> list[tuple[str, bytes]]:
    lines = {"type": "LineString", "coordinates": [[0, 0], [4, 0], [4, 3]]}
    plan = {"type": "FeatureCollection", "features": [{"type": "Feature", "properties": {}, "geometry": lines}]}
    drawn = [(kind, drawing("." + kind.removeprefix("image/"))) for kind in MEDIA_TYPES if kind.startswith("image/")]
    return drawn + [(kind, json.dumps(plan).encode()) for kind in MEDIA_TYPES if "json" in kind]


def _pictures() -> list[tuple[str, bytes]]:
    return [(ending, drawing(ending)) for ending in (".jpg", ".png", ".webp", ".bmp", ".ppm")]


def drawing(ending: str) -> bytes:
    """A picture of noise, as small as a recording's frames."""
    shades = np.random.default_rng(0).integers(0, 255, (phone.SIZE[1], phone.SIZE[0], 3), dtype=np.uint8)
    return bytes(cv2.imencode(ending, shades)[1])


def _use_recording(folder: Path) -> None:
    recording = read_recording(folder)
    next(iter(recording.frames.images([0])))


def _use_backup(path: Path) -> None:
    unpack_backup(path, path.parent / "out" / "maps", path.parent / "out" / "data")


def _use_camera(path: Path) -> None:
    CameraLibrary(path.parents[1]).get("c")


def _use_site(path: Path) -> None:
    SiteLibrary(path.parents[1]).get("s")


def _use_plan(kind: str, path: Path) -> None:
    check_plan(path.read_bytes(), FloorPlan(kind, (0.0, 0.0), 0.0, 0.01))


def _use_picture(path: Path) -> None:
    decode_image(path.read_bytes())


def case(reader: Reader, number: int, seed: int) -> dict[str, bytes]:
    """The files of a case."""
    choices = random.Random(f"{seed} {reader.name} {number}")
    broken = dict(reader.files)
    tables = sorted(path for path in broken if not path.endswith(IMAGES))
    for _ in range(choices.randint(1, 3)):
        victim = choices.choice(sorted(broken) if not tables or choices.random() < IMAGES_CHOSEN else tables)
        broken[victim] = damaged(broken[victim], choices)
    return broken


def write_files(files: Mapping[str, bytes], folder: Path) -> Path:
    """Files by path in a folder, which is returned."""
    for path, content in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(content)
    return folder


def run_case(reader: Reader, number: int, seed: int, tally: Tally) -> None:
    """Read the files of a case, and count what came of it."""
    problem = ""
    with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as name:
        folder = write_files(case(reader, number, seed), Path(name) / "walk")
        begun = time.process_time()
        try:
            with warnings.catch_warnings(action="error", category=RuntimeWarning):
                reader.read(folder)
            tally.read += 1
        except RholocError as error:
            tally.refused += 1
            said = f"{error.message} {error.hint}"
            if "\n" in said or len(said) > MOST_CHARACTERS or not error.message:
                problem = f"an error of {len(said)} characters: {said[:100]!r}"
        except Exception as error:
            problem = f"{type(error).__name__}: {str(error)[:200]}"
        took_s = time.process_time() - begun
    if took_s > tally.slowest_s:
        tally.slowest_s, tally.slowest_case = took_s, number
    if took_s > MOST_SECONDS:
        problem = problem or f"{took_s:.1f} s"
    if problem:
        tally.problems.append(f"{reader.name}, case {number}: {problem}")


def run_batch(reader: Reader, numbers: range, seed: int, answer: Any, at: Any) -> None:
    """Run cases in a process of their own, which says where it is."""
    limit_own_memory(MOST_MEMORY_BYTES)
    tally = Tally()
    for number in numbers:
        at.value = number
        run_case(reader, number, seed, tally)
    tally.memory_mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    answer.send(tally)


def in_process(reader: Reader, numbers: range, seed: int) -> Tally:
    """What came of cases; one that ends the process is a problem, and those after it are run by another."""
    tally = Tally()
    while numbers:
        ours, theirs = FORK.Pipe(duplex=False)
        at = FORK.Value("q", numbers.start)
        process = FORK.Process(target=run_batch, args=(reader, numbers, seed, theirs, at))
        process.start()
        theirs.close()
        try:
            tally.add(ours.recv())
            numbers = range(0)
        except EOFError:
            tally.problems.append(f"{reader.name}, case {at.value}: the process ended")
            numbers = range(at.value + 1, numbers.stop)
        process.join()
    return tally


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=100_000)
    parser.add_argument("--seconds", type=float, default=600.0, help="no batch begins later")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", metavar="NAME", help="readers whose names begin so")
    parser.add_argument("--json", type=Path, help="write the figures here as well")
    args = parser.parse_args()
    chosen = [one for one in readers() if not args.only or one.name.startswith(tuple(args.only))]
    tallies = {reader.name: Tally() for reader in chosen}
    each, end_s = -(-args.cases // len(chosen)), time.monotonic() + args.seconds
    for start in range(0, each, BATCH):
        for reader in chosen:
            if time.monotonic() < end_s:
                tallies[reader.name].add(in_process(reader, range(start, min(start + BATCH, each)), args.seed))
    problems = [problem for tally in tallies.values() for problem in tally.problems]
    figures = {
        "cases": sum(one.read + one.refused for one in tallies.values()) + len(problems),
        "problems": len(problems),
        "kinds": dict(Counter(problem.split(": ", 1)[-1][:60] for problem in problems)),
        "slowest_s": round(max(one.slowest_s for one in tallies.values()), 2),
        "memory_mib": round(max(one.memory_mib for one in tallies.values())),
        "readers": {
            name: {
                "read": one.read,
                "refused": one.refused,
                "slowest_s": round(one.slowest_s, 2),
                "slowest_case": one.slowest_case,
            }
            for name, one in tallies.items()
        },
    }
    text = json.dumps(figures, indent=2)
    print(text)
    for problem in problems[:SHOWN]:
        print(problem, file=sys.stderr)
    if args.json:
        args.json.write_text(text + "\n")
    raise SystemExit(bool(problems))


if __name__ == "__main__":
    main()
