"""Features that light leaves alone: what choosing landmarks by persistence brings where the light is a new one.

    python benchmarks/persistence.py [--cache DIR] [--features lab3] [--seeds 0,1,...,9] [--per-view 20,60] [--every 3]

A simulated room by three lights, each with a walk of its own through it, poses as they are. A map is made of the walks
by two lights, the second one short of pictures, and asked by frames of a further walk by the third light. Landmarks are
chosen twice, as many each time: by how often they are seen alone, and by how probably a further walk sees them
(`expected_sightings`). Prints for every light that was held back the share of frames within 5 cm and 5° and the matches
that agree, side by side. `--every 1` leaves both walks their pictures.
"""

from __future__ import annotations

import argparse
import pickle
import tempfile
import uuid
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from rholoc.density import DensityKind
from rholoc.evaluation.errors import trajectory_errors
from rholoc.features import Extractor, FeatureSet, get_extractor
from rholoc.geometry import ByteArray, FloatArray, IntArray
from rholoc.localization import Dof, Localizer, Query
from rholoc.mapping.assembly import assemble
from rholoc.mapping.landmarks import Landmarks, extend_and_merge, select_stable, triangulate
from rholoc.mapping.memory import with_landmarks
from rholoc.mapping.observations import Views, link_observations
from rholoc.maps import Map, MapInfo, Source
from rholoc.simulation import PHONE_CAMERA, Light, make_test_site, make_walk, render_view

WALKS = {Light.DAYLIGHT: 1, Light.ARTIFICIAL: 3, Light.DIM: 4}
QUERY_WALK = 2
SECONDS, REST_S = 30.0, 1.3
MAP_FRAMES, QUERY_FRAMES = 36, 15
LIMITS = (0.05, 5.0)  # m and degrees
EXTENSION_ROUNDS = 2
BY_SIGHTINGS, BY_PERSISTENCE = "by sightings", "by persistence"


@dataclass(frozen=True)
class Walked:
    """Pictures along a walk by one light, and the poses (N, 4, 4) that they were taken from."""

    T_map_camera: FloatArray
    pictures: list[ByteArray]


def walked(cache: Path, seed: int) -> dict[tuple[Light, int], Walked]:
    """By light and walk: each light's own walk, and the walk of the queries."""
    path = cache / f"lights-{seed}.pickle"
    if path.is_file():
        kept: dict[tuple[Light, int], Walked] = pickle.loads(path.read_bytes())
        return kept
    site, found = make_test_site(seed), {}
    for light in Light:
        for number, count in ((WALKS[light], MAP_FRAMES), (QUERY_WALK, QUERY_FRAMES)):
            walk = make_walk(number, SECONDS, seed)
            times = np.linspace(REST_S, SECONDS - REST_S, count)
            pictures = [render_view(site, PHONE_CAMERA, pose, light, i) for i, pose in enumerate(walk.poses(times))]
            found[light, number] = Walked(walk.T_map_camera(times), pictures)
    cache.mkdir(parents=True, exist_ok=True)
    path.write_bytes(pickle.dumps(found))
    return found


def seen(walks: list[tuple[FloatArray, list[FeatureSet]]], extractor: Extractor) -> tuple[Views, Landmarks, IntArray]:
    """The views of walks (poses (N, 4, 4) and features each), all landmarks that they show, and each view's walk."""
    of_view = np.repeat(np.arange(len(walks)), [len(features) for _, features in walks])
    features = [one for _, found in walks for one in found]
    times = 0.5 * np.arange(len(features)) + 2 * SECONDS * of_view
    T = np.concatenate([poses for poses, _ in walks])
    views = Views.from_features([PHONE_CAMERA] * len(features), T, times, features)
    landmarks = triangulate(views, link_observations(views, extractor.metric))
    for _ in range(EXTENSION_ROUNDS):
        landmarks = extend_and_merge(views, landmarks, extractor.metric)
    return views, landmarks, of_view


