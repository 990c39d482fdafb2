"""Recordings played as robots: the logic of the ROS 2 node against a real server.

    python benchmarks/robots.py [--write] [--cache FOLDER]

A robot's camera shows another room for three seconds, then a room with a map; its odometry drifts by 2 % of the way and
half a degree a metre, differently for each of ten seeds. Answers come 0.2 s after the question. What is measured: the
error of every pose that the node gives out, the time from the first picture that the service recognizes by itself to
the first pose, poses while the other room is shown, and how fast `map→odom` moves the robot, as a share of the bound.
The answers of every run are replayed through `MapSession` of `client/js`, whose poses are compared with the tracker's.
The living room's truth is the reconstruction of its whole walk: every second keyframe makes its map, errors are taken
at the others.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import load
import rooms
from figures import ROOT, Figure, Figures, length_cm, run
from measuring import jpeg_of
from rholoc.features import DEFAULT_FEATURES
from rholoc.geometry import FloatArray
from rholoc.maps import map_to_bytes
from rholoc.tracking.moments import film_times
from rholoc_client import Camera, Client
from rholoc_client.models import Localization
from rholoc_client.tracking import Tracker
from rholoc_lab.evaluation.tracking import drifting_odometry

sys.path.insert(0, str(ROOT / "ros"))
from rholoc_ros.robot import Estimate, Picture, Robot
from rholoc_ros.settings import Settings

SEEDS = range(10)
DRIFT, ELSEWHERE_S = 0.02, 3.0
ANSWER_S = 0.2
NEAR_M = 0.05
AXES = Rotation.from_matrix(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])).as_matrix()
T_BASE_CAMERA: FloatArray = np.array([[*AXES[0], 0.2], [*AXES[1], 0.05], [*AXES[2], 0.4], [0, 0, 0, 1]])
REPLAY = """
import { readFile } from "node:fs/promises";
const [, , module, file] = process.argv;
const { Axes, MapSession } = await import(module);
const found = [];
for (const { frames } of JSON.parse(await readFile(file))) {
  let [nowMs, answer] = [0, null];
  const session = new MapSession(async () => answer, { axes: Axes.OPENCV, intervalMs: 0, now: () => nowMs });
  found.push([]);
  for (const frame of frames) {
    nowMs = 1000 * frame.time_s;
    answer = frame.answer;
    if (answer) await session.offer({ pose: frame.pose, picture: null, camera: {} });
    found.at(-1).push(session.inMap(frame.pose));
  }
}
console.log(JSON.stringify(found));
"""


@dataclass(frozen=True, eq=False)
class Drive:
    """What a robot sees.

    Attributes:
        times: (N,) of the pictures, seconds from the start.
        pictures: their JPEG files.
        poses: (N, 4, 4) T_map_camera; of the other room in a frame of its own.
        known: (N,) whether a pose is the truth, rather than interpolated.
        inside: (N,) whether the picture shows the room with the map.
        camera: of all pictures.
    """

    times: FloatArray
    pictures: list[bytes]
    poses: FloatArray
    known: np.ndarray
    inside: np.ndarray
    camera: Camera


@dataclass
class Run:
    """What became of a drive.

    Attributes:
        T_odom_camera: (N, 4, 4) by odometry.
        estimates: poses of the base, by frame.
        answers: of the service, by frame.
        broadcasts: time, T_map_odom or None, T_odom_base.
        node_s: processor time of the node's logic for each picture, without the service's.
    """

    T_odom_camera: FloatArray
    estimates: dict[int, Estimate] = field(default_factory=dict)
    answers: dict[int, Localization] = field(default_factory=dict)
    broadcasts: list[tuple[float, FloatArray | None, FloatArray]] = field(default_factory=list)
    node_s: list[float] = field(default_factory=list)


class Noting(Client):
    """A client that notes the answers to a drive's pictures, by row."""

    def __init__(self, url: str, drive: Drive) -> None:
        super().__init__(url, timeout_s=60)
        self.answers: dict[int, Localization] = {}
        self._rows = {picture: row for row, picture in enumerate(drive.pictures)}

    def localize(self, maps: Any, image: Any, **options: Any) -> Localization:
        answer = super().localize(maps, image, **options)
        self.answers[self._rows[image]] = answer
        return answer


def played(named: rooms.NamedRoom, other: rooms.NamedRoom, cache: Path) -> Figures:
    """Figures of a room; the other room is shown first."""
    room, elsewhere = named.make(cache), other.make(cache)
    drive = _drive(room, elsewhere)
    map_ = rooms.map_of(named, room.mapped, DEFAULT_FEATURES, cache)
    with tempfile.TemporaryDirectory() as folder:
        server = load.start(Path(folder), None, 2, 2)
        try:
            load.wait_until_ready(server)
            with Client(server.url, timeout_s=60) as client:
                client.upload_map("room", map_to_bytes(map_))
                recognizable_s = _recognizable_s(client, drive)
            runs = [_drive_through(server.url, drive, seed) for seed in SEEDS]
        finally:
            server.process.terminate()
            server.process.wait(30)
    return {f"robots.{named.name}.{name}": one for name, one in _figures(drive, runs, recognizable_s).items()}


