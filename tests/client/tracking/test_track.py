"""A track: odometry carries a pose, answers correct it, wrong ones do not, and every jump is counted."""

import json
import math
import shutil
import subprocess
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rholoc_client.errors import InvalidTrack
from rholoc_client.tracking import Answer, ImuNoise, Track, Tracked, TrackOptions, TrackStatus
from rholoc_client.tracking.rigid import FloatArray, inverse, motion_between, moved, pose, rotation

FRAMES_PER_S = 30
TEN_SEEDS = [*range(3), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(3, 10))]
EXACT = np.diag([0.01**2] * 3 + [math.radians(0.3) ** 2] * 3)
WRONG = np.array([1.5, -0.8, 0.1, 0.0, 0.0, 1.0])
Heard = Callable[[int, FloatArray], Answer | None]


def walk(seconds: float) -> list[FloatArray]:
    """A camera on its way along an arc, swaying, at about 0.7 m/s."""
    return walk_at(seconds, FRAMES_PER_S)


def walk_at(seconds: float, rate: int) -> list[FloatArray]:
    """The same walk at another rate."""
    poses = []
    for t in np.arange(int(seconds * rate)) / rate:
        position = np.array([2 * math.cos(0.35 * t), 2 * math.sin(0.35 * t), 1.5 + 0.05 * math.sin(5 * t)])
        turn = rotation(np.array([0.0, 0.0, 0.35 * t + 0.2 * math.sin(t)]))
        poses.append(pose(turn @ rotation(np.array([-math.pi / 2, 0.0, 0.0])), position))
    return poses


def odometry(truth: list[FloatArray], rng: np.random.Generator, drift: float = 0.02) -> list[FloatArray]:
    """The walk as odometry has it: in a frame of its own, every step off by a share of its length, to one side."""
    side = rng.normal(size=3)
    side /= np.linalg.norm(side)
    found = [np.eye(4)]
    for before, now in pairwise(truth):
        step = inverse(before) @ now
        step[:3, 3] += drift * np.linalg.norm(step[:3, 3]) * side
        found.append(found[-1] @ step)
    return found


def right(rng: np.random.Generator) -> Heard:
    """Answers as exact as they say."""
    sigmas = np.sqrt(np.diag(EXACT))
    return lambda _, truth: Answer(moved(truth, sigmas * rng.normal(size=6)), EXACT, 0.97)


def follow(
    track: Track, truth: list[FloatArray], odometry_: list[FloatArray] | None, heard: Heard, latency: int = 3
) -> tuple[list[Tracked], list[int]]:
    """Feed a walk to a track; answers come a few frames late. What it said, and at which frames it asked."""
    said, asked = [], []
    for i, _ in enumerate(truth):
        if asked and i == asked[-1] + latency:
            track.answered(heard(asked[-1], truth[asked[-1]]))
        said.append(track.frame(i / FRAMES_PER_S, None if odometry_ is None else odometry_[i]))
        if track.wants_answer:
            track.ask()
            asked.append(i)
    return said, asked


def errors_m(said: list[Tracked], truth: list[FloatArray]) -> FloatArray:
    """Of the frames that have a pose."""
    return np.array(
        [np.linalg.norm(one.pose.position - T[:3, 3]) for one, T in zip(said, truth, strict=True) if one.pose]
    )


@pytest.mark.parametrize("seed", range(2))
def test_odometry_is_carried_and_corrected(seed: int) -> None:
    rng, truth = np.random.default_rng(seed), walk(20)
    said, asked = follow(Track(), truth, odometry(truth, rng), right(rng))
    assert said[-1].status is TrackStatus.TRACKING
    assert said[-1].reset_counter == 0
    assert errors_m(said, truth).max() < 0.05
    assert len(asked) <= 2 * 20 + 1
    assert np.allclose(said[-1].T_map_odom @ odometry_end(truth, seed), said[-1].pose.T_map_camera, atol=1e-6)


def odometry_end(truth: list[FloatArray], seed: int) -> FloatArray:
    return odometry(truth, np.random.default_rng(seed))[-1]


@pytest.mark.slow
def test_errors_are_as_the_covariance_says() -> None:
    """χ² of the last pose's error over many walks: its mean is 6 for an honest filter, less for a careful one."""
    distances = []
    for seed in range(20):
        rng, truth = np.random.default_rng(seed), walk(6)
        said, _ = follow(Track(), truth, odometry(truth, rng), right(rng))
        scale = np.diag([1, 1, 1, *[math.pi / 180] * 3])
        covariance = scale @ np.array(said[-1].covariance) @ scale
        error = motion_between(np.array(said[-1].pose.T_map_camera), truth[-1])
        distances.append(error @ np.linalg.solve(covariance, error))
    assert 0.5 < np.mean(distances) < 8


