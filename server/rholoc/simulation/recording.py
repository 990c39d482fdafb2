"""A phone's recording of a simulated walk, with the truth beside it, in rholoc's own recording format."""

import os
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from rholoc.errors import StorageFull
from rholoc.geometry import ByteArray, Camera, FloatArray, Pose
from rholoc.recordings import CameraFile, write_camera_json, write_frames_csv, write_imu_csv, write_waypoints_csv
from rholoc.recordings.tables.waypoints import MIN_WAYPOINTS
from rholoc.simulation.light import Light, light_building, light_scene
from rholoc.simulation.render import SAMPLES, Renderer
from rholoc.simulation.rooms import make_test_site
from rholoc.simulation.scene import Building, Scene
from rholoc.simulation.sensor import Exposure, develop, expose, meter
from rholoc.simulation.walk import R_CAMERA_IMU, Motion, make_walk, measure_imu, measure_waypoints

PHONE_CAMERA = Camera(width=640, height=480, fx=520.0, fy=520.0, cx=319.5, cy=239.5)
TRUTH_COLUMNS = "timestamp,x,y,z,hx,hy,hz,frame,roll,qx,qy,qz,qw,confidence,inliers"
_METER_INTERVAL_S = 0.25
_METER_SIZE = (80, 60)
_METER_INERTIA_S = 0.5  # time constant of the camera's exposure
_PREFETCH_FRAMES = 4
_ROWS_AT_ONCE = 24  # of a rolling shutter, drawn as if read in one moment


@dataclass(frozen=True, eq=False)
class SimulatedRecording:
    """A written recording, and its ground truth.

    Attributes:
        path: the folder.
        times: (N,) seconds, of the frames.
        T_map_camera: (N, 4, 4), the true poses.
    """

    path: Path
    walk: Motion
    light: Light
    camera: Camera
    times: FloatArray
    T_map_camera: FloatArray

    @property
    def truth(self) -> Path:
        """Path of the file of true poses (Table 6), which no reader of recordings reads."""
        return self.path / "truth.csv"


def simulate_recording(
    out: Path,
    *,
    walk: Motion | int = 1,
    light: Light = Light.ARTIFICIAL,
    seconds: float = 30.0,
    seed: int = 0,
    fps: float = 30.0,
    scene: Scene | Building | None = None,
    camera: Camera = PHONE_CAMERA,
    readout_s: float = 0.0,
    progress: Callable[[float], None] = lambda fraction: None,
) -> SimulatedRecording:
    """Walk through a room with a phone and write what it records into the folder ``out``.

    Writes ``video.mp4``, ``frames.csv``, ``imu.csv``, ``waypoints.csv``, ``camera.json``, and the true poses in
    ``truth.csv``. The same arguments give the same recording. Recordings of the same ``seed`` are of the same room and
    in the same map frame, whatever the walk and the light.

    Args:
        walk: a walk, or the number of one through the test site.
        seconds: the recording's length; less than a whole walk takes ends on the way, and without ``waypoints.csv``
            where it ends before the third.
        scene: another place than the ``seed``'s test site.
        readout_s: read-out time of a rolling shutter from the first row to the last; the frame's time is that of the
            middle row. Noted in ``camera.json``, as phones do that log it.
        progress: called with the fraction done; may raise to stop.

    Raises:
        StorageFull: the video cannot be written.
    """
    out.mkdir(parents=True, exist_ok=True)
    walk = make_walk(walk, seconds, seed) if isinstance(walk, int) else walk
    scene = make_test_site(seed) if scene is None else scene
    times = np.arange(max(1, round(seconds * fps))) / fps
    T_map_camera = walk.T_map_camera(times)

    write_frames_csv(out / "frames.csv", np.arange(len(times)), times)
    write_imu_csv(out / "imu.csv", measure_imu(walk, seconds, seed=seed))
    waypoints = measure_waypoints(walk, seconds, seed=seed)
    if len(waypoints) >= MIN_WAYPOINTS:
        write_waypoints_csv(out / "waypoints.csv", waypoints)
    else:
        (out / "waypoints.csv").unlink(missing_ok=True)
    description = CameraFile(camera=camera, R_camera_imu=R_CAMERA_IMU, readout_s=readout_s or None)
    write_camera_json(out / "camera.json", description)
    _write_truth(out / "truth.csv", times, T_map_camera)
    film = _film(walk, times, camera, light, seed, scene, readout_s)
    _write_video(out / "video.mp4", film, camera, fps, len(times), progress)
    return SimulatedRecording(out, walk, light, camera, times, T_map_camera)


