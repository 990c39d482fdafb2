"""Queries as a service keeps them."""

from pathlib import Path
from typing import Any

import numpy as np

from rholoc.features import FeatureSet
from rholoc.geometry import Camera, Pose
from rholoc.library.queries import QueryStore
from rholoc.mapping.learn.answered_query import AnsweredQuery
from rholoc.maps import Map
from rholoc.storage import ObjectStorage

LATELY_S = 4e9
"""Seconds since the epoch, later than now for long. Which queries are held back for a test goes by their times, and so
what there is to learn does."""

_APART_S = 1000.0


def a_query(x: float = 0.0, heading_deg: float = 0.0, time_s: float = 1e9, asker: str = "a" * 12) -> AnsweredQuery:
    """A query of random features from a place and a direction of looking."""
    rng = np.random.default_rng(0)
    turn = np.radians(heading_deg)
    pose = Pose.from_heading(np.array([x, 0.1, 1.4]), np.array([np.cos(turn), np.sin(turn), 0.0]))
    features = FeatureSet(
        rng.uniform(0, 400, (20, 2)).astype(np.float32),
        np.zeros(20, np.uint8),
        rng.integers(0, 256, (20, 48), dtype=np.uint8),
        np.full(20, 7, np.float32),
        np.full(20, np.nan, np.float32),
        rng.integers(0, 256, (20, 3), dtype=np.uint8),
    )
    camera = Camera(640, 480, 520.0, 521.0, 319.5, 239.5, (0.1, -0.2, 0.0, 0.0))
    return AnsweredQuery(features, camera, pose.T_map_camera, 1e-4 * np.eye(6), 0.97, time_s, asker)


def keep_queries(data_dir: Path, map_: Map, room: Any, newest_s: float, count: int = 36) -> int:
    """Keep queries of a map by cameras beside the walk through a room of points, with true poses; returns how many."""
    store = QueryStore(ObjectStorage(data_dir))
    for number, pose in enumerate(room.walk(2 * count, sideways_m=0.1)[:count]):
        features, time_s = room.see(pose, 700 + number), newest_s - _APART_S * number
        query = AnsweredQuery(features, room.camera, pose.T_map_camera, 1e-6 * np.eye(6), 0.97, time_s, "c" * 12)
        store.add(map_.info.id, query)
    return store.kept(map_.info.id).queries
