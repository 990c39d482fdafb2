"""A walk through the room of points, as views."""

from typing import Any

import numpy as np
import pytest

from rholoc.mapping.build.tracks import Views


@pytest.fixture(scope="session")
def walked(point_room: Any) -> Views:
    """Sixty views of the room of points."""
    poses = point_room.walk(60)
    features = [point_room.see(pose, seed) for seed, pose in enumerate(poses)]
    T = np.array([pose.T_map_camera for pose in poses])
    return Views.from_features([point_room.camera] * 60, T, np.arange(60) / 10, features)
