"""What answers are measured on: rooms with a recording that makes their map and one that asks it, poses known.

Real recordings, simulated rooms, and a simulated building; each belongs to the recording that it is made of, so that
what is fitted to some recordings can be checked on another. Trajectories, simulated walks and maps are kept in a cache.
"""

import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import cv2
import numpy as np

from measuring import SHARED_DATA
from rholoc.geometry import BoolArray, Camera, FloatArray, angles_between, interpolated_poses
from rholoc.mapping import BuildOptions, build_map
from rholoc.maps import Map, load_map, read_trajectory_csv, save_map
from rholoc.recordings import GivenPoses, Recording, read_image, read_recording
from rholoc.recordings.frame_slice import SelectedFrames
from rholoc.simulation import Light
from rholoc.trajectory import PoseMethod
from rholoc.trajectory.estimate import estimate_trajectory
from rholoc_lab.simulation.sites import Site, simulate_site

KITCHEN_CAMERA = "525.505,525.505,320,240"
HALVES_ASKED = 24  # frames of each half, about
APART_SHARE, APART_M, APART_ASKED = 0.4, 0.3, 40  # of the frames; along the walk's axis; frames, about
WALK_SECONDS, WALK_ASKED = 30.0, 30  # frames
ROOM_FPS, BUILDING_FPS, BUILDING_ASKED_FPS, LIGHT_FPS = 30.0, 15.0, 1.0, 5.0
ROOM_SEEDS = range(3)
SHOWN_BY, FEWEST_SHOWN = "sift48", 30  # landmarks
SHOWN_RAD, ALIKE_RAD = np.deg2rad(60.0), np.deg2rad(45.0)


@dataclass(frozen=True)
class Room:
    """A map's recording and the one that asks it, both with poses.

    Attributes:
        mapped: what the map is made of.
        asked: frames elsewhere or of another time, in the same map frame.
        blur_px: over how many pixels of a row what is asked is blurred.
    """

    mapped: Recording
    asked: Recording
    blur_px: int = 1

    def pictures(self) -> Iterator[tuple[FloatArray, np.ndarray]]:
        """The frames that ask: pose (4, 4) and image (H, W, 3)."""
        assert self.asked.poses is not None
        rows = np.flatnonzero(self.asked.poses.known)
        for row, image in zip(rows, self.asked.frames.images(rows.tolist()), strict=True):
            blurred = cv2.blur(image, (self.blur_px, 1)) if self.blur_px > 1 else image
            yield self.asked.poses.T_map_camera[row], np.asarray(blurred)


@dataclass(frozen=True)
class NamedRoom:
    """Where a room comes from.

    Attributes:
        name: of what is asked.
        mapped: of what makes the map; rooms that share it share the map.
        recording: all rooms of one recording are held back together.
        make: reads it, keeping what takes long in the folder that it is given.
    """

    name: str
    mapped: str
    recording: str
    make: Callable[[Path], Room]


# -- real recordings -------------------------------------------------------------------------------------------------


def kitchen(mapped: str, asked: str, blur_px: int, _: Path) -> Room:
    """Frames of the kitchen asked in a map of others, both as slices of frame numbers."""
    path = SHARED_DATA / "redkitchen"
    return Room(*(read_recording(path, camera=KITCHEN_CAMERA, frames=frames) for frames in (mapped, asked)), blur_px)


def half(name: str, which: int, kept: Path) -> Room:
    """One half of a walk asked in the other's map: keyframes, with the poses that the whole walk gives them.

    What one half alone has seen cannot be found in the other's map.
    """
    walk = _keyframes(name, kept)
    first = np.arange(len(walk.frames.times)) < len(walk.frames.times) // 2
    parts = [chosen(walk, np.flatnonzero(some)) for some in (first, ~first)]
    mapped, asked = parts[which], parts[1 - which]
    return Room(mapped, thinned(asked, HALVES_ASKED))


def every_second(path: Path, _: Path) -> Room:
    """Every second frame of a recording with poses asked in the map of the others."""
    walk = read_recording(path)
    assert walk.poses is not None
    rows = np.flatnonzero(walk.poses.known)
    return Room(chosen(walk, rows[::2]), thinned(chosen(walk, rows[1::2]), HALVES_ASKED))


