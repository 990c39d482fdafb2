"""What to do better: each advice from its own measured figure."""

import math
from pathlib import Path

import cv2
import numpy as np
import phone_recordings as phone
import pytest

from rholoc.geometry import Pose
from rholoc.recordings import Imu, Look, Recording, Waypoint, advise, look_at, measure_walk, pauses, read_recording
from rholoc.recordings.frames.memory_frames import MissingImages
from rholoc.recordings.walk.stillness import is_still
from rholoc.recordings.walk.walk_figures import look_through, nearest_return
from rholoc.reports import AdviceKind, WalkFigures, report_to_json

GOOD = {"turn_deg_s": 30.0, "brightness": 120.0, "bare_share": 0.0, "pauses": 3, "waypoints": 3, "nearest_return": 0.05}


def test_a_good_walk_gets_no_advice_and_an_unknown_one_neither() -> None:
    assert advise(WalkFigures(**GOOD)) == ()
    assert advise(WalkFigures()) == ()


@pytest.mark.parametrize(
    ("figure", "value", "kind"),
    [
        ("turn_deg_s", 80.0, AdviceKind.TOO_FAST),
        ("brightness", 20.0, AdviceKind.TOO_DARK),
        ("bare_share", 0.4, AdviceKind.TOO_LITTLE_TEXTURE),
        ("pauses", 1, AdviceKind.PAUSES_MISSING),
        ("nearest_return", 0.6, AdviceKind.NO_LOOP),
    ],
)
def test_one_figure_makes_one_advice_that_states_it(figure: str, value: float, kind: AdviceKind) -> None:
    (advice,) = advise(WalkFigures(**{**GOOD, figure: value}))
    assert advice.kind is kind
    assert advice.figure == value
    assert f"{value:.0%}" in advice.text or f"{value:.0f}" in advice.text
    assert "\n" not in advice.text
    assert report_to_json(advice)["kind"] == kind.value


def test_a_look_measures_light_and_corners() -> None:
    blocks = np.random.default_rng(0).integers(0, 2, (30, 80)).repeat(16, axis=0).repeat(16, axis=1)
    board = np.repeat((120 * blocks + 40).astype(np.uint8)[:, :, None], 3, axis=2)
    board += np.random.default_rng(1).integers(0, 6, board.shape, dtype=np.uint8)
    look = look_at(board)
    assert look.brightness == pytest.approx(102.5, abs=6)
    assert look.corners > 100
    assert look_at(cv2.GaussianBlur(board, (0, 0), 12)).corners < 20
    assert look_at(np.full((48, 64, 3), 7, np.uint8)) == Look(7.0, 0)


def walked(imu: Imu | None = None, waypoints: tuple[Waypoint, ...] = ()) -> Recording:
    frames = MissingImages(np.arange(50) / 10, np.arange(50))
    return Recording(frames, "walk", Path("walk"), imu=imu, waypoints=waypoints)


def resting_at(stops: list[float], turn: float = 0.6) -> Imu:
    """Ten seconds at 100 Hz that turn and shake, but for 1.4 s around each stop."""
    times = np.arange(1000) / 100
    moving = np.all([np.abs(times - stop) > 0.7 for stop in stops] or [times >= 0], axis=0)
    rng = np.random.default_rng(3)
    rate = np.column_stack([0 * times, turn * moving, 0 * times]) + 0.02 * rng.normal(size=(1000, 3))
    shake = np.column_stack([0 * times, 9.81 + moving * np.sin(12 * times), 0 * times])
    return Imu(times, shake + 0.05 * rng.normal(size=(1000, 3)), rate, True, None)


def test_pauses_are_where_nothing_moves() -> None:
    found = pauses(resting_at([2.0, 5.0, 8.0]))
    np.testing.assert_allclose(found.mean(axis=1), [2, 5, 8], atol=0.1)
    assert np.all(found[:, 1] - found[:, 0] > 1)
    assert len(pauses(resting_at([2.0]), shortest_s=2.0)) == 0
    assert len(pauses(resting_at([]))) == 0


