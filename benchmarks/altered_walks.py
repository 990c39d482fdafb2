"""Real recordings made into walks that nobody has met: backward, in a mirror, turned, spoiled, stamped wrongly.

    python benchmarks/altered_walks.py [bedroom_night android_livingroom euroc_v101 redkitchen] [--span 0 40]
        [--only backward mirror …] [--json FILE]

What was measured holds of each: backward the gyroscope reads the opposite and the accelerometer the same; in a mirror
the world and the IMU's axes are mirrored. For each alteration: the share of keyframes placed, whether the map is
trusted, how far turns over 1 and 10 s are from the gyroscope's, and where there is truth, the errors after a similarity
and the scale. Waypoints and given poses are left out. ``--json`` has all figures, and why a map is not trusted.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from measuring import SHARED_DATA, flat, position_errors, print_table, rounded, scale_between
from real_walks import KITCHEN_CAMERA, between, place, with_frames
from rholoc.geometry import ByteArray, FloatArray, IntArray
from rholoc.recordings import FrameSource, Recording, read_recording

NAMES = ("bedroom_night", "android_livingroom", "euroc_v101", "redkitchen")
COLUMNS = {
    "recording": "recording",
    "alteration": "alteration",
    "placed": "placed",
    "trusted": "trusted",
    "gyroscope 1s median": "1 s, degrees",
    "gyroscope 10s median": "10 s",
    "gyroscope 10s worst": "10 s worst",
    "truth median_cm": "median cm",
    "truth worst_cm": "worst cm",
    "scale": "scale",
    "seconds": "seconds",
    "failed": "failed",
}
MIRROR = np.diag([-1.0, 1.0, 1.0])
R_TURNED = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # the turned camera from the upright one
_BATCH = 64  # images held at once where they are wanted in another order

Alter = Callable[[ByteArray, int], ByteArray]  # an image and its number → another


@dataclass(frozen=True, eq=False)
class AlteredFrames:
    """Another source's frames in another order, at other times, each altered."""

    source: FrameSource
    times: FloatArray
    order: IntArray
    size: tuple[int, int]
    alter: Alter

    @property
    def numbers(self) -> IntArray:
        return np.arange(len(self.times))

    def images(self, rows: Sequence[int]) -> Iterator[ByteArray]:
        for start in range(0, len(rows), _BATCH):
            batch = [int(row) for row in rows[start : start + _BATCH]]
            wanted = sorted({int(self.order[row]) for row in batch})
            found = dict(zip(wanted, self.source.images(wanted), strict=True))
            for row in batch:
                yield np.ascontiguousarray(self.alter(found[int(self.order[row])], row))


def redrawn(recording: Recording, alter: Alter, size: tuple[int, int] | None = None) -> Recording:
    """The same walk, its pictures altered."""
    frames = recording.frames
    order = np.arange(len(frames.times))
    return replace(
        recording,
        frames=AlteredFrames(frames, frames.times, order, size or frames.size, alter),
        frame_intrinsics=None,
    )


def backward(recording: Recording) -> Recording:
    frames, imu, poses = recording.frames, recording.imu, recording.poses
    ends = frames.times[0] + frames.times[-1]
    order = np.arange(len(frames.times))[::-1]
    if imu is not None:
        imu = replace(
            imu,
            times=ends - imu.times[::-1],
            acceleration=imu.acceleration[::-1].copy(),
            angular_velocity=-imu.angular_velocity[::-1],
        )
    if poses is not None:
        poses = replace(poses, known=poses.known[::-1].copy(), T_map_camera=poses.T_map_camera[::-1].copy())
    return replace(
        recording,
        frames=AlteredFrames(frames, ends - frames.times[::-1], order, frames.size, lambda image, _: image),
        imu=imu,
        poses=poses,
        frame_intrinsics=None,
        readout_s=None,
    )


def mirrored(recording: Recording) -> Recording:
    camera, imu, poses = recording.camera, recording.imu, recording.poses
    if camera is not None:
        k1, k2, p1, p2, *more = (*camera.distortion, 0, 0, 0, 0)[: max(4, len(camera.distortion))]
        distortion = (k1, k2, p1, -p2, *more) if camera.distortion else ()
        camera = replace(camera, cx=camera.width - 1 - camera.cx, distortion=distortion)
    if imu is not None:
        R = imu.R_camera_imu
        imu = replace(
            imu,
            acceleration=imu.acceleration @ MIRROR,
            angular_velocity=-imu.angular_velocity @ MIRROR,
            R_camera_imu=None if R is None else MIRROR @ R @ MIRROR,
        )
    if poses is not None:
        T_mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
        poses = replace(poses, T_map_camera=T_mirror @ poses.T_map_camera @ T_mirror)
    return replace(redrawn(recording, lambda image, _: image[:, ::-1]), camera=camera, imu=imu, poses=poses)


def turned(recording: Recording) -> Recording:
    """Held on its side: a quarter turn against the clock."""
    width, height = recording.frames.size
    camera, imu, poses = recording.camera, recording.imu, recording.poses
    if camera is not None:
        k1, k2, p1, p2, *more = (*camera.distortion, 0, 0, 0, 0)[: max(4, len(camera.distortion))]
        distortion = (k1, k2, -p2, p1, *more) if camera.distortion else ()
        camera = replace(
            camera,
            width=height,
            height=width,
            fx=camera.fy,
            fy=camera.fx,
            cx=camera.cy,
            cy=width - 1 - camera.cx,
            distortion=distortion,
        )
    if imu is not None and imu.R_camera_imu is not None:
        imu = replace(imu, R_camera_imu=R_TURNED @ imu.R_camera_imu)
    if poses is not None:
        T = poses.T_map_camera.copy()
        T[:, :3, :3] = T[:, :3, :3] @ R_TURNED.T
        poses = replace(poses, T_map_camera=T)
    sideways = redrawn(recording, lambda image, _: np.rot90(image), (height, width))
    return replace(sideways, camera=camera, imu=imu, poses=poses)


