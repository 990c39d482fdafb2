"""Make the directions that XFeat's descriptors are projected on, from simulated rooms alone.

    python benchmarks/train_xfeat_basis.py [--out FILE] [--rooms 4] [--views 6]

Writes the mean of the network's descriptors and the 40 directions in which they differ most (PCA). Weak directions
gain a little, since what is alike in the strong ones alone is often only of the same kind. Then all are rotated, so
that all bytes carry equal variance, and scaled so that the limits that SIFT's distances are held against fit
(rholoc.features.matching.LIMITS): few pairs of different points are as near each other as matches must be. Prints how
much of the variance is kept, and quantiles of the distances between different points, beside sift48's.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from rholoc.features import Metric, get_extractor
from rholoc.features.extractors import xfeat
from rholoc.features.extractors._sift import evening_rotation
from rholoc.features.matching import LIMITS
from rholoc.geometry import ByteArray, FloatArray
from rholoc.simulation import PHONE_CAMERA, Light, make_test_site, make_walk, render_view

DEFAULT_OUT = Path(xfeat.__file__).with_name(xfeat.BASIS_FILE)
EVENED = 0.15  # the power of a direction's variance that is divided out
ALIKE = 0.03  # the share of pairs of different points that are within the loose limit; real rooms have more
PAIRS = 100_000


def views_of(seed: int, count: int) -> list[ByteArray]:
    """Pictures along a walk through a simulated room, in all lights."""
    scene = make_test_site(seed)
    walk = make_walk(1, 30.0, seed)
    lights = list(Light)
    poses = walk.poses(np.linspace(1, 29, count))
    return [render_view(scene, PHONE_CAMERA, pose, lights[n % len(lights)], seed) for n, pose in enumerate(poses)]


def descriptors_of(views: list[ByteArray]) -> FloatArray:
    """What the network says (N, 64) of the features of pictures."""
    extractor = xfeat.EXTRACTOR
    return np.concatenate([xfeat.described(view, extractor.longest_px, extractor.features)[1] for view in views])


def distances(descriptors: FloatArray) -> FloatArray:
    """Between descriptors (N, D) of different features, a sample."""
    a, b = np.random.default_rng(0).integers(0, len(descriptors), (2, PAIRS))
    return np.linalg.norm(descriptors[a[a != b]] - descriptors[b[a != b]], axis=1)


def main() -> None:
    """Run the training."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=DEFAULT_OUT)
    parser.add_argument("--rooms", type=int, default=4)
    parser.add_argument("--views", type=int, default=6)
    args = parser.parse_args()
    views = [view for seed in range(args.rooms) for view in views_of(seed, args.views)]
    training, other = descriptors_of(views), descriptors_of(views_of(args.rooms, args.views))
    mean = training.mean(axis=0)
    variances, vectors = np.linalg.eigh(np.cov((training - mean).T))
    strongest = np.argsort(-variances)[: xfeat.DESCRIPTOR_BYTES]
    directions = vectors[:, strongest] / variances[strongest] ** EVENED @ evening_rotation(xfeat.DESCRIPTOR_BYTES)
    directions *= LIMITS[Metric.EUCLIDEAN].loose / np.quantile(distances((training - mean) @ directions), ALIKE)
    np.save(args.out, np.vstack([mean, directions.T]).astype(np.float32))
    print(f"{len(training)} descriptors of {args.rooms} rooms → {args.out.name}, {args.out.stat().st_size} bytes")
    print(
        f"{xfeat.DESCRIPTOR_BYTES} directions keep {variances[strongest].sum() / variances.sum():.3f} of the variance"
    )
    shares = (0.001, 0.01, 0.1, 0.5)
    sift = get_extractor("sift48")
    for name, found in (
        ("sift48", distances(np.concatenate([sift.extract(view).descriptors for view in views]).astype(np.float32))),
        ("xfeat", distances((training - mean) @ directions)),
        ("xfeat, another room", distances((other - mean) @ directions)),
    ):
        print(f"{name}: " + ", ".join(f"{100 * share:g} % {np.quantile(found, share):.0f}" for share in shares))


if __name__ == "__main__":
    main()
