"""Real pairs of pictures of one scene under two lights, as in Middlebury Stereo 2014.

One folder per scene, with any of ``right_default.png`` and ``right_changed.png``, registered pixel for pixel, and
``left_default.png``, which ``right_changed.png`` is the rectified stereo partner of; ``calib.txt`` states as ``ndisp``
the largest disparity in pixels.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rholoc.errors import InvalidInput
from rholoc.features import Extractor, FeatureSet, extractor_names, get_extractor
from rholoc.features.matching import mutual_matches
from rholoc.progress import ProgressListener, Stage, silent
from rholoc.recordings import read_image
from rholoc_lab.evaluation.redetection import Redetection, redetection

_CHANGED, _DEFAULT, _LEFT, _CALIBRATION = "right_changed.png", "right_default.png", "left_default.png", "calib.txt"
_MAX_ROW_OFFSET_PX = 1.0


@dataclass(frozen=True)
class ScenePair:
    """One extractor's figures on one scene.

    Attributes:
        scene: the folder's name.
        features: the extractor's name.
        registered: of the registered pair; None where there is none.
        stereo_matches, stereo_right: mutual matches of the stereo pair, and those less than a row apart whose
            disparity is possible; None where there is none.
    """

    scene: str
    features: str
    registered: Redetection | None
    stereo_matches: int | None
    stereo_right: int | None

    @property
    def stereo_precision(self) -> float | None:
        """The share 0..1 of stereo matches that are right."""
        if not self.stereo_matches or self.stereo_right is None:
            return None
        return self.stereo_right / self.stereo_matches

    def figures(self) -> dict[str, Any]:
        """All figures, JSON-serialisable."""
        none = dict.fromkeys(("repeatability", "precision", "right_matches"))
        return {
            "scene": self.scene,
            "features": self.features,
            **(none if self.registered is None else self.registered.figures()),
            "stereo_precision": self.stereo_precision,
            "stereo_right_matches": self.stereo_right,
        }


def compare_lighting_pairs(
    folder: Path, extractors: Sequence[str] | None = None, progress: ProgressListener = silent
) -> list[ScenePair]:
    """Every scene of a folder by every extractor.

    Raises:
        InvalidInput: the folder has no scene, a scene no ``ndisp``, or an extractor does not exist.
        InvalidImage: a picture cannot be read, or the registered ones differ in size.
    """
    scenes = sorted(path.parent for path in folder.glob(f"*/{_CHANGED}"))
    if not scenes:
        raise InvalidInput(
            f"{folder} has no lighting pairs.", f"It needs one folder per scene, each with {_CHANGED} and {_DEFAULT}."
        )
    names = list(extractors or extractor_names())
    found = []
    for scene in scenes:
        for name in names:
            found.append(_compare_scene(scene, get_extractor(name)))
            progress(Stage.REPORT, len(found) / (len(scenes) * len(names)), f"{scene.name}, {name}")
    return found


def registered_redetection(a: FeatureSet, b: FeatureSet, extractor: Extractor) -> Redetection:
    """Redetection between two pictures that a camera at rest took."""
    return redetection(a, b, a.pixels.astype(np.float64), extractor.metric)


def stereo_counts(
    left: FeatureSet, right: FeatureSet, extractor: Extractor, max_disparity_px: float
) -> tuple[int, int]:
    """Mutual matches of a rectified pair, and how many of them a stereo camera could see: a row, a possible disparity.

    A match that is wrong along the row counts as right, so this flatters.
    """
    matches = mutual_matches(left, right, extractor.metric, np.inf)
    du, dv = (left.pixels[matches[:, 0]] - right.pixels[matches[:, 1]]).T
    right_ = (np.abs(dv) < _MAX_ROW_OFFSET_PX) & (du >= 0) & (du <= max_disparity_px)
    return len(matches), int(right_.sum())


def _compare_scene(scene: Path, extractor: Extractor) -> ScenePair:
    changed = extractor.extract(read_image(scene / _CHANGED))
    registered = stereo = None
    if (scene / _DEFAULT).is_file():
        registered = registered_redetection(extractor.extract(read_image(scene / _DEFAULT)), changed, extractor)
    if (scene / _LEFT).is_file():
        left = extractor.extract(read_image(scene / _LEFT))
        stereo = stereo_counts(left, changed, extractor, _max_disparity_px(scene / _CALIBRATION))
    return ScenePair(scene.name, extractor.name, registered, *(stereo or (None, None)))


def _max_disparity_px(path: Path) -> float:
    try:
        found = re.search(r"^\s*ndisp\s*=\s*(\d+)", path.read_text(encoding="utf-8"), re.MULTILINE)
    except (OSError, UnicodeDecodeError):
        found = None
    if found is None:
        raise InvalidInput(f"{path} does not state the maximum disparity.", "Add a line such as ndisp=64.")
    return float(found[1])
