"""A map of the room of points, made from sixty views."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from rholoc.density import Evidence
from rholoc.features import Metric
from rholoc.geometry import Pose
from rholoc.localization import Localizer
from rholoc.localization.index.matches import Matches
from rholoc.localization.pose.ascent import Optimum
from rholoc.localization.pose.pose_evidence import Support
from rholoc.localization.pose.rematching import Verified
from rholoc.mapping.build.landmarks import are_stable, representative_rows, triangulate
from rholoc.mapping.build.tracks import Views, link_observations
from rholoc.maps import DensityKind, Map, MapDescriptors, MapInfo, MapLandmarks, MapObservations, MapViews


@pytest.fixture(scope="session")
def room_map(point_room: Any) -> Map:
    """The map of the room of points."""
    poses = point_room.walk(60)
    T = np.array([pose.T_map_camera for pose in poses])
    features = [point_room.see(pose, seed) for seed, pose in enumerate(poses)]
    views = Views.from_features([point_room.camera] * 60, T, np.arange(60) / 10, features)
    landmarks = triangulate(views, link_observations(views, Metric.HAMMING))
    landmarks = landmarks.keep(are_stable(views, landmarks, 500))
    rows = representative_rows(views, landmarks.labels, len(landmarks), Metric.HAMMING, 1)
    observed = landmarks.observed_rows
    return Map(
        info=MapInfo("0" * 32, 1, DensityKind.RAY, "gray", True, True, "2026-01-01T00:00:00Z", point_room.camera),
        landmarks=MapLandmarks(
            channels=np.zeros(len(landmarks), np.uint8),
            positions=landmarks.positions.astype(np.float32),
            covariances=landmarks.covariances.astype(np.float32),
        ),
        descriptors=MapDescriptors(
            values=views.features.descriptors[np.concatenate(rows)], features=np.arange(len(landmarks), dtype=np.int32)
        ),
        views=MapViews(times=views.times, T_map_camera=T),
        observations=MapObservations(
            views=views.view_of[observed].astype(np.int32), features=landmarks.labels[observed].astype(np.int32)
        ),
    )


@pytest.fixture(scope="session")
def localizer(room_map: Map) -> Localizer:
    """Its localizer."""
    return Localizer(room_map)


@pytest.fixture(scope="session")
def verified_at() -> Callable[..., Verified]:
    """Makes verified poses without matches: of a pose, its support and the value of its density."""
    nothing = np.zeros(0, np.int64)
    evidence = Evidence.of(nothing, np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0), 500.0)

    def at(pose: Pose, support: Support | None = None, value: float = 1.0) -> Verified:
        optimum = Optimum(pose.T_map_camera, value, np.zeros(0))
        return Verified(
            optimum, Matches.none(), evidence, np.zeros((0, 2)), Matches.none(), support or Support(100.0, 0.0)
        )

    return at