def render_view(
    scene: Scene | Building, camera: Camera, pose: Pose, light: Light = Light.ARTIFICIAL, seed: int = 0
) -> ByteArray:
    """One photograph (H, W, 3) BGR of a scene, well exposed, the camera at rest; ``seed`` is of its noise.

    Lighting is kept for the next call.
    """
    renderer, white = _lit_renderer(scene, light)
    exposure = expose(meter(renderer.radiance(camera.resized(*_METER_SIZE), [pose])), white)
    return develop(renderer.radiance(camera, [pose] * len(SAMPLES)), exposure, np.random.default_rng(seed))


@lru_cache(maxsize=2)
def _lit_renderer(scene: Scene | Building, light: Light) -> tuple[Renderer, float]:
    """The renderer of a lit scene, and the luminance of its white in cd/m²."""
    lighting = light_building(scene, light) if isinstance(scene, Building) else light_scene(scene, light)
    return Renderer(scene, lighting.paints), lighting.white_luminance


def _film(
    walk: Motion,
    times: FloatArray,
    camera: Camera,
    light: Light,
    seed: int,
    scene: Scene | Building,
    readout_s: float,
) -> Iterator[ByteArray]:
    """Iterate over the frames (H, W, 3) BGR at times (N,) [s], drawn by as many threads as there are cores."""
    renderer, white = _lit_renderer(scene, light)
    gains = _metered(renderer, walk, camera, times)

    def frame(i: int) -> ByteArray:
        exposure: Exposure = expose(gains[i], white)
        within = (np.arange(len(SAMPLES)) + 0.5) / len(SAMPLES) - 0.5
        moments = times[i] + exposure.seconds * within
        parts = [
            renderer.radiance(camera, walk.poses(moments + late_s), rows)
            for rows, late_s in _read_out(camera.height, readout_s)
        ]
        rng = np.random.default_rng([seed, walk.number, list(Light).index(light), 3, i])
        return develop(np.concatenate(parts), exposure, rng)

    threads = os.cpu_count() or 1
    with ThreadPoolExecutor(threads) as pool:
        waiting: deque[Future[ByteArray]] = deque()
        try:
            for i in range(len(times)):
                waiting.append(pool.submit(frame, i))
                if len(waiting) > threads + _PREFETCH_FRAMES:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()


def _read_out(height: int, readout_s: float) -> list[tuple[tuple[int, int], float]]:
    """Ranges of rows read at once (first, last + 1), and their read-out time relative to the middle row [s]."""
    if readout_s == 0:
        return [((0, height), 0.0)]
    parts = [(top, min(top + _ROWS_AT_ONCE, height)) for top in range(0, height, _ROWS_AT_ONCE)]
    return [((top, bottom), ((top + bottom) / 2 / height - 0.5) * readout_s) for top, bottom in parts]


def _metered(renderer: Renderer, walk: Motion, camera: Camera, times: FloatArray) -> FloatArray:
    """Gains (N, 3) BGR of auto exposure and white balance at times (N,), following the light within half a second."""
    steps = np.arange(times[0], times[-1] + _METER_INTERVAL_S, _METER_INTERVAL_S)
    small = camera.resized(*_METER_SIZE)
    wanted = np.log([meter(renderer.radiance(small, [pose])) for pose in walk.poses(steps)])
    settled = wanted.copy()
    keep = np.exp(-_METER_INTERVAL_S / _METER_INERTIA_S)
    for i in range(1, len(steps)):
        settled[i] = keep * settled[i - 1] + (1 - keep) * wanted[i]
    return np.exp(np.column_stack([np.interp(times, steps, settled[:, c]) for c in range(3)]))


def _write_video(
    path: Path, frames: Iterator[ByteArray], camera: Camera, fps: float, count: int, progress: Callable[[float], None]
) -> None:
    """Write ``count`` frames (H, W, 3) BGR as MPEG-4. Raises StorageFull if the file cannot be opened."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), fps, (camera.width, camera.height))
    if not writer.isOpened():
        raise StorageFull(f"{path.name} cannot be written.", "Check that the folder is writable and the disk not full.")
    try:
        for i, frame in enumerate(frames):
            writer.write(frame)
            progress((i + 1) / count)
    finally:
        writer.release()


def _write_truth(path: Path, times: FloatArray, T_map_camera: FloatArray) -> None:
    """Write Table 6 with rholoc's further columns (``TRUTH_COLUMNS``); confidence is 1, and inliers are 0."""
    with path.open("w", encoding="utf-8") as file:
        file.write(TRUTH_COLUMNS + "\n")
        for number, (time, T) in enumerate(zip(times, T_map_camera, strict=True)):
            pose = Pose(T)
            place = ",".join(f"{value:.6f}" for value in (*pose.position, *pose.heading))
            turn = ",".join(f"{value:.8f}" for value in (pose.roll, *pose.quaternion_xyzw))
            file.write(f"{time:.6f},{place},{number},{turn},1,0\n")
