"""What `rholoc demo` measures, over many seeds: how right maps are, and how right they are about themselves.

    python benchmarks/demo_sweep.py --cache /tmp/walks [--seeds 0-9]

Simulates the demo's two walks of each seed (kept in ``--cache``, rendering takes longest), builds the map of the first
in this process and localizes every third frame of the second, as JPEG, without a prior. Figures of a seed, then the
worst and the spread over all.
"""

import argparse
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from rholoc.evaluation import PoseErrors, evaluate, read_frame_poses, trajectory_errors
from rholoc.geometry import FloatArray
from rholoc.localization import Localization, Localizer, Query
from rholoc.mapping import BuildOptions, build_map
from rholoc.maps import Map, expected_error_m, trust_of
from rholoc.recordings import Recording, read_recording
from rholoc.simulation import simulate_recording

SECONDS = 30.0
EVERY = 3  # frames of the second walk
JPEG_QUALITY = 95
CONFIDENT = 0.9  # from this confidence on an answer claims to be right
RIGHT_M, RIGHT_DEG = 0.10, 5.0  # what confidence speaks of
CHI2_95_OF_3 = 7.815
WORST_IS_LOW = {"within_5cm_5deg", "sure_right", "covered", "views_covered", "sure", "localized"}


@dataclass(frozen=True)
class Figures:
    """What one seed gave; metres and degrees where not said otherwise, shares 0..1."""

    seed: int
    localized: float
    within_5cm_5deg: float
    median_cm: float | None
    p90_cm: float | None
    median_deg: float | None
    expected_error_cm: float | None
    map_error_rms_cm: float
    views_covered: float | None
    trusted: bool
    why: str
    sure: float
    sure_right: float | None
    covered: float | None


def recording_of(cache: Path, seed: int, walk: int) -> Path:
    """The recording of a walk, simulated unless it is there."""
    folder = cache / f"s{seed}w{walk}"
    if not folder.exists():
        partial = cache / f"partial-{folder.name}"
        simulate_recording(partial, walk=walk, seconds=SECONDS, seed=seed)
        partial.rename(folder)
    return folder


def run(cache: Path, seed: int) -> Figures:
    """Map the first walk, localize the second."""
    map_ = build_map([read_recording(recording_of(cache, seed, 1))], BuildOptions())
    second = recording_of(cache, seed, 2)
    answers = localize(map_, read_recording(second))
    truth = read_frame_poses(second / "truth.csv").T_map_camera[::EVERY][: len(answers)]
    first_truth = read_frame_poses(recording_of(cache, seed, 1) / "truth.csv")
    off_m = errors_of_views(map_, first_truth.times, first_truth.T_map_camera)
    estimated = np.array([np.full((4, 4), np.nan) if a.pose is None else a.pose.T_map_camera for a in answers])
    errors = trajectory_errors(estimated, truth)
    figures = evaluate(errors)
    sure = np.array([answer.confidence >= CONFIDENT for answer in answers])
    return Figures(
        seed=seed,
        localized=figures.localized / figures.n,
        within_5cm_5deg=figures.recall_5cm_5deg,
        median_cm=figures.median_cm,
        p90_cm=figures.p90_cm,
        median_deg=figures.median_deg,
        expected_error_cm=expected_error_cm(map_),
        map_error_rms_cm=float(100 * np.sqrt(np.mean(np.sum(off_m**2, axis=1)))),
        views_covered=views_covered(map_, off_m),
        trusted=trust_of(map_.info).trusted is True,
        why=trust_of(map_.info).reason,
        sure=float(sure.mean()),
        sure_right=float(errors.within(RIGHT_M, RIGHT_DEG)[sure].mean()) if sure.any() else None,
        covered=covered(answers, estimated, truth, errors),
    )


def localize(map_: Map, recording: Recording) -> list[Localization]:
    """The answers to every ``EVERY``-th frame, as the service gives them to the demo's client."""
    localizer, camera = Localizer(map_), recording.camera
    assert camera is not None

    def answer(image: np.ndarray) -> Localization:
        _, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        sent = np.asarray(cv2.imdecode(jpeg, cv2.IMREAD_COLOR), dtype=np.uint8)
        return localizer.localize(Query(localizer.extractor.extract(sent), camera))

    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(answer, recording.frames.images(range(0, len(recording.frames.times), EVERY))))


def errors_of_views(map_: Map, times: FloatArray, T_map_camera: FloatArray) -> FloatArray:
    """By how much (K, 3) metres the map's own views are off from where the camera truly was."""
    rows = np.abs(times - map_.views.times[:, None]).argmin(axis=1)
    return np.asarray(map_.views.positions - T_map_camera[rows, :3, 3])


def views_covered(map_: Map, off_m: FloatArray) -> float | None:
    """The share of the map's views whose true position lies inside the 95 % ellipsoid of their own covariance."""
    spread = map_.views.known_covariances[:, :3, :3].astype(np.float64)
    known = np.isfinite(spread[:, 0, 0])
    if not known.any():
        return None
    squared = np.einsum("ki,ki->k", off_m[known], np.linalg.solve(spread[known], off_m[known, :, None])[..., 0])
    return float((squared <= CHI2_95_OF_3).mean())


def expected_error_cm(map_: Map) -> float | None:
    """What the map says of itself: the root mean square."""
    expected_m = expected_error_m(map_.info)
    return None if expected_m is None else 100 * expected_m


def covered(
    answers: Sequence[Localization], estimated: FloatArray, truth: FloatArray, errors: PoseErrors
) -> float | None:
    """The share of answers whose true position lies inside the 95 % ellipsoid of their covariance."""
    inside = [
        float(off @ np.linalg.solve(answer.covariance[:3, :3], off)) <= CHI2_95_OF_3
        for answer, off, found in zip(answers, estimated[:, :3, 3] - truth[:, :3, 3], errors.localized, strict=True)
        if found and answer.covariance is not None and np.isfinite(answer.covariance).all()
    ]
    return float(np.mean(inside)) if inside else None


def shown(value: Any) -> str:
    match value:
        case None:
            return "–"
        case bool():
            return "yes" if value else "no"
        case float():
            return f"{value:.3f}"
        case _:
            return str(value)


def print_row(row: Figures) -> None:
    """One seed, in one line."""
    print("  ".join(f"{name} {shown(value)}" for name, value in asdict(row).items()), flush=True)


def print_summary(rows: Sequence[Figures]) -> None:
    """For each figure that is a number the worst, the median and the spread over all rows."""
    for name, first in asdict(rows[0]).items():
        values = [value for row in rows if isinstance(value := getattr(row, name), float)]
        if not values or isinstance(first, bool):
            continue
        size = np.array(values)
        worst = size.min() if name in WORST_IS_LOW else size.max()
        print(f"{name:24} worst {worst:8.3f}  median {np.median(size):8.3f}  spread {np.ptp(size):8.3f}")
    print(f"{'trusted':24} {sum(row.trusted for row in rows)} of {len(rows)}")


def seeds_of(text: str) -> list[int]:
    """'0-9' or '0,3,5'."""
    parts = [part.partition("-") for part in text.split(",")]
    return [seed for first, _, last in parts for seed in range(int(first), int(last or first) + 1)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, required=True, help="where simulated recordings are kept")
    parser.add_argument("--seeds", type=seeds_of, default=seeds_of("0-9"), metavar="0-9")
    asked = parser.parse_args()
    asked.cache.mkdir(parents=True, exist_ok=True)
    rows = []
    for seed in asked.seeds:
        rows.append(run(asked.cache, seed))
        print_row(rows[-1])
    print()
    print_summary(rows)


if __name__ == "__main__":
    main()
