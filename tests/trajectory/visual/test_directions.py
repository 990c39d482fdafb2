"""The way between two cameras whose rotations are known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scene import rays
from scipy.spatial.transform import Rotation

from rholoc.geometry import FloatArray, angles_between, on_plane
from rholoc.trajectory.visual.directions import PairDirection, direction_between

_FOCAL_PX = 500.0
_TOLERANCE_PX = 2.0


def _seen(
    way: FloatArray, noise_px: float = 0.0, wrong: float = 0.0, seed: int = 0
) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
    """R_world_camera (2, 3, 3), and sixty points 2–6 m off on the plane z = 1 of cameras ``way`` (3,) metres apart."""
    rng = np.random.default_rng(seed)
    R = Rotation.from_rotvec([[0.1, -0.2, 0.05], [0.15, 0.1, -0.1]]).as_matrix()
    ahead = rng.uniform([-1.5, -1.0, 2.0], [1.5, 1.0, 6.0], (60, 3)) @ R[0].T
    plane = []
    for k, at in enumerate((np.zeros(3), way)):
        seen = (ahead - at) @ R[k]
        plane.append(seen[:, :2] / seen[:, 2:] + rng.normal(0, noise_px / _FOCAL_PX, (60, 2)))
    mismatched = rng.random(60) < wrong
    plane[1][mismatched] = rng.permutation(plane[1][mismatched])
    return R, (rays(plane[0]), rays(plane[1]))


def _angle_deg(a: FloatArray, b: FloatArray) -> float:
    return float(np.degrees(angles_between(a, b)))


@settings(max_examples=30)
@given(st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda way: np.linalg.norm(way) > 0.2))
def test_the_direction_comes_back_with_its_sign(way: tuple[float, float, float]) -> None:
    to = 0.3 * np.array(way) / np.linalg.norm(way)
    R, seen = _seen(to)
    found = direction_between(0, 1, R, seen, _TOLERANCE_PX, _FOCAL_PX)
    assert _angle_deg(found.direction, to) < 0.1


def test_noise_and_mismatches_leave_it_within_its_sigma() -> None:
    way = np.array([0.25, 0.1, 0.05])
    for seed in range(10):
        R, seen = _seen(way, noise_px=0.5, wrong=0.2, seed=seed)
        found = direction_between(0, 1, R, seen, _TOLERANCE_PX, _FOCAL_PX)
        assert _angle_deg(found.direction, way) < np.degrees(3 * found.sigma_rad)


def test_the_shorter_the_way_the_less_is_known() -> None:
    sigmas = []
    for length_m in (0.4, 0.1, 0.03):
        R, seen = _seen(length_m * np.array([1.0, 0.0, 0.0]), noise_px=0.2)
        found = direction_between(0, 1, R, seen, _TOLERANCE_PX, _FOCAL_PX)
        sigmas.append(found.sigma_rad)
    assert sigmas == sorted(sigmas)
    assert sigmas[-1] > 3 * sigmas[0]


@pytest.mark.parametrize("wrong", [0.9, 1.0])
def test_matches_that_agree_on_nothing_tell_no_direction(wrong: float) -> None:
    R, seen = _seen(np.array([0.3, 0.0, 0.0]), wrong=wrong)
    assert direction_between(0, 1, R, seen, 0.2, _FOCAL_PX) is None


def _between(R: FloatArray, seen: tuple[FloatArray, FloatArray]) -> PairDirection | None:
    return direction_between(0, 1, R, seen, _TOLERANCE_PX, _FOCAL_PX)


@pytest.mark.parametrize("way", [np.array([0.3, 0.0, 0.0]), np.array([0.02, 0.01, 0.05])])
def test_its_sigma_is_made_of_rays_rotation_and_what_nobody_knows(way: FloatArray) -> None:
    """Of perfect matches: 0.7 px of the rays, 0.1° of the rotation between the cameras, and half a degree."""
    R, seen = _seen(way)
    found = _between(R, seen)
    a, b = (one @ R[k].T for k, one in enumerate(seen))
    across = np.cross(a, b)
    second = np.linalg.eigvalsh(across.T @ across)[1]
    parallax = np.median(np.linalg.norm(across, axis=1))
    expected = (0.7 / _FOCAL_PX) ** 2 / second + (np.radians(0.1) / parallax) ** 2 + np.radians(0.5) ** 2
    assert found.sigma_rad == pytest.approx(np.sqrt(expected), rel=1e-3)


@pytest.mark.parametrize(("count", "enough"), [(11, False), (12, True)])
def test_a_dozen_matches_are_needed(count: int, enough: bool) -> None:
    R, (first, second) = _seen(np.array([0.3, 0.0, 0.1]))
    assert (_between(R, (first[:count], second[:count])) is not None) is enough


@pytest.mark.parametrize(("right", "enough"), [(80, True), (30, False)])
def test_two_in_five_matches_must_agree(right: int, enough: bool) -> None:
    """A hundred matches, the others moved off their planes by a tenth of the picture and more."""
    rng = np.random.default_rng(0)
    R, (first, second) = _seen(np.array([0.3, 0.0, 0.0]))
    first, second = np.tile(first, (2, 1))[:100], np.tile(second, (2, 1))[:100]
    plane = on_plane(second)
    plane[right:, 1] += rng.uniform(0.2, 0.9, 100 - right) * rng.choice([-1, 1], 100 - right)
    assert (_between(R, (first, rays(plane))) is not None) is enough


@pytest.mark.parametrize(("behind", "clear"), [(0, True), (15, True), (21, False), (39, False), (45, True), (60, True)])
def test_the_sign_is_that_by_which_most_points_lie_ahead(behind: int, clear: bool) -> None:
    """Points behind both cameras appear where they would, were the way the other one."""
    rng = np.random.default_rng(1)
    way = np.array([0.3, 0.05, 0.0])
    R = Rotation.from_rotvec([[0.1, -0.2, 0.05], [0.15, 0.1, -0.1]]).as_matrix()
    points = rng.uniform([-1.5, -1.0, 2.0], [1.5, 1.0, 6.0], (60, 3)) @ R[0].T
    points[:behind] *= -1
    seen = [(points - at) @ R[k] for k, at in enumerate((np.zeros(3), way))]
    found = _between(R, (rays(on_plane(seen[0])), rays(on_plane(seen[1]))))
    assert (found is not None) is clear
    if found is not None:
        assert (found.first, found.second) == (0, 1)
        assert _angle_deg(found.direction, way if behind < 30 else -way) < 0.1


def test_a_few_wrong_matches_within_the_tolerance_hardly_turn_it() -> None:
    """Moved by four pixels across their planes, each is five sigmas off and all but left out."""
    way = np.array([0.3, 0.0, 0.0])
    R, (first, second) = _seen(way)
    plane = on_plane(second)
    plane[:12, 1] += 4 / _FOCAL_PX
    found = direction_between(0, 1, R, (first, rays(plane)), 10.0, _FOCAL_PX)
    assert _angle_deg(found.direction, way) < 0.6
