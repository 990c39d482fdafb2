"""A walk through a building of fourteen rooms → its map: is every room found again, how far off, at what cost?

    python benchmarks/building.py [--seconds 30 120 300 600] [--seed 0] [--fps 15] [--cache DIR] [--json]
        [--only waypoints imu] [--query-fps 1]

For each length of the walk: the map is built of video, IMU and waypoints; two other walks, through the same rooms in
another order, higher or lower, at other speeds and looking elsewhere, are localized in it. In the whole building walk 3
goes around the rooms as the map's walk did and walk 2 the other way, so that half of what it sees was never mapped.
Printed for each of the two: the share localized, median and 95 % of the errors, a failure counting as wrong; the same
for pictures that show anything (200 features), for where a view of the map stands within 1.5 m and looks within 35° of
the same way, and for the rest; how many answers of which confidence are right to 15 cm; and a table of its rooms. What
mapping took, by the recording's length, and its largest memory; how far its views are from the truth. ``imu``: once
more without waypoints, as drift: how far the walk's end is from the true one when its start is laid on the truth, in %
of the way, and the errors after a similarity. The simulated recordings stay in ``--cache`` and are used again. Below
the table, the slope: how many seconds of mapping a further second of recording costs, from one length to the next.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from measuring import (
    coverage,
    measured,
    position_errors,
    print_figures,
    print_table,
    rigid_errors,
    rotation_errors,
    rounded,
    spread,
)
from rholoc.errors import RholocError
from rholoc.evaluation import trajectory_errors
from rholoc.geometry import BoolArray, FloatArray
from rholoc.localization import Localizer, Query
from rholoc.mapping import BuildOptions, build_map
from rholoc.maps import Map, read_trajectory_csv
from rholoc.recordings import Recording, read_recording
from rholoc.reports import report_to_json
from rholoc.simulation import Building, Site, make_site, simulate_recording
from rholoc.trajectory import PoseMethod, estimate_trajectory

ALIKE_M, ALIKE_DEG = 1.5, 35.0  # within which a query and a view may show the same things
SHOWS_FEATURES = 200  # fewer are a white wall
RIGHT_M = 0.15
CONFIDENCES = (0.6, 0.8, 0.9, 1.0)
ASKED_WALKS = (2, 3)
START_S = 3.0  # of the walk, whose poses are laid on the truth to see how far its end has drifted


def simulated(cache: Path, walk: int, seconds: float, seed: int, fps: float, readout_ms: float) -> Path:
    """A walk's recording, made unless it is there."""
    folder = cache / f"building-{seed}-walk{walk}-{seconds:.0f}s-{fps:g}fps-{readout_ms:g}ms"
    if not (folder / "made").exists():
        simulate_recording(
            folder, walk=walk, seconds=seconds, seed=seed, fps=fps, site=Site.BUILDING, readout_s=readout_ms / 1e3
        )
        (folder / "made").touch()
    return folder


def truth_of(folder: Path) -> tuple[FloatArray, FloatArray]:
    """The times (N,) and true poses (N, 4, 4) of a recording's frames."""
    table = read_trajectory_csv(folder / "truth.csv")
    return table.times, table.T_map_camera


def nearest_truth(folder: Path, times: FloatArray) -> FloatArray:
    true_times, T = truth_of(folder)
    return T[np.abs(true_times[:, None] - times).argmin(axis=0)]


def mapped(folder: Path) -> tuple[Map | None, dict[str, Any]]:
    """The map of a recording, None where there is none, and what it took."""
    recording = read_recording(folder)
    figures: dict[str, Any] = {}
    map_ = None
    with measured() as cost:
        try:
            map_ = build_map([recording], BuildOptions(report=False))
        except RholocError as error:
            figures["failed"] = str(error)
    length_s = float(recording.frames.times[-1] - recording.frames.times[0])
    figures |= {
        "mapping_s": rounded(cost.seconds, 0),
        "times_length": rounded(cost.seconds / length_s),
        "peak_mb": rounded(cost.peak_mb, 0),
    }
    if map_ is None:
        return None, figures
    report = report_to_json(map_.info.report)["trajectories"][0]
    placed = map_.views.times
    views = position_errors(map_.views.T_map_camera, nearest_truth(folder, placed))
    figures |= {
        "placed": f"{report['frames']}/{report.get('keyframes', '?')}",
        **coverage(recording.frames.times, placed),
        "trusted": report["trusted"],
        "why": report["why"],
        "features": len(map_),
        "views": len(placed),
        "views after similarity": views,
    }
    return map_, figures


