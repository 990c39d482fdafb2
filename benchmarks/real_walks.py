"""Real recordings → their trajectories: do they hold on, and do they agree with what was measured beside the pictures?

    python benchmarks/real_walks.py [bedroom_night android_livingroom euroc_v101 redkitchen spoiled] [--json]

For each: the share of keyframes placed, whether the map is trusted and why not, seconds. Where there is an IMU, how far
the cameras' turns over 1, 10 and 60 s are from the gyroscope's, whose offset, constant bias and mounting are fitted to
the walk (seven numbers). ``--halves``: scale and gravity found in each half of the walk alone against the whole's.
``euroc_v101``: errors against its truth after a rigid alignment, which does not mend a wrong scale. ``redkitchen``:
mapped from frames 400–999 without poses, with four frames' positions as measured waypoints, for several choices of
frames and waypoints; frames 200–399 are localized in each map. ``spoiled``: the first 20 s of android_livingroom with
one second blurred or blank, at five places each.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from measuring import (
    SHARED_DATA,
    coverage,
    gyroscope_errors,
    measured,
    position_errors,
    print_figures,
    rigid_errors,
    rounded,
    scale_between,
    spread,
)
from rholoc.errors import RholocError
from rholoc.evaluation import trajectory_errors
from rholoc.geometry import UP, ByteArray, FloatArray, IntArray, angles_between
from rholoc.localization import Dof, Localizer, Query
from rholoc.mapping import BuildOptions, build_map
from rholoc.recordings import FrameSource, Recording, Waypoint, read_recording
from rholoc.recordings.selection import SelectedFrames
from rholoc.reports import report_to_json
from rholoc.trajectory import PoseMethod, Trajectory, estimate_trajectory

KITCHEN_CAMERA = "525.505,525.505,320,240"
KITCHEN_CHOICES = ("1+0", "3+0", "3+1", "4+0", "4+1", "4+3", "5+0", "5+2", "6+0", "6+3", "6+5")
SPOILED_SECONDS = 20.0
SPOILED_AT_S = (2.0, 6.0, 10.0, 14.0, 18.0)
_WAYPOINTS = 4


class Spoil(StrEnum):
    """What befalls the pictures."""

    BLUR = "blurred"  # shaken: 61 pixels along one direction
    BLANK = "blank"  # a white wall


@dataclass(frozen=True, eq=False)
class SpoiledFrames:
    """Another source's frames, of which those within a span of time (seconds) are spoiled."""

    source: FrameSource
    span_s: tuple[float, float]
    spoil: Spoil

    @property
    def times(self) -> FloatArray:
        return self.source.times

    @property
    def timed(self) -> bool:
        return self.source.timed

    @property
    def numbers(self) -> np.ndarray:
        return self.source.numbers

    @property
    def size(self) -> tuple[int, int]:
        return self.source.size

    def images(self, rows: Sequence[int]) -> Iterator[ByteArray]:
        rng = np.random.default_rng(0)
        for row, image in zip(rows, self.source.images(rows), strict=True):
            if not self.span_s[0] <= self.times[row] < self.span_s[1]:
                yield image
            elif self.spoil is Spoil.BLANK:
                yield np.clip(225 + rng.normal(0, 1.5, image.shape), 0, 255).astype(np.uint8)
            else:
                yield cv2.blur(cv2.blur(image, (61, 1)), (1, 15))


def between(recording: Recording, start_s: float, end_s: float) -> Recording:
    """The frames of a span of time; the IMU's table stays whole."""
    times = recording.frames.times
    return with_frames(recording, np.flatnonzero((times >= start_s) & (times < end_s)))


def with_frames(recording: Recording, rows: IntArray) -> Recording:
    """The same walk with some of its frames."""
    poses = recording.poses
    if poses is not None:
        poses = replace(poses, known=poses.known[rows], T_map_camera=poses.T_map_camera[rows])
    return replace(recording, frames=SelectedFrames(recording.frames, rows), poses=poses, frame_intrinsics=None)


