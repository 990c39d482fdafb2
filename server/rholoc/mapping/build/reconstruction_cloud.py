"""Points of the reconstruction that are not landmarks: seen by too few views to localize with, but useful for
display.
"""

import numpy as np

from rholoc.geometry import BoolArray, IntArray, evenly
from rholoc.mapping.build.assembly import mean_colours
from rholoc.mapping.build.landmarks import Landmarks, relative_sigmas
from rholoc.mapping.build.tracks import Views
from rholoc.maps import Cloud

_MAX_POINTS = 500_000
_MAX_RELATIVE_SIGMA = 0.1  # of the largest standard deviation against the distance it is seen from


def cloud_of(views: Views, reconstructed: Landmarks, is_landmark: BoolArray, view_sources: IntArray) -> Cloud:
    """Points with a largest sigma below a tenth of their distance, at most 500,000; empty if the views have no colour.

    Args:
        views: K views.
        reconstructed: all F reconstructed points.
        is_landmark: (F,) mask of the map's landmarks, which are left out.
        view_sources: (K,) row of the recording that each view comes from; a point gets its first view's.
    """
    colours = views.features.colours
    shown = np.flatnonzero(~is_landmark & (relative_sigmas(views, reconstructed) < _MAX_RELATIVE_SIGMA))
    if colours is None or not len(shown):
        return Cloud()
    shown = shown[evenly(len(shown), _MAX_POINTS)]
    rows = reconstructed.observed_rows
    labels = reconstructed.labels[rows]
    sources = np.zeros(len(reconstructed), dtype=np.int32)
    sources[labels[::-1]] = view_sources[views.view_of[rows[::-1]]]  # of the first view that saw it
    tints = mean_colours(colours[rows], labels, len(reconstructed))
    return Cloud(reconstructed.positions[shown].astype(np.float32), tints[shown], sources[shown])
