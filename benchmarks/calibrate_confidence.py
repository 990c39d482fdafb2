"""Fit and check the confidence of answers (rholoc.localization.confidence) on recordings.

    python benchmarks/calibrate_confidence.py MAP.rho... FRAMES --camera fx,fy,cx,cy --frames 100:400 --every 3 \
        --features sift48 --halves WALK --building 30 --cache FOLDER \
        --other VIDEO_OR_FOLDER --other VIDEO_OR_FOLDER --plot reliability.png

Queries are the frames, whole and with an eighth of their features (frames that are easy say nothing about doubt);
frames of other rooms, which are all wrong; and windows of a frame, over a tenth and a fifth of its area, in a
picture of another room: a thing that looks alike, of less weight. ``--halves`` and ``--building`` add the walks of
benchmarks/features_table.py. Each map in turn is held back: weights are fitted to the others' queries and checked on
its own. Prints the weights that fit all best, and of the held-back queries a reliability table, the share of other
rooms' frames that are refused, of good answers that are kept, and of windows that are answered.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum, auto
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import minimize

from features_table import building, halves, map_of
from rholoc.features import Extractor, FeatureSet
from rholoc.geometry import Camera, FloatArray, pose_distances
from rholoc.localization import Localizer, Query
from rholoc.localization.confidence import confidence_inputs, confidence_of
from rholoc.maps import Map, load_map
from rholoc.recordings import Recording, read_recording

SHARES = (1.0, 1 / 8)  # of a frame's features that are kept
WINDOWS = (0.1, 0.2)  # of a frame's area
RIGHT_M, RIGHT_RAD = 0.10, np.deg2rad(5.0)
NEARLY_M = 0.3  # answers between the two count little: where they lie is chance
WINDOW_WEIGHT, NEARLY_WEIGHT = 0.3, 0.3
OTHER_ROOM_FRAMES = 30
RIDGE = 0.01
THRESHOLDS = (0.3, 0.5, 0.6, 0.7, 0.8, 0.9)


class Kind(Enum):
    """What was asked."""

    WHOLE = auto()
    THINNED = auto()  # with some of its features only
    OTHER_ROOM = auto()
    WINDOW = auto()  # in a picture of another room


@dataclass(frozen=True)
class Case:
    """One answer: of which map, what the logistic weighs, how sure the pose is against rivals, and how far off."""

    fold: str
    kind: Kind
    inputs: FloatArray | None
    factor: float
    off_m: float
    right: bool

    @property
    def weight(self) -> float:
        """How much it counts in the fit."""
        if self.kind is Kind.WINDOW:
            return WINDOW_WEIGHT
        return NEARLY_WEIGHT if not self.right and self.off_m < NEARLY_M else 1.0


def case(fold: str, kind: Kind, localizer: Localizer, query: Query, truth: FloatArray | None) -> Case:
    """Ask one query, however doubtful the answer."""
    found = localizer.candidate(query)
    if found is None:
        return Case(fold, kind, None, 0.0, np.inf, False)
    verified, contested = found
    inputs = confidence_inputs((verified,), verified.covariance)
    alone = confidence_of(verified, localizer.index.metric)
    factor = contested / alone if alone > 0 else 0.0
    if truth is None:
        return Case(fold, kind, inputs, factor, np.inf, False)
    apart, turned = pose_distances(verified.optimum.T_map_camera, truth)
    right = apart < RIGHT_M and turned < RIGHT_RAD and kind is not Kind.WINDOW
    return Case(fold, kind, inputs, factor, apart, right)


def own_cases(
    fold: str, localizer: Localizer, asked: Recording, every: int, strangers: list[FeatureSet]
) -> Iterator[Case]:
    """Frames of the map's room, with known poses."""
    assert asked.poses is not None
    assert asked.camera is not None
    rng, camera = np.random.default_rng(0), asked.camera
    rows = np.flatnonzero(asked.poses.known)[::every]
    for row, image in zip(rows, asked.frames.images(rows.tolist()), strict=True):
        features, truth = localizer.extractor.extract(image), asked.poses.T_map_camera[row]
        for share in SHARES:
            some = features.take(np.sort(rng.choice(len(features), int(len(features) * share), replace=False)))
            kind = Kind.WHOLE if share == 1 else Kind.THINNED
            yield case(fold, kind, localizer, Query(some, camera), truth)
        for share in WINDOWS if strangers else ():
            size = np.sqrt(share) * np.array([camera.width, camera.height])
            low = rng.uniform(0, 1, 2) * ((camera.width, camera.height) - size)
            strange = strangers[rng.integers(len(strangers))]
            mixed = FeatureSet.concatenate([_within(features, low, size, True), _within(strange, low, size, False)])
            yield case(fold, Kind.WINDOW, localizer, Query(mixed, camera), truth)


def _within(features: FeatureSet, low: FloatArray, size: FloatArray, inside: bool) -> FeatureSet:
    """The features inside or outside a window."""
    is_inside = ((features.pixels >= low) & (features.pixels < low + size)).all(axis=1)
    return features.take(np.flatnonzero(is_inside == inside))


