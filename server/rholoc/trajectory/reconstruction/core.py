"""The pictures over which parts agree that contradict each other as a whole."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rholoc.errors import MappingFailed
from rholoc.geometry import IntArray
from rholoc.trajectory.checks.agreeing_core import Links, agreeing_core
from rholoc.trajectory.optimization.rounds import AdjustmentProgress
from rholoc.trajectory.reconstruction.figures import depths_of
from rholoc.trajectory.reconstruction.outcome import fewest_placed
from rholoc.trajectory.reconstruction.part import Part, Pictured, Start, adjusted_part, agreement_of
from rholoc.trajectory.visual.matching import VerifiedPair
from rholoc.trajectory.visual.tracks import Observations

_MIN_PICTURES = 4


def agreeing_cores(
    parts: Sequence[Part], walk: Pictured, whole: Observations, progress: AdjustmentProgress
) -> list[Part]:
    """The parts, restricted to the pictures over which all of them agree, and adjusted again to ``whole`` sightings.

    Two parts that agree are not enough where a third one places their pictures differently: they may be mistaken alike,
    by places that look alike. Empty if there is one part alone, the pictures are too few for a map, an adjustment
    fails, or the parts do not agree after it.
    """
    count = len(walk.sights.rows)
    core = _core(parts, count, walk.evidence.sequential)
    if len(parts) < 2 or len(core) < max(_MIN_PICTURES, fewest_placed(count, is_film=False)):
        return []
    try:
        found = [adjusted_part(walk, whole, _restricted(part, core), progress, (0.75, 0.75)) for part in parts]
    except (MappingFailed, RuntimeError):
        return []
    return found if all(agreement_of(found[0], other).same for other in found[1:]) else []


def _core(parts: Sequence[Part], count: int, pairs: Sequence[VerifiedPair]) -> IntArray:
    """Numbers of those of ``count`` pictures over which all parts agree, increasing."""
    links = Links(
        np.array([(pair.first, pair.second) for pair in pairs]), np.array([len(pair.matches) for pair in pairs])
    )
    first = parts[0]
    T, core = first.held_poses(count)
    depths = np.full(count, np.nan)
    depths[first.members] = depths_of(first.problem.observations, first.adjusted, len(first.members))
    for other in parts[1:]:
        T_other, held = other.held_poses(count)
        core = agreeing_core(T, T_other, core & held, links, depths)
    return np.flatnonzero(core)


def _restricted(part: Part, members: IntArray) -> Start:
    """The poses of some ``members`` (N,) of a part."""
    state = part.start[0]
    return replace(state, T_map_camera=state.T_map_camera[np.searchsorted(part.members, members)]), members
