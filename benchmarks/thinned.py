"""How honest scale and positions of walks with an IMU are where pictures are few.

    python benchmarks/thinned.py [--seeds 0,1,2,3,4] [--rates 4,2,1,0.7] [--seconds 40] [--cache DIR] [--write]

Simulated walks of so many seconds through the test room, and the cut of EuRoC's V1_01, at fewer and fewer pictures a
second, without waypoints and poses. For each: pictures placed, by how much the scale is off and how many claimed
standard deviations these are; the median error of positions after a rigid alignment, and the share of positions
relative to the first picture, where the map frame is, within their 95 % regions. The last line counts all. With
``--write`` it goes to benchmarks/results/thinned.json.
"""

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from figures import REGION_95, Figure, quote_anew, write_results
from measuring import SHARED_DATA, print_table, rounded
from rholoc.errors import RholocError
from rholoc.geometry import FloatArray, kabsch, umeyama
from rholoc.maps import read_trajectory_csv
from rholoc.recordings import Recording, read_recording
from rholoc.recordings.frame_slice import select_frames
from rholoc.reports import ImuReport
from rholoc.trajectory import PoseMethod, Scale
from rholoc.trajectory.estimate import estimate_trajectory
from rholoc_lab.simulation.sites import Site, simulate_site

_EUROC = "euroc_v101"
_FEWEST = 12  # pictures of a walk
_COLUMNS = (
    *("walk", "Hz", "placed", "of", "trusted", "scale %", "claimed %", "sigmas"),
    *("median cm", "expected cm", "in region %", "how"),
)


def walks(seeds: list[int], seconds: float, rate_hz: float, cache: Path) -> Iterator[tuple[str, Recording, FloatArray]]:
    """Names, recordings and true poses (N, 4, 4)."""
    euroc = read_recording(SHARED_DATA / _EUROC)
    assert euroc.poses is not None
    yield _EUROC, replace(euroc, poses=None), euroc.poses.T_map_camera
    for seed in seeds:
        folder = cache / f"room-{seed}-{seconds:g}s-{rate_hz:g}hz"
        if not (folder / "made").exists():
            simulate_site(folder, Site.ROOM, seconds=seconds, seed=seed, fps=rate_hz)
            (folder / "made").touch()
        recording = replace(read_recording(folder), waypoints=())
        yield f"seed {seed}", recording, read_trajectory_csv(folder / "truth.csv").T_map_camera


def with_mean_rotation(true: FloatArray, found: FloatArray) -> FloatArray:
    """True poses (N, 4, 4), their cameras turned by the mean rotation to those found; paths are aligned first.

    The cut's truth is of a body, and how the camera is mounted on it is half a degree off.
    """
    R_found_true = kabsch(true[:, :3, 3], found[:, :3, 3]).rotation
    apart = np.swapaxes(true[:, :3, :3], 1, 2) @ R_found_true.T @ found[:, :3, :3]
    turned = true.copy()
    turned[:, :3, :3] = true[:, :3, :3] @ Rotation.from_matrix(apart).mean().as_matrix()
    return turned


def measure(name: str, recording: Recording, truth: FloatArray, rate_hz: float) -> dict[str, Any] | None:
    """One row of the table; None where too few pictures are left."""
    between_s = float(np.median(np.diff(recording.frames.times)))
    step = max(1, round(1 / rate_hz / between_s))
    first = int(recording.frames.numbers[0])
    thinned = select_frames(recording, slice(first, None, step))
    truth = truth[::step]
    row: dict[str, Any] = {"walk": name, "Hz": rate_hz, "of": len(truth)}
    if len(truth) < _FEWEST:
        return None
    try:
        found = estimate_trajectory(thinned, PoseMethod.AUTO)
    except RholocError as error:
        return row | {"how": error.message}
    report, true = found.report, truth[found.rows]
    row |= {"placed": len(found.rows), "trusted": report.trusted, "how": report.why}
    if found.scale is not Scale.METRIC or not isinstance(report.imu, ImuReport) or report.imu.scale_sigma is None:
        return row
    positions = found.T_map_camera[:, :3, 3]
    if name == _EUROC:
        true = with_mean_rotation(true, found.T_map_camera)
    off = abs(1 / umeyama(positions, true[:, :3, 3]).scale - 1)
    row |= {"scale %": rounded(100 * off), "claimed %": rounded(100 * report.imu.scale_sigma)}
    row["sigmas"] = rounded(off / report.imu.scale_sigma)
    assert found.covariances is not None
    off_m = np.linalg.norm(kabsch(true[:, :3, 3], positions).points(true[:, :3, 3]) - positions, axis=1)
    from_first = positions - (found.T_map_camera[0] @ np.linalg.inv(true[0]) @ true)[:, :3, 3]
    squared = [
        float(apart @ np.linalg.solve(covariance[:3, :3], apart))
        for apart, covariance in zip(from_first[1:], found.covariances[1:], strict=True)
    ]
    row["median cm"] = rounded(100 * float(np.median(off_m)))
    row["expected cm"] = rounded(100 * (report.expected_error_m or np.nan))
    row["in region %"] = rounded(100 * float(np.mean(np.array(squared) <= REGION_95)), 0)
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="0,1,2,3,4")
    parser.add_argument("--rates", default="4,2,1,0.7")
    parser.add_argument("--seconds", type=float, default=40.0)
    parser.add_argument("--cache", type=Path, help="where simulated walks are kept")
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    seeds = [int(one) for one in options.seeds.split(",")]
    table: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        cache = options.cache or Path(folder)
        rates = [float(one) for one in options.rates.split(",")]
        for name, recording, truth in walks(seeds, options.seconds, max(rates), cache):
            for rate_hz in rates:
                row = measure(name, recording, truth, rate_hz)
                if row is not None:
                    table.append(row)
                    print(row, flush=True)
    print_table(table, _COLUMNS)
    scaled = [row for row in table if "sigmas" in row]
    inside = np.average([row["in region %"] for row in scaled], weights=[row["placed"] for row in scaled])
    within = float(np.mean([row["sigmas"] <= 2 for row in scaled]))
    figures = {
        "thinned.walks": Figure(len(table), 0, True),
        "thinned.metric_percent": Figure(round(100 * len(scaled) / len(table), 1), 5.0, True),
        "thinned.scale_in_two_sigma_percent": Figure(round(100 * within, 1), 5.0, True),
        "thinned.in_region_percent": Figure(round(float(inside), 1), 3.0, True),
    }
    print(", ".join(f"{name} {one.value:g}" for name, one in figures.items()))
    if options.write:
        asked = f"--seeds {options.seeds} --rates {options.rates} --seconds {options.seconds:g}"
        write_results("thinned", figures, f"python benchmarks/thinned.py {asked} --write", seeds)
        quote_anew()


if __name__ == "__main__":
    main()