def test_a_wrong_answer_is_rejected() -> None:
    rng, truth = np.random.default_rng(0), walk(20)
    sound = right(rng)

    def heard(frame: int, T: FloatArray) -> Answer | None:
        return Answer(moved(T, WRONG), EXACT, 0.99) if 200 < frame < 220 else sound(frame, T)

    said, _ = follow(Track(), truth, odometry(truth, rng), heard)
    assert said[-1].rejected >= 1
    assert said[-1].reset_counter == 0
    assert errors_m(said, truth).max() < 0.05


def test_a_track_that_began_wrong_is_given_up_and_says_so() -> None:
    rng, truth = np.random.default_rng(0), walk(20)
    sound = right(rng)

    def heard(frame: int, T: FloatArray) -> Answer | None:
        return Answer(moved(T, WRONG), EXACT, 0.99) if frame == 0 else sound(frame, T)

    said, _ = follow(Track(), truth, odometry(truth, rng), heard)
    assert said[-1].reset_counter == 1
    assert errors_m(said, truth)[-300:].max() < 0.05


def test_a_robot_that_is_carried_elsewhere_is_found_again() -> None:
    """Odometry did not notice: three answers that agree overrule the track."""
    rng, truth = np.random.default_rng(0), walk(20)
    kept = odometry(truth, rng)
    shift = moved(np.eye(4), WRONG)
    elsewhere = [T if i < 300 else shift @ T for i, T in enumerate(truth)]
    said, _ = follow(Track(), elsewhere, kept, right(rng))
    assert said[-1].reset_counter == 1
    assert errors_m(said, elsewhere)[-150:].max() < 0.05


def test_odometry_that_is_not_true_is_not_believed_for_ever() -> None:
    """Its steps go another way than the camera: no two answers agree by it, and the track follows them all the same."""
    rng, truth = np.random.default_rng(0), walk(20)
    strange = [moved(np.eye(4), WRONG * i / 300) for i in range(len(truth))]
    said, _ = follow(Track(), truth, strange, right(rng))
    assert said[-1].reset_counter >= 1
    assert said[-1].since_answer_s < 5


@pytest.mark.parametrize("drift", [0.005, 0.02])
def test_poses_do_not_jump_unsaid(drift: float) -> None:
    rng, truth = np.random.default_rng(4), walk(20)
    moves = odometry(truth, rng, drift)
    said, _ = follow(Track(), truth, moves, right(rng))
    placed = [(one, T) for one, T in zip(said, moves, strict=True) if one.pose is not None]
    for (a, odom_a), (b, odom_b) in pairwise(placed):
        step = np.array(a.pose.T_map_camera) @ inverse(odom_a) @ odom_b
        apart_m = np.linalg.norm(motion_between(step, np.array(b.pose.T_map_camera))[:3])
        assert apart_m < 0.02 or b.reset_counter > a.reset_counter


def test_thirty_seconds_without_an_answer_are_survived() -> None:
    rng, truth = np.random.default_rng(1), walk(60)
    sound = right(rng)

    def heard(frame: int, T: FloatArray) -> Answer | None:
        return None if 300 <= frame < 1200 else sound(frame, T)

    said, asked = follow(Track(), truth, odometry(truth, rng), heard)
    errors = errors_m(said, truth)
    assert all(one.pose is not None for one in said[30:])
    assert errors[1100] < 0.6
    assert np.trace(np.array(said[1199].covariance)[:3, :3]) > 20 * np.trace(np.array(said[299].covariance)[:3, :3])
    assert errors[-300:].max() < 0.05
    assert sum(300 <= frame < 1200 for frame in asked) <= 60


def test_without_motion_and_answers_it_is_lost_and_says_so() -> None:
    rng, truth = np.random.default_rng(1), walk(20)
    sound = right(rng)
    said, _ = follow(Track(), truth, None, lambda i, T: sound(i, T) if i < 200 or i > 400 else None)
    assert said[199].status is TrackStatus.TRACKING
    assert said[390].status is TrackStatus.LOST
    assert said[-1].status is TrackStatus.TRACKING
    assert np.median(errors_m(said[-100:], truth[-100:])) < 0.1