def _drive(room: rooms.Room, elsewhere: rooms.Room) -> Drive:
    camera, poses = room.asked.camera, room.asked.poses
    assert camera is not None
    assert poses is not None
    assert elsewhere.asked.poses is not None
    own_s, strange_s = (film_times(one) - film_times(one)[0] for one in (room.asked, elsewhere.asked))
    strange = np.flatnonzero(strange_s < ELSEWHERE_S)
    images = (*elsewhere.asked.frames.images(strange.tolist()), *room.asked.frames.images(range(len(own_s))))
    inside = np.arange(len(images)) >= len(strange)
    return Drive(
        np.concatenate([strange_s[strange], ELSEWHERE_S + own_s]),
        [jpeg_of(np.asarray(image)) for image in images],
        np.concatenate([elsewhere.asked.poses.T_map_camera[strange], poses.T_map_camera]),
        np.concatenate([np.zeros(len(strange), dtype=bool), poses.known]),
        inside,
        Camera(camera.fx, camera.fy, camera.cx, camera.cy, camera.distortion, camera.width, camera.height),
    )


def _recognizable_s(client: Client, drive: Drive) -> float:
    """When the first picture is taken that the service localizes without knowing any other."""
    for row in np.flatnonzero(drive.inside):
        if client.localize("room", drive.pictures[row], camera=drive.camera).localized:
            return float(drive.times[row])
    raise SystemExit("No picture of the room is recognized.")


def _drive_through(url: str, drive: Drive, seed: int) -> Run:
    # In the other room odometry moves as the camera did there; where the room changes it does not move.
    parts = [drifting_odometry(drive.poses[rows], DRIFT, seed) for rows in (~drive.inside, drive.inside)]
    run = Run(np.concatenate([parts[0], parts[0][-1] @ parts[1]]))
    T_odom_base = run.T_odom_camera @ np.linalg.inv(T_BASE_CAMERA)
    settings = Settings(url=url, map_name="room", odometry="topic", publish_map_to_odom_tf=True)
    clock = _Clock()
    with closing(Noting(url, drive)) as client:

        def tracker(camera: Camera | None) -> Tracker:
            made = Tracker(client, settings.map_name, camera, settings.track_options)
            made.close()
            made._thread = _Late(clock)  # type: ignore[assignment]
            return made

        robot = Robot(settings, _Mounting(), tracker)
        robot.camera(drive.camera)
        rows = {round(1e9 * time_s): row for row, time_s in enumerate(drive.times)}
        for stamp_ns, row in rows.items():
            clock.now_s, clock.away_s, begun_s = float(drive.times[row]), 0.0, time.thread_time()
            robot.odometry(stamp_ns, T_odom_base[row])
            robot.picture(Picture(stamp_ns, "camera", drive.pictures[row], clock.now_s))
            run.estimates |= {rows[one.stamp_ns]: one for one in robot.poll(clock.now_s)}
            run.broadcasts.append((clock.now_s, robot.map_to_odom(clock.now_s), T_odom_base[row]))
            run.node_s.append(time.thread_time() - begun_s - clock.away_s)
        run.answers = client.answers
    return run


class _Clock:
    """The time of the drive, which does not depend on how fast this machine is; and processor time of questions."""

    now_s, away_s = 0.0, 0.0


class _Late:
    """Takes the place of the tracker's thread: answers come ``ANSWER_S`` after the question, however long they take."""

    def __init__(self, clock: _Clock) -> None:
        self._clock = clock

    def submit(self, call: Callable[[], Localization]) -> _LateAnswer:
        begun_s = time.thread_time()
        answer = call()
        self._clock.away_s += time.thread_time() - begun_s
        return _LateAnswer(self._clock, self._clock.now_s + ANSWER_S, answer)

    def shutdown(self, cancel_futures: bool = False) -> None:
        """Nothing runs."""


@dataclass(frozen=True, eq=False)
class _LateAnswer:
    clock: _Clock
    due_s: float
    answer: Localization

    def done(self) -> bool:
        return self.clock.now_s >= self.due_s

    def exception(self) -> None:
        return None

    def result(self) -> Localization:
        return self.answer


class _Mounting:
    """The tree of transforms of a robot that has a camera and nothing else."""

    def lookup(self, target: str, source: str, stamp_ns: int) -> FloatArray | None:
        known = {("base_link", "camera"): T_BASE_CAMERA, ("camera", "base_link"): np.linalg.inv(T_BASE_CAMERA)}
        return known.get((target, source))