def chosen(views: Views, landmarks: Landmarks, of_view: IntArray, per_view: int) -> dict[str, Landmarks]:
    """The same number of landmarks, or up to one a view more by sightings alone."""
    by_persistence = select_stable(views, landmarks, per_view, of_view)
    low, high = 1, 4 * per_view
    while low < high:
        middle = (low + high) // 2
        if len(select_stable(views, landmarks, middle)) >= len(by_persistence):
            high = middle
        else:
            low = middle + 1
    return {BY_SIGHTINGS: select_stable(views, landmarks, low), BY_PERSISTENCE: by_persistence}


def map_of(views: Views, landmarks: Landmarks, of_view: IntArray, extractor: Extractor) -> Map:
    """The map of chosen landmarks."""
    info = MapInfo(
        id=uuid.uuid4().hex,
        version=1,
        density=DensityKind.RAY,
        features=extractor.name,
        metric=True,
        upright=True,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        camera=PHONE_CAMERA,
        sources=tuple(Source(id=str(walk), name=str(walk), camera=PHONE_CAMERA) for walk in np.unique(of_view)),
    )
    return with_landmarks(assemble(info, views, landmarks, of_view, extractor.metric))


def asked(map_: Map, truth: FloatArray, frames: list[FeatureSet]) -> tuple[float, float]:
    """The share of frames within the limits, and how many matches agree, in the median."""
    localizer, answers, inliers = Localizer(map_), np.full((len(frames), 4, 4), np.nan), []
    for k, features in enumerate(frames):
        found = localizer.localize(Query(features, PHONE_CAMERA, Dof.FREE))
        inliers.append(found.inliers)
        if found.pose is not None:
            answers[k] = found.pose.T_map_camera
    return float(trajectory_errors(answers, truth).within(*LIMITS).mean()), float(np.median(inliers))


def main() -> None:
    parser = argparse.ArgumentParser(description="What choosing landmarks by persistence brings by a new light.")
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()) / "lights")
    parser.add_argument("--features", default="lab3")
    parser.add_argument("--seeds", default="0,1,2,3,4,5,6,7,8,9")
    parser.add_argument("--per-view", default="20,60", help="landmarks that each view may bring")
    parser.add_argument("--every", type=int, default=3, help="only so many of the second walk's pictures")
    args = parser.parse_args()
    extractor = get_extractor(args.features)
    budgets = [int(text) for text in args.per_view.split(",")]
    found: dict[tuple[Light, int, str], list[tuple[float, float, int]]] = {}
    for seed in map(int, args.seeds.split(",")):
        rooms = walked(args.cache, seed)
        features = {key: [extractor.extract(picture) for picture in walk.pictures] for key, walk in rooms.items()}
        for held_back in Light:
            keys = [(light, WALKS[light]) for light in Light if light is not held_back]
            walks = [
                (rooms[key].T_map_camera[::every], features[key][::every])
                for key, every in zip(keys, (1, args.every), strict=True)
            ]
            views, landmarks, of_view = seen(walks, extractor)
            queries = held_back, QUERY_WALK
            for per_view in budgets:
                for how, kept in chosen(views, landmarks, of_view, per_view).items():
                    share, inliers = asked(
                        map_of(views, kept, of_view, extractor), rooms[queries].T_map_camera, features[queries]
                    )
                    found.setdefault((held_back, per_view, how), []).append((share, inliers, len(kept)))
                    line = f"seed {seed}, {held_back} held back, {per_view:3} a view, {how:15} {len(kept):5} landmarks"
                    print(f"{line}   {share:4.0%}   {inliers:5.0f} agree", flush=True)
    print(f"{args.features}, {QUERY_FRAMES} frames by the light held back, within 5 cm and 5°: mean (worst) over seeds")
    for (held_back, per_view, how), rows in found.items():
        shares, inliers, counts = np.array(rows).T
        figures = f"{shares.mean():4.0%} ({shares.min():4.0%})   {inliers.mean():5.0f} agree"
        print(f"{held_back:11} {per_view:3} a view {how:15} {counts.mean():6.0f} landmarks   {figures}")


if __name__ == "__main__":
    main()
