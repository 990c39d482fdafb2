"""How exact the tensor densities are, and what they cost.

    python benchmarks/tensor_density.py [--densities 300] [--seed 0]

Landmarks are 1–5 m from the places they are seen from, in all directions; poses are anywhere in the domain of a
density, with any roll, such that a camera of 640 × 480 px and a focal length of 525 px sees the landmark. Prints, for
each degree, how far the polynomial's peak over (u, v) lies from the landmark's projection, in pixels, by the angle
between the heading and the density's direction; how far the value there is from 1, as the offset in pixels that would
do the same; and milliseconds for a fit, and for the values and gradients of 200 and 500 features at one pose.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from itertools import pairwise

import numpy as np

from rholoc.density.tensor import DEGREES, TARGET_RADIUS, TensorDensities, fit_tensors
from rholoc.geometry import FloatArray, Pose

FOCAL_PX = 525.0
HALF_WIDTH, HALF_HEIGHT = 320 / FOCAL_PX, 240 / FOCAL_PX
RADIUS_SHARE = 0.6  # of the distance: the domain that maps are built with
POSES_EACH = 20
BANDS_DEG = (0, 15, 30, 40, 50)


def random_densities(count: int, degree: int, seed: int) -> TensorDensities:
    """Densities of random landmarks."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    distances = rng.uniform(1, 5, count)
    places = rng.uniform(-3, 3, (count, 3))
    return fit_tensors(places + distances[:, None] * directions, places, RADIUS_SHARE * distances, degree)


def peak_errors(densities: TensorDensities, seed: int) -> FloatArray:
    """(N, 3): degrees off the direction, the peak's offset in pixels, the height's error as an offset in pixels."""
    rng = np.random.default_rng(seed)
    found = []
    for k in range(len(densities)):
        one = densities.take(np.array([k]))
        for _ in range(POSES_EACH):
            position = densities.places[k] + densities.radii[k] * rng.uniform(-1, 1, 3)
            heading = densities.directions[k] + rng.uniform(-1, 1, 3)
            pose = Pose.from_heading(position, heading / np.linalg.norm(heading), rng.uniform(-np.pi, np.pi))
            x, y, z = (densities.landmarks[k] - position) @ pose.R_map_camera
            seen = z > 0 and abs(x) < HALF_WIDTH * z and abs(y) < HALF_HEIGHT * z
            if not seen or not densities.valid_at(position, pose.heading, np.array([k]))[0]:
                continue
            peaks = one.at(np.array([[x / z, y / z]]), pose.T_map_camera)
            off_deg = np.degrees(np.arccos(densities.directions[k] @ pose.heading))
            height_px = FOCAL_PX * TARGET_RADIUS * np.sqrt(abs(1 - peaks.value[0]))
            found.append((off_deg, FOCAL_PX * np.linalg.norm(peaks.offset[0]), height_px))
    return np.array(found)


def milliseconds(work: Callable[[], object], repeats: int = 20) -> float:
    """The median of several runs."""
    work()
    taken = []
    for _ in range(repeats):
        started = time.perf_counter()
        work()
        taken.append(time.perf_counter() - started)
    return 1e3 * float(np.median(taken))


def evaluation_ms(densities: TensorDensities, pose: Pose) -> float:
    """How long values and gradients of all densities at one pose take."""
    plane = np.zeros((len(densities), 2))
    return milliseconds(lambda: densities.at(plane, pose.T_map_camera))


def main() -> None:
    parser = argparse.ArgumentParser(description="How exact the tensor densities are, and what they cost.")
    parser.add_argument("--densities", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    print("P   heading off    poses  peak off by px: median   90 %   99 %   height as px: median")
    for degree in DEGREES:
        started = time.perf_counter()
        densities = random_densities(args.densities, degree, args.seed)
        fit_ms = 1e3 * (time.perf_counter() - started) / len(densities)
        plane = np.zeros((len(densities), 2))
        pose = Pose.from_heading(densities.places[0], densities.directions[0])
        if not densities.at(plane, pose.T_map_camera).peaked.any():
            print(f"{degree}   no peak: linear in u and in v     fit {fit_ms:.1f} ms each")
            continue
        errors = peak_errors(densities, args.seed)
        for low, high in [*pairwise(BANDS_DEG), (BANDS_DEG[0], BANDS_DEG[-1])]:
            band = errors[(errors[:, 0] >= low) & (errors[:, 0] < high)]
            offsets = np.percentile(band[:, 1], [50, 90, 99])
            print(
                f"{degree}   {low:2d}–{high:2d}°        {len(band):5d}"
                f"                 {offsets[0]:8.3f} {offsets[1]:6.3f} {offsets[2]:6.3f}"
                f"                 {np.median(band[:, 2]):6.2f}"
            )
        rows = np.random.default_rng(args.seed).integers(0, len(densities), 500)
        at_pose = [evaluation_ms(densities.take(rows[:count]), pose) for count in (200, 500)]
        kept = densities.coefficients[0].size
        print(
            f"{degree}   fit {fit_ms:.1f} ms each; {kept} coefficients kept of {(degree + 1) ** 8}; "
            f"200 features at one pose {at_pose[0]:.2f} ms, 500 {at_pose[1]:.2f} ms"
        )


if __name__ == "__main__":
    main()
