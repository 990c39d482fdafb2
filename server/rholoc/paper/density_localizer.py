"""The paper's localizer (Figure 9): matches, their densities, and an ascent from where the features were seen.

Nothing else is asked: no sample is solved for a pose, no pose is verified, no rival looked for. What
:class:`rholoc.localization.Localizer` adds to it is what separates the two in figures.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rholoc.density import Evidence
from rholoc.features import FeatureSet
from rholoc.geometry import Camera, FloatArray
from rholoc.localization.index.map_index import MapIndex
from rholoc.localization.pose.ascent import Optimum, Step, climb, optimum_at
from rholoc.localization.pose.rematching import evidence_of
from rholoc.localization.pose.seeds import vote_for_places
from rholoc.localization.types import Dof
from rholoc.maps import Map

TOLERANCES_PX = (80.0, 40.0, 24.0, 12.0, 6.0, 4.0)
_ITERATIONS = 5
_VIEWS_EACH = 10
_MIN_MATCHES = 6


@dataclass(frozen=True, eq=False)
class Ascent:
    """A way to an optimum of equation (1).

    Attributes:
        evidence: the matches whose densities' product (2) was climbed.
        steps: every pose on the way and the tolerance that held there, the start first.
        optimum: where it ended.
    """

    evidence: Evidence
    steps: tuple[Step, ...]
    optimum: Optimum

    @property
    def positions(self) -> FloatArray:
        """Positions (S, 3) of the camera in the map [m], step by step."""
        return np.array([step.T_map_camera[:3, 3] for step in self.steps])

    @property
    def inliers(self) -> int:
        """Number of matches that agree with the optimum: their density there is above 0."""
        return int((self.optimum.density > 0).sum())


class DensityLocalizer:
    """Localizes frames in one map by its densities alone.

    Args:
        map_: the map.
        starts: how many voted places are climbed from.
        index: the map's, where another localizer has made it already.
    """

    def __init__(self, map_: Map, starts: int = 4, index: MapIndex | None = None) -> None:
        self.map = map_
        self.starts = starts
        self.index = index or MapIndex(map_)

    def ascents(
        self, features: FeatureSet, camera: Camera, dof: Dof = Dof.FREE, start: FloatArray | None = None
    ) -> Iterator[Ascent]:
        """Yield an ascent from the pose ``start`` (4, 4), or else from each of the ``starts`` views with the most
        votes.

        Yields nothing with fewer than six matches in the whole map.
        """
        everywhere = self.index.match_everywhere(features)
        if len(everywhere) < _MIN_MATCHES:
            return
        rays = camera.rays(features.pixels)
        places = vote_for_places(self.index, everywhere, 1 if start is not None else self.starts, _VIEWS_EACH, None)
        for place in places:
            matches = self.index.match_within(features, place.landmarks)
            evidence = evidence_of(self.index, matches, rays, camera)
            T = self.map.views.T_map_camera[place.view] if start is None else start
            densities = self.map.densities
            steps = tuple(climb(densities, evidence, T, TOLERANCES_PX, dof, _ITERATIONS))
            optimum = optimum_at(densities, evidence, steps[-1].T_map_camera, TOLERANCES_PX[-1])
            yield Ascent(evidence, steps, optimum)

    def localize(
        self, features: FeatureSet, camera: Camera, dof: Dof = Dof.FREE, start: FloatArray | None = None
    ) -> Ascent | None:
        """The one of :meth:`ascents` with the highest optimum; None without one, or with fewer than six inliers."""
        best = max(self.ascents(features, camera, dof, start), key=lambda one: one.optimum.value, default=None)
        return best if best is not None and best.inliers >= _MIN_MATCHES else None