def test_turning_slowly_is_no_pause() -> None:
    times = np.arange(500) / 100
    rest = np.tile([0, 0, 9.81], (500, 1))
    still = Imu(times, rest, np.zeros((500, 3)), True, None)
    assert is_still(still).all()
    assert not is_still(Imu(times, rest, np.tile([0, 0, 0.08], (500, 1)), True, None)).any()
    assert is_still(Imu(times[:1], rest[:1], rest[:1], True, None)).tolist() == [False]


def test_figures_of_a_walk_with_an_imu() -> None:
    waypoints = tuple(Waypoint(name, time, (0, 0, 0)) for name, time in (("W1", 2.0), ("W2", 3.6), ("W3", 5.0)))
    looks = [Look(10.0, 500), Look(30.0, 40), Look(90.0, 500), Look(50.0, 500)]
    figures = measure_walk(walked(resting_at([2.0, 5.0]), waypoints), looks, np.zeros(0), np.zeros((0, 4, 4)))
    assert figures.turn_deg_s == pytest.approx(math.degrees(0.6), rel=0.1)
    assert figures.brightness == 40
    assert figures.bare_share == 0.25
    assert (figures.pauses, figures.waypoints) == (2, 3)
    assert figures.nearest_return is None


def test_without_an_imu_poses_tell_how_fast_it_turned() -> None:
    times = np.arange(60) / 30
    T = np.array([Pose.from_heading(np.zeros(3), np.array([np.cos(t), np.sin(t), 0])).T_map_camera for t in times])
    figures = measure_walk(walked(), [], times, T)
    assert figures.turn_deg_s == pytest.approx(math.degrees(1.0), rel=1e-3)
    assert figures.pauses is None
    assert figures.brightness is None
    assert measure_walk(walked(), [], times[:1], T[:1]).turn_deg_s is None


def test_pictures_without_times_are_no_walk_that_could_return(tmp_path: Path) -> None:
    for number in range(4):
        cv2.imwrite(str(tmp_path / f"{number}.png"), np.zeros((48, 64, 3), np.uint8))
    line = np.tile(np.eye(4), (4, 1, 1))
    line[:, 0, 3] = np.arange(4)
    figures = measure_walk(read_recording(tmp_path), [], np.arange(4.0), line)
    assert (figures.nearest_return, figures.turn_deg_s) == (None, None)
    assert measure_walk(walked(), [], np.arange(4.0), line).nearest_return == 1


@pytest.mark.parametrize("unit", [0.01, 1.0, 100.0])
def test_a_loop_is_a_return_that_looks_the_same_way(unit: float) -> None:
    angles = np.linspace(0, 2 * np.pi, 80)

    def walk(places: np.ndarray, headings: np.ndarray) -> np.ndarray:
        pairs = zip(places * unit, headings, strict=True)
        return np.array([Pose.from_heading(place, heading).T_map_camera for place, heading in pairs])

    ring = np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
    ahead = np.column_stack([-np.sin(angles), np.cos(angles), 0 * angles])
    line = np.column_stack([angles, 0 * angles, 0 * angles])
    along = np.tile([1.0, 0, 0], (80, 1))
    assert nearest_return(walk(ring, ahead)) == pytest.approx(0, abs=0.01)
    assert nearest_return(walk(line, along)) == pytest.approx(1)
    there_and_back = np.concatenate([line[:40], line[39::-1]])
    assert nearest_return(walk(there_and_back, along)) == pytest.approx(0, abs=0.01)
    assert nearest_return(walk(there_and_back, np.concatenate([along[:40], -along[:40]]))) == pytest.approx(1)
    assert nearest_return(walk(0 * line, along)) is None
    assert nearest_return(walk(line[:2], along[:2])) is None


def test_frames_are_looked_at_all_over_a_recording(tmp_path: Path) -> None:
    recording = read_recording(phone.write_recording("tum", tmp_path / "walk"))
    np.testing.assert_allclose([look.brightness for look in look_through(recording.frames)], np.arange(24) * 10)
    assert look_through(walked().frames) == []
