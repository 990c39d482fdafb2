"""Verified pairs of keyframes: neighbours, and places seen again."""

from dataclasses import replace

import numpy as np
import pytest
from scene import CAMERA, arc, cloud, descriptors_of, in_pixels, sift_like
from scipy.spatial.transform import Rotation

from rholoc.features import FeatureSet
from rholoc.geometry import FloatArray, rotation_angles
from rholoc.progress import Stage
from rholoc.trajectory.visual import loop_candidates as candidates
from rholoc.trajectory.visual.loop_candidates import least_alike, loop_candidates, picture_pairs, sequential_pairs
from rholoc.trajectory.visual.matching import (
    VerifiedPair,
    clear_pairs,
    match_keyframes,
    match_pictures,
    supported_loops,
)


def _seen(T_world_camera: FloatArray, points: FloatArray, descriptors: FloatArray) -> list[FeatureSet]:
    return [sift_like(in_pixels(points, T), descriptors) for T in T_world_camera]


def _rays(features: list[FeatureSet]) -> list[FloatArray]:
    return [CAMERA.rays(one.pixels) for one in features]


def test_sequential_pairs_skip_nothing() -> None:
    pairs = sequential_pairs(10, (1, 2, 3, 6))
    assert len(pairs) == len(set(pairs))
    assert {(i, i + 1) for i in range(9)} <= set(pairs)
    assert {j - i for i, j in pairs} == {1, 2, 3, 6}


@pytest.mark.parametrize("gyroscope", [False, True])
def test_neighbours_agree_and_say_how_the_camera_turned(gyroscope: bool) -> None:
    T = arc(6)
    features = _seen(T, cloud(120), descriptors_of(120))
    by_gyroscope = Rotation.from_matrix(T[:, :3, :3]) if gyroscope else None
    sequential, loops = match_keyframes(features, _rays(features), CAMERA.focal, np.arange(6.0), by_gyroscope, True)
    assert {(pair.first, pair.second) for pair in sequential} >= {(k, k + 1) for k in range(5)}
    assert not loops
    for pair in sequential:
        R = T[pair.second, :3, :3].T @ T[pair.first, :3, :3]
        assert np.degrees(rotation_angles(pair.R_second_first, R)) < 0.5
        assert len(pair.matches) > 100
        np.testing.assert_array_equal(pair.matches[:, 0], pair.matches[:, 1])
        assert pair.rotation.support == len(pair.matches)


def _two_walls(turned_deg: float) -> tuple[list[FeatureSet], Rotation]:
    """Six keyframes along a wall, ten of other things, six along a wall that looks just like the first.

    And the rotations that the gyroscope measured: by then the camera has turned.
    """
    T = arc(6, 0.5)
    points, descriptors = cloud(100), descriptors_of(100)
    between = [sift_like(in_pixels(cloud(100, 50 + k), T[0]), descriptors_of(100, 50 + k)) for k in range(10)]
    wall = _seen(T, points, descriptors)
    R = Rotation.from_matrix(T[:, :3, :3])
    after = Rotation.from_euler("y", turned_deg, degrees=True)
    return [*wall, *between, *wall], Rotation.concatenate([R, Rotation.concatenate([R[5]] * 10), after * R])


def test_a_place_seen_again_is_found() -> None:
    features, by_gyroscope = _two_walls(0.0)
    _, loops = match_keyframes(features, _rays(features), CAMERA.focal, np.arange(22.0), by_gyroscope, True)
    assert len(loops) >= 6
    assert all(pair.first < 6 and pair.second >= 16 for pair in loops)


def test_a_wall_that_only_looks_alike_is_refused_because_the_gyroscope_contradicts_it() -> None:
    features, by_gyroscope = _two_walls(90.0)
    _, loops = match_keyframes(features, _rays(features), CAMERA.focal, np.arange(22.0), by_gyroscope, True)
    assert not loops
    _, believed = match_keyframes(features, _rays(features), CAMERA.focal, np.arange(22.0), None, True)
    assert believed, "pictures alone cannot tell: the test would pass for nothing"


