"""Make the directions that descriptors of SIFT and XFeat are projected on, from simulated rooms alone.

    python benchmarks/train_bases.py [sift] [xfeat]

sift: the mean and the 64 strongest principal directions of RootSIFT descriptors (float16, 65 × 128, 17 KB). xfeat: the
mean of the network's descriptors and the 40 directions in which they differ most. Weak directions gain a little, since
descriptors that agree in the strong ones alone are often only of the same kind of thing. Then all are rotated, so
that all bytes carry equal variance, and scaled so that the limits of SIFT's distances fit
(rholoc.features.matching.LIMITS): few pairs of different points are as near each other as matches must be. Prints the
share of the variance that is kept, in the rooms of the training and in another one, and of XFeat quantiles of the
distances between different points.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np

from rholoc.features import Metric
from rholoc.features.extractors import _sift, xfeat
from rholoc.features.matching import LIMITS
from rholoc.geometry import ByteArray, FloatArray
from rholoc.simulation import PHONE_CAMERA, Light, make_test_site, make_walk, render_view

SIFT_DIRECTIONS = 64
EVENED = 0.15  # the power of a direction's variance that is divided out
ALIKE = 0.03  # the share of pairs of different points that are within the loose limit; real rooms have more
PAIRS = 100_000
SHARES = (0.001, 0.01, 0.1, 0.5)


def views_of(seed: int, count: int) -> list[ByteArray]:
    """Pictures along a walk through a simulated room, in all lights."""
    scene, lights = make_test_site(seed), list(Light)
    poses = make_walk(1, 30.0, seed).poses(np.linspace(1, 29, count))
    return [render_view(scene, PHONE_CAMERA, pose, lights[n % len(lights)], seed) for n, pose in enumerate(poses)]


def sift_of(seed: int) -> FloatArray:
    """RootSIFT descriptors (N, 128) of a room's pictures, whole and shrunk to half their size."""
    found = []
    for image in views_of(seed, 12):
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        for scale in (1.0, 0.5):
            sized = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            _, descriptors = cv2.SIFT_create(nfeatures=1000, contrastThreshold=0.02).detectAndCompute(sized, None)
            if descriptors is not None:
                found.append(_sift.root_sift(descriptors))
    return np.concatenate(found)


def xfeat_of(seed: int) -> FloatArray:
    """The network's descriptors (N, 64) of a room's pictures."""
    extractor = xfeat.EXTRACTOR
    return np.concatenate(
        [xfeat.described(view, extractor.longest_px, extractor.features)[1] for view in views_of(seed, 6)]
    )


def principal(training: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean (D,), variances (D,) and directions (D, D) in columns of descriptors (N, D), the strongest first."""
    mean = training.mean(axis=0)
    variances, vectors = np.linalg.eigh(np.cov((training - mean).T))
    return mean, variances[::-1], vectors[:, ::-1]


def print_kept(name: str, descriptors: FloatArray, mean: FloatArray, directions: FloatArray) -> None:
    """Print the share of variance that orthonormal directions (D, K) keep."""
    centred = descriptors - mean
    share = float(((centred @ directions) ** 2).sum() / (centred**2).sum())
    print(
        f"{name}: {directions.shape[1]} directions keep {share:.3f} of the variance of {len(descriptors)} descriptors"
    )


def distances(descriptors: FloatArray) -> FloatArray:
    """Distances between descriptors (N, D) of different features, a sample."""
    a, b = np.random.default_rng(0).integers(0, len(descriptors), (2, PAIRS))
    return np.linalg.norm(descriptors[a[a != b]] - descriptors[b[a != b]], axis=1)


def train_sift() -> None:
    """Write SIFT's basis."""
    training, other = np.concatenate([sift_of(seed) for seed in range(6)]), sift_of(6)
    mean, _, directions = principal(training)
    kept = directions[:, :SIFT_DIRECTIONS]
    np.save(Path(_sift.__file__).with_name("sift_basis.npy"), np.vstack([mean, kept.T]).astype(np.float16))
    for count in (32, 48, 64):
        print_kept("sift", training, mean, kept[:, :count])
        print_kept("sift, another room", other, mean, kept[:, :count])


def train_xfeat() -> None:
    """Write XFeat's basis."""
    training, other = np.concatenate([xfeat_of(seed) for seed in range(4)]), xfeat_of(4)
    mean, variances, directions = principal(training)
    size = xfeat.DESCRIPTOR_BYTES
    print_kept("xfeat", training, mean, directions[:, :size])
    scaled = directions[:, :size] / variances[:size] ** EVENED @ _sift.evening_rotation(size)
    scaled *= LIMITS[Metric.EUCLIDEAN].loose / np.quantile(distances((training - mean) @ scaled), ALIKE)
    np.save(Path(xfeat.__file__).with_name(xfeat.BASIS_FILE), np.vstack([mean, scaled.T]).astype(np.float32))
    for name, found in (("xfeat", training), ("xfeat, another room", other)):
        apart = distances((found - mean) @ scaled)
        print(f"{name}: " + ", ".join(f"{100 * share:g} % {np.quantile(apart, share):.0f}" for share in SHARES))


TRAINED = {"sift": train_sift, "xfeat": train_xfeat}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bases", nargs="*", help=f"default: {', '.join(TRAINED)}")
    for name in parser.parse_args().bases or TRAINED:
        TRAINED[name]()
