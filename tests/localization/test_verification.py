"""Verification: the last steps go by what was seen from hereabouts."""

from dataclasses import replace
from typing import Any

import numpy as np

from rholoc.geometry import Pose
from rholoc.localization import Dof, Query
from rholoc.localization.index.map_index import MapIndex
from rholoc.localization.pose.ascent import ascend
from rholoc.localization.pose.rematching import FINAL_TOLERANCE_PX, polished, verify
from rholoc.maps import DensityKind, Map, MapDescriptors, MapInfo, MapLandmarks, MapObservations, MapViews

_VIEWS = 12


def _map_of_here_and_elsewhere(point_room: Any, here: Pose, raised_m: float) -> tuple[Map, np.ndarray]:
    """Of what is in view, views at ``here`` saw three fifths; views beside it the others (F,), which are too high."""
    camera = point_room.camera
    shown = np.flatnonzero(camera.contains(camera.project((point_room.points - here.position) @ here.R_map_camera)))
    elsewhere = np.arange(len(shown)) % 5 >= 3
    aside = here.T_map_camera.copy()
    aside[:3, 3] += 0.3 * here.R_map_camera[:, 0]
    of_view = [np.flatnonzero(~elsewhere)] * _VIEWS + [np.flatnonzero(elsewhere)] * _VIEWS
    raised = np.where(elsewhere, raised_m, 0)[:, None] * (0.0, 0.0, 1.0)
    map_ = Map(
        info=MapInfo("0" * 32, 1, DensityKind.RAY, "gray", True, True, "2026-01-01T00:00:00Z", camera),
        landmarks=MapLandmarks(
            channels=np.zeros(len(shown), np.uint8),
            positions=(point_room.points[shown] + raised).astype(np.float32),
            covariances=np.tile(np.float32(0.002**2) * np.eye(3, dtype=np.float32), (len(shown), 1, 1)),
        ),
        descriptors=MapDescriptors(
            values=point_room.descriptors[shown], features=np.arange(len(shown), dtype=np.int32)
        ),
        views=MapViews(
            times=np.arange(2.0 * _VIEWS), T_map_camera=np.array([here.T_map_camera] * _VIEWS + [aside] * _VIEWS)
        ),
        observations=MapObservations(
            views=np.repeat(np.arange(2 * _VIEWS), [len(seen) for seen in of_view]).astype(np.int32),
            features=np.concatenate(of_view).astype(np.int32),
        ),
    )
    return map_, elsewhere


def test_the_last_steps_go_by_what_was_seen_from_hereabouts(point_room: Any) -> None:
    off_m: dict[str, list[float]] = {"verified": [], "climbed": []}
    exact = replace(point_room, noise_px=0.05)
    for seed, truth in enumerate(point_room.walk(6)):
        map_, elsewhere = _map_of_here_and_elsewhere(point_room, truth, raised_m=0.01)
        query = Query(exact.see(truth, 800 + seed), point_room.camera, Dof.FREE)
        rays = query.camera.rays(query.features.pixels)
        found = verify(MapIndex(map_), query, rays, truth.T_map_camera)
        assert elsewhere[found.matches.landmarks].sum() > 10
        climbed = ascend(map_.densities, found.evidence, truth.T_map_camera, (FINAL_TOLERANCE_PX,) * 3, Dof.FREE)
        for name, optimum in (("verified", found.optimum), ("climbed", climbed)):
            off_m[name].append(float(np.linalg.norm(optimum.T_map_camera[:3, 3] - truth.position)))
    assert np.median(off_m["verified"]) < 0.5 * np.median(off_m["climbed"])


def test_a_pose_is_polished_by_matches_that_the_narrow_radius_leaves_out(point_room: Any) -> None:
    off_m: dict[str, list[float]] = {"verified": [], "polished": []}
    blurred = replace(point_room, noise_px=4.0)
    for seed, truth in enumerate(point_room.walk(8)):
        map_, _ = _map_of_here_and_elsewhere(point_room, truth, raised_m=0.0)
        query = Query(blurred.see(truth, 300 + seed), point_room.camera, Dof.FREE)
        index, rays = MapIndex(map_), query.camera.rays(query.features.pixels)
        found = verify(index, query, rays, truth.T_map_camera)
        better = polished(index, query, found)
        assert better.support == found.support
        assert better.matches is found.matches
        for name, one in (("verified", found), ("polished", better)):
            off_m[name].append(float(np.linalg.norm(one.optimum.T_map_camera[:3, 3] - truth.position)))
    assert np.mean(off_m["polished"]) < 0.9 * np.mean(off_m["verified"])
