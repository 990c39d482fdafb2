"""Fit and check the confidence of answers (rholoc.localization.confidence) on recordings.

    python benchmarks/calibrate_confidence.py MAP.rho... FRAMES --camera fx,fy,cx,cy --frames 100:400 --every 3 \
        --other VIDEO_OR_FOLDER --other VIDEO_OR_FOLDER --plot reliability.png

Queries are the frames, whole and with only some of their features (frames that are easy say nothing about doubt), and
frames of other rooms, which are all wrong. Every other frame is for fitting, the rest for checking. Prints the weights
that fit best and, for the weights in use, a reliability table and the share of other rooms' frames that are refused.
Several maps of the same frames share their weights, as all kinds of features with one metric do.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import minimize

from rholoc.features import FeatureSet, Metric
from rholoc.geometry import Camera, FloatArray, pose_distances
from rholoc.localization import Dof, Localizer, Query
from rholoc.localization import localizer as localizer_module
from rholoc.localization.confidence import confidence_inputs, confidence_of
from rholoc.localization.verification import Verified
from rholoc.maps import load_map
from rholoc.recordings import read_recording

SHARES = (1.0, 0.4, 0.2, 0.1, 0.05, 0.03)  # of a frame's features that are kept
RIGHT_M, RIGHT_RAD = 0.10, np.deg2rad(5.0)
OTHER_ROOM_FRAMES = 60
RIDGE = 0.01
THRESHOLDS = (0.3, 0.5, 0.7, 0.8, 0.9)


@dataclass(frozen=True)
class Case:
    """One answer: what the confidence weighs, what it says, and whether the pose is right."""

    inputs: FloatArray
    confidence: float
    right: bool
    whole: bool
    other_room: bool
    fitted: bool


def answers(localizer: Localizer, query: Query) -> Verified | None:
    """The candidate that the localizer settles on, however doubtful."""
    settled: list[Verified] = []

    def note(verified: Verified, metric: Metric) -> float:
        confidence = confidence_of(verified, metric)
        if not settled or confidence > confidence_of(settled[0], metric):
            settled[:] = [verified]
        return confidence

    with mock.patch.object(localizer_module, "confidence_of", note):
        localizer.localize(query)
    return settled[0] if settled else None


def thinned(features: FeatureSet, rng: np.random.Generator) -> Iterator[tuple[float, FeatureSet]]:
    """The features, whole and thinned out."""
    for share in SHARES:
        yield share, features.take(np.sort(rng.choice(len(features), int(len(features) * share), replace=False)))


def own_cases(localizer: Localizer, args: argparse.Namespace) -> Iterator[Case]:
    """Frames of the map's room, with known poses."""
    recording = read_recording(args.recording, camera=args.camera, frames=args.frames)
    assert recording.poses is not None
    assert recording.camera is not None
    metric, rng = localizer.index.metric, np.random.default_rng(0)
    rows = np.flatnonzero(recording.poses.known)[:: args.every]
    for number, (row, image) in enumerate(zip(rows, recording.frames.images(rows.tolist()), strict=True)):
        for share, features in thinned(localizer.extractor.extract(image), rng):
            found = answers(localizer, Query(features, recording.camera, Dof.FREE))
            if found is None:
                continue
            apart, turned = pose_distances(found.optimum.T_map_camera, recording.poses.T_map_camera[row])
            right = apart < RIGHT_M and turned < RIGHT_RAD
            yield Case(
                confidence_inputs(found), confidence_of(found, metric), right, share == 1, False, number % 2 == 0
            )


