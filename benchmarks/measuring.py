"""What benchmarks measure alike: poses against a gyroscope or the truth, time, memory; and how they print it."""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation, Slerp

from rholoc.geometry import ByteArray, FloatArray, aligning_rotation, umeyama
from rholoc.recordings import Imu

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
INTERVALS_S = (1.0, 10.0, 60.0)
_FIT_INTERVAL_S = 1.0
_OFFSETS_S = np.arange(-0.25, 0.2501, 0.01)
_FEWEST_PAIRS = 8
_FIT_SCALES = np.array([0.05] * 3 + [0.01] * 3 + [0.02])  # rad, rad/s, s
_FIT_SCALE_RAD = np.radians(0.2)  # errors beyond count less and less in the fit
START_SECONDS = 60  # by which a service answers
_REACH = 0.15  # of an interval: how far the distance of two frames in time may be from it


# -- rotations -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Gyroscope:
    """A gyroscope fitted to a camera's rotations: seven numbers for a whole walk.

    Attributes:
        imu: its readings.
        offset_s: to be added to a frame's time to get the IMU's.
        bias: (3,) rad/s, constant over the walk.
        R_camera_imu: (3, 3).
    """

    imu: Imu
    offset_s: float
    bias: FloatArray
    R_camera_imu: FloatArray

    def rotations(self, times: FloatArray) -> Rotation:
        """R_start_camera at frame times (N,), by the gyroscope alone."""
        mounting = Rotation.from_matrix(self.R_camera_imu)
        there = np.clip(times + self.offset_s, self.imu.times[0], self.imu.times[-1])
        return Slerp(self.imu.times, orientations(self.imu, self.bias))(there) * mounting.inv()


def orientations(imu: Imu, bias: FloatArray) -> Rotation:
    """R_start_imu at every IMU time, by the midpoint rule; products of all prefixes, in log₂ N rounds."""
    rate = imu.angular_velocity - bias
    steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(imu.times)[:, None]
    R = Rotation.from_rotvec(np.concatenate([np.zeros((1, 3)), steps]))
    reach = 1
    while reach < len(R):
        R = Rotation.concatenate([R[:reach], R[:-reach] * R[reach:]])
        reach *= 2
    return R


def fit_gyroscope(times: FloatArray, R_map_camera: FloatArray, imu: Imu) -> Gyroscope | None:
    """Offset, constant bias and mounting that explain the camera's rotations (N, 3, 3) over a second best.

    Robust, so that frames whose poses are wrong do not bend it; a mounting that the recording states is where it
    starts. None where too few frames share the IMU's time.
    """
    first, second = pairs_apart(times, _FIT_INTERVAL_S)
    inside = (times[first] > imu.times[0] + 0.3) & (times[second] < imu.times[-1] - 0.3)
    first, second = first[inside], second[inside]
    if len(first) < _FEWEST_PAIRS:
        return None
    R = Rotation.from_matrix(R_map_camera)
    camera = R[first].inv() * R[second]
    near = (imu.times > times[0] - 1) & (imu.times < times[-1] + 1)
    rate = imu.angular_velocity[near]
    imu = replace(imu, times=imu.times[near], acceleration=imu.acceleration[near], angular_velocity=rate)

    @lru_cache(maxsize=4)
    def integrated(*bias: float) -> Slerp:
        return Slerp(imu.times, orientations(imu, np.array(bias)))

    def turned(offset_s: float, bias: FloatArray) -> Rotation:
        slerp = integrated(*bias.tolist())
        return slerp(times[first] + offset_s).inv() * slerp(times[second] + offset_s)

    bias = np.zeros(3)
    for _ in range(2):  # the second time with the bias that the first found
        starts = []
        for offset_s in _OFFSETS_S:
            gyro = turned(offset_s, bias).as_rotvec()
            mounting = imu.R_camera_imu if imu.R_camera_imu is not None else aligning_rotation(gyro, camera.as_rotvec())
            remaining = gyro - camera.as_rotvec() @ mounting
            drift = np.median(remaining, axis=0)
            error = np.linalg.norm(remaining - drift, axis=1)
            starts.append((float(np.minimum(error, np.radians(5)).mean()), float(offset_s), drift, mounting))
        _, offset_s, drift, mounting = min(starts, key=lambda start: start[0])
        bias = bias + drift / _FIT_INTERVAL_S
    start = Rotation.from_matrix(mounting)

    def residuals(x: FloatArray) -> FloatArray:
        M = Rotation.from_rotvec(x[:3]) * start
        gyro = turned(offset_s + x[6], bias + x[3:6])
        return np.asarray((camera.inv() * (M * gyro * M.inv())).as_rotvec().ravel())

    x = least_squares(residuals, np.zeros(7), x_scale=_FIT_SCALES, loss="soft_l1", f_scale=_FIT_SCALE_RAD).x
    return Gyroscope(imu, offset_s + float(x[6]), bias + x[3:6], (Rotation.from_rotvec(x[:3]) * start).as_matrix())


