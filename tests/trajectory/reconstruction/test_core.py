"""Parts that place some pictures alike and the others differently."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from scene import CAMERA, arc, cloud, in_pixels
from scipy.spatial.transform import Rotation

from rholoc.geometry import BoolArray, IntArray, Similarity, umeyama
from rholoc.progress import silent
from rholoc.trajectory.optimization.problem import State
from rholoc.trajectory.optimization.rounds import AdjustmentProgress
from rholoc.trajectory.reconstruction.core import agreeing_cores
from rholoc.trajectory.reconstruction.part import Part, Pictured, adjusted_part
from rholoc.trajectory.visual.matching import VerifiedPair
from rholoc.trajectory.visual.tracks import Observations

_COUNT, _POINTS = 12, 80
_ELSEWHERE = Similarity(1.0, Rotation.from_rotvec([0.0, 0.7, 0.0]).as_matrix(), np.array([1.0, 0.0, 0.5]))
_PROGRESS = AdjustmentProgress(silent)


def _walk(group: IntArray) -> Pictured:
    """Twelve pictures, of which each is linked to the next two: by many matches with those of its ``group`` (12,)."""
    pairs = [(k, k + step) for step in (1, 2) for k in range(_COUNT - step)]
    matches = [np.zeros((40 if group[a] == group[b] else 4, 2), np.int64) for a, b in pairs]
    linked = [VerifiedPair(a, b, some, np.eye(3)) for (a, b), some in zip(pairs, matches, strict=True)]
    taken = type("Sights", (), {"steps": ()})()
    things = {"rows": np.arange(_COUNT), "times": np.arange(float(_COUNT)), "camera": CAMERA}
    sights: Any = type("Sights", (), things | {"take": lambda *_: taken})()
    evidence: Any = type("Evidence", (), {"sequential": linked})()
    return Pictured(sights, CAMERA, evidence)


def _observations(group: IntArray) -> Observations:
    """What the pictures show of the points, to 0.3 px. Each ``group`` (12,) of them shows points of its own, so that
    nothing measures where it is beside the others.
    """
    exact = np.array([in_pixels(cloud(_POINTS), T) for T in arc(_COUNT)])
    pixels = exact + np.random.default_rng(0).normal(0, 0.3, exact.shape)
    keyframes, tracks = (some.ravel() for some in np.indices(pixels.shape[:2]))
    return Observations(keyframes, tracks + _POINTS * group[keyframes], pixels.reshape(-1, 2))


def _part(walk: Pictured, seen: Observations, elsewhere: BoolArray) -> Part:
    """A part with the pictures ``elsewhere`` (12,) away from their places."""
    T = arc(_COUNT)
    T[elsewhere] = _ELSEWHERE.poses(T[elsewhere])
    start = State(T, np.zeros((0, 3)), CAMERA), np.arange(_COUNT)
    return adjusted_part(walk, seen, start, _PROGRESS, (0.0, 0.5))


@pytest.mark.parametrize(
    ("sizes", "elsewhere", "core"),
    [
        ([8, 4], [[], [1]], range(8)),
        ([3, 3, 6], [[], [0], [1]], range(6, 12)),
        ([3, 3, 3, 3], [[], [1, 3]], []),
        ([12], [[]], []),
    ],
    ids=["two", "three", "three pictures are too few", "one alone"],
)
def test_the_pictures_that_all_parts_place_alike_are_left(
    sizes: list[int], elsewhere: list[list[int]], core: Sequence[int]
) -> None:
    """Each part has some of the groups elsewhere."""
    group = np.repeat(np.arange(len(sizes)), sizes)
    walk, seen = _walk(group), _observations(group)
    parts = [_part(walk, seen, np.isin(group, some)) for some in elsewhere]
    found = agreeing_cores(parts, walk, seen, _PROGRESS)
    assert [part.members.tolist() for part in found] == [list(core)] * (len(parts) if core else 0)
    for part in found:
        T = part.adjusted.state.T_map_camera
        aligned = umeyama(T[:, :3, 3], arc(_COUNT)[core, :3, 3]).poses(T)
        np.testing.assert_allclose(aligned, arc(_COUNT)[core], atol=0.02)
