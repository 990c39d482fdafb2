"""What each part of the density adds to geometry, from the same features in the same place.

    python benchmarks/density_parts.py KITCHEN [--camera fx,fy,cx,cy] [--maps 700:1000,600:1000] [--queries 100:400:6]
        [--features sift48] [--samples 150]

Maps are made of some frames of a posed recording, and asked by others. Of each query all features are extracted, and
the place is found that most matches with the whole map speak for; from there on every row of the table has the same:
each feature's four nearest descriptors in that place. A row says how many poses are within 5 cm and 5° and within 2 cm
and 2°, the median error, and the processor time after the place is known. The rows:

- LO-RANSAC: poselib from mutual matches, with 1000, 10,000 and 100,000 samples: what geometry makes of ever more time.
- density: from samples of three mutual matches, the best by density, the ascent.
- LO-RANSAC, density: the ascent from LO-RANSAC's pose, as far as it may have to go; narrow: from within 8 px.
- several landmarks: the same two, but each feature speaks for all of its four nearest landmarks, with chances that
  leave each other room: ρ of a feature is the mixture Σ_k c_k ρ_k, in the samples' scores and in the ascent.
- shown, and not missing: the poses of all the rows above, each matched again about itself (``verify``), of which the
  one is taken that its matches say most for; and the one for which they say most after what the place should show and
  does not is subtracted.
- re-matched: LO-RANSAC's pose, then matches with all landmarks within 14 px of where it expects them, refined, and
  again within 5 px: refined by density (``verify``), and by least squares with Cauchy's loss on the same matches.
- from the voted view: the same two, from the pose of the view that most matches speak for instead of LO-RANSAC's; each
  first refines by its own loss on the mutual matches, from 80 px down.
- rholoc: the localizer as it is, which looks in further places.

Then, for the queries that the rows differ in or all fail in, how much there is to find: landmarks that the true pose
sees, features that show one of these within 5 px: in mutual matches, among the four nearest, and by likeness alone.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from rholoc.density import Evidence, RayDensities
from rholoc.density.ray import RayOffsets
from rholoc.features import DEFAULT_FEATURES
from rholoc.features.matching import LIMITS
from rholoc.geometry import Camera, FloatArray, IntArray, pose_distances
from rholoc.localization import Dof, Localizer, Query
from rholoc.localization.index.map_index import MapIndex
from rholoc.localization.index.matches import Matches, NearestLandmarks
from rholoc.localization.pose.ascent import ascend, end_of_climb, moved
from rholoc.localization.pose.ransac import lo_ransac
from rholoc.localization.pose.rematching import (
    FINAL_TOLERANCE_PX,
    SEARCH_RADII_PX,
    Verified,
    evidence_of,
    settle,
    verify,
)
from rholoc.localization.pose.seeds import minimal_samples, vote_for_places
from rholoc.mapping import BuildOptions, build_map
from rholoc.recordings import read_recording
from rholoc.trajectory import PoseMethod
from rholoc_lab.evaluation.pnp_baselines import refine_by_density

CAMERA = "525.505,525.505,320,240"
SAMPLES_OF_RANSAC = (1_000, 10_000, 100_000)
RANSAC_PX, ASCENT_PX = 8.0, (24.0, 12.0, 6.0, FINAL_TOLERANCE_PX)
NARROW_PX = (RANSAC_PX, FINAL_TOLERANCE_PX)
SEEDS, VIEWS_EACH, ITERATIONS = 8, 10, 3
NEAR_PX = 5.0
FEWEST_MATCHES, SETTLED = 6, 1e-5  # to refine by; metres or radians: steps that end a refinement
LIMITS_M_DEG = ((0.05, 5.0), (0.02, 2.0))
FALSE_DENSITY = 0.1  # as of matches that have one landmark each
MOST_CHANCE = 0.95
RANSAC, DENSITY, MIXTURE = "LO-RANSAC, {:,} samples", "density", "several landmarks"
SEEDED, NARROW, SEEDED_MIXTURE = "LO-RANSAC, density", "LO-RANSAC, density, narrow", "LO-RANSAC, several landmarks"
REMATCHED_DENSITY, REMATCHED_CAUCHY = "LO-RANSAC, re-matched, density", "LO-RANSAC, re-matched, Cauchy"
VOTED_DENSITY, VOTED_CAUCHY = "voted view, re-matched, density", "voted view, re-matched, Cauchy"
VOTED_PX = (80.0, 40.0, 24.0, 12.0)  # on the way from a view's pose to where matches are looked for again
CAUCHY_SHARE = 0.25  # of a tolerance: the scale of Cauchy's loss there
CAUCHY_ITERATIONS = 10
SHOWN, NOT_MISSING, WHOLE = "all, by what is shown", "all, by that and what is missing", "rholoc, whole"


@dataclass(frozen=True, eq=False)
class Frame:
    """A query, the place it is looked for in, and what its features are most like there.

    Attributes:
        query: the picture's features and camera.
        rays: (N, 3) of its features, camera frame.
        nearest: the landmarks of the place that each feature is most like.
        T_map_view: (4, 4) the pose of the view that stands for the place.
        truth: (4, 4) the true pose.
    """

    query: Query
    rays: FloatArray
    nearest: NearestLandmarks
    T_map_view: FloatArray
    truth: FloatArray

    @property
    def mutual(self) -> Matches:
        return self.nearest.matches(mutual=True).likeliest_first()


@dataclass(frozen=True, eq=False)
class Mixture:
    """Features that may each show several landmarks.

    Attributes:
        evidence: of all pairs (P,).
        feature: (P,) which of F features a pair is of.
        chances: (P,) that the pair is true.
        false: (F,) the odds' density that none of a feature's pairs is.
    """

    evidence: Evidence
    feature: IntArray
    chances: FloatArray
    false: FloatArray

    @classmethod
    def of(cls, index: MapIndex, frame: Frame) -> Mixture:
        """Of what a frame's features are like."""
        nearest, limits = frame.nearest, LIMITS[frame.nearest.metric]
        distances = nearest.distances.astype(np.float64)
        rival = np.where(np.isfinite(distances), distances, -np.inf).max(axis=1, keepdims=True)
        odds = np.exp(2 * ((rival - distances) / limits.spread - 1) + (0.6 * limits.strict - distances) / limits.spread)
        good = (nearest.landmarks >= 0) & (distances <= limits.loose)
        odds = np.where(good, odds, 0.0)
        chances = np.minimum(odds / (1 + odds.sum(axis=1, keepdims=True)), MOST_CHANCE)
        rows, ranks = np.nonzero(good & (chances > 0.01))
        pairs = Matches(nearest.detections[rows], nearest.landmarks[rows, ranks], chances[rows, ranks])
        _, feature = np.unique(rows, return_inverse=True)
        total = np.minimum(np.bincount(feature, weights=pairs.chances), MOST_CHANCE)
        evidence = evidence_of(index, pairs, frame.rays, frame.query.camera)
        return cls(evidence, feature, pairs.chances, FALSE_DENSITY * (1 - total))

    def densities(self, T_map_camera: FloatArray, tolerance_px: float) -> FloatArray:
        """Σ_k c_k ρ_k (F,) of each feature at a pose (4, 4)."""
        slopes = RayDensities().near(self.evidence, T_map_camera, tolerance_px).at(T_map_camera, tolerance_px)
        return np.bincount(self.feature, weights=self.chances * slopes.density, minlength=len(self.false))

    def value(self, T_map_camera: FloatArray, tolerance_px: float) -> float:
        """Nats for a pose: Σ log(1 + Σ_k c_k ρ_k / false)."""
        return float(np.log1p(self.densities(T_map_camera, tolerance_px) / self.false).sum())

    def ascended(self, T_map_camera: FloatArray) -> FloatArray:
        """Where Gauss–Newton on the mixture ends, from a pose (4, 4)."""
        T = T_map_camera
        for tolerance_px in ASCENT_PX:
            for _ in range(ITERATIONS):
                slopes = RayDensities().near(self.evidence, T, tolerance_px).at(T, tolerance_px)
                inside, weights = slopes.inside, self.chances * slopes.density
                whole = np.bincount(self.feature, weights=weights, minlength=len(self.false)) + self.false
                weight = self.chances[inside] / whole[self.feature[inside]]
                roots = slopes.roots.reshape(-1, 6)
                curvature = (np.repeat(2 * weight, 2)[:, None] * roots).T @ roots
                damped = curvature + (1e-6 * np.trace(curvature) / 6 + 1e-12) * np.eye(6)
                step = np.linalg.solve(damped, -weight @ slopes.gradient)
                length = max(np.linalg.norm(step[:3]) / 0.5, np.linalg.norm(step[3:]) / 0.3, 1.0)
                T = moved(T, step / length)
        return T


