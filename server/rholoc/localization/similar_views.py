"""Place recognition without a pose: the views of a map that look most like a picture."""

from dataclasses import dataclass

import numpy as np

from rholoc.features import FeatureSet
from rholoc.geometry import Pose
from rholoc.localization.large_map import AnyLocalizer


@dataclass(frozen=True, eq=False)
class LikelyView:
    """A view of the map that looks like a picture.

    Attributes:
        view: row of the view in the map.
        pose: pose of the view's camera in the map frame.
        score: sum of the matches' votes for the view; comparable between maps with the same kind of features.
    """

    view: int
    pose: Pose
    score: float


def likeliest_views(localizer: AnyLocalizer, features: FeatureSet, most: int) -> list[LikelyView]:
    """The views of a map, ranked by votes of a picture's features. At most ``most``, best first; none without votes."""
    votes = localizer.view_votes(features)
    best = np.argsort(-votes, kind="stable")[:most]
    return [
        LikelyView(int(view), Pose(localizer.map.views.T_map_camera[view]), float(votes[view]))
        for view in best
        if votes[view] > 0
    ]
