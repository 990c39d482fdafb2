"""A walk as cameras with other lenses would have recorded it: does each map and localize as well as the pinhole?

    python benchmarks/lenses.py [--seeds 0-9] [--lenses pinhole fisheye equirectangular] [--json FILE]

``euroc_v101``, as it is and resampled: as a fisheye of the same size and as a panorama, each with as many pixels a
radian at the optical axis. Of every seed, two frames of three make a map, by pictures and IMU, and the others are
localized in it, with the camera that the map found. Errors are against the truth after a similarity alignment of the
map's frames, that of the rotations by the rotations. A seed chooses the frames.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from measuring import SHARED_DATA, measured, position_errors, print_table, rounded
from rholoc.evaluation import trajectory_errors
from rholoc.geometry import ByteArray, Camera, FloatArray, IntArray, Lens, align_poses, posed_alignment
from rholoc.localization import Localizer, Query
from rholoc.mapping import BuildOptions, build_map
from rholoc.recordings import FrameSource, Recording, read_recording
from rholoc.recordings.frames.unified_pictures import resampled
from rholoc.recordings.selection import SelectedFrames

FISHEYE = (0.0008, 0.031, -0.03, 0.005)  # coefficients of a RealSense T265
WALK = SHARED_DATA / "euroc_v101"


@dataclass(frozen=True, eq=False)
class ResampledFrames:
    """Another source's frames as another camera at the same place shows them."""

    source: FrameSource
    camera: Camera
    seen_by: Camera

    @property
    def times(self) -> FloatArray:
        return self.source.times

    @property
    def timed(self) -> bool:
        return self.source.timed

    @property
    def numbers(self) -> IntArray:
        return self.source.numbers

    @property
    def size(self) -> tuple[int, int]:
        return self.seen_by.width, self.seen_by.height

    def images(self, rows: Sequence[int]) -> Iterator[ByteArray]:
        for image in self.source.images(rows):
            yield resampled(image, self.camera, self.seen_by)


def with_lens(recording: Recording, lens: Lens) -> Recording:
    """The recording as a camera with another lens would have made it; as it is for a pinhole."""
    camera = recording.camera
    assert camera is not None
    if lens is Lens.PINHOLE:
        return recording
    if lens is Lens.FISHEYE:
        seen_by = replace(camera, fx=camera.focal, fy=camera.focal, distortion=FISHEYE, lens=lens)
    else:
        height = round(math.pi * camera.focal)
        seen_by = Camera.panorama(2 * height, height)
    return replace(recording, frames=ResampledFrames(recording.frames, camera, seen_by), camera=seen_by)


def chosen(recording: Recording, rows: IntArray) -> Recording:
    """Some of the frames."""
    poses = recording.poses
    assert poses is not None
    poses = replace(poses, known=poses.known[rows], T_map_camera=poses.T_map_camera[rows])
    return replace(recording, frames=SelectedFrames(recording.frames, rows), poses=poses, frame_intrinsics=None)


def _turned(T_map_camera: FloatArray, truth: FloatArray) -> FloatArray:
    """R_truth_map (3, 3) by the cameras' own rotations: a walk nearly along a line does not show it well."""
    return posed_alignment(T_map_camera, truth, np.ones(len(truth)), fixed_scale=False).rotation


def run(lens: Lens, seed: int) -> dict[str, Any]:
    """Figures of one lens and seed."""
    recording = with_lens(read_recording(WALK), lens)
    assert recording.camera is not None
    count = len(recording.frames.times)
    asked = np.sort(np.random.default_rng(seed).choice(count, count // 3, replace=False))
    mapped = chosen(recording, np.setdiff1d(np.arange(count), asked))
    queries = chosen(recording, asked)
    assert mapped.poses is not None
    assert queries.poses is not None
    with measured() as cost:
        map_ = build_map([replace(mapped, poses=None)], BuildOptions(report=False))
    rows = np.searchsorted(mapped.frames.times, map_.views.times)
    truth = mapped.poses.T_map_camera[rows]
    placed, turned = align_poses(map_.views.T_map_camera, truth), _turned(map_.views.T_map_camera, truth)
    localizer = Localizer(map_)
    estimated = np.full((len(asked), 4, 4), np.nan)
    for i, image in enumerate(queries.frames.images(range(len(asked)))):
        answer = localizer.localize(Query.of_picture(image, localizer.extractor, map_.info.camera))
        if answer.pose is not None:
            estimated[i, :3, :3] = turned @ answer.pose.R_map_camera
            estimated[i, :3, 3] = placed.points(answer.pose.position[None])[0]
    errors = trajectory_errors(estimated, queries.poses.T_map_camera)
    return {
        "lens": lens.value,
        "seed": seed,
        "views": len(map_.views),
        "landmarks": len(map_),
        "map_cm": position_errors(map_.views.T_map_camera, truth)["median_cm"],
        "localized_percent": rounded(100 * errors.localized.mean(), 1),
        "median_cm": rounded(100 * float(np.median(errors.position_m))),
        "p90_cm": rounded(100 * float(np.quantile(errors.position_m, 0.9))),
        "median_deg": rounded(np.degrees(float(np.median(errors.rotation_rad)))),
        "map_s": rounded(cost.seconds, 0),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="0")
    parser.add_argument("--lenses", nargs="+", type=Lens, default=list(Lens))
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    first, _, last = asked.seeds.partition("-")
    rows = []
    for seed in range(int(first), int(last or first) + 1):
        for lens in asked.lenses:
            rows.append(run(lens, seed))
            print_table(rows[-1:], list(rows[-1]))
    if asked.json is not None:
        asked.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