@pytest.mark.slow
def test_the_imu_alone_carries_a_pose_between_answers() -> None:
    """Readings of the walk's own second derivatives, with noise and a bias: within 10 cm at every frame."""
    rng, truth = np.random.default_rng(2), walk(20)
    track, said, asked, sound = Track(TrackOptions(imu=ImuNoise())), [], [], right(rng)
    steps = 6
    fine = walk_at(20, FRAMES_PER_S * steps)
    for i in range(1, len(fine) - 1):
        dt = 1 / (FRAMES_PER_S * steps)
        force = (fine[i + 1][:3, 3] - 2 * fine[i][:3, 3] + fine[i - 1][:3, 3]) / dt**2 + (0, 0, 9.81)
        rate = motion_between(np.eye(4), inverse(fine[i - 1]) @ fine[i + 1])[3:] / (2 * dt)
        track.imu(
            i * dt,
            fine[i][:3, :3].T @ force + 0.1 + rng.normal(0, 0.05 / math.sqrt(dt) * dt, 3),
            rate + 0.005 + rng.normal(0, 0.003, 3),
        )
        if i % steps == 0:
            frame = i // steps
            if asked and frame == asked[-1] + 3:
                track.answered(sound(frame, truth[asked[-1]]))
            said.append(track.frame(frame / FRAMES_PER_S))
            if track.wants_answer:
                track.ask()
                asked.append(frame)
    errors = np.array(
        [np.linalg.norm(one.pose.position - truth[k + 1][:3, 3]) for k, one in enumerate(said) if one.pose is not None]
    )
    assert len(errors) > 0.9 * len(said)
    assert errors.max() < 0.10
    assert len(asked) <= 41


def test_two_doubtful_answers_begin_a_track_where_one_does_not() -> None:
    truth = walk(3)
    track = Track()
    said, asked = follow(track, truth, truth, lambda _, T: Answer(T, EXACT, 0.65))
    first = next(i for i, one in enumerate(said) if one.pose is not None)
    assert said[0].status is TrackStatus.SEARCHING
    assert first > asked[1]


TWIN = pose(rotation(np.array([0.0, 0.0, math.pi])), np.array([8.0, 1.0, 0.0]))
OTHER_TWIN = pose(np.eye(3), np.array([0.0, 9.0, 3.0]))


def undecided(T: FloatArray, rng: np.random.Generator, twin: FloatArray) -> Answer:
    """An answer of two places that look alike; either may be named first."""
    sigmas = np.sqrt(np.diag(EXACT))
    poses = [moved(one, sigmas * rng.normal(size=6)) for one in (T, twin @ T)]
    first, second = (Answer(poses[i], EXACT, 0.49, localized=False) for i in rng.permutation(2))
    return Answer(first.T_map_camera, EXACT, 0.49, True, (second,), False)


@pytest.mark.parametrize("seed", TEN_SEEDS)
def test_of_two_rooms_that_look_alike_the_right_one_wins_by_walking_and_nothing_is_claimed_before(seed: int) -> None:
    rng, truth = np.random.default_rng(seed), walk(20)
    sound, door = right(rng), 240  # after 8 s
    said, asked = follow(
        Track(),
        truth,
        odometry(truth, rng),
        lambda i, T: undecided(T, rng, TWIN) if i < door else sound(i, T),
    )
    first = next(i for i, one in enumerate(said) if one.pose is not None)
    assert door <= first <= next(frame for frame in asked if frame >= door) + 3
    assert errors_m(said, truth).max() < 0.1
    assert said[-1].reset_counter == 0


@pytest.mark.parametrize("seed", TEN_SEEDS)
def test_two_places_that_look_like_others_are_told_apart_by_the_way_between_them(seed: int) -> None:
    """No single frame is ever localized; only one start leads by odometry to a place that the later frames show."""
    rng, truth = np.random.default_rng(seed), walk(20)
    said, _ = follow(
        Track(),
        truth,
        odometry(truth, rng),
        lambda i, T: undecided(T, rng, TWIN if i < 240 else OTHER_TWIN),
    )
    assert all(one.pose is None for one in said[:240])
    assert said[-1].pose is not None
    assert errors_m(said, truth).max() < 0.1


def test_frames_of_another_room_begin_no_track_however_alike_they_are() -> None:
    rng, truth = np.random.default_rng(0), walk(20)
    somewhere = [moved(truth[0], rng.normal(size=6) * (3, 3, 0.3, 1, 1, 1)) for _ in truth]
    said, asked = follow(Track(), truth, truth, lambda i, _: Answer(somewhere[i], EXACT, 0.3, localized=False))
    assert all(one.status is TrackStatus.SEARCHING for one in said)
    assert len(asked) < 20  # they become rarer


