"""How long a map takes to learn one more recording, against building it again from all; what the maps then localize.

    python benchmarks/learning.py RECORDING --camera fx,fy,cx,cy --parts 400:600 600:800 800:1000 --queries 100:400:5

The parts of a recording with poses stand for recordings. Times are of the process (CPU), on one core.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from rholoc.geometry import pose_distances
from rholoc.localization import Dof, Localizer, Query
from rholoc.mapping import BuildOptions, build_map, forget_recording, merge_maps, update_map
from rholoc.maps import Map, map_to_bytes
from rholoc.recordings import Recording, read_recording
from rholoc.trajectory import PoseMethod

T = TypeVar("T")
GIVEN = BuildOptions(poses=PoseMethod.GIVEN)


def timed(work: Callable[[], T]) -> tuple[float, T]:
    start = time.process_time()
    result = work()
    return time.process_time() - start, result


def accuracy(map_: Map, queries: Recording) -> dict[str, Any]:
    """Medians over all queries, a frame without a pose being infinitely wrong, and the share within 5 cm and 5°."""
    assert queries.poses is not None
    assert queries.camera is not None
    localizer, errors = Localizer(map_), []
    images = queries.frames.images(list(range(len(queries.frames.times))))
    for true, image in zip(queries.poses.T_map_camera, images, strict=True):
        pose = localizer.localize(Query(localizer.extractor.extract(image), queries.camera, Dof.FREE)).pose
        if pose is None:
            errors.append((np.inf, np.inf))
            continue
        apart_m, turned_rad = pose_distances(pose.T_map_camera, true)
        errors.append((float(apart_m), float(np.degrees(turned_rad))))
    distance_m, angle_deg = np.array(errors).T
    return {
        "median_cm": round(100 * float(np.median(distance_m)), 2),
        "median_deg": round(float(np.median(angle_deg)), 3),
        "recall_5cm_5deg": round(float(np.mean((distance_m < 0.05) & (angle_deg < 5))), 3),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recording", type=Path)
    parser.add_argument("--camera")
    parser.add_argument("--parts", nargs="+", required=True)
    parser.add_argument("--queries", required=True)
    arguments = parser.parse_args()

    def part(frames: str) -> Recording:
        return read_recording(arguments.recording, camera=arguments.camera, frames=frames)

    parts, queries = [part(frames) for frames in arguments.parts], part(arguments.queries)
    rebuild_s, whole = timed(lambda: build_map(parts, GIVEN))
    before = build_map(parts[:-1], GIVEN)
    last = parts[-1]
    aligned_s, aligned = timed(lambda: update_map(before, last))
    localized_s, localized = timed(lambda: update_map(before, replace(last, poses=None)))
    alone = build_map([last], GIVEN)
    merge_s, merged = timed(lambda: merge_maps(before, alone))
    forget_s, left = timed(lambda: forget_recording(merged, merged.info.sources[-1].id))
    figures = {
        "rebuild": {"cpu_s": rebuild_s, "of_rebuild": 1.0, **described(whole, queries)},
        "before": described(before, queries),
        "update, poses given and aligned": {"cpu_s": aligned_s, "of_rebuild": aligned_s / rebuild_s}
        | described(aligned, queries),
        "update, frames localized": {"cpu_s": localized_s, "of_rebuild": localized_s / rebuild_s}
        | described(localized, queries),
        "merge": {"cpu_s": merge_s, "of_rebuild": merge_s / rebuild_s, **described(merged, queries)},
        "forget": {
            "cpu_s": forget_s,
            "of_rebuild": forget_s / rebuild_s,
            "off_m": float(np.abs(left.landmarks - before.landmarks).max()) if len(left) == len(before) else None,
        },
    }
    print(json.dumps(figures, indent=2))


def described(map_: Map, queries: Recording) -> dict[str, Any]:
    return {"features": len(map_), "bytes": len(map_to_bytes(map_)), **accuracy(map_, queries)}


if __name__ == "__main__":
    main()