def other_cases(localizer: Localizer, path: Path) -> Iterator[Case]:
    """Frames of another room: whatever is found is wrong."""
    recording = read_recording(path)
    width, height = recording.frames.size
    camera = Camera(width, height, 0.8 * width, 0.8 * width, (width - 1) / 2, (height - 1) / 2)
    metric = localizer.index.metric
    step = max(1, len(recording.frames.times) // OTHER_ROOM_FRAMES)
    rows = list(range(0, len(recording.frames.times), step))
    for number, image in enumerate(recording.frames.images(rows)):
        found = answers(localizer, Query(localizer.extractor.extract(image), camera, Dof.FREE))
        inputs = np.zeros(3) if found is None else confidence_inputs(found)
        yield Case(inputs, confidence_of(found, metric) if found else 0.0, False, True, True, number % 2 == 0)


def all_cases(localizer: Localizer, args: argparse.Namespace) -> Iterator[Case]:
    """Frames of the map's room and of the others."""
    yield from own_cases(localizer, args)
    for path in args.other:
        yield from other_cases(localizer, path)


def fit(cases: list[Case]) -> FloatArray:
    """The logistic's intercept and weights (4,), by likelihood with a little ridge."""
    X = np.array([[1.0, *case.inputs] for case in cases])
    sign = np.where([case.right for case in cases], 1.0, -1.0)
    return np.asarray(minimize(lambda w: np.logaddexp(0, -sign * (X @ w)).sum() + RIDGE * (w @ w), np.zeros(4)).x)


def reliability(cases: list[Case]) -> list[tuple[str, int, float, float]]:
    """For each tenth of confidence: its name, how many answers, the mean confidence and the share that is right."""
    confidence = np.array([case.confidence for case in cases])
    right = np.array([case.right for case in cases])
    rows = []
    for low in np.arange(10) / 10:
        inside = (confidence >= low) & ((confidence < low + 0.1) | (low > 0.85))
        if inside.any():
            name = f"{low:.1f}–{low + 0.1:.1f}"
            rows.append((name, int(inside.sum()), float(confidence[inside].mean()), float(right[inside].mean())))
    return rows


def plot(rows: list[tuple[str, int, float, float]], path: Path) -> None:
    """The reliability diagram."""
    figure = Figure(figsize=(5, 5), layout="constrained")
    axes = figure.add_subplot()
    axes.plot([0, 1], [0, 1], color="0.7", label="perfect")
    said, was, count = [r[2] for r in rows], [r[3] for r in rows], [r[1] for r in rows]
    axes.scatter(said, was, s=[20 + 2 * c**0.5 * 5 for c in count], color="tab:blue", label="measured")
    for x, y, n in zip(said, was, count, strict=True):
        axes.annotate(f"{n}", (x, y), xytext=(6, -10), textcoords="offset points", fontsize=8)
    axes.set(xlabel="confidence", ylabel="share within 10 cm and 5°", xlim=(0, 1), ylim=(0, 1.02), aspect="equal")
    axes.set_title("Reliability on frames not fitted to")
    axes.legend(loc="upper left")
    figure.savefig(path, dpi=120)


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("map", type=Path, nargs="+")
    parser.add_argument("recording", type=Path)
    parser.add_argument("--camera")
    parser.add_argument("--frames")
    parser.add_argument("--every", type=int, default=2)
    parser.add_argument("--other", type=Path, action="append", default=[])
    parser.add_argument("--plot", type=Path)
    args = parser.parse_args()
    cases = [case for path in args.map for case in all_cases(Localizer(load_map(path), min_confidence=0.0), args)]
    print("intercept and weights that fit best:", np.round(fit([case for case in cases if case.fitted]), 2))
    print("confidence  answers  said  right")
    rows = reliability([case for case in cases if not case.fitted])
    for name, count, said, was in rows:
        print(f"{name:10}  {count:7}  {said:.2f}  {was:.2f}")
    print("threshold  other rooms refused  good answers kept")
    other = np.array([case.confidence for case in cases if case.other_room])
    good = np.array([case.confidence for case in cases if case.whole and case.right])
    for threshold in THRESHOLDS:
        refused = f"{(other < threshold).mean():.3f}" if len(other) else "–"
        print(f"{threshold:9}  {refused:>19}  {(good >= threshold).mean():17.3f}")
    if args.plot:
        plot(rows, args.plot)


if __name__ == "__main__":
    main()