def frame_of(localizer: Localizer, picture: FloatArray, camera: Camera, truth: FloatArray) -> Frame | None:
    """A query in the place that most of its matches speak for; None where none do."""
    index = localizer.index
    query = Query(localizer.extractor.extract(picture), camera, Dof.FREE)
    places = vote_for_places(index, index.match_everywhere(query.features), 1, VIEWS_EACH, None)
    if not places:
        return None
    nearest = index.nearest_within(query.features, places[0].landmarks)
    T_map_view = index.map.views.T_map_camera[places[0].view]
    return Frame(query, camera.rays(query.features.pixels), nearest, T_map_view, truth)


def ransac_pose(index: MapIndex, frame: Frame, samples: int) -> FloatArray | None:
    matches = frame.mutual
    seen = frame.rays[matches.detections]
    found = lo_ransac(seen, index.landmarks[matches.landmarks], frame.query.camera.focal, RANSAC_PX, samples, samples)
    return None if found is None else found[0]


def density_pose(index: MapIndex, frame: Frame, samples: int) -> FloatArray | None:
    """Of the poses that the best samples lead to the densest."""
    matches = frame.mutual
    evidence = evidence_of(index, matches, frame.rays, frame.query.camera)
    seeds = minimal_samples(evidence, matches.chances, matches.detections, samples, SEEDS)
    ends = [refine_by_density(index, frame.query, frame.rays, matches, T) for T in seeds]
    return best(ends, lambda T: hard_value(evidence, T))