def test_loop_candidates_are_far_apart_in_time_and_few() -> None:
    features, _ = _two_walls(0.0)
    pairs = loop_candidates(features, 9, 3)
    assert all(j - i >= 9 for i, j in pairs)
    assert len(pairs) <= 3 * len(features)
    assert {i for i, j in pairs if i < 6 and j >= 16} == set(range(6))


def _pair(first: int, second: int, matches: int) -> VerifiedPair:
    return VerifiedPair(first, second, np.zeros((matches, 2), np.int64), np.eye(3))


def test_a_loop_stands_alone_only_if_it_is_strong() -> None:
    weak, strong, beside = _pair(0, 50, 40), _pair(10, 70, 90), _pair(1, 52, 35)
    assert supported_loops([weak, strong]) == [strong]
    assert supported_loops([weak, beside]) == [weak, beside]
    assert supported_loops([]) == []


def test_of_many_pictures_those_least_alike_are_kept() -> None:
    places = [descriptors_of(60, seed) for seed in range(4)]
    pixels = np.random.default_rng(0).uniform(0, 400, (60, 2))
    features = [sift_like(pixels, places[k % 4]) for k in range(10)]  # places 0 and 1 three times, 2 and 3 twice
    sharpness = np.arange(10.0)
    assert least_alike(features, sharpness, 4).tolist() == [6, 7, 8, 9]
    assert least_alike(features, sharpness, 10).tolist() == list(range(10))


def test_pairs_that_look_alike_elsewhere_are_left_out() -> None:
    walk = [_pair(k, k + step, 200) for step in (1, 2) for k in range(6 - step)]
    alike = _pair(0, 5, 40)
    assert clear_pairs([*walk, alike], 6) == (walk, [alike])
    loop = _pair(0, 5, 80)
    assert clear_pairs([*walk, loop], 6) == ([*walk, loop], [])
    assert clear_pairs([], 6) == ([], [])


def test_weak_pairs_that_link_two_parts_are_kept() -> None:
    parts = [_pair(a, b, 200) for first in (0, 3) for a in range(first, first + 3) for b in range(a + 1, first + 3)]
    link = _pair(2, 3, 20)
    assert clear_pairs([*parts, link], 6) == ([*parts, link], [])


def test_progress_counts_pairs_up_to_two_fifths() -> None:
    T = arc(6)
    features = _seen(T, cloud(40), descriptors_of(40))
    heard: list[tuple[Stage, float, str]] = []
    match_keyframes(
        features, _rays(features), CAMERA.focal, np.arange(6.0), None, True, lambda *what: heard.append(what)
    )
    total = len(sequential_pairs(6, (1, 2, 4)))
    assert [stage for stage, *_ in heard] == [Stage.POSES] * len(heard)
    assert [share for _, share, _ in heard] == pytest.approx(0.4 * np.arange(1, total + 1) / total)
    assert heard[1][2] == f"2 of {total} pairs of keyframes matched"


def test_a_loop_is_supported_by_one_at_most_two_keyframes_aside() -> None:
    weak = _pair(10, 50, 40)
    for near, supported in ((_pair(12, 48, 40), True), (_pair(13, 50, 40), False), (_pair(10, 53, 40), False)):
        assert (weak in supported_loops([weak, near])) is supported
    assert supported_loops([_pair(0, 9, 79)]) == []
    assert len(supported_loops([_pair(0, 9, 80)])) == 1


