"""A recording → Table 4."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from rholoc.features import get_extractor
from rholoc.geometry import ByteArray
from rholoc.recordings import Recording
from rholoc.reports import TrajectoryReport
from rholoc.trajectory import PoseMethod, Scale, Trajectory
from rholoc.trajectory.visual.rolling_shutter import RollingShutter
from rholoc_lab.paper import observing

_ROWS = np.array([1, 4, 7, 10])
_READOUT_S = 0.03
_NOISE = np.random.default_rng(0).integers(0, 255, (12, 240, 320, 3), dtype=np.uint8)
_IMAGES = [cv2.GaussianBlur(one, (0, 0), 2) for one in _NOISE]


class Frames:
    """Twelve frames of texture."""

    times = np.arange(12) / 10
    numbers = np.arange(12)
    size = (320, 240)

    def images(self, rows: Sequence[int]) -> Iterator[ByteArray]:
        for row in rows:
            yield _IMAGES[row]


def test_each_frame_is_corrected_by_its_own_motion(point_room: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    camera = point_room.camera.resized(320, 240)
    recording = Recording("walk", Path("walk"), Frames(), camera, readout_s=_READOUT_S)
    T = np.array([pose.T_map_camera for pose in point_room.walk(4)])
    velocities = np.zeros((4, 2, 3))
    velocities[:, 0, 2] = [100, 200, 300, 400]
    shutter = RollingShutter(_READOUT_S, 240, velocities)
    report = TrajectoryReport("visual", 4, trusted=True, why="")
    found = Trajectory(_ROWS, _ROWS / 10, T, camera, Scale.METRIC, True, report, shutter)
    monkeypatch.setattr(observing, "estimate_trajectory", lambda *_: found)
    table, _ = observing.observe_recording(recording, "sift48", PoseMethod.VISUAL)
    seen = [get_extractor("sift48").extract(_IMAGES[row]).pixels.astype(np.float64) for row in _ROWS]
    frame = np.repeat(np.arange(4), [len(one) for one in seen])
    pixels = np.concatenate(seen)
    late_s = ((pixels[:, 1] + 0.5) / 240 - 0.5) * _READOUT_S
    np.testing.assert_allclose(table.pixels[:, 0], pixels[:, 0] - late_s * 100 * (frame + 1), atol=1e-3)
    np.testing.assert_array_equal(table.times, _ROWS[frame] / 10)