def narrow_pose(index: MapIndex, frame: Frame, T_map_camera: FloatArray) -> FloatArray:
    matches = frame.mutual
    evidence = evidence_of(index, matches, frame.rays, frame.query.camera)
    optimum = ascend(index.map.densities, evidence, T_map_camera, NARROW_PX, Dof.FREE)
    return settle(index, matches, evidence, optimum, Dof.FREE).T_map_camera


def cauchy_pose(evidence: Evidence, T_map_camera: FloatArray, tolerances_px: tuple[float, ...]) -> FloatArray:
    """The pose (4, 4) of least squares with Cauchy's loss on reprojection errors, its scale narrowing."""
    T = T_map_camera
    for tolerance_px in tolerances_px:
        for _ in range(CAUCHY_ITERATIONS):
            offsets = RayOffsets.of(evidence, T)
            along = np.einsum("mi,mi->m", (evidence.landmarks - T[:3, 3]) @ T[:3, :3], evidence.rays)
            in_front = along > 0
            px_per_m = (evidence.focal_px / np.maximum(along, 1e-3))[:, None]
            residuals = offsets.offset * px_per_m
            J = offsets.jacobian * px_per_m[:, :, None]
            scale_px = CAUCHY_SHARE * tolerance_px
            weight = in_front / (1 + (residuals**2).sum(axis=1) / scale_px**2)
            curvature = np.einsum("m,mrp,mrq->pq", weight, J, J)
            damped = curvature + (1e-6 * np.trace(curvature) / 6 + 1e-12) * np.eye(6)
            step = -np.linalg.solve(damped, np.einsum("m,mrp,mr->p", weight, J, residuals))
            T = moved(T, step / max(np.linalg.norm(step[:3]) / 0.5, np.linalg.norm(step[3:]) / 0.3, 1.0))
            if np.abs(step).max() < SETTLED:
                break
    return T


