"""From what was seen and measured to a start, and which way a reconstruction goes: by the parts, put in by hand."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from scene import CAMERA, arc, cloud, in_pixels
from scipy.spatial.transform import Rotation
from synthetic_walk import followed

from rholoc.errors import MappingFailed
from rholoc.features import FeatureSet
from rholoc.geometry import FloatArray, IntArray, Similarity
from rholoc.progress import silent
from rholoc.recordings import GRAVITY, Imu
from rholoc.trajectory import Scale
from rholoc.trajectory.checks.agreement import Agreement
from rholoc.trajectory.frame.map_frame import MapFrame
from rholoc.trajectory.inertial.gyroscope import GyroCalibration
from rholoc.trajectory.optimization.problem import InertialState, Problem, State
from rholoc.trajectory.optimization.rounds import AdjustmentProgress
from rholoc.trajectory.reconstruction import dispatch, from_imu
from rholoc.trajectory.reconstruction.outcome import Reconstruction
from rholoc.trajectory.reconstruction.part import Pictured
from rholoc.trajectory.reconstruction.sights import Evidence, Sights, gather_evidence
from rholoc.trajectory.visual.matching import VerifiedPair
from rholoc.trajectory.visual.tracks import Observations
from rholoc.trajectory.visual.two_view import PairRotation

_GYRO = GyroCalibration(
    0.01, 0.0, np.array([0.1, 0.2, 0.3]), 0.0, Rotation.from_euler("x", 90, degrees=True).as_matrix(), False, 0.0, 0.1
)
_IMU = Imu(np.arange(2.0), np.full((2, 3), 2.0), np.zeros((2, 3)), True, None)
_FRAME = MapFrame(Similarity.identity(), Scale.ARBITRARY, False, "", "")
_NOTHING = Observations.none()


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


def _features(pixels: FloatArray) -> FeatureSet:
    zeros = np.zeros(len(pixels), np.float32)
    return FeatureSet(
        pixels.astype(np.float32), np.zeros(len(pixels), np.uint8), np.zeros((len(pixels), 0), np.uint8), zeros, zeros
    )


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
    np.testing.assert_allclose(found.imu.acceleration, 2.0 / (read if corrected else 1.0))
    np.testing.assert_allclose(after.state.inertial.gravity[2], -GRAVITY * (1 if corrected else read))


def test_what_shows_nothing_has_no_observations() -> None:
    with pytest.raises(MappingFailed, match="nothing that could be followed"):
        Evidence(_NOTHING, [], [], []).observations(_sights(2))


def test_photos_that_share_nothing_need_no_slower_walk() -> None:
    sights = _sights(2)
    photos = replace(sights, is_film=False, flow=replace(sights.flow, timed=False))
    with pytest.raises(MappingFailed, match=r"No two pictures overlap enough\. Take more"):
        Evidence(_NOTHING, [], [], []).observations(photos)


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


@pytest.mark.parametrize(
    ("is_film", "features", "by_gyroscope", "followed_too"),
    [(True, 0, None, True), (False, 1, None, False), (False, 0, Rotation.identity(12), True), (False, 0, None, True)],
    ids=["a film", "a set", "a set with a gyroscope", "a set's odometry, which has no features"],
)
def test_corners_of_a_set_are_not_followed_without_a_gyroscope(
    is_film: bool, features: int, by_gyroscope: Rotation | None, followed_too: bool
) -> None:
    """Corners followed over half a second made poses of a desk a quarter less exact than matches alone."""
    sights = replace(_sights(), is_film=is_film, features=[_features(np.zeros((features, 2)))] * 12)
    found = gather_evidence(sights, CAMERA, by_gyroscope, silent)
    assert bool(len(found.corners)) is followed_too


class _Route:
    """Which parts a reconstruction went through."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, gyro: GyroCalibration | None, starts: bool) -> None:
        self.by_gyroscope: list[object] = []
        self.reasons: list[str] = []
        self.halves: list[IntArray] = []
        monkeypatch.setattr(dispatch, "calibrated", lambda *_: (gyro, "" if gyro else "It is of no use."))
        monkeypatch.setattr(dispatch, "camera_rotations", lambda *_: "by_gyroscope")
        monkeypatch.setattr(dispatch, "gather_evidence", self._gather)
        monkeypatch.setattr(dispatch, "start_with_imu", lambda *_: "start" if starts else None)
        monkeypatch.setattr(dispatch, "solve_with_imu", lambda *_: "with the IMU")
        monkeypatch.setattr(dispatch, "solve_from_pictures", self._solve)
        monkeypatch.setattr(dispatch, "solve_from_set", self._solve_set)

    def _gather(self, sights: Sights, camera: object, by_gyroscope: object, progress: object) -> Evidence:
        self.by_gyroscope.append(by_gyroscope)
        return Evidence(_NOTHING, [], [], [])

    def _solve(self, walk: Pictured, steps: object) -> Any:
        self.reasons.append(walk.reason)
        self.halves.append(walk.sights.rows)
        count = len(walk.sights.rows)
        T = arc(24, 0.6)[walk.sights.rows]
        return Reconstruction(
            np.ones(count, bool), T, np.zeros((count, 6, 6)), CAMERA, None, _FRAME, None,
            walk.reason, {}, (), 0.3, 5, 0, 2.0,
        )  # fmt: skip

    def _solve_set(self, walk: Pictured, steps: object) -> Any:
        assert not walk.sights.is_film
        assert len(walk.evidence.corners), "what was followed through the film is lost"
        self.reasons.append("set")
        return replace(self._solve(replace(walk, reason="set"), steps), residual_px=0.5)