def between(name: str, kept: Path) -> Room:
    """A walk's other frames asked in the map of every second keyframe.

    Poses are known at the other keyframes; between these they are interpolated.
    """
    whole = replace(read_recording(SHARED_DATA / name), poses=None)
    rows, T, camera = _trajectory(whole, kept / f"{name}-trajectory.npz")
    asked = np.setdiff1d(np.arange(rows[0], rows[-1] + 1), rows[::2])
    times = whole.frames.times
    poses = GivenPoses(np.isin(asked, rows), interpolated_poses(times[rows], T, times[asked]))
    frames = SelectedFrames(whole.frames, asked)
    others = replace(whole, camera=camera, frames=frames, poses=poses, frame_intrinsics=None)
    return Room(_posed(whole, rows[::2], T[::2], camera), others)


def apart(name: str, end: int, kept: Path) -> Room:
    """What was recorded at one end of a walk asked in the map of what was recorded farther along.

    The ends are those of the axis along which the camera's positions spread most, whenever it came there.
    """
    walk = _whole_walk(name, kept)
    assert walk.poses is not None
    positions = walk.poses.T_map_camera[:, :3, 3]
    axis = np.linalg.svd(positions - positions.mean(axis=0), full_matrices=False)[2][0]
    axis *= np.sign(axis[np.abs(axis).argmax()])
    along_m = positions @ axis * (1, -1)[end]
    last_m = float(np.quantile(along_m, APART_SHARE))
    asked = chosen(walk, np.flatnonzero(along_m < last_m))
    return Room(chosen(walk, np.flatnonzero(along_m > last_m + APART_M)), thinned(asked, APART_ASKED))


def _whole_walk(name: str, kept: Path) -> Recording:
    """The frames of a recording whose poses are known."""
    if name == "bedroom_night":
        return _keyframes(name, kept)
    options = {"camera": KITCHEN_CAMERA, "frames": "100:1000"} if name == "redkitchen" else {}
    recording = read_recording(SHARED_DATA / name, **options)
    assert recording.poses is not None
    return chosen(recording, np.flatnonzero(recording.poses.known))


def _keyframes(name: str, kept: Path) -> Recording:
    """A walk's keyframes, with the poses that are estimated of them."""
    recording = replace(read_recording(SHARED_DATA / name), poses=None)
    return _posed(recording, *_trajectory(recording, kept / f"{name}-trajectory.npz"))


def _trajectory(recording: Recording, path: Path) -> tuple[np.ndarray, FloatArray, Camera]:
    """The keyframes' rows (K,), their poses (K, 4, 4) and the camera, estimated once."""
    if not path.is_file():
        found = estimate_trajectory(recording, PoseMethod.VISUAL_INERTIAL)
        camera = found.camera
        lens = [camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy]
        kept = {"rows": found.rows, "T": found.T_map_camera, "lens": lens, "distortion": camera.distortion}
        np.savez(path, **kept)
    with np.load(path) as kept:
        width, height, *pinhole = kept["lens"]
        camera = Camera(int(width), int(height), *pinhole, tuple(kept["distortion"]))
        return kept["rows"], kept["T"], camera


def _posed(recording: Recording, rows: np.ndarray, T_map_camera: FloatArray, camera: Camera) -> Recording:
    poses = GivenPoses(np.ones(len(rows), dtype=bool), T_map_camera)
    frames = SelectedFrames(recording.frames, rows)
    return replace(recording, camera=camera, frames=frames, poses=poses, frame_intrinsics=None)


