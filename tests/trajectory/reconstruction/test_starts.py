"""From what was seen and felt to a start, and which way a reconstruction goes: by the parts, each put in by hand."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from scene import CAMERA, arc, cloud, in_pixels, on_plane, rays
from scipy.spatial.transform import Rotation
from synthetic_walk import followed

from rholoc.errors import MappingFailed
from rholoc.features import FeatureSet
from rholoc.geometry import FloatArray, IntArray, Similarity, pose_matrix
from rholoc.progress import silent
from rholoc.recordings import GRAVITY, Imu
from rholoc.trajectory import Scale
from rholoc.trajectory.frame.map_frame import MapFrame
from rholoc.trajectory.inertial.gyroscope import GyroCalibration
from rholoc.trajectory.initialization.inertial_start import InertialStart
from rholoc.trajectory.optimization.adjustment import InertialState, Problem, State
from rholoc.trajectory.reconstruction import dispatch, from_imu, from_pictures, loops
from rholoc.trajectory.reconstruction import sights as in_sights
from rholoc.trajectory.reconstruction.outcome import Reconstruction
from rholoc.trajectory.reconstruction.rounds import AdjustmentProgress
from rholoc.trajectory.reconstruction.sights import Evidence, Sights
from rholoc.trajectory.visual.directions import PairDirection
from rholoc.trajectory.visual.matching import VerifiedPair
from rholoc.trajectory.visual.tracks import Observations
from rholoc.trajectory.visual.two_view import PairRotation

_GYRO = GyroCalibration(
    0.01, 0.0, np.array([0.1, 0.2, 0.3]), 0.0, Rotation.from_euler("x", 90, degrees=True).as_matrix(), False, 0.0, 0.1
)
_IMU = Imu(np.arange(2.0), np.full((2, 3), 2.0), np.zeros((2, 3)), True, None)
_FRAME = MapFrame(Similarity.identity(), Scale.ARBITRARY, False, "", "")
_NOTHING = Observations(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)))


def _sights(count: int = 12, corners: int = 20) -> Sights:
    """Keyframes, every second of the frames, that all see the same corners."""
    T = arc(2 * count, 0.6)
    pixels = np.array([in_pixels(cloud(corners), one) for one in T])
    flow = followed(np.arange(2.0 * count) / 10, (640, 480), pixels, np.ones((2 * count, corners), np.bool_))
    return Sights(flow, np.arange(0, 2 * count, 2), [FeatureSet.empty(0)] * count, CAMERA)


@pytest.mark.parametrize(
    ("gyro", "imu", "reason"),
    [
        (None, _IMU, "hardly overlap"),
        (replace(_GYRO, residual_deg=2.5), _IMU, "contradicts the pictures: moment by moment they turn 2.5° apart"),
        (replace(_GYRO, mounting_sigma_deg=4.0), _IMU, "How the IMU is mounted is not known"),
        (_GYRO, replace(_IMU, includes_gravity=False), "took gravity out"),
        (_GYRO, _IMU, ""),
    ],
)
def test_why_an_imu_is_of_no_use(
    gyro: GyroCalibration | None, imu: Imu, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(from_imu, "calibrate_by_flow", lambda *_: gyro)
    found, why = from_imu.calibrated(_sights(), CAMERA, imu)
    assert found is (None if reason else gyro)
    assert reason in why
    assert bool(why) is bool(reason)


@pytest.mark.parametrize(("corners", "pairs"), [(14, 0), (15, 11 + 10 + 8 + 4)])
def test_directions_are_between_keyframes_up_to_eight_apart(
    corners: int, pairs: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By followed corners from fifteen on, and by matched features."""
    asked: list[tuple[int, int, int, float]] = []

    def between(
        first: int, second: int, R: FloatArray, seen: tuple[FloatArray, FloatArray], tolerance: float, focal: float
    ) -> PairDirection | None:
        asked.append((first, second, len(seen[0]), tolerance))
        assert focal == CAMERA.focal
        for k, one in ((first, seen[0]), (second, seen[1])):
            np.testing.assert_allclose(one, rays(on_plane(cloud(corners), arc(24, 0.6)[2 * k])), atol=1e-4)
        return PairDirection(first, second, np.eye(3)[0], 0.1) if first else None

    monkeypatch.setattr(from_imu, "direction_between", between)
    sights = _sights(corners=corners)
    found = from_imu._directions(sights, CAMERA, np.tile(np.eye(3), (12, 1, 1)), [])
    assert len(asked) == pairs
    if pairs:
        assert sorted({second - first for first, second, *_ in asked}) == [1, 2, 4, 8]
        assert all(0 < tolerance < 5 for *_, tolerance in asked)
    assert all(one.first > 0 for one in found)
    assert len(found) == sum(first > 0 for first, *_ in asked)


