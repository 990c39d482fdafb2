"""Make what ``maps/`` ships: a small map of the simulated test site and three pictures to localize in it.

The README's picture, the second walk from above, is made on the way.

    python benchmarks/make_shipped_map.py

The map is built from some frames of the first walk and their true poses, which keeps it small; the demo builds its own
from video, IMU and waypoints. The pictures are of the second walk; their true poses lie beside them in ``poses.txt``,
so that a test can tell how far off the answers are.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from rholoc.errors import MappingFailed
from rholoc.evaluation import trajectory_errors
from rholoc.geometry import ByteArray, FloatArray, Pose
from rholoc.localization import Localizer, Query
from rholoc.mapping import BuildOptions, build_map
from rholoc.maps import Map, map_to_bytes, save_map
from rholoc.pictures.trajectories import plot_top_view, save_figure
from rholoc.recordings import CameraFile, GivenPoses, Recording, read_recording, write_camera_json
from rholoc.simulation import SimulatedRecording, simulate_recording
from rholoc.trajectory import PoseMethod

MAPS = Path(__file__).parents[1] / "maps"
QUERIES = MAPS / "queries"
PICTURE = MAPS.parent / "server" / "pictures" / "top_view.png"
MAP_FPS = 2.0  # of the first walk: few views, so that the map stays small
MAX_MAP_BYTES = 500_000
QUERY_FPS = 2.0  # of the second walk: enough to choose from
PICTURES = 3
JPEG_QUALITY = 90
MAX_ERROR_M = 0.05


def main() -> None:
    """Simulate, map, localize, choose pictures, write."""
    with tempfile.TemporaryDirectory() as scratch:
        first = simulate_recording(Path(scratch, "walk-1"), walk=1, fps=MAP_FPS)
        second = simulate_recording(Path(scratch, "walk-2"), walk=2, fps=QUERY_FPS)
        map_ = build_map([with_truth(first)], BuildOptions(poses=PoseMethod.GIVEN))
        size_bytes = len(map_to_bytes(map_))
        if size_bytes > MAX_MAP_BYTES:
            raise MappingFailed(f"The map has {size_bytes} bytes.", f"At most {MAX_MAP_BYTES} are shipped.")
        save_map(map_, MAPS / "testsite.rho")
        images = list(read_recording(second.path).frames.images(range(len(second.times))))
        estimated = localized(map_, images, second)
        _write_queries({row: images[row] for row in choose_queries(estimated, second)}, second)
        points = [(point.name, np.asarray(point.position)) for point in map_.info.waypoints]
        save_figure(plot_top_view(estimated, second.T_map_camera, map_.landmarks.positions, points), PICTURE)
    print(f"maps/testsite.rho: {size_bytes} bytes, {len(map_)} landmarks")


def with_truth(walk: SimulatedRecording) -> Recording:
    """The recording of a walk with the true poses of three frames in four, as a dataset would give them."""
    poses = GivenPoses(np.arange(len(walk.times)) % 4 != 3, walk.T_map_camera)
    return replace(read_recording(walk.path), poses=poses)


def localized(map_: Map, images: list[ByteArray], walk: SimulatedRecording) -> FloatArray:
    """T_map_camera (N, 4, 4) of the images, NaN where the map does not place one."""
    localizer = Localizer(map_)
    answers = [localizer.localize(Query(localizer.extractor.extract(image), walk.camera)) for image in images]
    nothing = np.full((4, 4), np.nan)
    return np.stack([nothing if answer.pose is None else answer.pose.T_map_camera for answer in answers])


def choose_queries(estimated: FloatArray, walk: SimulatedRecording) -> list[int]:
    """Rows of frames, spread over the walk, of those that the map places well."""
    good = np.flatnonzero(trajectory_errors(estimated, walk.T_map_camera).within(MAX_ERROR_M, 5.0))
    if len(good) < PICTURES:
        raise MappingFailed("The map places too few frames of the second walk.", "Look at its report.")
    return good[np.linspace(0, len(good) - 1, PICTURES + 2)[1:-1].astype(int)].tolist()


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
