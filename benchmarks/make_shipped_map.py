"""Make what ``maps/`` ships: a small map of the simulated test site, and three pictures to localize in it.

    python benchmarks/make_shipped_map.py

The map is built from video, IMU and waypoints of the first walk, as a user's would be. The pictures are of the second
walk; their true poses lie beside them in ``poses.txt``, so that a test can tell how far off the answers are.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import cv2
import numpy as np

from rholoc.errors import MappingFailed
from rholoc.evaluation import trajectory_errors
from rholoc.geometry import ByteArray, Pose
from rholoc.localization import Localizer, Query
from rholoc.mapping import build_map
from rholoc.maps import Map, map_to_bytes, save_map
from rholoc.recordings import CameraFile, Recording, read_recording, write_camera_json
from rholoc.simulation import SimulatedRecording, simulate_recording

MAPS = Path(__file__).parents[1] / "maps"
QUERIES = MAPS / "queries"
SECONDS = 11.0  # of the walk: a part of the test site, so that the map stays small
MAX_MAP_BYTES = 500_000
PICTURES = 3
JPEG_QUALITY = 90
MAX_ERROR_M = 0.05


def main() -> None:
    """Simulate, map, choose pictures, write."""
    with tempfile.TemporaryDirectory() as scratch:
        first = simulate_recording(Path(scratch, "walk-1"), walk=1, seconds=SECONDS)
        second = simulate_recording(Path(scratch, "walk-2"), walk=2, seconds=SECONDS)
        map_ = build_map([read_recording(first.path)])
        size_bytes = len(map_to_bytes(map_))
        if size_bytes > MAX_MAP_BYTES:
            raise MappingFailed(f"The map has {size_bytes} bytes.", f"At most {MAX_MAP_BYTES} are shipped.")
        save_map(map_, MAPS / "testsite.rho")
        _write_queries(choose_queries(map_, second, read_recording(second.path)), second)
    print(f"maps/testsite.rho: {size_bytes} bytes, {len(map_)} landmarks")


def choose_queries(map_: Map, walk: SimulatedRecording, recording: Recording) -> dict[int, ByteArray]:
    """Frames by their row, spread over the walk, of those that the map places well."""
    localizer = Localizer(map_)
    rows = range(0, len(walk.times), 10)
    good: dict[int, ByteArray] = {}
    for row, image in zip(rows, recording.frames.images(rows), strict=True):
        answer = localizer.localize(Query(localizer.extractor.extract(image), walk.camera))
        if answer.localized and answer.pose is not None:
            errors = trajectory_errors(answer.pose.T_map_camera[None], walk.T_map_camera[row][None])
            if errors.within(MAX_ERROR_M, 5.0)[0]:
                good[row] = image
    if len(good) < PICTURES:
        raise MappingFailed("The map places too few frames of the second walk.", "Look at its report.")
    places = np.linspace(0, len(good) - 1, PICTURES + 2)[1:-1].astype(int)
    return {row: good[row] for row in np.array(list(good))[places].tolist()}


def _write_queries(images: dict[int, ByteArray], walk: SimulatedRecording) -> None:
    QUERIES.mkdir(parents=True, exist_ok=True)
    lines = ["# picture tx ty tz qx qy qz qw   T_map_camera, metres"]
    for number, (row, image) in enumerate(images.items(), start=1):
        cv2.imwrite(str(QUERIES / f"{number}.jpg"), image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        pose = Pose(walk.T_map_camera[row])
        lines.append(f"{number} " + " ".join(f"{value:.6f}" for value in (*pose.position, *pose.quaternion_xyzw)))
    (QUERIES / "poses.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    write_camera_json(QUERIES / "camera.json", CameraFile(camera=walk.camera))


if __name__ == "__main__":
    main()
