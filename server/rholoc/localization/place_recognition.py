"""Which place? The views of a map that a picture is most like, without a pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rholoc.features import FeatureSet
from rholoc.geometry import Pose
from rholoc.localization.large_map import AnyLocalizer


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


def likeliest_views(localizer: AnyLocalizer, features: FeatureSet, most: int) -> list[LikelyView]:
    """The views of a map that a picture's features speak for, at most ``most``, the likeliest first."""
    votes = localizer.view_votes(features)
    best = np.argsort(-votes, kind="stable")[:most]
    return [
        LikelyView(int(view), Pose(localizer.map.views.T_map_camera[view]), float(votes[view]))
        for view in best
        if votes[view] > 0
    ]