def rematched_by_cauchy(index: MapIndex, frame: Frame, T_map_camera: FloatArray) -> FloatArray | None:
    """As :func:`verify` matches and refines a pose (4, 4), with Cauchy's loss in place of the density."""
    T, (wide_px, narrow_px) = T_map_camera, SEARCH_RADII_PX
    for radius_px, tolerances_px in (
        (wide_px, (wide_px, wide_px / 2, FINAL_TOLERANCE_PX)),
        (narrow_px, (narrow_px, FINAL_TOLERANCE_PX)),
    ):
        matches, _ = index.match_near(frame.query.features, frame.query.camera, T, radius_px)
        if len(matches) < FEWEST_MATCHES:
            return None
        T = cauchy_pose(evidence_of(index, matches, frame.rays, frame.query.camera), T, tolerances_px)
    return T


def rematched_by_density(index: MapIndex, frame: Frame, T_map_camera: FloatArray) -> FloatArray | None:
    verified = verify(index, frame.query, frame.rays, T_map_camera)
    return None if verified is None else verified.optimum.T_map_camera


def voted_pose(index: MapIndex, frame: Frame, by_density: bool) -> FloatArray | None:
    """From the pose of the view that most matches speak for, by one loss all the way."""
    evidence = evidence_of(index, frame.mutual, frame.rays, frame.query.camera)
    if by_density:
        T = end_of_climb(index.map.densities, evidence, frame.T_map_view, VOTED_PX, Dof.FREE, CAUCHY_ITERATIONS)
        return rematched_by_density(index, frame, T)
    return rematched_by_cauchy(index, frame, cauchy_pose(evidence, frame.T_map_view, VOTED_PX))


def hard_value(evidence: Evidence, T: FloatArray) -> float:
    slopes = RayDensities().near(evidence, T, FINAL_TOLERANCE_PX).at(T, FINAL_TOLERANCE_PX)
    return float(np.log1p(slopes.density / evidence.epsilon).sum())


def mixture_pose(index: MapIndex, frame: Frame, samples: int) -> FloatArray | None:
    """As :func:`density_pose`, each feature speaking for several landmarks."""
    mixture = Mixture.of(index, frame)
    drawn = minimal_samples(mixture.evidence, mixture.chances, mixture.feature, samples, 4 * SEEDS)
    seeds = sorted(drawn, key=lambda T: -mixture.value(T, ASCENT_PX[1]))[:SEEDS]
    return best([mixture.ascended(T) for T in seeds], lambda T: mixture.value(T, FINAL_TOLERANCE_PX))


def best(poses: list[FloatArray], value: Callable[[FloatArray], float]) -> FloatArray | None:
    return max(poses, key=value, default=None)


Row = tuple[str, FloatArray | None, float]  # its name, the pose (4, 4), seconds of processor time


