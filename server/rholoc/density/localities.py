"""Places that a feature was seen from (locality, the paper's section 4): each gets a density of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rholoc.density.density import Sightings
from rholoc.geometry import FloatArray, IntArray

_SAME_PLACE_RAD = np.deg2rad(20.0)  # how far apart a place's views may see a feature from
_SAME_PLACE_RATIO = 1.7  # of their distances from it
_MAX_PLACES = 4  # a feature
_MIN_VIEWS = 2  # of every place but a feature's first
_MAX_DENSITIES = 20_000  # 6.5 kB each with degree 2
_RADIUS_SHARE = 0.6  # of the distance, at least: the fit is exact in the position, the headings are its limit
_MAX_RADIUS_SHARE = 0.95  # at most: a landmark must stay ahead
_RADIUS_MARGIN = 1.2  # times the distance of the views from the middle of their place


@dataclass(frozen=True, eq=False)
class Places:
    """T places that features were seen from.

    Attributes:
        features: (T,) feature of each place, non-decreasing.
        positions: (T, 3) mean position of its views [m].
        radii: (T,) radius around it within which a density is to be valid [m].
        members: T arrays (n,) of rows of the sightings from the place, in their order.
    """

    features: IntArray
    positions: FloatArray
    radii: FloatArray
    members: tuple[IntArray, ...]

    @classmethod
    def of(cls, sightings: Sightings) -> Places:
        """Gather each feature's views into places; from one place it is seen from one side and at similar distances.

        Of more than 20,000 places, all features' first places stay, and of the others those with the most views.
        Positions and radii are rounded to float32, as files keep them.
        """
        order = np.argsort(sightings.features, kind="stable")
        bounds = np.searchsorted(sightings.features[order], np.arange(len(sightings.landmarks) + 1))
        features, positions, radii, support, of_place = [], [], [], [], []
        for feature, landmark in enumerate(sightings.landmarks):
            own = order[bounds[feature] : bounds[feature + 1]]
            seen_from = sightings.positions[own]
            for rank, members in enumerate(gather_places(landmark, seen_from)):
                position, radius_m = _place(landmark, seen_from[members])
                features.append(feature)
                positions.append(position)
                radii.append(radius_m)
                support.append(len(members) if rank else len(sightings.positions))
                of_place.append(own[members])
        most = max(_MAX_DENSITIES, len(sightings.landmarks))
        kept = np.sort(np.argsort(-np.array(support, dtype=np.int64), kind="stable")[:most])
        return cls(
            np.array(features, dtype=np.int64)[kept],
            np.array(positions).reshape(-1, 3)[kept].astype(np.float32).astype(np.float64),
            np.array(radii)[kept].astype(np.float32).astype(np.float64),
            tuple(of_place[row] for row in kept),
        )


def gather_places(landmark: FloatArray, seen_from: FloatArray) -> list[IntArray]:
    """Views of each place that a landmark (3,) was seen from, as rows of the positions ``seen_from`` (N, 3).

    At most four places, most views first: within 20° and a ratio of distances of 1.7 of one view. All but the first
    have at least two views; other views are left out.
    """
    away = seen_from - landmark
    distance = np.linalg.norm(away, axis=1)
    unit = away / distance[:, None]
    alike = (unit @ unit.T >= np.cos(_SAME_PLACE_RAD)) & (
        np.abs(np.log(distance[:, None] / distance)) <= np.log(_SAME_PLACE_RATIO)
    )
    left = np.ones(len(seen_from), dtype=bool)
    places: list[IntArray] = []
    while left.any() and len(places) < _MAX_PLACES:
        counts = np.where(left, (alike & left).sum(axis=1), 0)
        members = np.flatnonzero(alike[int(np.argmax(counts))] & left)
        if places and len(members) < _MIN_VIEWS:
            break
        places.append(members)
        left[members] = False
    return places


def _place(landmark: FloatArray, positions: FloatArray) -> tuple[FloatArray, float]:
    """Mean position (3,) of a place's views, and the radius [m] around it within which its density is valid.

    The radius is 1.2 × the largest distance of a view from the mean, but 0.6 to 0.95 × the landmark's distance.
    """
    middle = positions.mean(axis=0)
    distance = float(np.linalg.norm(landmark - middle))
    reach = _RADIUS_MARGIN * float(np.linalg.norm(positions - middle, axis=1).max())
    return middle, min(max(reach, _RADIUS_SHARE * distance), _MAX_RADIUS_SHARE * distance)