def rotation_errors(times: FloatArray, R_map_camera: FloatArray, reference: Rotation) -> dict[str, Any]:
    """How far the turns of N cameras over 1, 10 and 60 s are from a reference's: degrees, by interval.

    Between frames about so far apart in time, one pair a frame; an interval that the walk does not have is left out.
    """
    R = Rotation.from_matrix(R_map_camera)
    found: dict[str, Any] = {}
    for interval_s in INTERVALS_S:
        a, b = pairs_apart(times, interval_s)
        if len(a) == 0:
            continue
        apart = ((R[a].inv() * R[b]).inv() * (reference[a].inv() * reference[b])).magnitude()
        found[f"{interval_s:.0f}s"] = spread(np.degrees(apart))
    return found


def gyroscope_errors(times: FloatArray, R_map_camera: FloatArray, imu: Imu | None) -> dict[str, Any]:
    """:func:`rotation_errors` against the gyroscope, with what was fitted of it; empty without one."""
    gyro = None if imu is None else fit_gyroscope(times, R_map_camera, imu)
    if gyro is None:
        return {}
    inside = (times + gyro.offset_s >= gyro.imu.times[0]) & (times + gyro.offset_s <= gyro.imu.times[-1])
    return {
        "offset_ms": round(1e3 * gyro.offset_s, 1),
        "bias_deg_s": np.degrees(gyro.bias).round(3).tolist(),
        **rotation_errors(times[inside], R_map_camera[inside], gyro.rotations(times[inside])),
    }


def pairs_apart(times: FloatArray, interval_s: float) -> tuple[np.ndarray, np.ndarray]:
    """For each frame the one nearest to ``interval_s`` later, where there is one about there."""
    rows = np.arange(len(times))
    wanted = times + interval_s
    after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    nearest = np.where(wanted - times[after - 1] < times[after] - wanted, after - 1, after)
    good = (np.abs(times[nearest] - wanted) <= _REACH * interval_s) & (nearest > rows)
    return rows[good], nearest[good]


# -- positions -------------------------------------------------------------------------------------------------------


def position_errors(T_map_camera: FloatArray, truth: FloatArray) -> dict[str, Any]:
    """Errors (N, 4, 4) after a similarity alignment of the camera centres, and the scale that it took."""
    similarity = umeyama(T_map_camera[:, :3, 3], truth[:, :3, 3])
    off_cm = 100 * np.linalg.norm(similarity.points(T_map_camera[:, :3, 3]) - truth[:, :3, 3], axis=1)
    return {"rms_cm": rounded(np.sqrt(np.mean(off_cm**2))), **{f"{k}_cm": v for k, v in spread(off_cm).items()}}


# -- time and memory -------------------------------------------------------------------------------------------------


@dataclass
class Cost:
    """What a piece of work took: wall clock seconds, and the largest resident size of this process and its children."""

    seconds: float = 0.0
    peak_mb: float = 0.0


@contextmanager
def measured() -> Iterator[Cost]:
    """Measure a ``with`` block; memory is sampled five times a second."""
    cost, done = Cost(), threading.Event()

    def watch() -> None:
        while not done.wait(0.2):
            cost.peak_mb = max(cost.peak_mb, resident_mb())

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    began = time.monotonic()
    try:
        yield cost
    finally:
        cost.seconds = time.monotonic() - began
        done.set()
        watcher.join()
        cost.peak_mb = max(cost.peak_mb, resident_mb())


def free_port() -> int:
    """A local port that is free now."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return int(listener.getsockname()[1])


def resident_mb() -> float:
    """The resident size of this process and of all below it, shared pages counted in each."""
    parents, sizes = {}, {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                parents[int(entry.name)] = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
                sizes[int(entry.name)] = int((entry / "statm").read_text().split()[1])
            except (OSError, ValueError, IndexError):
                continue
    family, grown = {os.getpid()}, True
    while grown:
        grown = False
        for pid, parent in parents.items():
            if parent in family and pid not in family:
                family.add(pid)
                grown = True
    return sum(sizes.get(pid, 0) for pid in family) * os.sysconf("SC_PAGE_SIZE") / 1e6


# -- printing --------------------------------------------------------------------------------------------------------


def spread(values: FloatArray) -> dict[str, Any]:
    """Median, 95 % and worst of values."""
    return {
        "median": rounded(np.median(values)),
        "p95": rounded(np.quantile(values, 0.95)),
        "worst": rounded(np.max(values)),
    }


def rounded(value: float, digits: int = 2) -> float:
    return round(float(value), digits)


def flat(figures: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested dictionaries as one, names joined by spaces."""
    found: dict[str, Any] = {}
    for name, value in figures.items():
        if isinstance(value, dict):
            found |= flat(value, f"{prefix}{name} ")
        else:
            found[prefix + name] = value
    return found


def jpeg_of(image: ByteArray, quality: int = 92) -> bytes:
    """An image (H, W) or (H, W, 3) as a camera would send it."""
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def print_table(rows: Sequence[dict[str, Any]], columns: Sequence[str]) -> None:
    """Rows under their columns' names; what a row lacks is a dash."""
    cells = [[str(row.get(column, "–")) for column in columns] for row in rows]
    widths = [max(len(column), *(len(row[i]) for row in cells)) for i, column in enumerate(columns)]
    for line in [list(columns), *cells]:
        print("  ".join(text.ljust(width) for text, width in zip(line, widths, strict=True)).rstrip(), flush=True)
