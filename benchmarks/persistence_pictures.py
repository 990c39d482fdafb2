"""Features that light leaves alone, in real pictures: which of them a light finds again that nobody chose them by.

    python benchmarks/persistence_pictures.py [--pictures ../shared/data/coloured_lights] [--features lab3]

Pictures of one room from one place by several lights, `LIGHT_SIDE.jpg`, white light several times (`white18` …). Of one
white picture's features the best are chosen, three ways: by how many other white pictures show them; by how many of all
pictures but the light's that is held back; and by how probably a further light shows them, all white ones being one
light. Prints which share of those chosen the light that was held back shows, in the mean over lights and sides. A
picture shows a feature where their mutual match agrees with the two pictures' epipolar geometry.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

from measuring import SHARED_DATA
from rholoc.features import Extractor, FeatureSet, get_extractor
from rholoc.features.matching import LIMITS, mutual_matches
from rholoc.geometry import BoolArray, FloatArray
from rholoc.recordings import read_image

WHITE = ("white18", "white19", "white20", "white21")  # with the curtains as by the coloured lights
SIDES = ("left", "right")
TOLERANCE_PX = 2.0
FEWEST = 15  # matches that agree
CHOSEN = (50, 100, 200)
WAYS = ("in white", "in all", "by persistence")


def shown(reference: FeatureSet, other: FeatureSet, extractor: Extractor) -> BoolArray:
    """Which features (N,) of one picture another one shows."""
    matches = mutual_matches(reference, other, extractor.metric, LIMITS[extractor.metric].loose)
    found = np.zeros(len(reference), dtype=np.bool_)
    if len(matches) < FEWEST:
        return found
    a, b = reference.pixels[matches[:, 0]], other.pixels[matches[:, 1]]
    _, agree = cv2.findFundamentalMat(a, b, cv2.USAC_MAGSAC, TOLERANCE_PX, 0.999, 5000)
    if agree is not None and agree.sum() >= FEWEST:
        found[matches[agree.ravel() > 0, 0]] = True
    return found


def best(count: int, *keys: FloatArray) -> FloatArray:
    """So many features of the greatest first key, those of the same by the next one, then by number."""
    return np.lexsort([np.arange(len(keys[0])), *(-key for key in reversed(keys))])[:count]


def shares(white: BoolArray, coloured: dict[str, BoolArray]) -> FloatArray:
    """(lights, counts, ways) the share of the chosen features that the light held back shows.

    Args:
        white: (W, N) which features the white pictures show.
        coloured: by light, which (N,) its picture shows.
    """
    table = np.zeros((len(coloured), len(CHOSEN), len(WAYS)))
    for i, (light, seen) in enumerate(coloured.items()):
        others = np.array([one for name, one in coloured.items() if name != light])
        pictures = white.sum(axis=0) + others.sum(axis=0)
        lights = white.any(axis=0).astype(int) + others.sum(axis=0)
        for j, count in enumerate(CHOSEN):
            ways = best(count, white.sum(axis=0)), best(count, pictures), best(count, lights, pictures)
            table[i, j] = [seen[rows].mean() for rows in ways]
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description="Features that light leaves alone, in real pictures.")
    parser.add_argument("--pictures", type=Path, default=SHARED_DATA / "coloured_lights")
    parser.add_argument("--features", default="lab3")
    args = parser.parse_args()
    extractor, tables = get_extractor(args.features), []
    for side in SIDES:
        paths = {path.stem.removesuffix(f"_{side}"): path for path in args.pictures.glob(f"*_{side}.jpg")}
        features = {light: extractor.extract(read_image(path)) for light, path in sorted(paths.items())}
        reference = features[WHITE[0]]
        if len(reference) == 0:
            raise SystemExit(f"{args.features} finds nothing in {WHITE[0]}_{side}.jpg.")
        white = np.array([shown(reference, features[light], extractor) for light in WHITE[1:]])
        coloured = {
            light: shown(reference, one, extractor) for light, one in features.items() if not light.startswith("white")
        }
        tables.append(shares(white, coloured))
        for light, row in zip(coloured, tables[-1], strict=True):
            figures = "   ".join(
                f"{count}: " + " ".join(f"{share:4.0%}" for share in ways)
                for count, ways in zip(CHOSEN, row, strict=True)
            )
            print(f"{side:5} {light:9} {figures}")
    mean = np.concatenate(tables).mean(axis=0)
    for count, ways in zip(CHOSEN, mean, strict=True):
        line = ", ".join(f"{way} {share:.0%}" for way, share in zip(WAYS, ways, strict=True))
        print(f"{args.features}, {count} features chosen by how often they are seen {line}")


if __name__ == "__main__":
    main()