def test_matches_give_directions_between_the_features_they_join(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[FloatArray] = []
    monkeypatch.setattr(from_imu, "direction_between", lambda i, j, R, both, *_: seen.extend([np.array([i, j]), *both]))
    rng = np.random.default_rng(0)
    places = [rng.uniform([100, 100], [500, 400], (9, 2)) for _ in range(3)]
    features = [_features(one) for one in places]
    matches = np.array([[0, 5], [3, 8], [7, 1]])
    from_imu._direction_of(
        replace(_sights(3), features=features), CAMERA, np.zeros(0), VerifiedPair(0, 2, matches, np.eye(3))
    )
    assert seen[0].tolist() == [0, 2]
    for found, pixels in ((seen[1], places[0][[0, 3, 7]]), (seen[2], places[2][[5, 8, 1]])):
        np.testing.assert_allclose(CAMERA.project(found), pixels, atol=1e-3)


def _features(pixels: FloatArray) -> FeatureSet:
    zeros = np.zeros(len(pixels), np.float32)
    return FeatureSet(
        pixels.astype(np.float32), np.zeros(len(pixels), np.uint8), np.zeros((len(pixels), 0), np.uint8), zeros, zeros
    )


def test_the_start_with_an_imu_is_upright_and_metric(monkeypatch: pytest.MonkeyPatch) -> None:
    """Everything in the frame of the rotations is turned to it; gravity points down, the camera sits in the IMU."""
    count = 5
    rng = np.random.default_rng(0)
    R, positions, velocities = (
        Rotation.random(count, rng=rng).as_matrix(),
        rng.normal(size=(count, 3)),
        rng.normal(size=(count, 3)),
    )
    up = np.array([0.6, 0.0, 0.8])
    start = InertialStart(up, positions, velocities, np.array([0.4, 0.5, 0.6]), 1.5)
    monkeypatch.setattr(from_imu, "average_rotations", lambda *_: (R, None))
    monkeypatch.setattr(from_imu, "inertial_start", lambda *_: start)
    evidence = Evidence(_NOTHING, [], [], [])
    found = from_imu.start_with_imu(_sights(count), CAMERA, evidence, _IMU, _GYRO, Rotation.identity(count))
    assert found is not None
    state, began = found
    assert began is start
    turn = state.R_map_camera[0] @ R[0].T
    np.testing.assert_allclose(turn @ up, [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(state.R_map_camera, turn @ R, atol=1e-12)
    np.testing.assert_allclose(state.positions, positions @ turn.T)
    assert state.inertial is not None
    np.testing.assert_allclose(state.inertial.velocities, velocities @ turn.T)
    np.testing.assert_allclose(state.inertial.biases, np.tile([0.4, 0.5, 0.6, 0.1, 0.2, 0.3], (count, 1)))
    np.testing.assert_allclose(state.inertial.gravity, [0, 0, -GRAVITY])
    np.testing.assert_allclose(state.inertial.T_imu_camera, pose_matrix(_GYRO.R_camera_imu.T, np.zeros(3)))
    assert state.inertial.clock_s == 0
    monkeypatch.setattr(from_imu, "inertial_start", lambda *_: None)
    assert from_imu.start_with_imu(_sights(count), CAMERA, evidence, _IMU, _GYRO, Rotation.identity(count)) is None


@dataclass(frozen=True, eq=False)
class _Adjusted:
    state: State


def _inertial(read: float) -> State:
    inertial = InertialState(np.ones((2, 3)), np.zeros((2, 6)), np.eye(4), 0.0, np.array([0.0, 0.0, -read * GRAVITY]))
    return State(arc(2), np.zeros((0, 3)), CAMERA, inertial)


@pytest.mark.parametrize(("read", "corrected"), [(0.985, True), (0.995, False), (1.005, False), (1.015, True)])
def test_an_accelerometer_a_hundredth_off_is_corrected(
    read: float, corrected: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    adjusted: Any = _Adjusted(_inertial(read))
    asked: list[int] = []

    def adjust(problem: Problem, state: State, iterations: int, progress: object) -> _Adjusted:
        asked.append(iterations)
        return _Adjusted(state)

    monkeypatch.setattr(from_imu, "adjust", adjust)
    problem = Problem(np.arange(2.0), _NOTHING, _IMU, _GYRO)
    found, after, scale = from_imu._accelerometer_corrected(problem, adjusted, AdjustmentProgress(silent))
    assert scale == pytest.approx(read if corrected else 1.0)
    assert asked == ([8] if corrected else [])
    assert found.imu is not None
    np.testing.assert_allclose(found.imu.acceleration, 2.0 / (read if corrected else 1.0))
    assert after.state.inertial is not None
    np.testing.assert_allclose(after.state.inertial.gravity[2], -GRAVITY * (1 if corrected else read))


def test_of_several_pieces_the_largest_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keyframes are of one piece if rotations link them, and points."""
    count = 9
    R = Rotation.random(count, rng=np.random.default_rng(0)).as_matrix()
    component = np.array([0, 0, 0, 0, 0, 0, 0, 7, 7])
    piece = np.array([0, 0, 1, 1, 1, -1, 1, 1, 1])
    monkeypatch.setattr(from_pictures, "average_rotations", lambda *_: (R, component))
    monkeypatch.setattr(from_pictures, "pieces_of", lambda *_: piece)
    monkeypatch.setattr(from_pictures, "_positions_of", lambda members, *_: np.outer(members, [1.0, 2.0, 3.0]))
    state, members = from_pictures._own_start(_sights(count), CAMERA, [], _NOTHING)
    assert members.tolist() == [2, 3, 4, 6]
    np.testing.assert_array_equal(state.R_map_camera, R[members])
    np.testing.assert_array_equal(state.positions, np.outer(members, [1, 2, 3]))
    monkeypatch.setattr(from_pictures, "pieces_of", lambda *_: np.full(count, -1))
    with pytest.raises(MappingFailed, match="overlap"):
        from_pictures._own_start(_sights(count), CAMERA, [], _NOTHING)


def test_a_pieces_positions_come_from_points_that_two_of_it_see(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []
    monkeypatch.setattr(from_pictures, "global_positions", lambda *what: asked.extend(what))
    seen = Observations(np.array([0, 1, 2, 1, 2, 3, 0, 3]), np.array([0, 0, 0, 4, 4, 4, 2, 2]), np.zeros((8, 2)))
    plane = np.arange(16.0).reshape(8, 2)
    R = Rotation.random(4, rng=np.random.default_rng(0)).as_matrix()
    from_pictures._positions_of(np.array([1, 3]), R, seen, plane)
    np.testing.assert_array_equal(asked[0], R[[1, 3]])
    assert asked[1].tolist() == [0, 1]  # of the piece's two keyframes both see point 4 alone
    assert asked[2].tolist() == [0, 0]
    np.testing.assert_array_equal(asked[3], plane[[3, 5]])


def test_what_is_not_of_the_piece_has_no_place() -> None:
    part: Any = Reconstruction(
        np.array([True, False]), arc(2), np.array([np.eye(6), 2 * np.eye(6)]), CAMERA, None, _FRAME, None,
        "", {}, (), 0.3, 5, 0, 2.0,
    )  # fmt: skip
    whole = from_pictures._of_all(part, np.array([1, 3]), 5)
    assert whole.placed.tolist() == [False, True, False, False, False]
    np.testing.assert_array_equal(whole.T_map_camera[[1, 3]], arc(2))
    np.testing.assert_array_equal(whole.T_map_camera[[0, 2, 4]], np.tile(np.eye(4), (3, 1, 1)))
    np.testing.assert_array_equal(whole.covariances[:, 0, 0], [0, 1, 0, 2, 0])


@pytest.mark.parametrize(("corners", "is_followed"), [(59, False), (60, True)])
def test_pictures_are_followed_where_neighbours_share_sixty_corners(corners: int, is_followed: bool) -> None:
    assert in_sights._is_followed(_sights(4, corners)) is is_followed
    assert in_sights._is_followed(_sights(1, corners)) is False


@pytest.mark.parametrize(("keyframes", "corners", "features"), [(10, 90, 150), (1000, 90, 150), (4000, 45, 75)])
def test_long_walks_take_fewer_sightings_of_each_keyframe(
    keyframes: int, corners: int, features: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []

    class Some:
        def thinned(self, per_keyframe: int) -> Some:
            asked.append(per_keyframe)
            return self

        def joined(self, others: Some) -> list[int]:
            return [1]

    some: Any = Some()
    monkeypatch.setattr(in_sights, "matched_features", lambda places, pairs: some)
    sights = replace(_sights(2), rows=np.zeros(keyframes, np.int64), features=[])
    assert Evidence(some, [], [], []).observations(sights) == [1]  # type: ignore[comparison-overlap]
    assert sorted(asked) == [corners, features]


def test_what_shows_nothing_has_no_observations() -> None:
    with pytest.raises(MappingFailed, match="nothing that could be followed"):
        Evidence(_NOTHING, [], [], []).observations(_sights(2))


def test_some_of_the_keyframes_keep_their_own() -> None:
    sights = replace(_sights(5), features=[_features(np.full((1, 2), k)) for k in range(5)])
    some = sights.take(np.array([1, 4]))
    assert some.rows.tolist() == [2, 8]
    assert [one.pixels[0, 0] for one in some.features] == [1, 4]
    np.testing.assert_allclose(some.times, [0.2, 0.8])
    assert some.shutter is None


def test_rotations_are_of_corners_neighbours_and_loops() -> None:
    pair = VerifiedPair(3, 9, np.zeros((7, 2), np.int64), np.eye(3))
    turned = PairRotation(0, 1, np.eye(3), 5)
    found = Evidence(_NOTHING, [turned], [pair], [pair]).rotations
    assert [(one.first, one.second, one.support) for one in found] == [(0, 1, 5), (3, 9, 7), (3, 9, 7)]


class _Route:
    """Which parts a reconstruction went through."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, gyro: GyroCalibration | None, starts: bool) -> None:
        self.felt: list[object] = []
        self.reasons: list[str] = []
        self.halves: list[IntArray] = []
        monkeypatch.setattr(dispatch, "calibrated", lambda *_: (gyro, "" if gyro else "It is of no use."))
        monkeypatch.setattr(dispatch, "camera_rotations", lambda *_: "felt")
        monkeypatch.setattr(dispatch, "gather_evidence", self._gather)
        monkeypatch.setattr(dispatch, "start_with_imu", lambda *_: "start" if starts else None)
        monkeypatch.setattr(dispatch, "solve_with_imu", lambda *_: "with the IMU")
        monkeypatch.setattr(dispatch, "solve_from_pictures", self._solve)

    def _gather(self, sights: Sights, camera: object, felt: object, progress: object) -> str:
        self.felt.append(felt)
        return "evidence"

    def _solve(
        self, sights: Sights, camera: object, evidence: object, waypoints: object, reason: str, steps: object
    ) -> Any:
        self.reasons.append(reason)
        self.halves.append(sights.rows)
        count = len(sights.rows)
        T = arc(24, 0.6)[sights.rows]
        return Reconstruction(
            np.ones(count, bool), T, np.zeros((count, 6, 6)), CAMERA, None, _FRAME, None,
            reason, {}, (), 0.3, 5, 0, 2.0,
        )  # fmt: skip


def test_a_useful_imu_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    route = _Route(monkeypatch, _GYRO, starts=True)
    assert dispatch.reconstruct(_sights(), _IMU, []) == "with the IMU"
    assert route.felt == ["felt"]
    assert route.reasons == []


@pytest.mark.parametrize(
    ("imu", "gyro", "reason"),
    [(None, _GYRO, ""), (_IMU, None, "It is of no use."), (_IMU, _GYRO, "The pictures do not show enough")],
)
def test_else_pictures_are_held_against_every_other_of_them(
    imu: Imu | None, gyro: GyroCalibration | None, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    route = _Route(monkeypatch, gyro, starts=False)
    found = dispatch.reconstruct(_sights(), imu, [])
    assert route.reasons[0].startswith(reason)
    assert bool(route.reasons[0]) is bool(reason)
    assert route.reasons[1] == ""
    assert route.halves[1].tolist() == list(range(0, 24, 4))
    assert route.felt[0] == ("felt" if imu is not None and gyro is not None else None)
    assert route.felt[1] is None
    assert found.agreement is not None
    assert found.agreement.same
    assert found.agreement.of == 6


def test_a_second_reconstruction_that_fails_proves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    route = _Route(monkeypatch, None, starts=False)
    solve = route._solve

    def once(*what: Any) -> Any:
        if route.reasons:
            raise MappingFailed("Nothing fits.")
        return solve(*what)

    monkeypatch.setattr(dispatch, "solve_from_pictures", once)
    found = dispatch.reconstruct(_sights(), None, [])
    assert found.agreement is not None
    assert (found.agreement.common, found.agreement.of) == (0, 6)
    assert np.isnan([found.agreement.distance, found.agreement.distance_of_most, found.agreement.angle_deg]).all()


def _loop_state(count: int = 12) -> State:
    return State(arc(count), np.zeros((0, 3)), CAMERA)


def test_loops_are_judged_twice_by_the_walk_that_came_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """First roughly, then in two rounds; the loops that are kept at last are those of the second judgement."""
    pairs = [VerifiedPair(0, k, np.zeros((0, 2), np.int64), np.eye(3)) for k in (7, 8, 9)]
    kept = iter([[True, True, False], [True, False, True]])
    sigmas: list[FloatArray] = []

    def in_reach(loops_: object, placed: object, sigmas_m: FloatArray) -> list[bool]:
        sigmas.append(sigmas_m)
        return next(kept)

    asked: list[tuple[tuple[float, float], int]] = []

    def rounds(problem: Problem, state: State, progress: object, span: tuple[float, float], count: int) -> Any:
        asked.append((span, count))
        return problem, _Adjusted(state)

    covariances = np.tile(np.diag([1.0, 4.0, 4.0, 100, 100, 100]), (12, 1, 1))
    monkeypatch.setattr(loops, "spread_covariances", lambda adjusted, count, computed: covariances[:count])
    monkeypatch.setattr(loops, "place_features", lambda *_: None)
    monkeypatch.setattr(loops, "loops_in_reach", in_reach)
    monkeypatch.setattr(loops, "_with_loops_met", lambda found, placed: _loop_state())
    monkeypatch.setattr(loops, "adjusted_in_rounds", rounds)
    given: list[list[int]] = []
    monkeypatch.setattr(
        Evidence, "observations", lambda self, sights: given.append([pair.second for pair in self.loops])
    )
    evidence = Evidence(_NOTHING, [], [], pairs)
    found, _, _ = loops.with_loops_closed(
        _sights(), evidence, Problem(np.arange(12.0), _NOTHING), _Adjusted(_loop_state()), None
    )  # type: ignore[arg-type]
    assert given == [[7, 8], [7, 9]]
    assert [pair.second for pair in found.loops] == [7, 9]
    assert asked == [((0.6, 0.65), 1), ((0.65, 0.75), 2)]
    np.testing.assert_allclose(sigmas, 3.0)
    none = Evidence(_NOTHING, [], [], [])
    problem, adjusted = Problem(np.arange(12.0), _NOTHING), _Adjusted(_loop_state())
    assert loops.with_loops_closed(_sights(), none, problem, adjusted, None) == (none, problem, adjusted)  # type: ignore[arg-type, comparison-overlap]


@pytest.mark.parametrize(("moved_m", "is_bent"), [(0.14, False), (0.16, True)])
def test_a_walk_is_bent_where_its_loops_are_far_from_closing(
    moved_m: float, is_bent: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = _loop_state()
    T = state.T_map_camera.copy()
    T[5, 1, 3] += moved_m
    bent = replace(state, T_map_camera=T)
    monkeypatch.setattr(loops, "loop_pose", lambda pair, placed: pair if pair != 2 else None)
    given: list[object] = []
    monkeypatch.setattr(loops, "bend", lambda walk, poses: given.extend(poses) or bent)

    class Placed:
        pass

    placed: Any = Placed()
    placed.state = state
    assert loops._with_loops_met([1, 2, 3], placed) is (bent if is_bent else state)  # type: ignore[list-item]
    assert given == [1, 3]