def compressed(recording: Recording) -> Recording:
    def alter(image: ByteArray, _: int) -> ByteArray:
        _, encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 20])
        return np.asarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR), dtype=np.uint8)

    return redrawn(recording, alter)


def slowly_varying(recording: Recording, every: int, seed: int) -> FloatArray:
    """(N,) normal numbers that change over ``every`` frames."""
    count = len(recording.frames.times)
    knots = np.arange(0, count + every, every)
    return np.interp(np.arange(count), knots, np.random.default_rng(seed).normal(0, 1, len(knots)))


def flickering(recording: Recording) -> Recording:
    """Exposure that wanders by a factor of 1.6."""
    gain = np.exp(0.5 * slowly_varying(recording, 40, 1))
    return redrawn(recording, lambda image, row: np.clip(image * gain[row], 0, 255).astype(np.uint8))


def shaken(recording: Recording) -> Recording:
    """Blurred by up to 14 pixels, now and then."""
    length_px = np.clip(3 + 6 * slowly_varying(recording, 20, 4), 1, 14).astype(int)
    return redrawn(recording, lambda image, row: cv2.blur(image, (int(length_px[row]), 1)))


def noisy(recording: Recording) -> Recording:
    def alter(image: ByteArray, row: int) -> ByteArray:
        noise = np.random.default_rng(row).normal(0, 8, image.shape)
        return np.clip(image + noise, 0, 255).astype(np.uint8)

    return redrawn(recording, alter)


def cropped(recording: Recording) -> Recording:
    """The middle 70 % of the picture: a narrower view."""
    (width, height), camera = recording.frames.size, recording.camera
    w, h = int(0.7 * width) // 2 * 2, int(0.7 * height) // 2 * 2
    x, y = (width - w) // 2, (height - h) // 2
    if camera is not None:
        camera = replace(camera, width=w, height=h, cx=camera.cx - x, cy=camera.cy - y)
    middle = redrawn(recording, lambda image, _: image[y : y + h, x : x + w], (w, h))
    return replace(middle, camera=camera)


def with_frames_lost(recording: Recording) -> Recording:
    """Three in ten, at random."""
    kept = np.random.default_rng(2).random(len(recording.frames.times)) > 0.3
    return with_frames(recording, np.flatnonzero(kept))


def stamped_roughly(recording: Recording) -> Recording:
    """Each frame's time off by 4 ms."""
    times = recording.frames.times
    off_s = np.random.default_rng(3).normal(0, 0.004, len(times))
    rough = np.maximum.accumulate(times + off_s) + 1e-6 * np.arange(len(times))
    order = np.arange(len(times))
    frames = AlteredFrames(recording.frames, rough, order, recording.frames.size, lambda image, _: image)
    return replace(recording, frames=frames)


def twice_a_second(recording: Recording) -> Recording:
    """Two pictures a second, no IMU: a folder of photographs."""
    times = recording.frames.times
    wanted = np.arange(times[0], times[-1], 0.5)
    return replace(with_frames(recording, np.unique(np.abs(times[:, None] - wanted).argmin(axis=0))), imu=None)


ALTERATIONS: dict[str, Callable[[Recording], Recording]] = {
    "as it is": lambda recording: recording,
    "backward": backward,
    "mirrored": mirrored,
    "turned": turned,
    "backward, mirrored, turned": lambda recording: turned(mirrored(backward(recording))),
    "compressed": compressed,
    "flickering": flickering,
    "shaken": shaken,
    "noisy, flickering, shaken": lambda recording: noisy(flickering(shaken(recording))),
    "cropped": cropped,
    "with frames lost": with_frames_lost,
    "stamped roughly": stamped_roughly,
    "twice a second": twice_a_second,
}


def figures_of(recording: Recording) -> dict[str, Any]:
    found, figures = place(recording)
    row = flat(figures)
    if found is not None and recording.poses is not None:
        T_true = recording.poses.T_map_camera[found.rows]
        errors = position_errors(found.T_map_camera, T_true)
        row |= {f"truth {name}": value for name, value in errors.items()}
        row["scale"] = rounded(scale_between(found.T_map_camera, T_true), 4)
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", nargs="*", default=NAMES, help=", ".join(NAMES))
    parser.add_argument("--span", type=float, nargs=2, default=(0.0, np.inf), help="seconds of the recording")
    parser.add_argument("--only", nargs="+", choices=tuple(ALTERATIONS), default=tuple(ALTERATIONS))
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    found: list[dict[str, Any]] = []
    for name in arguments.recordings:
        camera = KITCHEN_CAMERA if name == "redkitchen" else None
        recording = replace(read_recording(SHARED_DATA / name, camera=camera), waypoints=())
        start_s = float(recording.frames.times[0])
        recording = between(recording, *(start_s + seconds for seconds in arguments.span))
        rows = [
            {"recording": name, "alteration": alteration, **figures_of(ALTERATIONS[alteration](recording))}
            for alteration in arguments.only
        ]
        print_table([{title: row.get(key, "") for key, title in COLUMNS.items()} for row in rows], [*COLUMNS.values()])
        found += rows
    if arguments.json:
        arguments.json.write_text(json.dumps(found, indent=2))


if __name__ == "__main__":
    main()