def localized(map_: Map, folder: Path, building: Building) -> dict[str, Any]:
    """Another walk's frames in the map, by what they show and by room."""
    recording = read_recording(folder)
    assert recording.camera is not None
    localizer = Localizer(map_)
    truth = nearest_truth(folder, recording.frames.times)
    found = np.full(truth.shape, np.nan)
    confidence, features = np.zeros(len(truth)), np.zeros(len(truth), int)
    for i, image in enumerate(recording.frames.images(range(len(truth)))):
        frame = localizer.extractor.extract(image)
        answer = localizer.localize(Query(frame, recording.camera))
        features[i], confidence[i] = len(frame.pixels), answer.confidence
        if answer.localized and answer.pose is not None:
            found[i] = answer.pose.T_map_camera
    errors = trajectory_errors(found, truth)
    rooms = np.array([building.names[i] for i in building.outside(truth[:, :3, 3]).argmin(axis=0)])

    def figures(chosen: np.ndarray) -> dict[str, Any]:
        cm = 100 * np.minimum(errors.position_m[chosen], 10)
        answered = cm[errors.localized[chosen]]
        return {
            "frames": int(chosen.sum()),
            "localized_percent": rounded(100 * errors.localized[chosen].mean(), 0),
            "median_cm": rounded(np.median(cm), 1),
            "p95_cm": rounded(np.quantile(cm, 0.95), 1),
            "answered_median_cm": rounded(np.median(answered), 1) if len(answered) else None,
            "answered_p95_cm": rounded(np.quantile(answered, 0.95), 1) if len(answered) else None,
        }

    by_room = {name: figures(rooms == name) for name in sorted(set(rooms)) if not name.startswith("door")}
    halls = {name: values for name, values in by_room.items() if name.startswith("room")}
    looked_at = seen_alike(map_, truth)
    shows = features >= SHOWS_FEATURES
    chosen = {
        "all": np.ones(len(rooms), bool),
        "where the map's walk looked": looked_at,
        "the same, showing anything": looked_at & shows,
        "where it did not": ~looked_at,
    }
    return {
        **{name: figures(rows) for name, rows in chosen.items() if rows.any()},
        "right": reliability(confidence[errors.localized], errors.position_m[errors.localized] < RIGHT_M),
        "rooms_found": f"{sum(values['localized_percent'] > 0 for values in halls.values())}/{len(halls)}",
        "by room": by_room,
    }


def reliability(confidence: FloatArray, right: BoolArray) -> dict[str, str]:
    """Of the answers whose confidence lies between two figures, how many are right."""
    within = [(a, b, (confidence >= a) & ((confidence < b) | (b == 1))) for a, b in pairwise(CONFIDENCES)]
    return {f"confidence {a:g}-{b:g}": f"{int(right[rows].sum())}/{int(rows.sum())}" for a, b, rows in within}


def seen_alike(map_: Map, T_map_camera: FloatArray) -> BoolArray:
    """Which cameras (N, 4, 4) stand and look about as one of the map's views did: what others see, no feature joins."""
    views = map_.views.T_map_camera
    near = np.linalg.norm(views[None, :, :3, 3] - T_map_camera[:, None, :3, 3], axis=2) < ALIKE_M
    ahead = np.einsum("ni,vi->nv", T_map_camera[:, :3, 2], views[:, :3, 2]) > np.cos(np.radians(ALIKE_DEG))
    return np.asarray((near & ahead).any(axis=1))


