"""A walk as cameras with other lenses, or a rig, would have recorded it: does each map and localize as well as the
pinhole?

    python benchmarks/lenses.py [euroc_v101 room] [--seeds 0-9] [--lenses pinhole fisheye equirectangular rig]
        [--json FILE] [--write]

``euroc_v101``: as it is; resampled as a fisheye of the same size and as a panorama, each with as many pixels a radian
at the optical axis; and as a rig of two cameras at one place that look to the left and to the right, each through two
thirds of the width. Of every seed, which chooses the frames, two frames of three make a map, by pictures and IMU (the
rig's: by pictures alone), and the others are localized in it. The lens is another one, what it shows is the same.

``room``: the demo's room of a seed, two pictures a second, rendered for a phone, for a fisheye of 170°, for a whole
panorama, and for a rig of two phones 10 cm apart; the first walk is mapped from its pictures alone, or with its true
poses where that fails, the second is localized. The lenses show more and more.

A rig's two pictures of a moment are asked together. Frames are localized with the camera that the map has. Errors of
positions are after the similarity that aligns the map's views with the truth, errors of rotations after the mean
rotation. With ``--write`` the first walk's errors, others as multiples of the pinhole's, go to
benchmarks/results/lenses.json.
"""

import argparse
import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import cv2
import numpy as np

from figures import Figure, quote_anew, write_results
from measuring import SHARED_DATA, print_table, rounded
from rholoc.errors import MappingFailed
from rholoc.evaluation import trajectory_errors
from rholoc.geometry import ByteArray, Camera, FloatArray, IntArray, Lens, Pose, align_poses, posed_alignment
from rholoc.localization import Localizer, Query, SeveralFrames, localize_together
from rholoc.mapping import BuildOptions, build_map
from rholoc.recordings import GivenPoses, MemoryFrames, Mounted, Recording, read_recording
from rholoc.recordings.frames.unified_pictures import SteadyFrames
from rholoc.simulation import Light
from rholoc.simulation.light import light_scene
from rholoc.simulation.recording import PHONE_CAMERA
from rholoc.simulation.render import Renderer
from rholoc.simulation.sensor import develop, expose, meter
from rholoc_lab.simulation.sites import Site, make_site, make_site_walk
from rooms import chosen


class SeenBy(StrEnum):
    """What would have recorded the walk."""

    PINHOLE = "pinhole"
    FISHEYE = "fisheye"
    EQUIRECTANGULAR = "equirectangular"
    RIG = "rig"  # of two pinholes