def test_a_useful_imu_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    route = _Route(monkeypatch, _GYRO, starts=True)
    assert dispatch.reconstruct(_sights(), _IMU, []) == "with the IMU"
    assert route.by_gyroscope == ["by_gyroscope"]
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
    assert route.by_gyroscope[0] == ("by_gyroscope" if imu is not None and gyro is not None else None)
    assert route.by_gyroscope[1] is None
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
    assert (found.agreement.common, found.agreement.of) == (0, 6)
    assert np.isnan([found.agreement.distance, found.agreement.distance_of_most, found.agreement.angle_deg]).all()


@pytest.mark.parametrize(
    ("placed", "apart", "as_set"),
    [(12, 0.05, False), (10, 0.001, True), (12, 0.2, True), (None, 0.0, True)],
    ids=["a film", "much is left out", "halves contradict each other", "nothing is placed"],
)
def test_a_film_that_cannot_be_followed_is_a_set(
    placed: int | None, apart: float, as_set: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    route = _Route(monkeypatch, None, starts=False)

    def followed(*what: Any) -> Any:
        if placed is None:
            raise MappingFailed("Nothing fits.")
        return replace(route._solve(*what), placed=np.arange(12) < placed)

    monkeypatch.setattr(dispatch, "solve_from_pictures", followed)
    monkeypatch.setattr(dispatch, "_agreement", lambda *_: Agreement(apart, apart, 0.1, 6, 6))
    found = dispatch.reconstruct(_sights(), None, [])
    assert (found.residual_px == 0.5) is as_set
    assert ("as a set of pictures" in found.note) is as_set


@pytest.mark.parametrize("placed", [10, 12])
def test_a_film_whose_halves_contradict_each_other_makes_no_map(placed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two reconstructions were apart by 45 times the depth, and the map was published."""
    route = _Route(monkeypatch, None, starts=False)
    apart = 45.0 if placed == 12 else 0.001

    def contradicted(*_: Any) -> Any:
        raise MappingFailed("Reconstructions of these pictures contradict each other.")

    monkeypatch.setattr(
        dispatch, "solve_from_pictures", lambda *what: replace(route._solve(*what), placed=np.arange(12) < placed)
    )
    monkeypatch.setattr(dispatch, "_agreement", lambda *_: Agreement(apart, apart, 9.0, 6, 6))
    monkeypatch.setattr(dispatch, "solve_from_set", contradicted)
    if placed == 12:
        with pytest.raises(MappingFailed, match="contradict each other"):
            dispatch.reconstruct(_sights(), None, [])
    else:
        assert dispatch.reconstruct(_sights(), None, []).placed.sum() == 10


def test_where_corners_cannot_be_followed_matched_pictures_calibrate_the_gyroscope(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """At a picture a second 19 of 30 were placed, without the IMU, for it seemed to contradict them."""
    route = _Route(monkeypatch, None, starts=True)
    monkeypatch.setattr(dispatch, "calibrated", lambda *what: (_GYRO, "") if what[3:] else (None, "It contradicts."))
    assert dispatch.reconstruct(replace(_sights(), is_film=False), _IMU, []) == "with the IMU"
    assert route.by_gyroscope == [None, "by_gyroscope"]


def test_pictures_that_are_linked_calibrate_the_gyroscope(monkeypatch: pytest.MonkeyPatch) -> None:
    sights = _sights(5)
    R = Rotation.from_rotvec(np.outer(np.arange(5.0), [0, 1, 0])).as_matrix()
    monkeypatch.setattr(from_imu, "average_rotations", lambda *_: (R, np.array([0, 1, 1, 0, 1])))
    monkeypatch.setattr(from_imu, "calibrate_gyro", lambda *what: replace(_GYRO, bias=what))
    gyro, reason = from_imu.calibrated(sights, CAMERA, _IMU, Evidence(_NOTHING, [], [], []))
    assert reason == ""
    np.testing.assert_allclose(gyro.bias[0], sights.times[[1, 2, 4]])
    np.testing.assert_allclose(gyro.bias[1], R[[1, 2, 4]])
