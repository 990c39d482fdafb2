"""Make the directions that shortened SIFT descriptors are projected on, from simulated rooms alone.

    python benchmarks/train_sift_basis.py [--out FILE] [--rooms 6] [--views 12]

Writes the mean and the 64 strongest principal directions of RootSIFT descriptors (float16, 65 × 128, 17 KB), and prints
how much of the descriptors' variance 32, 48 and 64 of them keep: in the rooms they were made from, and in others.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

from rholoc.features.extractors import _sift
from rholoc.geometry import FloatArray
from rholoc.simulation import PHONE_CAMERA, Light, make_test_site, make_walk, render_view

DIRECTIONS = 64
DEFAULT_OUT = Path(_sift.__file__).with_name("sift_basis.npy")


def descriptors_of(seed: int, views: int) -> FloatArray:
    """RootSIFT descriptors (N, 128) of views along a walk through a simulated room, whole and shrunk, in all lights."""
    scene = make_test_site(seed)
    walk = make_walk(1, 30.0, seed)
    lights = list(Light)
    found = []
    for number, pose in enumerate(walk.poses(np.linspace(1, 29, views))):
        image = render_view(scene, PHONE_CAMERA, pose, lights[number % len(lights)], seed)
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        for scale in (1.0, 0.5):
            sized = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            _, descriptors = cv2.SIFT_create(nfeatures=1000, contrastThreshold=0.02).detectAndCompute(sized, None)
            if descriptors is not None:
                found.append(_sift.root_sift(descriptors))
    return np.concatenate(found)


def kept(descriptors: FloatArray, mean: FloatArray, directions: FloatArray, count: int) -> float:
    """The share of variance that the first directions keep."""
    centred = descriptors - mean
    return float(((centred @ directions[:count].T) ** 2).sum() / (centred**2).sum())


def main() -> None:
    """Run the training."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=DEFAULT_OUT)
    parser.add_argument("--rooms", type=int, default=6)
    parser.add_argument("--views", type=int, default=12)
    args = parser.parse_args()
    training = np.concatenate([descriptors_of(seed, args.views) for seed in range(args.rooms)])
    other = descriptors_of(args.rooms, args.views)
    mean = training.mean(axis=0)
    _, vectors = np.linalg.eigh(np.cov((training - mean).T))
    directions = vectors[:, ::-1].T[:DIRECTIONS]
    np.save(args.out, np.vstack([mean, directions]).astype(np.float16))
    print(f"{len(training)} descriptors of {args.rooms} rooms → {args.out.name}, {args.out.stat().st_size} bytes")
    for count in (32, 48, 64):
        print(
            f"{count} directions keep {kept(training, mean, directions, count):.3f} of the variance, "
            f"{kept(other, mean, directions, count):.3f} in another room"
        )


if __name__ == "__main__":
    main()