def thinned(recording: Recording, count: int) -> Recording:
    """About ``count`` frames of a posed recording."""
    return chosen(recording, np.arange(len(recording.frames.times))[:: max(1, len(recording.frames.times) // count)])


def chosen(recording: Recording, rows: np.ndarray) -> Recording:
    """Some frames of a posed recording."""
    assert recording.poses is not None
    poses = GivenPoses(recording.poses.known[rows], recording.poses.T_map_camera[rows])
    frames = SelectedFrames(recording.frames, rows)
    depth = None if recording.depth is None else recording.depth.select(rows)
    return replace(recording, frames=frames, poses=poses, depth=depth, frame_intrinsics=None)


# -- simulated ones --------------------------------------------------------------------------------------------------


def building(kept: Path) -> Room:
    """Half a minute of each of two walks through a building with doors and furniture that look alike."""
    walks = ((1, BUILDING_FPS), (2, BUILDING_ASKED_FPS))
    return Room(*(simulated(kept, walk, fps, site=Site.BUILDING) for walk, fps in walks))


def room(seed: int, kept: Path) -> Room:
    """Two walks through a room of its own."""
    mapped, asked = (simulated(kept, walk, ROOM_FPS, seed) for walk in (1, 2))
    return Room(mapped, thinned(asked, WALK_ASKED))


def room_by_another_light(kept: Path) -> Room:
    """A room mapped by daylight, asked by lamps."""
    mapped = simulated(kept, 1, LIGHT_FPS, light=Light.DAYLIGHT)
    return Room(mapped, thinned(simulated(kept, 2, ROOM_FPS), WALK_ASKED))


def simulated(
    kept: Path, walk: int, fps: float, seed: int = 0, site: Site = Site.ROOM, light: Light = Light.ARTIFICIAL
) -> Recording:
    """A walk with its true poses."""
    folder = kept / f"{site.value}-{seed}-walk{walk}-{light.value}-{fps:g}fps"
    if not (folder / "made").exists():
        shutil.rmtree(folder, ignore_errors=True)
        simulate_site(folder, site, walk, WALK_SECONDS, seed, fps=fps, light=light)
        (folder / "made").touch()
    recording, truth = read_recording(folder), read_trajectory_csv(folder / "truth.csv")
    nearest = np.abs(truth.times[:, None] - recording.frames.times).argmin(axis=0)
    known: BoolArray = np.ones(len(nearest), dtype=bool)
    return replace(recording, poses=GivenPoses(known, truth.T_map_camera[nearest]))


ROOMS = (
    NamedRoom("kitchen, easy", "kitchen 400", "redkitchen", partial(kitchen, "400:1000", "200:400:8", 1)),
    NamedRoom("kitchen, hard", "kitchen 400", "redkitchen", partial(kitchen, "400:1000", "100:200:4", 1)),
    NamedRoom("kitchen, blurred over 9 px", "kitchen 400", "redkitchen", partial(kitchen, "400:1000", "200:400:8", 9)),
    NamedRoom("kitchen, map 600–999", "kitchen 600", "redkitchen", partial(kitchen, "600:1000", "100:400:12", 1)),
    NamedRoom("kitchen, map 700–999", "kitchen 700", "redkitchen", partial(kitchen, "700:1000", "100:400:6", 1)),
    *(
        NamedRoom(f"{room_name}, {part} half mapped", f"{room_name} {which}", name, partial(half, name, which))
        for name, room_name in (("bedroom_night", "bedroom"), ("android_livingroom", "living room"))
        for which, part in enumerate(("first", "second"))
    ),
    NamedRoom("building", "building", "building", building),
    NamedRoom("another light", "another light", "room 0", room_by_another_light),
    *(NamedRoom(f"room {seed}", f"room {seed}", f"room {seed}", partial(room, seed)) for seed in ROOM_SEEDS),
)

ALTERNATE = tuple(
    NamedRoom(f"{label}, every second", f"{label} every second", name, partial(every_second, SHARED_DATA / path))
    for name, path, label in (
        ("splat_desk", "splat_desk", "desk"),
        ("corridor", "corridor_lidar/scan", "corridor"),
        ("euroc_v101", "euroc_v101", "hall"),
    )
)
"""Recordings of which every second picture is asked in the map of the others."""

PLAYED = (
    NamedRoom("kitchen", "kitchen 400", "redkitchen", partial(kitchen, "400:1000", "100:400", 1)),
    NamedRoom("livingroom", "living room between", "android_livingroom", partial(between, "android_livingroom")),
)
"""Rooms that a robot drives through."""

WIDE = tuple(
    NamedRoom(f"{label}, {end} end asked", f"{label} {end} end", name, partial(apart, name, number))
    for name, label in (("redkitchen", "kitchen"), ("bedroom_night", "bedroom"), ("euroc_v101", "hall"))
    for number, end in enumerate(("near", "far"))
)
"""Rooms asked from places beside which no picture of the map was taken."""


# -- their maps, and pictures of other rooms -------------------------------------------------------------------------


def map_of(named: NamedRoom, mapped: Recording, features: str, kept: Path) -> Map:
    """The map of a room, made once for each kind of features."""
    path = kept / "maps" / f"{named.mapped}-{features}.rho".replace(" ", "-")
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        save_map(build_map([mapped], BuildOptions(features=features, poses=PoseMethod.GIVEN, report=False)), path)
    return load_map(path)


def nearest_views(named: NamedRoom, kept: Path) -> FloatArray:
    """(N,) how far each frame that asks is from the nearest view of the map that looks about the same way, metres.

    Infinite where none does; NaN where the frame shows next to nothing that the map knows: fewer than 30 landmarks from
    within 60° of where a view saw them, furniture in between aside. By one kind of features for all, so that all are
    asked the same.
    """
    room = named.make(kept)
    camera, poses, map_ = room.asked.camera, room.asked.poses, map_of(named, room.mapped, SHOWN_BY, kept)
    assert camera is not None
    assert poses is not None
    owners, seen_from = map_.observations.features, map_.views.positions[map_.observations.views]
    landmarks = map_.landmarks.positions.astype(np.float64)
    nearest_m = []
    for T in poses.T_map_camera[poses.known]:
        position, heading = T[:3, 3], T[:3, 2]
        inside = camera.contains(camera.project((landmarks - position) @ T[:3, :3]))
        turned = angles_between(seen_from - landmarks[owners], position - landmarks[owners])
        shown = np.unique(owners[inside[owners] & (turned < SHOWN_RAD)])
        alike = angles_between(map_.views.headings, heading) < ALIKE_RAD
        apart_m = np.linalg.norm(map_.views.positions - position, axis=1)[alike]
        nearest_m.append(apart_m.min(initial=np.inf) if len(shown) >= FEWEST_SHOWN else np.nan)
    return np.array(nearest_m)


def strangers(recording: str, each: int, kept: Path | None = None) -> Iterator[tuple[np.ndarray, Camera]]:
    """Pictures of all recordings but one, about ``each`` of every one, with a camera of a usual focal length.

    Simulated recordings are included if their folder ``kept`` is given.
    """
    for name, path in (*_real_paths(), *(_simulated_paths(kept) if kept else ())):
        if name != recording:
            yield from _pictures(path, each)


def _real_paths() -> Iterator[tuple[str, Path]]:
    for name in ("redkitchen", "bedroom_night", "android_livingroom", "coloured_lights", "euroc_v101"):
        yield name, SHARED_DATA / name
    for scene in sorted((SHARED_DATA / "lighting_pairs").iterdir()):
        if scene.is_dir():
            yield "lighting_pairs", scene


def _simulated_paths(kept: Path) -> Iterator[tuple[str, Path]]:
    yield "building", simulated(kept, 2, BUILDING_ASKED_FPS, site=Site.BUILDING).path
    for seed in ROOM_SEEDS:
        yield f"room {seed}", simulated(kept, 2, ROOM_FPS, seed).path


@cache
def _pictures(path: Path, each: int) -> list[tuple[np.ndarray, Camera]]:
    files = sorted([*path.glob("*.jpg"), *path.glob("*.png")])
    if files:
        images = [read_image(file) for file in files[:: max(1, len(files) // each)]]
    else:
        frames = read_recording(path).frames
        rows = np.linspace(0, len(frames.times) - 1, each).astype(int).tolist()
        images = [np.asarray(image) for image in frames.images(rows)]
    found = []
    for image in images:
        height, width = image.shape[:2]
        found.append((image, Camera(width, height, 0.8 * width, 0.8 * width, (width - 1) / 2, (height - 1) / 2)))
    return found