def drift(folder: Path) -> dict[str, Any]:
    """The walk by pictures and IMU alone: its end, when its start is laid on the truth."""
    recording: Recording = replace(read_recording(folder), waypoints=())
    with measured() as cost:
        try:
            found = estimate_trajectory(recording, PoseMethod.VISUAL_INERTIAL)
        except RholocError as error:
            return {"failed": str(error)}
    T, true = found.T_map_camera, nearest_truth(folder, found.times)
    way_m = float(np.linalg.norm(np.diff(truth_of(folder)[1][:, :3, 3], axis=0), axis=1).sum())
    start = found.times <= found.times[0] + START_S
    turn = Rotation.from_matrix(true[start, :3, :3] @ np.swapaxes(T[start, :3, :3], 1, 2)).mean().as_matrix()
    laid = (T[:, :3, 3] - T[start, :3, 3].mean(axis=0)) @ turn.T + true[start, :3, 3].mean(axis=0)
    off_m = np.linalg.norm(laid - true[:, :3, 3], axis=1)
    return {
        "placed": f"{found.report.frames}/{found.report.keyframes}",
        "trusted": found.report.trusted,
        "why": found.report.why,
        "poses_s": rounded(cost.seconds, 0),
        "way_m": rounded(way_m, 1),
        "end_off_percent": rounded(100 * off_m[-1] / way_m),
        "worst_off_percent": rounded(100 * off_m.max() / way_m),
        **rigid_errors(T, true),
        "similarity": position_errors(T, true),
        "rotation": rotation_errors(found.times, T[:, :3, :3], Rotation.from_matrix(true[:, :3, :3])),
        "off_m": spread(off_m),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, nargs="+", default=[30.0, 120.0, 300.0, 600.0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--fps", type=float, default=15.0, help="of the walk that is mapped")
    parser.add_argument("--query-fps", type=float, default=1.0, help="how many frames a second are localized")
    parser.add_argument("--readout-ms", type=float, default=0.0, help="of a rolling shutter")
    parser.add_argument("--cache", type=Path, help="where the simulated recordings are kept")
    parser.add_argument("--only", nargs="+", choices=("waypoints", "imu", "simulate"), default=("waypoints", "imu"))
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    building = make_site(Site.BUILDING, arguments.seed)
    assert isinstance(building, Building)
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as temporary:
        cache = arguments.cache or Path(temporary)
        for seconds in arguments.seconds:
            options = seconds, arguments.seed
            walk = simulated(cache, 1, *options, arguments.fps, arguments.readout_ms)
            asked = {n: simulated(cache, n, *options, arguments.query_fps, arguments.readout_ms) for n in ASKED_WALKS}
            figures: dict[str, Any] = {}
            if "waypoints" in arguments.only:
                map_, figures = mapped(walk)
                if map_ is not None:
                    figures |= {f"walk {n}": localized(map_, folder, building) for n, folder in asked.items()}
            if "imu" in arguments.only:
                figures["imu alone"] = drift(walk)
            found[f"{seconds:.0f} s"] = figures
            if not arguments.json:
                by_room = {n: figures[n].pop("by room") for n in map("walk {}".format, ASKED_WALKS) if n in figures}
                print_figures(f"{seconds:.0f} s", figures)
                for name, rooms in by_room.items():
                    rows = [{name: room, **values} for room, values in rooms.items()]
                    print_table(rows, list(rows[0]))
    costs = [(s, found[f"{s:.0f} s"].get("mapping_s")) for s in arguments.seconds]
    slopes = {
        f"slope {a[0]:.0f}-{b[0]:.0f} s": rounded((b[1] - a[1]) / (b[0] - a[0]))
        for a, b in pairwise(costs)
        if a[1] is not None and b[1] is not None
    }
    if arguments.json:
        print(json.dumps({**found, **slopes}, indent=2))
    elif slopes:
        print_figures("mapping seconds a further second of recording", slopes)


if __name__ == "__main__":
    main()