T265 = (0.0008, 0.031, -0.03, 0.005)  # coefficients of a RealSense's fisheyes
EUROC = SHARED_DATA / "euroc_v101"
ROOM_CAMERAS = {
    SeenBy.PINHOLE: PHONE_CAMERA,
    SeenBy.FISHEYE: Camera(960, 960, 320.0, 320.0, 479.5, 479.5, T265, Lens.FISHEYE),
    SeenBy.EQUIRECTANGULAR: Camera.panorama(2000, 1000),
}
RIG_SIGMA_M, RIG_SIGMA_RAD = 0.001, 0.001  # of its mounting
APART_M, ASIDE_RAD, SHARE = 0.1, np.deg2rad(25.0), 2 / 3  # of a rig's cameras; of the width that EuRoC's each have
SECONDS, RATE_HZ, EVERY = 30.0, 2.0, 4  # of the room's walks; of the second every 4th picture is asked
FACE = Camera(680, 680, 320.0, 320.0, 339.5, 339.5)  # a little more than 90°
R_CAMERA_FACES = np.array(  # front, right, back, left, down, up
    [
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
        [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],
        [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
        [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
        [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
    ],
    dtype=np.float64,
)


# -- walks -----------------------------------------------------------------------------------------------------------


def with_lens(recording: Recording, seen_by: SeenBy) -> Recording:
    """The recording as a camera with another lens would have made it; as it is for a pinhole."""
    camera = recording.camera
    assert camera is not None
    if seen_by is SeenBy.PINHOLE:
        return recording
    if seen_by is SeenBy.FISHEYE:
        other = replace(camera, fx=camera.focal, fy=camera.focal, distortion=T265, lens=Lens.FISHEYE)
    else:
        height = round(math.pi * camera.focal)
        other = Camera.panorama(2 * height, height)
    cameras = (camera,) * len(recording.frames.times)
    return replace(recording, frames=SteadyFrames(recording.frames, cameras, other), camera=other)


@dataclass(frozen=True, eq=False)
class UntimedFrames(MemoryFrames):
    """Pictures of which only the order is known."""

    timed: ClassVar[bool] = False
    frames_per_second: float = 1.0


def rig_mounting(apart_m: float, aside_rad: float) -> FloatArray:
    """T_rig_cameras (2, 4, 4) of two cameras side by side that are turned outwards."""
    T = np.tile(np.eye(4), (2, 1, 1))
    for one, side in zip(T, (-1, 1), strict=True):
        one[0, 3] = side * apart_m / 2
        one[:3, :3] = cv2.Rodrigues(np.array([0.0, side * aside_rad, 0.0]))[0]
    return T


def of_rig(pictures: list[ByteArray], T_map_rig: FloatArray, T_rig_cameras: FloatArray, camera: Camera) -> Recording:
    """Recording of a rig's 2 N pictures, those of a moment in succession, without times. ``T_map_rig`` is (N, 4, 4)."""
    T = (T_map_rig[:, None] @ T_rig_cameras).reshape(-1, 4, 4)
    T_left_right = np.linalg.inv(T_rig_cameras[0]) @ T_rig_cameras[1]
    mounted = tuple(Mounted(k, k + 1, T_left_right) for k in range(0, len(T), 2))
    poses = GivenPoses(np.ones(len(T), dtype=np.bool_), T)
    return Recording(UntimedFrames(pictures), "rig", Path(), camera, poses=poses, mounted=mounted)


def rig_of(recording: Recording) -> Recording:
    """The recording as two narrower cameras at the same place would have made it."""
    camera, poses = recording.camera, recording.poses
    assert camera is not None
    assert poses is not None
    width = round(SHARE * camera.width)
    narrow = Camera(width, camera.height, camera.focal, camera.focal, (width - 1) / 2, (camera.height - 1) / 2)
    T_rig_cameras = rig_mounting(0.0, math.atan((1 - SHARE) * camera.width / 2 / camera.focal))
    maps = [rig_places(camera, narrow, T[:3, :3]) for T in T_rig_cameras]
    pictures = [
        np.asarray(cv2.remap(image, places, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), dtype=np.uint8)
        for image in recording.frames.images(range(len(recording.frames.times)))
        for places in maps
    ]
    return of_rig(pictures, poses.T_map_camera, T_rig_cameras, narrow)


def pixel_rays(camera: Camera) -> FloatArray:
    """Rays (H · W, 3) of all pixels, row by row."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    return camera.rays(np.column_stack([u.ravel(), v.ravel()]))


def rig_places(camera: Camera, turned: Camera, R_camera_turned: FloatArray) -> FloatArray:
    """Where in the image of ``camera`` (H, W, 2) a camera turned at the same place sees each of its pixels."""
    return (
        camera.project(pixel_rays(turned) @ R_camera_turned.T)
        .reshape(turned.height, turned.width, 2)
        .astype(np.float32)
    )


def euroc(seen_by: SeenBy, seed: int) -> tuple[Recording, Recording]:
    """The frames that are mapped, and those that are asked."""
    recording = read_recording(EUROC)
    count = len(recording.frames.times)
    asked = np.sort(np.random.default_rng(seed).choice(count, count // 3, replace=False))
    parts = chosen(recording, np.setdiff1d(np.arange(count), asked)), chosen(recording, asked)
    first, second = (rig_of(part) if seen_by is SeenBy.RIG else with_lens(part, seen_by) for part in parts)
    return first, second


def room(seen_by: SeenBy, seed: int) -> tuple[Recording, Recording]:
    """Two walks through a room, the second thinned."""
    every = np.arange(0, round(SECONDS * RATE_HZ), EVERY)
    return room_walk(0, seen_by, seed, np.arange(round(SECONDS * RATE_HZ))), room_walk(1, seen_by, seed, every)


def room_walk(walk: int, seen_by: SeenBy, seed: int, moments: IntArray) -> Recording:
    """Some moments of a walk through the demo's room of a seed, as a camera or a rig sees it."""
    scene, camera = make_site(Site.ROOM, seed), ROOM_CAMERAS.get(seen_by, PHONE_CAMERA)
    lighting = light_scene(scene, Light.ARTIFICIAL)
    renderer = Renderer(scene, lighting.paints)
    T = make_site_walk(Site.ROOM, walk, SECONDS, seed).T_map_camera(moments / RATE_HZ)
    T_rig_cameras = rig_mounting(APART_M, ASIDE_RAD) if seen_by is SeenBy.RIG else np.eye(4)[None]
    pictures = []
    for number, one in zip(moments.tolist(), T, strict=True):
        exposure = expose(meter(renderer.radiance(PHONE_CAMERA.resized(80, 60), [Pose(one)])), lighting.white_luminance)
        rng = np.random.default_rng([seed, walk, number])
        pictures += [develop(seen_through(camera, renderer, one @ at), exposure, rng) for at in T_rig_cameras]
    if seen_by is SeenBy.RIG:
        return of_rig(pictures, T, T_rig_cameras, camera)
    poses = GivenPoses(np.ones(len(T), dtype=np.bool_), T)
    return Recording(MemoryFrames(pictures, RATE_HZ), f"walk {walk}", Path(), camera, poses=poses)


def seen_through(camera: Camera, renderer: Renderer, T_map_camera: FloatArray) -> ByteArray:
    """The light (H, W, 3) that a camera of any lens sees from a pose (4, 4)."""
    if camera.lens is Lens.PINHOLE:
        return renderer.radiance(camera, [Pose(T_map_camera)] * 4)
    face_of, places = divided(camera)
    picture = np.zeros((camera.height, camera.width, 3), np.uint8)
    for face, R_camera_face in enumerate(R_CAMERA_FACES):
        if (face_of == face).any():
            T = T_map_camera.copy()
            T[:3, :3] = T[:3, :3] @ R_camera_face
            shown = cv2.remap(renderer.radiance(FACE, [Pose(T)] * 4), places, None, cv2.INTER_LINEAR)
            picture[face_of == face] = shown[face_of == face]
    return picture


@lru_cache
def divided(camera: Camera) -> tuple[IntArray, FloatArray]:
    """The face of a cube (H, W) that shows what a camera's pixels do, and where on it (H, W, 2)."""
    rays = pixel_rays(camera)
    face_of = np.argmax(rays @ R_CAMERA_FACES[:, :, 2].T, axis=1)
    places = FACE.project(np.einsum("nji,nj->ni", R_CAMERA_FACES[face_of], rays))
    shape = camera.height, camera.width
    return face_of.reshape(shape), places.reshape(*shape, 2).astype(np.float32)


WALKS: dict[str, Callable[[SeenBy, int], tuple[Recording, Recording]]] = {"euroc_v101": euroc, "room": room}


# -- figures ---------------------------------------------------------------------------------------------------------


def answered(localizer: Localizer, asked: Recording) -> list[tuple[int, FloatArray]]:
    """Rows of the frames that got a pose, and T_map_camera (4, 4); of a rig's pictures the first of each moment."""
    rig = asked.mounted[0].T_first_second if asked.mounted else None
    found, camera = [], localizer.map.info.camera
    queries = [
        Query.of_picture(image, localizer.extractor, camera)
        for image in asked.frames.images(range(len(asked.frames.times)))
    ]
    for row in range(0, len(queries), 1 if rig is None else 2):
        if rig is None:
            answer = localizer.localize(queries[row])
        else:
            both = SeveralFrames(
                (queries[row], queries[row + 1]), np.stack([np.eye(4), rig]), RIG_SIGMA_M, RIG_SIGMA_RAD
            )
            answer = localize_together(localizer, both).first
        if answer.pose is not None:
            found.append((row, answer.pose.T_map_camera))
    return found


def run(walk: str, seen_by: SeenBy, seed: int) -> dict[str, Any]:
    """Figures of one walk, lens and seed."""
    mapped, asked = WALKS[walk](seen_by, seed)
    assert mapped.poses is not None
    assert asked.poses is not None
    began = time.monotonic()
    try:
        map_, failed = build_map([replace(mapped, poses=None)], BuildOptions(report=False)), ""
    except MappingFailed as error:
        map_, failed = build_map([mapped], BuildOptions(report=False)), error.message
    map_s = time.monotonic() - began
    truth = mapped.poses.T_map_camera[np.searchsorted(mapped.frames.times, map_.views.times)]
    placed = align_poses(map_.views.T_map_camera, truth)
    views_off_m = np.linalg.norm(placed.points(map_.views.T_map_camera[:, :3, 3]) - truth[:, :3, 3], axis=1)
    turned = posed_alignment(map_.views.T_map_camera, truth, np.ones(len(truth)), fixed_scale=False).rotation
    rows = np.arange(0, len(asked.frames.times), 2 if asked.mounted else 1)
    estimated = np.full((len(asked.frames.times), 4, 4), np.nan)
    for row, T_map_camera in answered(Localizer(map_), asked):
        estimated[row] = T_map_camera
        estimated[row, :3, :3] = turned @ T_map_camera[:3, :3]
        estimated[row, :3, 3] = placed.points(T_map_camera[None, :3, 3])[0]
    errors = trajectory_errors(estimated[rows], asked.poses.T_map_camera[rows])
    return {
        "walk": walk,
        "lens": seen_by.value,
        "seed": seed,
        "views": len(map_.views),
        "landmarks": len(map_),
        "map_cm": math.nan if failed else rounded(100 * float(np.median(views_off_m))),
        "localized_percent": rounded(100 * errors.localized.mean(), 1),
        "median_cm": rounded(100 * float(np.median(errors.position_m))),
        "p90_cm": rounded(100 * float(np.quantile(errors.position_m, 0.9))),
        "median_deg": rounded(np.degrees(float(np.median(errors.rotation_rad)))),
        "map_s": rounded(map_s, 0),
        "failed": failed,
    }


def figures_of(rows: Sequence[dict[str, Any]]) -> dict[str, Figure]:
    """What the documents quote: means over the seeds, of the pinhole in centimetres, of other lenses as multiples."""

    def mean(seen_by: SeenBy, figure: str) -> float:
        return float(np.mean([row[figure] for row in rows if row["lens"] == seen_by.value]))

    found = {
        f"lenses.{one.value}.localized_percent": Figure(round(mean(one, "localized_percent"), 1), 2.0, True)
        for one in SeenBy
    }
    for figure, what in (("map_cm", "map"), ("median_cm", "localizing")):
        pinhole = mean(SeenBy.PINHOLE, figure)
        found[f"lenses.pinhole.{figure}"] = Figure(round(pinhole, 2), 0.2, False)
        for one in (SeenBy.FISHEYE, SeenBy.EQUIRECTANGULAR, SeenBy.RIG):
            found[f"lenses.{one.value}.{what}_ratio"] = Figure(round(mean(one, figure) / pinhole, 2), 0.3, False)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("walks", nargs="*", help=f"default: {', '.join(WALKS)}")
    parser.add_argument("--seeds", default="0", help="0-9")
    parser.add_argument("--lenses", nargs="+", type=SeenBy, default=list(SeenBy))
    parser.add_argument("--json", type=Path)
    parser.add_argument("--write", action="store_true", help="write benchmarks/results/lenses.json")
    asked = parser.parse_args()
    first, _, last = asked.seeds.partition("-")
    rows = []
    for seed in range(int(first), int(last or first) + 1):
        for walk in asked.walks or WALKS:
            for seen_by in asked.lenses:
                rows.append(run(walk, seen_by, seed))
                print_table(rows[-1:], list(rows[-1]))
    if asked.json is not None:
        asked.json.write_text(json.dumps(rows, indent=1) + "\n")
    if asked.write:
        walk = rows[0]["walk"]
        command = f"python benchmarks/lenses.py {walk} --seeds {asked.seeds} --write"
        write_results("lenses", figures_of([row for row in rows if row["walk"] == walk]), command)
        quote_anew()


if __name__ == "__main__":
    main()
