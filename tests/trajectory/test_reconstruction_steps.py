"""Single steps of a reconstruction, by known values."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.geometry import BoolArray, Camera, FloatArray, Similarity, pose_matrix
from rholoc.progress import Stage
from rholoc.recordings import GRAVITY
from rholoc.trajectory.optimization.problem import GIVEN, GUESSED, InertialState, State
from rholoc.trajectory.optimization.rounds import AdjustmentProgress, camera_sigmas
from rholoc.trajectory.reconstruction.figures import median_depth_of, scale_sigma_of, spread_covariances
from rholoc.trajectory.reconstruction.outcome import moved
from rholoc.trajectory.visual.tracks import Observations

CAMERA = Camera(640, 480, 500.0, 500.0, 320.0, 240.0)


def _state(positions: FloatArray, points: FloatArray | None = None, inertial: bool = True) -> State:
    """Cameras at positions (K, 3) that all look along x."""
    R = Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]]).as_matrix()
    T = pose_matrix(np.tile(R, (len(positions), 1, 1)), positions)
    points = np.zeros((0, 3)) if points is None else points
    if not inertial:
        return State(T, points, CAMERA)
    velocities = positions + 1.0
    biases = np.zeros((len(positions), 6))
    return State(T, points, CAMERA, InertialState(velocities, biases, np.eye(4), 0.0, np.array([0.0, 0.0, -GRAVITY])))


@dataclass
class _Adjusted:
    """Stands in for what an adjustment found: a covariance that grows with the keyframe's number."""

    state: State
    used: BoolArray = field(default_factory=lambda: np.zeros(0, np.bool_))
    axis: int = 0
    asked: list[int] = field(default_factory=list)

    def covariances(self, keyframes: list[int]) -> FloatArray:
        self.asked = list(keyframes)
        found = np.tile(1e-8 * np.eye(6), (len(keyframes), 1, 1))
        found[:, self.axis, self.axis] = np.array(keyframes, dtype=np.float64)
        return found


def test_intrinsics_are_corrected_as_far_as_they_may_be_wrong() -> None:
    assert camera_sigmas(None) is GUESSED
    assert camera_sigmas(replace(CAMERA, distortion=(0.1, 0.0, 0.0, 0.0))) is GIVEN
    assert camera_sigmas(replace(CAMERA, distortion=(0.1, 0.0, 0.0, 0.0, 0.01))) is None


def test_in_another_frame_everything_turns_with_the_walk() -> None:
    state = _state(np.arange(12.0).reshape(4, 3), np.arange(6.0).reshape(2, 3))
    quarter = Rotation.from_euler("x", 90, degrees=True).as_matrix()
    found = moved(state, Similarity(2.0, quarter, np.array([1.0, 0.0, 0.0])))
    np.testing.assert_allclose(found.positions, 2 * state.positions @ quarter.T + [1, 0, 0])
    np.testing.assert_allclose(found.points, 2 * state.points @ quarter.T + [1, 0, 0])
    np.testing.assert_allclose(found.R_map_camera, quarter @ state.R_map_camera)
    np.testing.assert_allclose(found.inertial.velocities, 2 * state.inertial.velocities @ quarter.T)
    np.testing.assert_allclose(found.inertial.gravity, [0, GRAVITY, 0], atol=1e-12)
    without = moved(_state(np.zeros((2, 3)), inertial=False), Similarity.identity())
    assert without.inertial is None


@pytest.mark.parametrize(("count", "computed"), [(20, 7), (5, 60), (2, 2)])
def test_covariances_between_those_computed_are_interpolated(count: int, computed: int) -> None:
    adjusted = _Adjusted(_state(np.zeros((count, 3))))
    found = spread_covariances(adjusted, count, computed)
    assert len(adjusted.asked) == min(count, computed)
    assert (adjusted.asked[0], adjusted.asked[-1]) == (0, count - 1)
    np.testing.assert_allclose(found[:, 0, 0], np.arange(count), atol=1e-12)
    np.testing.assert_allclose(found[:, 5, 5], 1e-8)


def test_the_scales_sigma_is_that_of_the_furthest_keyframe_along_the_way() -> None:
    positions = np.array([[1.0, 1.0, 0.0], [2.0, 1.0, 0.0], [6.0, 1.0, 0.0], [3.0, 1.0, 0.0]])
    assert scale_sigma_of(_Adjusted(_state(positions))) == pytest.approx(np.sqrt(2) / 5)
    assert scale_sigma_of(_Adjusted(_state(positions), axis=1)) == pytest.approx(1e-4 / 5)


def test_the_median_depth_is_of_points_ahead() -> None:
    points = np.array([[3.0, 9.0, 9.0], [5.0, 0.0, 0.0], [8.0, 0.0, 0.0], [-7.0, 0.0, 0.0], [90.0, 0.0, 0.0]])
    state = _state(np.array([[0.0, 0, 0], [1.0, 0, 0]]), points)
    keyframes, tracks = np.array([0, 0, 1, 0, 1]), np.array([0, 1, 2, 3, 4])
    used = np.array([True, True, True, True, False])
    adjusted = _Adjusted(state, used)
    observations = Observations(keyframes, tracks, np.zeros((5, 2)))
    assert median_depth_of(observations, adjusted) == 5.0  # of 3, 5 and 7


def test_progress_is_a_share_of_the_poses_stage() -> None:
    heard: list[tuple[Stage, float, str]] = []
    steps = AdjustmentProgress(lambda stage, fraction, text="": heard.append((stage, fraction, text)))
    steps.step(0.6, 0.8, "one")(0.5)
    steps.step(0.9, 1.5, "two")(1.0)
    assert [stage for stage, *_ in heard] == [Stage.POSES] * 4
    assert [fraction for _, fraction, _ in heard] == pytest.approx([0.6, 0.7, 0.9, 0.99])
    assert [text for *_, text in heard] == ["one", "one", "two", "two"]
