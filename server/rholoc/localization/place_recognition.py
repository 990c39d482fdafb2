"""Which place? The views of a map that a picture is most like, without a pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rholoc.features import FeatureSet
from rholoc.geometry import Pose
from rholoc.localization.map_index import MapIndex
from rholoc.localization.seeds import view_votes


@dataclass(frozen=True, eq=False)
class LikelyView:
    """A view that a picture may show much the same as.

    Attributes:
        view: its number in the map.
        pose: where it was taken.
        score: how strongly the picture's features speak for it; comparable between maps of one kind of features.
    """

    view: int
    pose: Pose
    score: float


def likeliest_views(index: MapIndex, features: FeatureSet, most: int) -> list[LikelyView]:
    """The views that a picture's features speak for, at most ``most``, the likeliest first."""
    votes = view_votes(index, index.match_everywhere(features))
    best = np.argsort(-votes, kind="stable")[:most]
    return [
        LikelyView(int(view), Pose(index.map.T_map_camera[view]), float(votes[view]))
        for view in best
        if votes[view] > 0
    ]
