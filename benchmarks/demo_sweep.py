"""What `rholoc demo` measures, over many seeds: how right maps are, and how right they are about themselves.

    python benchmarks/demo_sweep.py --cache /tmp/walks                          seeds 0-9, the demo itself
    python benchmarks/demo_sweep.py --cache /tmp/walks --seeds 0-2 --feature-noise 0.02 --draws 3
    python benchmarks/demo_sweep.py --cache /tmp/walks --no-waypoints           the IMU alone: scale, vertical
    python benchmarks/demo_sweep.py --cache /tmp/walks --wrong-waypoint 0.15    is the wrong one named?

Simulates the demo's two walks of each seed (kept in ``--cache``, rendering takes longest), builds the map of the first
in this process and localizes every third frame of the second, as JPEG, without a prior. Figures of a seed, then the
worst and the spread over all. ``--json FILE`` has them all. ``--maps DIR`` keeps the maps and takes those there are:
for another look at answers without mapping again.

``--feature-noise`` moves every keypoint of every extractor, in mapping and in localization, by normal noise of that
many pixels. ``--wrong-waypoint`` moves one waypoint by that many metres, in a random direction.
"""

from __future__ import annotations

import argparse
import json
import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.errors import RholocError
from rholoc.evaluation import PoseErrors, evaluate, read_frame_poses, trajectory_errors
from rholoc.features import FeatureSet
from rholoc.features.extractors._orb import OrbExtractor
from rholoc.features.extractors._sift import SiftExtractor
from rholoc.geometry import UP, ByteArray, FloatArray, angles_between, umeyama
from rholoc.localization import Localization, Localizer, Query
from rholoc.mapping import BuildOptions, build_map
from rholoc.maps import Map, expected_error_m, load_map, save_map, trust_of
from rholoc.progress import Stage
from rholoc.recordings import Recording, Waypoint, read_recording
from rholoc.simulation import simulate_recording
from rholoc.trajectory import PoseMethod, Trajectory, estimate_trajectory

SECONDS = 30.0
EVERY = 3  # frames of the second walk
JPEG_QUALITY = 95
CONFIDENT = 0.9  # from this confidence on an answer claims to be right
RIGHT_M, RIGHT_DEG = 0.10, 5.0  # what confidence speaks of
CHI2_95_OF_3 = 7.815
WORST_IS_LOW = {"within_5cm_5deg", "sure_right", "covered", "views_covered", "sure", "localized"}


class Stopwatch:
    """A progress listener that notes how many seconds each stage took."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._stage, self._since = "", time.perf_counter()

    def __call__(self, stage: Stage, fraction: float, message: str = "") -> None:
        now = time.perf_counter()
        if self._stage:
            self.seconds[self._stage] = self.seconds.get(self._stage, 0.0) + now - self._since
        self._stage, self._since = stage.value, now


@dataclass(frozen=True)
class Figures:
    """What one seed (and draw) gave; metres and degrees where not said otherwise, shares 0..1."""

    seed: int
    draw: int
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
    stages_s: dict[str, float]


@dataclass(frozen=True)
class TrajectoryFigures:
    """A walk's trajectory against its truth, without waypoints or with a wrong one."""

    seed: int
    frames: int
    scale_error_percent: float | None
    vertical_error_deg: float | None
    median_cm: float | None
    trusted: bool
    why: str
    moved: str = ""
    named: list[str] = field(default_factory=list)
    seconds: float = 0.0


def recording_of(cache: Path, seed: int, walk: int) -> Path:
    """The recording of a walk, simulated unless it is there."""
    folder = cache / f"s{seed}w{walk}"
    if not folder.exists():
        partial = cache / f"partial-{folder.name}"
        simulate_recording(partial, walk=walk, seconds=SECONDS, seed=seed)
        partial.rename(folder)
    return folder


@contextmanager
def moved_features(sigma_px: float, seed: int) -> Iterator[None]:
    """While it lasts, every extractor's keypoints are off by normal noise."""
    if sigma_px == 0:
        yield
        return
    originals = {kind: kind.extract for kind in (SiftExtractor, OrbExtractor)}

    def moving(extract: Callable[[Any, ByteArray], FeatureSet]) -> Callable[[Any, ByteArray], FeatureSet]:
        def moved(self: Any, image: ByteArray) -> FeatureSet:
            found = extract(self, image)
            rng = np.random.default_rng([seed, 17, zlib.crc32(found.pixels.tobytes())])  # the same in any thread
            noise = rng.normal(0, sigma_px, found.pixels.shape)
            return replace(found, pixels=(found.pixels + noise).astype(np.float32))

        return moved

    for kind, extract in originals.items():
        kind.extract = moving(extract)  # type: ignore[method-assign]
    try:
        yield
    finally:
        for kind, extract in originals.items():
            kind.extract = extract  # type: ignore[method-assign]