def _figures(drive: Drive, runs: list[Run], recognizable_s: float) -> Figures:
    off_m = np.concatenate([_errors(drive, one) for one in runs])
    first_s = [min(drive.times[row] for row in one.estimates if drive.inside[row]) for one in runs]
    elsewhere = sum(not drive.inside[row] for one in runs for row in one.estimates)
    apart_m = _js_apart(drive, runs)
    frames = drive.inside & (drive.times > max(first_s))
    return {
        "runs": Figure(len(runs), 0, True),
        "poses": Figure(len(off_m), 100, True),
        "with_pose_percent": Figure(
            round(100 * float(np.mean([row in one.estimates for one in runs for row in np.flatnonzero(frames)])), 1),
            1,
            True,
        ),
        "within_5cm_percent": Figure(round(100 * float(np.mean(off_m <= NEAR_M)), 2), 0.2, True),
        "median_cm": length_cm(100 * float(np.median(off_m))),
        "worst_cm": length_cm(100 * float(np.max(off_m)), 0.5),
        "first_pose_s": Figure(round(max(first_s) - recognizable_s, 2), 0.3, False),
        "poses_elsewhere": Figure(elsewhere, 0, False),
        "speed_of_bound_percent": Figure(round(100 * max(_speed(one) for one in runs), 1), 0.5, False),
        "node_ms": Figure(
            round(1e3 * float(np.quantile(np.concatenate([one.node_s for one in runs]), 0.95)), 1), 2.0, False
        ),
        "js_median_cm": length_cm(100 * float(np.median(apart_m))),
        "js_p95_cm": length_cm(100 * float(np.quantile(apart_m, 0.95)), 0.3),
        "js_worst_cm": length_cm(100 * float(np.max(apart_m)), 0.5),
    }


def _errors(drive: Drive, one: Run) -> FloatArray:
    """Distance of each pose of the camera in the room from the truth [m]."""
    found = [
        np.linalg.norm((estimate.T_map_base @ T_BASE_CAMERA)[:3, 3] - drive.poses[row, :3, 3])
        for row, estimate in one.estimates.items()
        if drive.inside[row] and drive.known[row]
    ]
    return np.array(found)


def _speed(one: Run) -> float:
    """Greatest rate at which successive broadcasts moved or turned the robot, as a share of the bound."""
    limits = Settings(map_name="room").limits
    worst = 0.0
    for (before_s, before, _), (now_s, now, T_odom_base) in zip(one.broadcasts, one.broadcasts[1:], strict=False):
        if before is None or now is None:
            continue
        moved, reference = now @ T_odom_base, before @ T_odom_base
        turned = Rotation.from_matrix(moved[:3, :3] @ reference[:3, :3].T).magnitude()
        worst = max(
            worst,
            float(np.linalg.norm(moved[:3, 3] - reference[:3, 3])) / (now_s - before_s) / limits.speed_m_s,
            math.degrees(turned) / (now_s - before_s) / limits.turn_deg_s,
        )
    return worst


def _js_apart(drive: Drive, runs: list[Run]) -> FloatArray:
    """How far apart `MapSession` and the tracker have the camera [m], at frames where both have it."""
    sent = []
    for one in runs:
        frames = [
            {"time_s": time_s, "pose": T.tolist(), "answer": _as_json(one.answers.get(row))}
            for row, (time_s, T) in enumerate(zip(drive.times.tolist(), one.T_odom_camera, strict=True))
        ]
        sent.append({"frames": frames})
    with tempfile.TemporaryDirectory() as name:
        program, file = Path(name) / "replay.mjs", Path(name) / "runs.json"
        program.write_text(REPLAY)
        file.write_text(json.dumps(sent))
        module = ROOT / "client" / "js" / "index.js"
        command = ["node", str(program), module.as_uri(), str(file)]
        said = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    apart = []
    for one, placed in zip(runs, said, strict=True):
        for row, estimate in one.estimates.items():
            if placed[row] is not None and drive.inside[row]:
                T = estimate.T_map_base @ T_BASE_CAMERA
                apart.append(np.linalg.norm(np.array(placed[row])[:3, 3] - T[:3, 3]))
    return np.array(apart)


def _as_json(answer: Localization | None) -> dict[str, Any] | None:
    if answer is None or answer.pose is None:
        return None
    return {
        "localized": answer.localized,
        "recognized": answer.recognized,
        "covariance": answer.covariance,
        "pose": {"T_map_camera": answer.pose.T_map_camera},
    }


def robots(cache: Path) -> Figures:
    """Both rooms; the other one is shown first."""
    kitchen, livingroom = rooms.PLAYED
    return played(kitchen, livingroom, cache) | played(livingroom, kitchen, cache)


if __name__ == "__main__":
    run(__doc__, {"robots": robots}, SEEDS)