def test_candidates_beside_one_another_are_passed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keyframes 20 to 25 look like 0, which takes every second of them; they look more like others than like it."""
    angles = 3.0 + 0.01 * np.arange(26)
    angles[[0, 10, 12, 14]] = [0.0, 0.2, 0.21, 0.22]
    angles[20:] = 0.11 + 0.01 * np.arange(6)

    class Likeness:
        def __init__(self, descriptors: object) -> None:
            pass

        def vectors(self, descriptors: object) -> FloatArray:
            return np.column_stack([np.cos(angles), np.sin(angles)])

    monkeypatch.setattr("rholoc.trajectory.visual.loop_candidates.Vlad", Likeness)
    pairs = loop_candidates([FeatureSet.empty(0)] * 25 + [sift_like(np.zeros((1, 2)), np.zeros((1, 128)))], 6, 3)
    assert [pair for pair in pairs if pair[0] == 0] == [(0, 20), (0, 22), (0, 24)]
    assert loop_candidates([FeatureSet.empty(0)] * 26, 6, 3) == []


def test_neighbours_end_with_the_walk() -> None:
    assert sequential_pairs(5, (1, 4)) == [(0, 1), (0, 4), (1, 2), (2, 3), (3, 4)]


@pytest.fixture
def many(monkeypatch: pytest.MonkeyPatch) -> None:
    """However few pictures there are, they are too many to match all pairs."""
    monkeypatch.setattr(candidates, "_MAX_EXHAUSTIVE", 1)


def test_all_pairs_of_few_pictures_are_matched() -> None:
    features = _seen(arc(3), cloud(60), descriptors_of(60)) + _seen(arc(1), cloud(60), descriptors_of(60, 1))
    assert picture_pairs(features) == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]


def test_pictures_of_two_rooms_are_matched_within_each(many: None) -> None:
    T, places = arc(4), [(cloud(120, seed), descriptors_of(120, seed)) for seed in (0, 1)]
    features = [one for points, descriptors in places for one in _seen(T, points, descriptors)]
    within = [(i, j) for i in range(8) for j in range(i + 1, 8) if i // 4 == j // 4]
    assert picture_pairs(features) == within
    clear, weak = match_pictures(features, _rays(features), CAMERA.focal)
    assert [(pair.first, pair.second) for pair in clear] == within
    assert not weak


def test_many_pictures_are_compared_by_their_largest_features(many: None) -> None:
    """Pictures 0 and 1 share their large features, 0 and 2 their small ones."""
    large, small, others = (descriptors_of(200, seed) for seed in range(3))

    def picture(big: FloatArray, little: FloatArray) -> FeatureSet:
        found = sift_like(np.zeros((400, 2)), np.concatenate([little, big]))
        return replace(found, sizes=np.repeat([2.0, 9.0], 200).astype(np.float32))

    features = [picture(large, small), picture(large, others), picture(others[::-1], small)]
    assert (0, 1) in picture_pairs(features)
    assert (0, 2) not in picture_pairs(features)


def test_of_many_pictures_of_one_place_some_of_the_less_alike_are_matched(monkeypatch: pytest.MonkeyPatch) -> None:
    """All are more alike to one another than to picture 0, which has fewer matches with each later one."""
    count = 300
    alike = {(0, j): count + 1 - j for j in range(1, count)}
    monkeypatch.setattr(candidates, "_matches_of_largest", lambda _, pairs: [alike.get(pair, 500) for pair in pairs])
    chosen = [j for i, j in picture_pairs([FeatureSet.empty(128)] * count) if i == 0]
    assert set(range(1, 21)) <= set(chosen)
    assert 5 <= sum(j > 20 for j in chosen) <= 12
    assert 100 < max(chosen) < count


def test_of_a_large_set_only_those_alike_are_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    compared: list[tuple[int, int]] = []
    monkeypatch.setattr(candidates, "_MAX_EXHAUSTIVE", 1)
    monkeypatch.setattr(candidates, "_MAX_COMPARED", 4)
    monkeypatch.setattr(candidates, "_ALIKE_EACH", 1)
    monkeypatch.setattr(candidates, "_matches_of_largest", lambda _, pairs: compared.extend(pairs) or [9] * len(pairs))
    places = [descriptors_of(60, seed) for seed in range(12)]
    features = [sift_like(np.zeros((60, 2)), descriptors) for descriptors in (*places, places[0])]
    found = picture_pairs(features)
    assert (0, 12) in compared
    assert (0, 7) not in compared
    assert (0, 12) in found
    assert set(found) <= set(compared)


def test_of_many_pictures_one_without_features_has_no_pairs(many: None) -> None:
    features = [*_seen(arc(2), cloud(60), descriptors_of(60)), FeatureSet.empty(128)]
    assert picture_pairs(features) == [(0, 1)]
    assert picture_pairs([]) == []