def run(cache: Path, seed: int, draw: int, noise_px: float, maps: Path | None) -> Figures:
    """Map the first walk, localize the second."""
    watch = Stopwatch()
    stored = None if maps is None else maps / f"s{seed}-draw{draw}-{noise_px}.rho"
    with moved_features(noise_px, 1000 * seed + draw):
        if stored is not None and stored.exists():
            map_ = load_map(stored)
        else:
            map_ = build_map([read_recording(recording_of(cache, seed, 1))], BuildOptions(), watch)
            if stored is not None:
                stored.parent.mkdir(parents=True, exist_ok=True)
                save_map(map_, stored)
        second = recording_of(cache, seed, 2)
        answers, truth = localize(map_, read_recording(second)), read_frame_poses(second / "truth.csv").T_map_camera
    truth = truth[::EVERY][: len(answers)]
    first_truth = read_frame_poses(recording_of(cache, seed, 1) / "truth.csv")
    off_m = errors_of_views(map_, first_truth.times, first_truth.T_map_camera)
    estimated = np.array([np.full((4, 4), np.nan) if a.pose is None else a.pose.T_map_camera for a in answers])
    errors = trajectory_errors(estimated, truth)
    figures = evaluate(errors)
    sure = np.array([answer.confidence >= CONFIDENT for answer in answers])
    return Figures(
        seed=seed,
        draw=draw,
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
        stages_s=watch.seconds,
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


def run_without_waypoints(cache: Path, seed: int) -> TrajectoryFigures:
    """Scale and vertical by the IMU alone."""
    recording = replace(read_recording(recording_of(cache, seed, 1)), waypoints=())
    return trajectory_figures(cache, seed, recording, aligned=True)


def run_with_wrong_waypoint(cache: Path, seed: int, off_m: float) -> TrajectoryFigures:
    """Whether the waypoint that was moved is named, and others are not."""
    recording = read_recording(recording_of(cache, seed, 1))
    rng = np.random.default_rng([seed, 23])
    chosen = int(rng.integers(len(recording.waypoints)))
    direction = rng.normal(size=3)
    off = off_m * direction / np.linalg.norm(direction)
    waypoints = [
        Waypoint(w.name, w.time, tuple(np.array(w.position) + off)) if i == chosen else w  # type: ignore[arg-type]
        for i, w in enumerate(recording.waypoints)
    ]
    figures = trajectory_figures(cache, seed, replace(recording, waypoints=tuple(waypoints)), aligned=False)
    return replace(figures, moved=waypoints[chosen].name)


def trajectory_figures(cache: Path, seed: int, recording: Recording, aligned: bool) -> TrajectoryFigures:
    """A trajectory against the truth; ``aligned`` by a rigid motion first, where nothing says what frame it is in."""
    start_s = time.perf_counter()
    try:
        found = estimate_trajectory(recording, PoseMethod.VISUAL_INERTIAL)
    except RholocError as error:
        why = f"{error.message} {error.hint}"
        return TrajectoryFigures(seed, 0, None, None, None, False, why, named=named_in(why, recording))
    seconds = time.perf_counter() - start_s
    poses = read_frame_poses(recording_of(cache, seed, 1) / "truth.csv")
    truth = poses.T_map_camera[np.abs(poses.times - found.times[:, None]).argmin(axis=1)]
    return TrajectoryFigures(
        seed,
        len(found.rows),
        **figures_against(found, truth, aligned),
        trusted=found.report.trusted,
        why=found.report.why,
        named=named_in(found.report.waypoint_mistake or "", recording),
        seconds=round(seconds, 1),
    )


def figures_against(found: Trajectory, truth: FloatArray, aligned: bool) -> dict[str, float]:
    """Scale and vertical error of a trajectory, and its median position error (after a rigid motion, if asked)."""
    own, true = found.T_map_camera[:, :3, 3], truth[:, :3, 3]
    turn = Rotation.from_matrix(truth[:, :3, :3] @ found.T_map_camera[:, :3, :3].transpose(0, 2, 1)).mean()
    if aligned:
        own = turn.apply(own - own.mean(axis=0)) + true.mean(axis=0)
    return {
        "scale_error_percent": 100 * (1 / umeyama(own, true).scale - 1),
        "vertical_error_deg": float(np.degrees(angles_between(turn.as_matrix()[2], UP))),
        "median_cm": float(100 * np.median(np.linalg.norm(own - true, axis=1))),
    }


def named_in(text: str, recording: Recording) -> list[str]:
    """The waypoints that a text speaks of."""
    words = {word.strip(".,:;'\"()") for word in text.split()}
    return [waypoint.name for waypoint in recording.waypoints if waypoint.name in words]


def shown(value: Any) -> str:
    match value:
        case None:
            return "–"
        case bool():
            return "yes" if value else "no"
        case float():
            return f"{value:.3f}"
        case dict():
            return " ".join(f"{name} {seconds:.0f}" for name, seconds in value.items())
        case list():
            return ",".join(value) or "none"
        case _:
            return str(value)


def print_row(row: Figures | TrajectoryFigures) -> None:
    """One seed, in one line."""
    print("  ".join(f"{name} {shown(value)}" for name, value in asdict(row).items()), flush=True)


def print_summary(rows: Sequence[Figures | TrajectoryFigures]) -> dict[str, dict[str, float]]:
    """For each figure that is a number the worst, the median and the spread over all rows."""
    summary = {}
    for name, first in asdict(rows[0]).items():
        values = [value for row in rows if isinstance(value := getattr(row, name), float)]
        if name in ("seed", "draw") or not values or isinstance(first, bool | str | list | dict):
            continue
        size = np.abs(values) if name == "scale_error_percent" else np.array(values)
        worst = size.min() if name in WORST_IS_LOW else size.max()
        summary[name] = {"worst": float(worst), "median": float(np.median(size)), "spread": float(np.ptp(size))}
        print(f"{name:24} worst {worst:8.3f}  median {np.median(size):8.3f}  spread {np.ptp(size):8.3f}")
    print(f"{'trusted':24} {sum(row.trusted for row in rows)} of {len(rows)}")
    return summary


def print_wrong_waypoints(rows: Sequence[TrajectoryFigures]) -> None:
    found = sum(row.moved in row.named for row in rows)
    wronged = [f"{name} (seed {row.seed})" for row in rows for name in row.named if name != row.moved]
    print(f"the wrong waypoint was named in {found} of {len(rows)}; right ones: {', '.join(wronged) or 'none'}")


def print_moves(rows: Sequence[Figures], without: Sequence[Figures]) -> None:
    """How far each figure in centimetres moves between draws of the noise and without any."""
    for name in ("median_cm", "p90_cm"):
        for seed in sorted({row.seed for row in rows}):
            values = [getattr(row, name) for row in (*without, *rows) if row.seed == seed]
            move = "–" if None in values else f"{np.ptp(values):.2f} cm"
            print(f"seed {seed}: {name} moves by {move}: {', '.join(shown(value) for value in values)}")


def seeds_of(text: str) -> list[int]:
    """'0-9' or '0,3,5'."""
    parts = [part.partition("-") for part in text.split(",")]
    return [seed for first, _, last in parts for seed in range(int(first), int(last or first) + 1)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, required=True, help="where simulated recordings are kept")
    parser.add_argument("--seeds", type=seeds_of, default=seeds_of("0-9"), metavar="0-9")
    parser.add_argument("--maps", type=Path, help="where maps are kept, and taken from if they are there")
    parser.add_argument("--json", type=Path, help="all figures go there")
    parser.add_argument("--feature-noise", type=float, default=0.0, metavar="PX")
    parser.add_argument("--draws", type=int, default=1, help="how often the noise is drawn")
    parser.add_argument("--no-waypoints", action="store_true")
    parser.add_argument("--wrong-waypoint", type=float, metavar="M")
    asked = parser.parse_args()
    asked.cache.mkdir(parents=True, exist_ok=True)
    rows: list[Any] = []
    for seed in asked.seeds:
        if asked.no_waypoints:
            new: list[Any] = [run_without_waypoints(asked.cache, seed)]
        elif asked.wrong_waypoint is not None:
            new = [run_with_wrong_waypoint(asked.cache, seed, asked.wrong_waypoint)]
        else:
            draws = range(asked.draws) if asked.feature_noise else [0]
            if asked.feature_noise:
                rows.append(run(asked.cache, seed, 0, 0.0, asked.maps))
                print_row(rows[-1])
            new = [run(asked.cache, seed, 1 + draw, asked.feature_noise, asked.maps) for draw in draws]
        for row in new:
            print_row(row)
        rows += new
    print()
    summary = print_summary(rows)
    if asked.wrong_waypoint is not None:
        print_wrong_waypoints(rows)
    if asked.feature_noise:
        print_moves([row for row in rows if row.draw], [row for row in rows if not row.draw])
    if asked.json:
        asked.json.write_text(json.dumps({"rows": [asdict(row) for row in rows], "summary": summary}, indent=1))


if __name__ == "__main__":
    main()
