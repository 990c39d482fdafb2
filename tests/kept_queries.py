"""Queries as a service keeps them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rholoc.jobs import QueryStore
from rholoc.localization import Dof, Localizer, Query
from rholoc.mapping import AnsweredQuery
from rholoc.maps import Map

_APART_S = 1000.0


def keep_queries(data_dir: Path, map_: Map, room: Any, newest_s: float, count: int = 40) -> int:
    """Keep what a map answered cameras beside the walk through a room of points; returns how many it was sure of."""
    store, localizer = QueryStore(data_dir), Localizer(map_)
    for number, pose in enumerate(room.walk(2 * count, sideways_m=0.1)[:count]):
        features = room.see(pose, 700 + number)
        answer = localizer.localize(Query(features, room.camera, Dof.FREE))
        if answer.pose is not None and answer.covariance is not None:
            T, time_s = answer.pose.T_map_camera, newest_s - _APART_S * number
            query = AnsweredQuery(features, room.camera, T, answer.covariance, answer.confidence, time_s, "c" * 12)
            store.add(map_.info.id, query)
    return store.kept(map_.info.id).queries
