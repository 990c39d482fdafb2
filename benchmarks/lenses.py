"""A walk as cameras with other lenses would have recorded it: does each map and localize as well as the pinhole?

    python benchmarks/lenses.py [euroc_v101 room] [--seeds 0-9] [--lenses pinhole fisheye equirectangular] [--json FILE]
        [--write]

``euroc_v101``: as it is, and resampled as a fisheye of the same size and as a panorama, each with as many pixels a
radian at the optical axis. Of every seed, which chooses the frames, two frames of three make a map, by pictures and
IMU, and the others are localized in it. The lens is another one, what it shows is the same.

``room``: the demo's room of a seed, two pictures a second, rendered for a phone, for a fisheye of 170° and for a whole
panorama; the first walk is mapped from its pictures alone, or with its true poses where that fails, the second is
localized. The lenses show more and more.

With ``--write`` the first walk's errors, those of other lenses as multiples of the pinhole's, go to
benchmarks/results/lenses.json. Frames are localized with the camera that the map has. Errors of positions are after
the similarity that aligns the map's views with the truth, errors of rotations after the mean rotation.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from figures import Figure, quote_anew, write_results
from measuring import SHARED_DATA, print_table, rounded
from rholoc.errors import MappingFailed
from rholoc.evaluation import trajectory_errors
from rholoc.geometry import ByteArray, Camera, FloatArray, IntArray, Lens, Pose, align_poses, posed_alignment
from rholoc.localization import Localizer, Query
from rholoc.mapping import BuildOptions, build_map
from rholoc.recordings import GivenPoses, MemoryFrames, Recording, read_recording
from rholoc.recordings.frames.unified_pictures import SteadyFrames
from rholoc.simulation import Light
from rholoc.simulation.light import light_scene
from rholoc.simulation.recording import PHONE_CAMERA
from rholoc.simulation.render import Renderer
from rholoc.simulation.sensor import develop, expose, meter
from rholoc_lab.simulation.sites import Site, make_site, make_site_walk
from rooms import chosen

T265 = (0.0008, 0.031, -0.03, 0.005)  # coefficients of a RealSense's fisheyes
EUROC = SHARED_DATA / "euroc_v101"
ROOM_CAMERAS = {
    Lens.PINHOLE: PHONE_CAMERA,
    Lens.FISHEYE: Camera(960, 960, 320.0, 320.0, 479.5, 479.5, T265, Lens.FISHEYE),
    Lens.EQUIRECTANGULAR: Camera.panorama(2000, 1000),
}
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


def with_lens(recording: Recording, lens: Lens) -> Recording:
    """The recording as a camera with another lens would have made it; as it is for a pinhole."""
    camera = recording.camera
    assert camera is not None
    if lens is Lens.PINHOLE:
        return recording
    if lens is Lens.FISHEYE:
        seen_by = replace(camera, fx=camera.focal, fy=camera.focal, distortion=T265, lens=lens)
    else:
        height = round(math.pi * camera.focal)
        seen_by = Camera.panorama(2 * height, height)
    cameras = (camera,) * len(recording.frames.times)
    return replace(recording, frames=SteadyFrames(recording.frames, cameras, seen_by), camera=seen_by)


def euroc(lens: Lens, seed: int) -> tuple[Recording, Recording]:
    """The frames that are mapped, and those that are asked."""
    recording = with_lens(read_recording(EUROC), lens)
    count = len(recording.frames.times)
    asked = np.sort(np.random.default_rng(seed).choice(count, count // 3, replace=False))
    return chosen(recording, np.setdiff1d(np.arange(count), asked)), chosen(recording, asked)


def room(lens: Lens, seed: int) -> tuple[Recording, Recording]:
    """Two walks through a room, the second thinned."""
    first, second = (room_walk(walk, lens, seed) for walk in (0, 1))
    return first, chosen(second, np.arange(0, len(second.frames.times), EVERY))


def room_walk(walk: int, lens: Lens, seed: int) -> Recording:
    """A walk through the demo's room of a seed, as a camera with the lens sees it."""
    scene, camera = make_site(Site.ROOM, seed), ROOM_CAMERAS[lens]
    lighting = light_scene(scene, Light.ARTIFICIAL)
    renderer = Renderer(scene, lighting.paints)
    T = make_site_walk(Site.ROOM, walk, SECONDS, seed).T_map_camera(np.arange(SECONDS * RATE_HZ) / RATE_HZ)
    pictures = []
    for number, one in enumerate(T):
        exposure = expose(meter(renderer.radiance(PHONE_CAMERA.resized(80, 60), [Pose(one)])), lighting.white_luminance)
        rng = np.random.default_rng([seed, walk, number])
        pictures.append(develop(seen_through(camera, renderer, one), exposure, rng))
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
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = camera.rays(np.column_stack([u.ravel(), v.ravel()]))
    face_of = np.argmax(rays @ R_CAMERA_FACES[:, :, 2].T, axis=1)
    places = FACE.project(np.einsum("nji,nj->ni", R_CAMERA_FACES[face_of], rays))
    shape = camera.height, camera.width
    return face_of.reshape(shape), places.reshape(*shape, 2).astype(np.float32)


WALKS: dict[str, Callable[[Lens, int], tuple[Recording, Recording]]] = {"euroc_v101": euroc, "room": room}


# -- figures ---------------------------------------------------------------------------------------------------------


def run(walk: str, lens: Lens, seed: int) -> dict[str, Any]:
    """Figures of one walk, lens and seed."""
    mapped, asked = WALKS[walk](lens, seed)
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
    localizer = Localizer(map_)
    estimated = np.full((len(asked.frames.times), 4, 4), np.nan)
    for i, image in enumerate(asked.frames.images(range(len(estimated)))):
        answer = localizer.localize(Query.of_picture(image, localizer.extractor, map_.info.camera))
        if answer.pose is not None:
            estimated[i] = answer.pose.T_map_camera
            estimated[i, :3, :3] = turned @ answer.pose.R_map_camera
            estimated[i, :3, 3] = placed.points(answer.pose.position[None])[0]
    errors = trajectory_errors(estimated, asked.poses.T_map_camera)
    return {
        "walk": walk,
        "lens": lens.value,
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

    def mean(lens: Lens, figure: str) -> float:
        return float(np.mean([row[figure] for row in rows if row["lens"] == lens.value]))

    found = {
        f"lenses.{lens.value}.localized_percent": Figure(round(mean(lens, "localized_percent"), 1), 2.0, True)
        for lens in Lens
    }
    for figure, what in (("map_cm", "map"), ("median_cm", "localizing")):
        pinhole = mean(Lens.PINHOLE, figure)
        found[f"lenses.pinhole.{figure}"] = Figure(round(pinhole, 2), 0.2, False)
        for lens in (Lens.FISHEYE, Lens.EQUIRECTANGULAR):
            found[f"lenses.{lens.value}.{what}_ratio"] = Figure(round(mean(lens, figure) / pinhole, 2), 0.3, False)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("walks", nargs="*", help=f"default: {', '.join(WALKS)}")
    parser.add_argument("--seeds", default="0", help="0-9")
    parser.add_argument("--lenses", nargs="+", type=Lens, default=list(Lens))
    parser.add_argument("--json", type=Path)
    parser.add_argument("--write", action="store_true", help="write benchmarks/results/lenses.json")
    asked = parser.parse_args()
    first, _, last = asked.seeds.partition("-")
    rows = []
    for seed in range(int(first), int(last or first) + 1):
        for walk in asked.walks or WALKS:
            for lens in asked.lenses:
                rows.append(run(walk, lens, seed))
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