def answers(localizer: Localizer, frame: Frame, samples: int) -> Iterator[Row]:
    """Every row's pose."""
    index, found = localizer.index, {}

    def timed(name: str, make: Callable[[], FloatArray | None], besides_s: float = 0.0) -> Row:
        begun = time.process_time()
        T = make()
        found[name] = T, time.process_time() - begun + besides_s
        return name, *found[name]

    for count in SAMPLES_OF_RANSAC:
        yield timed(RANSAC.format(count), lambda: ransac_pose(index, frame, count))  # noqa: B023
    seed, seed_s = found[RANSAC.format(SAMPLES_OF_RANSAC[0])]
    yield timed(DENSITY, lambda: density_pose(index, frame, samples))
    if seed is None:
        seed_s = 0.0
    yield timed(
        SEEDED,
        lambda: None if seed is None else refine_by_density(index, frame.query, frame.rays, frame.mutual, seed),
        seed_s,
    )
    yield timed(NARROW, lambda: None if seed is None else narrow_pose(index, frame, seed), seed_s)
    yield timed(REMATCHED_DENSITY, lambda: None if seed is None else rematched_by_density(index, frame, seed), seed_s)
    yield timed(REMATCHED_CAUCHY, lambda: None if seed is None else rematched_by_cauchy(index, frame, seed), seed_s)
    yield timed(VOTED_DENSITY, lambda: voted_pose(index, frame, by_density=True))
    yield timed(VOTED_CAUCHY, lambda: voted_pose(index, frame, by_density=False))
    yield timed(MIXTURE, lambda: mixture_pose(index, frame, samples))
    yield timed(SEEDED_MIXTURE, lambda: None if seed is None else Mixture.of(index, frame).ascended(seed), seed_s)
    ends = (SEEDED, DENSITY, MIXTURE, SEEDED_MIXTURE)
    verified: list[Verified] = []

    def chosen(value: Callable[[Verified], float]) -> FloatArray | None:
        if not verified:
            poses = [found[name][0] for name in ends]
            checked = [verify(index, frame.query, frame.rays, T) for T in poses if T is not None]
            verified.extend(one for one in checked if one is not None)
        return max(verified, key=value).optimum.T_map_camera if verified else None

    before_s = sum(found[name][1] for name in ends) - seed_s
    name, T, spent_s = timed(SHOWN, lambda: chosen(lambda one: one.support.seen), before_s)
    yield name, T, spent_s
    yield timed(NOT_MISSING, lambda: chosen(lambda one: one.support.net), spent_s)

    def whole() -> FloatArray | None:
        found = localizer.candidate(frame.query)
        return None if found is None else found[0].optimum.T_map_camera

    yield timed(WHOLE, whole)


@dataclass(frozen=True)
class There:
    """What there is to be found of a frame in its place.

    Attributes:
        features: of the picture.
        visible: landmarks of the map that the true pose should see.
        in_place: of those in the place that is looked in.
        mutual: mutual matches; ``mutual_true``: of those true.
        nearest_true: features of which one of the four nearest landmarks is true; ``second_true``: but not the first.
        second: pairs of features and near landmarks that are not the nearest.
        alike: features that are like a landmark that is where they are; ``by_chance``: as many as chance would make.
    """

    features: int
    visible: int
    in_place: int
    mutual: int
    mutual_true: int
    nearest_true: int
    second_true: int
    second: int
    alike: int
    by_chance: int

    @classmethod
    def of(cls, index: MapIndex, frame: Frame) -> There:
        query, T, nearest = frame.query, frame.truth, frame.nearest
        rows = np.flatnonzero(index.present(T[:3, 3]))
        pixels = query.camera.project((index.landmarks - T[:3, 3]) @ T[:3, :3])
        visible = rows[query.camera.contains(pixels[rows])]
        detected = query.features.pixels

        def is_true(detections: IntArray, landmarks: IntArray) -> FloatArray:
            off_px = np.linalg.norm(pixels[landmarks] - detected[detections], axis=-1)
            return np.asarray((landmarks >= 0) & (off_px < NEAR_PX))

        mutual = frame.mutual
        true = is_true(nearest.detections[:, None], nearest.landmarks)
        likely = nearest.distances <= LIMITS[nearest.metric].loose
        alike, by_chance = index.match_near(query.features, query.camera, T, NEAR_PX)
        return cls(
            len(query.features),
            len(visible),
            int(np.isin(visible, nearest.landmarks).sum()),
            len(mutual),
            int(is_true(mutual.detections, mutual.landmarks).sum()),
            int((true & likely).any(axis=1).sum()),
            int(((true & likely).any(axis=1) & ~true[:, 0]).sum()),
            int((likely & (nearest.landmarks != nearest.landmarks[:, :1]))[:, 1:].sum()),
            len(alike),
            round(float(by_chance.sum())),
        )

    def __str__(self) -> str:
        return (
            f"{self.features} features, {self.visible} landmarks to be seen; true: {self.mutual_true} of {self.mutual} "
            f"mutual matches, {self.nearest_true} features by their four nearest ({self.second_true} not by the first, "
            f"of {self.second} pairs); alike where they should be: {self.alike} ({self.by_chance} by chance)"
        )


