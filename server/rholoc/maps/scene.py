"""A map for a viewer: what is drawn of it, in as few bytes as will do."""

from __future__ import annotations

import numpy as np

from rholoc.maps.export import landmark_sigmas, view_headings
from rholoc.maps.map import Map


def map_to_scene(map_: Map) -> bytes:
    """Landmarks and views as little-endian numbers, one array after the other.

    Two uint32, the numbers F and K; (F, 4) float32 of each landmark's x, y, z and standard deviation; (K, 7) float32 of
    each view's x, y, z, heading and the number of the recording that it comes from. Lengths in metres.
    """
    sources = np.asarray(map_.extras.get("view_sources", np.zeros(len(map_.view_poses))))
    landmarks = np.column_stack([map_.landmarks, landmark_sigmas(map_)])
    views = np.column_stack([map_.view_poses[:, :3], view_headings(map_), sources])
    counts = np.array([len(landmarks), len(views)])
    return counts.astype("<u4").tobytes() + landmarks.astype("<f4").tobytes() + views.astype("<f4").tobytes()
