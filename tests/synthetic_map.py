"""A synthetic map of a room."""

import numpy as np
import pytest

from rholoc.geometry import Camera, Pose, poses_from_rows
from rholoc.maps import (
    DensityKind,
    Map,
    MapDescriptors,
    MapInfo,
    MapLandmarks,
    MapObservations,
    MapViews,
    MapWaypoint,
    Source,
)
from rholoc.reports import HeldOutReport, MapReport


def synthetic_map(features: int = 60, views: int = 8, seed: int = 1) -> Map:
    """Landmarks on the walls of a 6×5×3 m room, seen from a loop that looks outwards."""
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0, 2 * np.pi, features)
    square = np.maximum(np.abs(np.cos(angle)) / 3, np.abs(np.sin(angle)) / 2.5)
    landmarks = np.column_stack([np.cos(angle) / square, np.sin(angle) / square, rng.uniform(0, 3, features)])
    sigma = rng.lognormal(np.log(0.01), 0.8, features)
    covariances = ((sigma**2)[:, None, None] * np.eye(3)).astype(np.float32)
    walk = np.linspace(0, 1.6 * np.pi, views)
    positions = np.column_stack([1.6 * np.cos(walk), 1.2 * np.sin(walk), np.full(views, 1.5)])
    headings = np.column_stack([np.cos(walk + 0.5), np.sin(walk + 0.5), np.zeros(views)])
    quaternions = [Pose.from_heading(p, h).quaternion_xyzw for p, h in zip(positions, headings, strict=True)]
    seen = [np.sort(rng.choice(features, features // 3, replace=False)) for _ in range(views)]
    owners = np.sort(np.concatenate([np.arange(features), rng.integers(0, features, features // 2)]))
    return Map(
        info=MapInfo(
            id="0123456789abcdef" * 2,
            version=1,
            density=DensityKind.RAY,
            features="lab",
            metric=True,
            upright=True,
            created="2026-01-02T03:04:05Z",
            camera=Camera(640, 480, 500.0, 501.0, 319.5, 239.5, (0.1, -0.2, 0.0, 0.001)),
            sources=(Source("walk", frames=900),),
            waypoints=(
                MapWaypoint("W1", (1.6, 0.0, 1.5), 0.012),
                MapWaypoint("W2", (0.0, 1.2, 1.5), 0.02),
                MapWaypoint("E", (-1.6, 0.0, 1.5), 0.008),
            ),
            report=MapReport(features=features, held_out=HeldOutReport(40, 39, median_m=0.019, p90_m=0.03)),
        ),
        landmarks=MapLandmarks(
            channels=rng.integers(1, 3, features).astype(np.uint8),
            positions=landmarks.astype(np.float32),
            covariances=covariances,
        ),
        descriptors=MapDescriptors(
            values=rng.integers(0, 256, (len(owners), 32)).astype(np.uint8), features=owners.astype(np.int32)
        ),
        views=MapViews(
            times=np.arange(views, dtype=np.float64),
            T_map_camera=poses_from_rows(
                np.column_stack([positions, np.reshape(quaternions, (-1, 4))]).astype(np.float32)
            ),
        ),
        observations=MapObservations(
            views=np.repeat(np.arange(views), [len(s) for s in seen]).astype(np.int32),
            features=np.concatenate([np.zeros(0, int), *seen]).astype(np.int32),
        ),
    )


@pytest.fixture(scope="session")
def room_map() -> Map:
    """A small map that is whole."""
    return synthetic_map()


@pytest.fixture
def make_map():
    """Makes maps of chosen size."""
    return synthetic_map