def place(recording: Recording) -> tuple[Trajectory | None, dict[str, Any]]:
    """The trajectory of a recording's frames, None where there is none, and its figures."""
    method = PoseMethod.VISUAL if recording.imu is None else PoseMethod.VISUAL_INERTIAL
    times = recording.frames.times
    figures: dict[str, Any] = {"length_s": rounded(times[-1] - times[0], 1)}
    found = None
    with measured() as cost:
        try:
            found = estimate_trajectory(replace(recording, poses=None), method)
        except RholocError as error:
            figures["failed"] = str(error)
    figures |= {"seconds": rounded(cost.seconds, 0), "peak_mb": rounded(cost.peak_mb, 0)}
    if found is None:
        return None, figures
    report = found.report.to_json()
    figures |= {
        "placed": f"{report['frames']}/{report.get('keyframes', '?')}",
        **coverage(times, found.times),
        "trusted": report["trusted"],
        "why": report["why"],
        **{name: report[name] for name in ("missing",) if name in report},
        "gyroscope": gyroscope_errors(found.times, found.T_map_camera[:, :3, :3], recording.imu),
    }
    return found, figures


def walk(path: Path, halves: bool) -> dict[str, Any]:
    """A walk without truth."""
    recording = read_recording(path)
    found, figures = place(recording)
    if found is None or not halves:
        return figures
    times = recording.frames.times
    middle = 0.5 * (times[0] + times[-1])
    for name, span in (("first half", (times[0], middle)), ("second half", (middle, np.inf))):
        half, half_figures = place(between(recording, *span))
        if half is not None:
            half_figures |= against_whole(half, found)
        figures[name] = half_figures
    ratios = [figures[name].get("scale_of_whole") for name in ("first half", "second half")]
    if all(ratios):
        figures["halves_scale_apart_percent"] = rounded(100 * abs(ratios[0] / ratios[1] - 1))
    return figures


def against_whole(half: Trajectory, whole: Trajectory) -> dict[str, Any]:
    """Scale and vertical of a part of a walk mapped alone, against those of the whole."""
    own = np.array([np.interp(whole.times, half.times, axis) for axis in half.T_map_camera[:, :3, 3].T]).T
    nearest = np.clip(np.searchsorted(half.times, whole.times), 0, len(half.times) - 1)
    common = np.flatnonzero(
        (whole.times >= half.times[0])
        & (whole.times <= half.times[-1])
        & (np.abs(half.times[nearest] - whole.times) < 0.5)
    )
    T_half = half.T_map_camera[nearest[common]].copy()
    T_half[:, :3, 3] = own[common]
    T_whole = whole.T_map_camera[common]
    exact = half.times[nearest[common]] == whole.times[common]
    ups = {}
    if exact.sum() >= 3:  # the vertical as each of the two sees it in the same cameras
        up = np.einsum("nij,nj->ni", T_whole[exact, :3, :3], T_half[exact, 2, :3])
        ups["vertical_apart_deg"] = rounded(np.degrees(np.median(angles_between(up, UP))))
    return {"scale_of_whole": rounded(1 / scale_between(T_half, T_whole), 4), **ups}


def euroc(path: Path) -> dict[str, Any]:
    """A cut whose truth is known."""
    recording = read_recording(path)
    found, figures = place(recording)
    if found is None or recording.poses is None:
        return figures
    truth = recording.poses.T_map_camera[found.rows]
    return {
        **figures,
        **rigid_errors(found.T_map_camera, truth),
        "similarity": position_errors(found.T_map_camera, truth),
    }