def table(localizer: Localizer, folder: Path, camera_text: str, queries: str, samples: int) -> None:
    """The table of one map and its queries, and what there was to find."""
    recording = read_recording(folder, camera_text, queries)
    assert recording.poses is not None
    assert recording.camera is not None
    errors: dict[str, list[tuple[float, float]]] = {}
    spent: dict[str, list[float]] = {}
    there: list[There] = []
    numbers: list[int] = []
    pictures = recording.frames.images(list(range(len(recording.frames.times))))
    for row, (picture, truth) in enumerate(zip(pictures, recording.poses.T_map_camera, strict=True)):
        frame = frame_of(localizer, picture, recording.camera, truth)
        if frame is None:
            print(f"frame {recording.frames.numbers[row]}: nothing in it is like the map; left out")
            continue
        there.append(There.of(localizer.index, frame))
        numbers.append(int(recording.frames.numbers[row]))
        for name, T, seconds in answers(localizer, frame, samples):
            off = (np.inf, np.inf) if T is None else pose_distances(T, truth)
            errors.setdefault(name, []).append((float(off[0]), float(off[1])))
            spent.setdefault(name, []).append(seconds)
    print(f"| {len(there)} queries | " + " | ".join(f"{100 * m:g} cm, {deg:g}°" for m, deg in LIMITS_M_DEG), end="")
    print(" | median cm | ms |\n|---|--:|--:|--:|--:|")
    right = {}
    for name, found in errors.items():
        off = np.array(found)
        within = [(off[:, 0] < m) & (off[:, 1] < np.deg2rad(deg)) for m, deg in LIMITS_M_DEG]
        right[name] = within[0]
        shares = " | ".join(f"{100 * one.mean():.0f} %" for one in within)
        print(f"| {name} | {shares} | {100 * np.median(off[:, 0]):.2f} | {1e3 * np.mean(spent[name]):.0f} |")
    all_right = np.all(list(right.values()), axis=0)
    true = np.array([one.mutual_true for one in there])
    solved = true[all_right]
    if len(solved):
        print(f"Right in every row: {len(solved)}, with {solved.min()} to {solved.max()} true mutual matches.")
    for row in np.flatnonzero(~all_right):
        wrong = [name for name, one in right.items() if not one[row]]
        print(f"frame {numbers[row]}: {there[row]}; wrong: {'; '.join(wrong)}")


def main() -> None:
    parser = argparse.ArgumentParser(description="What each part of the density adds to geometry.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--camera", default=CAMERA)
    parser.add_argument("--maps", default="700:1000,600:1000")
    parser.add_argument("--queries", default="100:400:6")
    parser.add_argument("--features", default=DEFAULT_FEATURES)
    parser.add_argument("--samples", type=int, default=150)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    options = BuildOptions(poses=PoseMethod.GIVEN, features=args.features, report=False)
    for frames in args.maps.split(","):
        map_ = build_map([read_recording(args.folder, args.camera, frames)], options)
        print(
            f"\nMap of frames {frames}, {args.features}: {len(map_)} landmarks, {len(map_.views)} views",
            flush=True,
        )
        table(Localizer(map_), args.folder, args.camera, args.queries, args.samples)


if __name__ == "__main__":
    main()