def test_an_answer_about_the_past_corrects_the_present() -> None:
    """The camera turned a quarter since it asked: the answer's place is of then, not of now."""
    truth = walk(3)
    track = Track()
    follow(track, truth, truth, lambda _, T: Answer(T, EXACT, 0.97), latency=40)
    assert np.allclose(track.now().pose.T_map_camera, truth[-1], atol=1e-3)


@pytest.mark.parametrize("time_s", [0.0, -1.0, math.nan, math.inf])
def test_times_that_do_not_go_forward_are_refused(time_s: float) -> None:
    track = Track()
    track.frame(0.0)
    track.imu(0.0, np.zeros(3), np.zeros(3))
    with pytest.raises(InvalidTrack, match="time"):
        track.frame(time_s)
    with pytest.raises(InvalidTrack, match="time"):
        track.imu(time_s, np.zeros(3), np.zeros(3))
    track.frame(0.1)


def test_poses_that_are_none_are_refused() -> None:
    mirrored = np.diag([1.0, 1.0, -1.0, 1.0])
    for bad in (mirrored, np.full((4, 4), np.nan), np.eye(3), 2 * np.eye(4)):
        with pytest.raises(InvalidTrack, match="Odometry"):
            Track().frame(0.0, bad)


def test_a_map_without_scale_takes_no_odometry() -> None:
    track = Track()
    track.frame(0.0, np.eye(4))
    track.ask()
    with pytest.raises(InvalidTrack, match="scale is unknown"):
        track.answered(Answer(np.eye(4), EXACT, 0.97, metric=False))


def test_a_long_gap_begins_anew() -> None:
    truth = walk(3)
    track = Track()
    follow(track, truth, truth, lambda _, T: Answer(T, EXACT, 0.97))
    said = track.frame(60.0, truth[-1])
    assert said.status is TrackStatus.SEARCHING
    assert said.reset_counter == 1


@pytest.mark.parametrize("name", ["answers_per_s", "drift_m", "jump_m", "lost_deg", "smoothing_s"])
def test_options_that_make_no_sense_are_refused(name: str) -> None:
    with pytest.raises(InvalidTrack, match=name):
        TrackOptions(**{name: -1.0})


@given(st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6))
def test_motions_and_poses_are_each_others_inverse(values: list[float]) -> None:
    T, motion = walk(1)[7], np.array(values)
    assert np.allclose(motion_between(T, moved(T, motion)), motion, atol=1e-9)


@pytest.mark.skipif(shutil.which("node") is None, reason="Node.js is not installed")
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_the_session_of_javascript_has_the_camera_within_two_centimetres(seed, tmp_path):
    """On the same odometry and the same answers, which come a few frames late to the track."""
    rng = np.random.default_rng(seed)
    truth = walk(40)
    moves = odometry(truth, rng)
    answers = right(rng)
    given: dict[int, Answer] = {}

    def noted(frame: int, T: FloatArray) -> Answer | None:
        given[frame] = said = answers(frame, T)
        return said

    tracked, _ = follow(Track(), truth, moves, noted)
    frames = [
        {
            "time_s": number / FRAMES_PER_S,
            "session_pose": T.ravel().tolist(),
            "T_map_camera": given[number].T_map_camera.ravel().tolist() if number in given else None,
            "localized": True,
            "recognized": 0.97,
        }
        for number, T in enumerate(moves)
    ]
    (tmp_path / "frames.json").write_text(json.dumps({"axes": "opencv", "intervalMs": 0, "frames": frames}))
    here = Path(__file__).parents[1]
    module = (here.parents[1] / "client" / "js" / "index.js").as_uri()
    command = ["node", str(here / "session_replay.mjs"), module, str(tmp_path / "frames.json")]
    said = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout.splitlines()[:-1]
    apart = [
        np.linalg.norm(np.reshape(json.loads(line)[0], (4, 4))[:3, 3] - np.array(one.pose.T_map_camera)[:3, 3])
        for line, one in zip(said, tracked, strict=True)
        if one.pose is not None and json.loads(line)[0] is not None
    ]
    assert len(apart) > 0.95 * len(truth)
    assert np.quantile(apart, 0.99) < 0.02
    assert max(apart[5 * FRAMES_PER_S :]) < 0.03  # of answers that are off by 1 cm along each axis