def kitchen(path: Path, choice: str, every: int) -> dict[str, Any]:
    """One map of frames 400–999 and the errors of frames 200–399 localized in it.

    A choice ``n+k`` is every n-th frame from the k-th on; another choice has other waypoints, spread as a user would.
    """
    step, offset = (int(part) for part in choice.split("+"))
    recording = read_recording(path, camera=KITCHEN_CAMERA, frames=f"{400 + offset}:1000:{step}")
    assert recording.poses is not None
    positions = recording.poses.T_map_camera[:, :3, 3]
    measured_rows = spread_rows(positions, KITCHEN_CHOICES.index(choice))
    waypoints = tuple(
        Waypoint(f"W{i}", float(recording.frames.times[row]), tuple(positions[row].tolist()))
        for i, row in enumerate(measured_rows)
    )
    figures: dict[str, Any] = {}
    with measured() as cost:
        try:
            map_ = build_map([replace(recording, poses=None, waypoints=waypoints)], BuildOptions(report=False))
        except RholocError as error:
            return {"failed": str(error)}
    report = report_to_json(map_.info.report)["trajectories"][0]
    figures |= {"placed": f"{report['frames']}/{report.get('keyframes', '?')}", "trusted": report["trusted"]}
    figures |= {"why": report["why"], "seconds": rounded(cost.seconds, 0)}
    queries = read_recording(path, camera=KITCHEN_CAMERA, frames=f"200:400:{every}")
    assert queries.poses is not None
    assert queries.camera is not None
    localizer = Localizer(map_)
    estimated = np.full((len(queries.frames.times), 4, 4), np.nan)
    for i, image in enumerate(queries.frames.images(range(len(estimated)))):
        answer = localizer.localize(Query(localizer.extractor.extract(image), queries.camera, Dof.FREE))
        if answer.pose is not None and answer.localized:
            estimated[i] = answer.pose.T_map_camera
    errors = trajectory_errors(estimated, queries.poses.T_map_camera)
    return {
        **figures,
        "localized_percent": rounded(100 * errors.localized.mean(), 1),
        "cm": spread(100 * np.minimum(errors.position_m, 10)),
        "deg": spread(np.degrees(np.minimum(errors.rotation_rad, np.pi))),
    }


def spread_rows(positions: FloatArray, seed: int) -> list[int]:
    """Rows of four positions (N, 3): one at random, then each the furthest from those before."""
    rows = [int(np.random.default_rng(seed).integers(len(positions)))]
    while len(rows) < _WAYPOINTS:
        apart = np.linalg.norm(positions[:, None] - positions[rows], axis=2).min(axis=1)
        rows.append(int(apart.argmax()))
    return sorted(rows)


def spoiled(path: Path, spoil: Spoil, at_s: float | None) -> dict[str, Any]:
    """The first seconds of a walk with one of them spoiled, against the gyroscope, which was not."""
    recording = read_recording(path)
    start_s = float(recording.frames.times[0])
    recording = between(recording, start_s, start_s + SPOILED_SECONDS)
    if at_s is not None:
        span_s = (start_s + at_s - 0.5, start_s + at_s + 0.5)
        recording = replace(recording, frames=SpoiledFrames(recording.frames, span_s, spoil))
    return place(recording)[1]


def runs(arguments: argparse.Namespace) -> Iterator[tuple[str, Callable[[], dict[str, Any]]]]:
    data: Path = arguments.data
    for name in arguments.walks:
        match name:
            case "euroc_v101":
                yield name, lambda: euroc(data / "euroc_v101")
            case "redkitchen":
                for choice in arguments.choices:
                    yield f"{name} {choice}", lambda c=choice: kitchen(data / "redkitchen", c, arguments.every)
            case "spoiled":
                yield "spoiled nowhere", lambda: spoiled(data / "android_livingroom", Spoil.BLANK, None)
                for spoil in Spoil:
                    for at_s in SPOILED_AT_S:
                        yield (
                            f"{spoil} at {at_s:.0f} s",
                            lambda s=spoil, t=at_s: spoiled(data / "android_livingroom", s, t),
                        )
            case _:
                yield name, lambda n=name: walk(data / n, arguments.halves)


def main() -> None:
    names = ("bedroom_night", "android_livingroom", "euroc_v101", "redkitchen", "spoiled")
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("walks", nargs="*", default=names, help=", ".join(names) + ", or another folder of the data")
    parser.add_argument("--data", type=Path, default=SHARED_DATA)
    parser.add_argument("--halves", action="store_true", help="map each half of a walk alone, too")
    parser.add_argument("--choices", nargs="+", default=KITCHEN_CHOICES, help="of the kitchen's frames")
    parser.add_argument("--every", type=int, default=2, help="how many of the kitchen's queries are asked: each n-th")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    found = {}
    for title, run in runs(arguments):
        found[title] = run()
        if not arguments.json:
            print_figures(title, found[title])
    if arguments.json:
        print(json.dumps(found, indent=2))


if __name__ == "__main__":
    main()
