"""Steps of a track that is played."""

import numpy as np
import pytest

from rholoc.tracking.follow import Answered, Step
from rholoc.tracking.moments import Moment
from rholoc_client.models import Pose
from rholoc_client.tracking import Tracked, TrackStatus


@pytest.fixture
def step():
    """Makes a step: time, T_map_camera (4, 4) or None, and the reset counter."""

    def make(time_s, T_map_camera=None, resets=0, status=None, recognized=0.9, size=(2, 2)):
        status = status or (TrackStatus.SEARCHING if T_map_camera is None else TrackStatus.TRACKING)
        pose = covariance = None
        if T_map_camera is not None:
            rows = tuple(map(tuple, T_map_camera.tolist()))
            pose = Pose((0, 0, 0), (0, 0, 1), 0.0, (0, 0, 0, 1), rows)
            covariance = tuple(map(tuple, np.diag([1e-4, 2e-4, 3e-4, 1.0, 2.0, 3.0]).tolist()))
        answer = Answered(time_s, type("Found", (), {"recognized": recognized, "confidence": 0.8})())
        tracked = Tracked(time_s, status, pose, covariance, None, None, resets, 0.0, 1, 0)
        return Step(Moment(0, time_s, np.zeros((*size, 3), np.uint8)), tracked, True, answer, 0.0)

    return make
