"""Frame poses of a real hand-held walk from its images and four waypoints in order, against its true poses."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.errors import MappingFailed
from rholoc.geometry import ByteArray, FloatArray, IntArray, pose_matrix
from rholoc.localization import Dof, Localizer, Query
from rholoc.mapping import BuildOptions, build_map, update_map
from rholoc.mapping.edit.sources import forget_recording
from rholoc.mapping.learn.merging import merge_maps
from rholoc.maps import Map
from rholoc.recordings import FrameSource, Waypoint, read_recording
from rholoc.trajectory import PoseMethod, Scale
from rholoc.trajectory.estimate import estimate_trajectory

_WAYPOINT_FRAMES = (424, 700, 772, 976)  # the far ends of the walk, along it and across: they fix its rotation
_CAMERA = "525.505,525.505,320,240"
_INTERVAL_S = 0.3


@dataclass(frozen=True, eq=False)
class _Pausing:
    """Frames of another source, with some rows shown for two seconds, as if the camera had paused there."""

    source: FrameSource
    pauses: tuple[int, ...]

    @property
    def times(self) -> FloatArray:
        return np.arange(len(self._rows)) * _INTERVAL_S

    @property
    def timed(self) -> bool:
        return True

    @property
    def numbers(self) -> IntArray:
        return self.source.numbers[self._rows]

    @property
    def size(self) -> tuple[int, int]:
        return self.source.size

    def images(self, rows: Sequence[int]) -> Iterator[ByteArray]:
        wanted = [int(self._rows[row]) for row in rows]
        distinct = sorted(set(wanted))
        shown = dict(zip(distinct, self.source.images(distinct), strict=True))
        return (shown[row] for row in wanted)

    @property
    def _rows(self) -> IntArray:
        counts = np.ones(len(self.source.times), dtype=np.int64)
        counts[list(self.pauses)] = round(2 / _INTERVAL_S)
        return np.repeat(np.arange(len(counts)), counts)


@pytest.mark.real
@pytest.mark.slow
@pytest.mark.timeout(600)
def test_redkitchen_is_placed_from_images_and_four_waypoints_in_order(real_data: Path) -> None:
    table = np.loadtxt(real_data / "redkitchen" / "poses.txt")
    truth = {int(row[0]): row[1:] for row in table}
    recording = read_recording(real_data / "redkitchen", camera=_CAMERA, frames="400:1000:12")
    numbers = recording.frames.numbers
    frames = _Pausing(recording.frames, tuple(int(np.flatnonzero(numbers == n)[0]) for n in _WAYPOINT_FRAMES))
    waypoints = tuple(Waypoint(f"W{n}", float("nan"), tuple(truth[n][:3])) for n in _WAYPOINT_FRAMES)
    recording = replace(recording, frames=frames, poses=None, waypoints=waypoints)

    trajectory = estimate_trajectory(recording, PoseMethod.VISUAL)

    true = np.array([truth[int(frames.numbers[row])] for row in trajectory.rows])
    T = pose_matrix(Rotation.from_quat(true[:, 3:]).as_matrix(), true[:, :3])
    position_cm = 100 * np.linalg.norm(trajectory.T_map_camera[:, :3, 3] - T[:, :3, 3], axis=1)
    turned = Rotation.from_matrix(np.swapaxes(trajectory.T_map_camera[:, :3, :3], 1, 2) @ T[:, :3, :3])
    angle_deg = np.degrees(turned.magnitude())
    assert trajectory.report.trusted, trajectory.report.why
    assert trajectory.scale is Scale.METRIC
    assert not trajectory.upright  # this camera rolls, and nothing measured gravity
    assert trajectory.report.frames >= 0.95 * trajectory.report.keyframes >= 40
    taken = [
        int(frames.numbers[np.abs(frames.times - t).argmin()]) for t in trajectory.report.waypoint_times_s.values()
    ]
    assert taken == list(_WAYPOINT_FRAMES)
    assert max(trajectory.report.waypoint_residuals_m.values()) < 0.05
    assert np.median(position_cm) < 2.0
    assert np.percentile(position_cm, 90) < 4.0
    assert np.median(angle_deg) < 2.0


_OTHERS = {
    "euroc_v101/cam0/data": "458.654,457.296,367.215,248.375,-0.28340811,0.07395907,0.00019359,0.0000176",
    "android_livingroom/video.mp4": None,
}


def first_half(real_data: Path) -> Map:
    recording = read_recording(real_data / "redkitchen", camera=_CAMERA, frames="400:700:6")
    return build_map([recording], BuildOptions(poses=PoseMethod.GIVEN, report=False))


def errors_m(map_: Map, real_data: Path) -> np.ndarray:
    """Of easy queries, metres; infinite where there is no pose."""
    queries = read_recording(real_data / "redkitchen", camera=_CAMERA, frames="200:400:16")
    localizer, errors = Localizer(map_), []
    for row, image in enumerate(queries.frames.images(list(range(len(queries.frames.times))))):
        answer = localizer.localize(Query(localizer.extractor.extract(image), queries.camera, Dof.FREE))
        true = queries.poses.T_map_camera[row, :3, 3]
        errors.append(np.inf if answer.pose is None else np.linalg.norm(answer.pose.position - true))
    return np.array(errors)


@pytest.mark.slow
@pytest.mark.real
def test_the_second_half_makes_the_map_no_worse_and_other_rooms_are_refused(real_data: Path) -> None:
    first = first_half(real_data)
    second = read_recording(real_data / "redkitchen", camera=_CAMERA, frames="700:1000:6")
    updated = update_map(first, replace(second, poses=None))
    before, after = errors_m(first, real_data), errors_m(updated, real_data)
    assert (after < 0.05).sum() >= (before < 0.05).sum() >= 0.9 * len(before)
    assert np.median(after) < np.median(before) + 0.002
    assert np.median(after) < 0.015
    left = forget_recording(updated, updated.info.sources[1].id)
    np.testing.assert_allclose(left.landmarks.positions, first.landmarks.positions, rtol=0, atol=1e-6)

    built = build_map([second], BuildOptions(poses=PoseMethod.GIVEN, report=False))
    merged = merge_maps(first, built)
    assert merged.info.report.learned[0].residual_median_m < 0.03
    assert np.median(errors_m(merged, real_data)) < np.median(before) + 0.002

    for other, camera in _OTHERS.items():
        with pytest.raises(MappingFailed, match="does not show the place"):
            update_map(first, read_recording(real_data / other, camera=camera, frames="::10"))
