"""What an adjusted walk is made into: which keyframes count as placed, in which frame, and how sure."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scene import CAMERA, arc, cloud, in_pixels
from scipy.spatial.transform import Rotation

from rholoc.geometry import BoolArray, FloatArray, Similarity
from rholoc.recordings import Waypoint
from rholoc.trajectory import Scale
from rholoc.trajectory.checks.mistaken_waypoints import LeftOut
from rholoc.trajectory.frame.map_frame import MapFrame, ScaleMeasurement, ScaleSource, up_by_gravity
from rholoc.trajectory.inertial.gyroscope import GyroCalibration
from rholoc.trajectory.optimization.problem import Fix, Problem, State
from rholoc.trajectory.reconstruction import waypoints as in_waypoints
from rholoc.trajectory.reconstruction.outcome import InertialFigures, Solved, finished
from rholoc.trajectory.reconstruction.waypoints import in_map_frame
from rholoc.trajectory.visual.tracks import Observations

_COUNT = 6
_GYRO = GyroCalibration(0.0, 0.0, np.zeros(3), 0.0, np.eye(3), False, 0.0, 0.0)
_IMU = InertialFigures(_GYRO, 0.01, np.zeros(3), np.zeros(3), 0.0, 1.0, 1.0, 1.0)
_FELT = ScaleMeasurement(ScaleSource.ACCELEROMETER, 1.0, 0.01, is_adjusted=True)


@dataclass(frozen=True, eq=False)
class _Adjusted:
    """Stands in for what an adjustment found: so many metres of uncertainty a keyframe."""

    state: State
    used: BoolArray
    sigmas_m: FloatArray

    def covariances(self, keyframes: list[int]) -> FloatArray:
        found = np.zeros((len(keyframes), 6, 6))
        found[:, 0, 0] = self.sigmas_m[keyframes] ** 2
        found[:, 3:, 3:] = 1e-6 * np.diag([1, 4, 9])
        return found

    def camera_sigmas(self) -> FloatArray:
        return np.arange(1.0, 10.0)


def _solved(
    sightings: list[int], off_px: float = 0.0, sigmas_m: FloatArray | None = None, in_frame: bool = True
) -> Solved:
    """Six cameras, of which each sees so many points right; half a pixel off, and one more point by so many pixels."""
    T, points = arc(_COUNT), cloud(40)
    keyframes, tracks, pixels = [], [], []
    for k, count in enumerate(sightings):
        seen = in_pixels(points, T[k])
        for track in range(count):
            keyframes.append(k)
            tracks.append(track)
            pixels.append(seen[track] + [0.3, 0.4])
        keyframes.append(k)
        tracks.append(39)
        pixels.append(seen[39] + [off_px, 0.0])
    observations = Observations(np.array(keyframes), np.array(tracks), np.array(pixels))
    sigmas_m = np.full(_COUNT, 0.01) if sigmas_m is None else sigmas_m
    adjusted = _Adjusted(State(T, points, CAMERA), np.ones(len(tracks), np.bool_), sigmas_m)
    turned = Similarity(2.0, Rotation.from_euler("z", 90, degrees=True).as_matrix(), np.array([1.0, 2.0, 3.0]))
    frame = MapFrame(turned, Scale.METRIC, True, "", "")
    return Solved(Problem(np.arange(6.0), observations), adjusted, frame, in_frame)  # type: ignore[arg-type]


def test_a_keyframe_is_placed_by_a_dozen_sightings_that_fit() -> None:
    found = finished(_solved([12, 11, 10, 30, 30, 30], off_px=0.5), 3, True, None, "why")
    assert found.placed.tolist() == [True, True, False, True, True, True]
    wrong = finished(_solved([12, 11, 10, 30, 30, 30], off_px=2.7), 3, True, None, "why")
    assert wrong.placed.tolist() == [True, False, False, True, True, True]
    assert finished(_solved([12] * 6, off_px=2.3), 0, True, None, "").landmarks == 13
    assert wrong.landmarks == 30
    assert (wrong.loops, wrong.imu_reason, wrong.focal_sigma_px) == (3, "why", None)
    assert wrong.residual_px == pytest.approx(0.5, rel=0.05)
    assert finished(_solved([12] * 6), 0, False, None, "").focal_sigma_px == 1.0


@pytest.mark.parametrize(("alone", "depth", "placed"), [(23, False, True), (24, False, False), (24, True, True)])
def test_points_that_only_one_other_sees_leave_the_distance_open(alone: int, depth: bool, placed: bool) -> None:
    """Of ten pictures of a kitchen, one that shared such points with its neighbour was placed 18 cm off."""
    solved = _solved([30] * _COUNT)
    found = solved.problem.observations
    kept = found.at((found.keyframes < 2) | (found.tracks >= alone))
    observations = replace(kept, depths=np.ones(len(kept)) if depth else None)
    adjusted = replace(solved.adjusted, used=np.ones(len(kept), np.bool_))
    problem = replace(solved.problem, observations=observations)
    held = finished(replace(solved, problem=problem, adjusted=adjusted), 0, True, None, "").placed
    assert held.tolist()[:2] == [placed] * 2


def test_sightings_that_were_not_used_place_nothing() -> None:
    solved = _solved([30] * 6)
    unused = replace(solved.adjusted, used=solved.problem.observations.keyframes != 2)
    found = finished(replace(solved, adjusted=unused), 0, True, None, "")
    assert found.placed.tolist() == [True, True, False, True, True, True]


@pytest.mark.parametrize(
    ("usual_m", "own_m", "carried"),
    [(0.01, 0.049, True), (0.01, 0.051, False), (0.04, 0.079, True), (0.04, 0.081, False)],
)
def test_the_imu_places_a_keyframe_that_is_known_well_enough(usual_m: float, own_m: float, carried: bool) -> None:
    """To five centimetres, or to twice what is usual."""
    sigmas_m = np.append(np.full(5, usual_m), own_m)
    solved = _solved([30] * 5 + [0], sigmas_m=sigmas_m)
    assert finished(solved, 0, True, _IMU, "").placed.tolist() == [True] * 5 + [carried]
    assert finished(solved, 0, True, None, "").placed.tolist() == [True] * 5 + [False]
    assert finished(_solved([0] * 6, sigmas_m=sigmas_m), 0, True, _IMU, "").placed[-1] == (own_m < 0.05)


def test_what_waypoints_have_not_put_into_the_maps_frame_is_put_there() -> None:
    here, there = (finished(_solved([30] * 6, in_frame=one), 0, True, None, "") for one in (True, False))
    similarity = there.frame.similarity
    np.testing.assert_allclose(there.T_map_camera, similarity.poses(here.T_map_camera))
    assert there.median_depth == pytest.approx(2 * here.median_depth)
    R = similarity.rotation
    np.testing.assert_allclose(there.covariances[:, :3, :3], 4 * R @ here.covariances[:, :3, :3] @ R.T, atol=1e-15)
    np.testing.assert_allclose(there.covariances[:, 3:, 3:], R @ here.covariances[:, 3:, 3:] @ R.T, atol=1e-15)
    np.testing.assert_array_equal(here.T_map_camera, arc(_COUNT))


@dataclass
class _Walk:
    """An adjustment that answers from a list of who is mistaken, one after the other."""

    mistakes: list[str]
    fixes: list[list[int]]
    sigmas_m: list[float]
    iterations: list[int]

    def adjust(self, problem: Problem, state: State, iterations: int, progress: object) -> object:
        self.fixes.append([fix.keyframe for fix in problem.fixes])
        self.sigmas_m.append(problem.fixes[0].sigma_m)
        self.iterations.append(iterations)
        return _Adjusted(state, np.zeros(0, np.bool_), np.zeros(20))

    def each_left_out(self, fixes: dict[str, Fix], mistaken: list[str], adjusted: object) -> dict[str, LeftOut]:
        wrong = self.mistakes[: len(mistaken) + 1]
        return {name: LeftOut(np.array([0.5, 0, 0]), 9.0 if name in wrong else 1.0) for name in fixes}


def _held(
    monkeypatch: pytest.MonkeyPatch, count: int, mistakes: list[str], late_s: float = 0.0
) -> tuple[_Walk, Solved]:
    times = np.arange(20.0)
    walk = _Walk(mistakes, [], [], [])
    monkeypatch.setattr(in_waypoints, "adjust", walk.adjust)
    monkeypatch.setattr(in_waypoints, "_each_left_out", walk.each_left_out)
    T = np.tile(np.eye(4), (20, 1, 1))
    T[:, :3, 3] = np.column_stack([times, np.sin(times), 0 * times])
    state = State(T, np.zeros((0, 3)), CAMERA)
    named = tuple(Waypoint(f"W{i}", 2.0 * i + (late_s if i == 1 else 0.0), (0.0, 0.0, 0.0)) for i in range(count))
    frame = MapFrame(Similarity.identity(), Scale.METRIC, True, "", "", named)
    nothing = Observations.none()

    class Progress:
        def step(self, start: float, end: float, what: str) -> None:
            assert 0.75 <= start < end <= 0.95

    solved = in_waypoints._held_by_waypoints(Problem(times, nothing), state, frame, (), Progress())  # type: ignore[arg-type]
    return walk, solved


@pytest.mark.parametrize(("count", "taken_out"), [(9, 3), (8, 2), (6, 2), (5, 1), (4, 1), (3, 0)])
def test_a_third_of_the_waypoints_may_be_mistaken(count: int, taken_out: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """And three are always left."""
    walk, solved = _held(monkeypatch, count, [f"W{i}" for i in range(count)])
    assert len(solved.mistaken) == taken_out
    assert len(walk.fixes[-1]) == count - taken_out


def test_without_waypoints_the_walk_stays_in_its_own_frame() -> None:
    solved = _solved([30] * 6)
    found = in_map_frame(solved.problem, solved.adjusted, [], up_by_gravity(), [_FELT], (), None)  # type: ignore[arg-type]
    assert not found.in_frame
    assert found.adjusted is solved.adjusted
    assert found.frame.scale is Scale.METRIC
    open_scale = in_map_frame(solved.problem, solved.adjusted, [], up_by_gravity(), [], (), None)  # type: ignore[arg-type]
    depths = np.einsum("ni,ni->n", *_depths(solved))
    assert open_scale.frame.similarity.scale == pytest.approx(1 / np.median(depths))


def _depths(solved: Solved) -> tuple[FloatArray, FloatArray]:
    seen = solved.problem.observations
    T = solved.adjusted.state.T_map_camera[seen.keyframes]
    return solved.adjusted.state.points[seen.tracks] - T[:, :3, 3], T[:, :3, 2]


def test_a_scale_that_was_not_adjusted_makes_far_poses_less_certain() -> None:
    solved = _solved([30] * 6, in_frame=False)
    known = finished(solved, 0, True, None, "")
    scaled = replace(solved, frame=replace(solved.frame, scale_sigma=0.05))
    found = finished(scaled, 0, True, None, "")
    positions = found.T_map_camera[:, :3, 3]
    np.testing.assert_allclose(
        found.covariances[:, :3, :3] - known.covariances[:, :3, :3],
        0.05**2 * positions[:, :, None] * positions[:, None, :],
        atol=1e-12,
    )


def test_covariances_without_bound_cost_a_walk_nothing_but_them() -> None:
    found = finished(_solved([30] * 6, sigmas_m=np.full(_COUNT, np.nan)), 0, False, _IMU, "")
    assert found.placed.all()
    assert np.isnan(found.covariances[:, :3, :3]).any(axis=(1, 2)).all()


def test_no_pose_is_surer_than_what_its_sightings_share() -> None:
    """Of simulated walks at 4 pictures a second, 61 % of the positions were within their 95 % regions."""
    found = finished(_solved([30] * _COUNT, sigmas_m=np.full(_COUNT, 1e-5)), 0, True, None, "")
    sigmas_m = np.sqrt(np.diagonal(found.covariances[:, :3, :3], axis1=1, axis2=2))
    assert sigmas_m.min() > 0.001 * found.median_depth
