"""Which features survive a change of light, as server/LIGHT.md shows it: simulated lights, and real pairs of pictures.

    python benchmarks/light.py [pairs] [lights] [--write]

Runs `rholoc compare --lighting-pairs` on the shared pairs, and `rholoc compare --lighting`, for every extractor. Prints
their figures: of the simulated lights means over the pairs of map and query in the same light, in full and in half
artificial light, and in daylight and artificial light. With ``--write`` they go to benchmarks/results, and from there
into the documents.
"""

import json
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from figures import FRAME_PERCENT, Figure, Figures, run
from measuring import SHARED_DATA

UNITS = {
    "repeatability": "repeatability_percent",
    "precision": "precision_percent",
    "stereo_precision": "stereo_precision_percent",
    "recall_5cm_5deg": "within_5cm_percent",
    "right_matches": "right_matches",
    "stereo_right_matches": "stereo_right_matches",
    "median_cm": "median_cm",
}


def compared(*options: object) -> list[dict[str, Any]]:
    """The figures that ``rholoc compare`` prints with these options."""
    command = [sys.executable, "-m", "rholoc", "compare", *map(str, options), "--json"]
    found: list[dict[str, Any]] = json.loads(subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout)
    return found


def figure(name: str, value: float) -> Figure:
    """A figure with its noise: shares in percent, matches as counts, errors in centimetres."""
    if UNITS[name].endswith("percent"):
        return Figure(round(100 * value, 2), FRAME_PERCENT, True)
    return Figure(round(value, 2), 0.1 if name == "median_cm" else 5.0, name != "median_cm")


def named(where: str, figures: dict[str, float | None]) -> Figures:
    """Those figures of ``figures`` that are known and quoted, by their names below ``where``."""
    known = {name: value for name in UNITS if (value := figures.get(name)) is not None}
    return {f"{where}.{UNITS[name]}": figure(name, value) for name, value in known.items()}


def pairs(_: Path) -> Figures:
    """Real pictures of one scene by two lights."""
    found: Figures = {}
    for one in compared("--lighting-pairs", SHARED_DATA / "lighting_pairs"):
        found |= named(f"pairs.{one['scene']}.{one['features']}", one)
    return found


def lights(_: Path) -> Figures:
    """Two walks through the test site in each of three lights."""
    groups: dict[str, list[dict[str, Any]]] = defaultdict(list)
    with tempfile.TemporaryDirectory() as folder:
        for one in compared("--lighting", "-o", folder):
            both = {one["map_light"], one["query_light"]}
            group = "same" if len(both) == 1 else "other" if "daylight" in both else "half"
            one["right_matches"] /= one["queries"]
            groups[f"lights.{group}.{one['features']}"].append(one)
    found: Figures = {}
    for where, rows in groups.items():
        found |= named(where, {name: float(np.mean([row[name] for row in rows])) for name in UNITS if name in rows[0]})
    return found


PARTS = {"pairs": pairs, "lights": lights}


if __name__ == "__main__":
    run(__doc__, PARTS)