def other_rooms(paths: list[Path], extractor: Extractor) -> list[tuple[FeatureSet, Camera]]:
    """Frames of other rooms: whatever is found of them is wrong."""
    frames = []
    for path in paths:
        recording = read_recording(path)
        width, height = recording.frames.size
        camera = Camera(width, height, 0.8 * width, 0.8 * width, (width - 1) / 2, (height - 1) / 2)
        step = max(1, len(recording.frames.times) // OTHER_ROOM_FRAMES)
        rows = list(range(0, len(recording.frames.times), step))
        frames += [(extractor.extract(image), camera) for image in recording.frames.images(rows)]
    return frames


def all_cases(args: argparse.Namespace) -> Iterator[Case]:
    """All maps' queries. Frames of the walk of ``--halves`` are asked of its own maps only."""
    asked = read_recording(args.recording, camera=args.camera, frames=args.frames)
    sets: list[tuple[str, Map, Recording]] = [(path.stem, load_map(path), asked) for path in args.map]
    if args.halves:
        first, second = halves(args.halves)
        sets += [("first half", map_of(first, args.features), second)]
        sets += [("second half", map_of(second, args.features), first)]
    if args.building:
        walk, again = building(args.cache, args.building)
        sets.append(("building", map_of(walk, args.features), again))
    for fold, map_, asked in sets:
        localizer = Localizer(map_, min_confidence=0.0)
        others = other_rooms(
            [path for path in args.other if path != args.halves or "half" not in fold], localizer.extractor
        )
        yield from own_cases(fold, localizer, asked, args.every, [features for features, _ in others])
        for features, camera in others:
            yield case(fold, Kind.OTHER_ROOM, localizer, Query(features, camera), None)


def fit(cases: list[Case]) -> FloatArray:
    """The logistic's intercept and weights (5,), by likelihood with a little ridge; what speaks against cannot help."""
    usable = [case for case in cases if case.inputs is not None]
    X = np.array([[1.0, *case.inputs] for case in usable])  # type: ignore[misc]
    sign = np.where([case.right for case in usable], 1.0, -1.0)
    weight = np.array([case.weight for case in usable])
    bounds = [(None, None), (0, None), *[(None, 0)] * (X.shape[1] - 2)]
    found = minimize(
        lambda w: (weight * np.logaddexp(0, -sign * (X @ w))).sum() + RIDGE * (w @ w),
        np.zeros(X.shape[1]),
        bounds=bounds,
    )
    return np.asarray(found.x)


def held_back(cases: list[Case]) -> FloatArray:
    """Each case's confidence (N,) by weights that were fitted without its map."""
    confidence = np.zeros(len(cases))
    folds = sorted({one.fold for one in cases})
    for fold in folds:
        weights = fit([one for one in cases if one.fold != fold or len(folds) == 1])
        for i, one in enumerate(cases):
            if one.fold == fold and one.inputs is not None:
                score = float(weights @ np.concatenate([[1.0], one.inputs]))
                confidence[i] = one.factor / (1 + np.exp(-np.clip(score, -50, 50)))
    return confidence


def reliability(cases: list[Case], confidence: FloatArray) -> list[tuple[str, int, float, float]]:
    """For each tenth of confidence: its name, how many answers, the mean confidence and the share that is right."""
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
    parser.add_argument("--features", default="sift48", help="of the maps that are made here")
    parser.add_argument("--halves", type=Path, help="a walk without truth")
    parser.add_argument("--building", type=float, metavar="SECONDS", help="of each walk through it")
    parser.add_argument("--cache", type=Path, help="where the simulated walks are kept")
    parser.add_argument("--every", type=int, default=2)
    parser.add_argument("--other", type=Path, action="append", default=[])
    parser.add_argument("--plot", type=Path)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        args.cache = args.cache or Path(folder)
        cases = list(all_cases(args))
    confidence = held_back(cases)
    print("intercept and weights that fit best:", np.round(fit(cases), 2))
    print("confidence  answers  said  right   (held back, windows left out)")
    open_ = np.array([case.kind is not Kind.WINDOW for case in cases])
    rows = reliability([case for case, kept in zip(cases, open_, strict=True) if kept], confidence[open_])
    for name, count, said, was in rows:
        print(f"{name:10}  {count:7}  {said:.2f}  {was:.2f}")
    print("threshold  other rooms refused  good answers kept  windows answered")

    def share(chosen: list[bool], threshold: float) -> str:
        return f"{(confidence[np.array(chosen)] >= threshold).mean():.3f}" if any(chosen) else "–"

    for threshold in THRESHOLDS:
        others = [case.kind is Kind.OTHER_ROOM for case in cases]
        refused = f"{(confidence[np.array(others)] < threshold).mean():.4f}" if any(others) else "–"
        good = share([case.kind is Kind.WHOLE and case.right for case in cases], threshold)
        windows = share([case.kind is Kind.WINDOW for case in cases], threshold)
        print(f"{threshold:9}  {refused:>19}  {good:>17}  {windows:>16}")
    if args.plot:
        plot(rows, args.plot)


if __name__ == "__main__":
    main()
