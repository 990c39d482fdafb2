"""Links between frames: their equations against differences, and where they draw the frames."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.density import Evidence, RayDensities
from rholoc.geometry import FloatArray, pose_distances, pose_matrix
from rholoc.localization.pose.ascent import ascend, covariance_at, information_at, moved, optimum_at, refined
from rholoc.localization.pose.joint_ascent import Link, ascend_together, joint_covariances, refined_together
from rholoc.localization.types import Dof

_FOCAL_PX = 500.0
_TOLERANCES_PX = (40.0, 20.0, 8.0)


def _random_poses(count: int, seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    return pose_matrix(Rotation.from_rotvec(rng.normal(0, 0.4, (count, 3))).as_matrix(), rng.normal(0, 1, (count, 3)))


def _links(T: FloatArray, sigma_m: float = 0.02, sigma_rad: float = 0.01) -> list[Link]:
    """From the first frame to every other, as they are."""
    return [Link(0, b, np.linalg.inv(T[0]) @ T[b], sigma_m, sigma_rad) for b in range(1, len(T))]


def _log_likelihood(T: FloatArray, links: list[Link]) -> float:
    """− Σ |error|² / 2σ²."""
    total = 0.0
    for link in links:
        expected = T[link.a] @ link.T_a_b
        apart = T[link.b, :3, 3] - expected[:3, 3]
        turned = Rotation.from_matrix(T[link.b, :3, :3] @ expected[:3, :3].T).as_rotvec()
        total -= apart @ apart / (2 * link.sigma_m**2) + turned @ turned / (2 * link.sigma_rad**2)
    return total


def _moved_all(T: FloatArray, step: FloatArray) -> FloatArray:
    return np.array([moved(pose, part) for pose, part in zip(T, step.reshape(-1, 6), strict=True)])


def _evidence(T_map_camera: FloatArray, seed: int, count: int = 30, false: int = 0) -> Evidence:
    """Exact sightings of points ahead of a camera; the last ``false`` of them of something else."""
    rng = np.random.default_rng(seed)
    inside = np.column_stack([rng.uniform(-1, 1, (count, 2)), rng.uniform(2, 4, count)])
    points = inside @ T_map_camera[:3, :3].T + T_map_camera[:3, 3]
    rays = inside / np.linalg.norm(inside, axis=1, keepdims=True)
    rays[count - false :] = rays[:false]
    covariances = np.tile(1e-6 * np.eye(3), (count, 1, 1))
    return Evidence.of(np.arange(count), rays, points, covariances, np.full(count, 0.6), _FOCAL_PX)


def test_frames_climb_together_to_where_each_was() -> None:
    truth = _random_poses(3, 5)
    evidences = [_evidence(T, seed, false=8) for seed, T in enumerate(truth)]
    start = _moved_all(truth, np.random.default_rng(6).normal(0, 0.02, 18))
    climbed = ascend_together(RayDensities(), evidences, start, _links(truth), _TOLERANCES_PX, Dof.FREE)
    for T in (climbed, refined_together(evidences, climbed, _links(truth), Dof.FREE)):
        apart_m, turned_rad = pose_distances(T, truth)
        assert np.all(apart_m < 1e-3)
        assert np.all(turned_rad < 1e-3)


def test_a_frame_without_matches_goes_where_its_link_says() -> None:
    truth = _random_poses(2, 7)
    seen, blind = _evidence(truth[0], 0), _evidence(truth[1], 1).take(np.zeros(0, np.int64))
    start = truth.copy()
    start[1] = moved(start[1], np.array([0.1, -0.05, 0.08, 0.05, 0.02, -0.04]))
    climbed = ascend_together(RayDensities(), [seen, blind], start, _links(truth), _TOLERANCES_PX, Dof.FREE)
    refined_ = refined_together([seen, blind], start, _links(truth), Dof.FREE)
    for T in (climbed, refined_):
        apart_m, turned_rad = pose_distances(T[1], truth[1])
        assert apart_m < 1e-3
        assert turned_rad < 1e-3


def test_frames_without_matches_stay_where_they_are() -> None:
    start = _random_poses(2, 7)
    blind = _evidence(start[0], 1).take(np.zeros(0, np.int64))
    links = [Link(0, 1, np.eye(4), 0.01, 0.01)]
    np.testing.assert_array_equal(refined_together([blind, blind], start, links, Dof.FREE), start)


def test_one_frame_alone_climbs_as_it_always_does() -> None:
    truth = _random_poses(1, 8)
    evidence = _evidence(truth[0], 2)
    start = moved(truth[0], np.full(6, 0.01))
    joint = ascend_together(RayDensities(), [evidence], start[None], [], _TOLERANCES_PX, Dof.FREE)[0]
    alone = ascend(RayDensities(), evidence, start, _TOLERANCES_PX, Dof.FREE)
    np.testing.assert_allclose(joint, alone.T_map_camera, atol=1e-4)


def test_one_frame_alone_is_refined_as_it_always_is() -> None:
    T = _random_poses(1, 8)[0]
    exact = _evidence(T, 2)
    offsets = np.random.default_rng(1).standard_t(2, (30, 3))
    evidence = replace(exact, landmarks=exact.landmarks + 0.01 * offsets)
    joint = refined_together([evidence], T[None], [], Dof.FREE)[0]
    alone = refined(evidence, T, Dof.FREE)
    apart_m, _ = pose_distances(joint, T)
    assert apart_m > 1e-3  # the landmarks' errors move it
    np.testing.assert_allclose(joint, alone, atol=1e-4)


def test_stiff_links_share_what_each_frame_knows_and_loose_ones_do_not() -> None:
    truth = _random_poses(2, 9)
    evidences = [_evidence(truth[0], 3, 60), _evidence(truth[1], 4, 6)]
    optima = [optimum_at(RayDensities(), e, T, 8.0) for e, T in zip(evidences, truth, strict=True)]

    def sigmas_m(sigma: float) -> FloatArray:
        covariances = joint_covariances(evidences, optima, _links(truth, sigma, sigma))
        assert covariances.shape == (2, 6, 6)
        return np.sqrt(np.trace(covariances[:, :3, :3], axis1=1, axis2=2))

    alone = sigmas_m(1e3)
    together = sigmas_m(1e-4)
    assert np.all(together < alone)
    assert together[1] < 0.7 * alone[1]
    between = sigmas_m(0.5 * alone[1])
    assert together[1] < between[1] < alone[1]


def test_a_frame_that_nothing_is_known_of_may_be_a_kilometre_off() -> None:
    blind = _evidence(np.eye(4), 1).take(np.zeros(0, np.int64))
    covariances = joint_covariances([blind], [optimum_at(RayDensities(), blind, np.eye(4), 8.0)], [])
    np.testing.assert_allclose(covariances, [1e6 * np.eye(6)])


def test_joint_covariances_are_of_all_that_frames_and_links_know() -> None:
    truth = _random_poses(3, 11)
    evidences = [_evidence(T, seed, 40) for seed, T in enumerate(truth)]
    optima = [optimum_at(RayDensities(), e, T, 8.0) for e, T in zip(evidences, truth, strict=True)]
    for found, one, optimum in zip(joint_covariances(evidences, optima, []), evidences, optima, strict=True):
        np.testing.assert_allclose(found, covariance_at(one, optimum), rtol=1e-6, atol=1e-12)
    links = [Link(0, 1, np.linalg.inv(truth[0]) @ truth[1], 0.002, 0.001)]
    links.append(Link(1, 2, np.linalg.inv(truth[1]) @ truth[2], 0.004, 0.003))
    axes = 1e-5 * np.eye(18)

    def fallen(step: FloatArray) -> float:
        return -_log_likelihood(_moved_all(truth, step), links)

    bent = np.array([[fallen(a + b) - fallen(a - b) for b in axes] for a in axes]) / 2e-10
    for i, (one, optimum) in enumerate(zip(evidences, optima, strict=True)):
        bent[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] += information_at(one, optimum)
    whole = np.linalg.inv(bent + 1e-6 * np.eye(18))
    for i, found in enumerate(joint_covariances(evidences, optima, links)):
        expected = whole[6 * i : 6 * i + 6, 6 * i : 6 * i + 6]
        np.testing.assert_allclose(found, expected, atol=2e-3 * np.abs(expected).max())


def test_five_steps_at_each_tolerance_unless_they_are_below_a_tenth_of_a_millimetre() -> None:
    truth = _random_poses(2, 12)
    rng = np.random.default_rng(0)
    exact = [_evidence(T, seed) for seed, T in enumerate(truth)]
    evidences = [replace(one, landmarks=one.landmarks + rng.normal(0, 0.05, (30, 3))) for one in exact]
    start = _moved_all(truth, np.full(12, 0.05))

    def climbed(iterations: int | None) -> FloatArray:
        more = {} if iterations is None else {"iterations": iterations}
        return ascend_together(RayDensities(), evidences, start, _links(truth, 0.3, 0.3), (30.0,), Dof.FREE, **more)

    ways = [climbed(count) for count in range(1, 40)]
    np.testing.assert_array_equal(climbed(None), ways[4])
    lengths = [
        max(
            np.abs(np.r_[(b - a)[:3, 3], Rotation.from_matrix(b[:3, :3] @ a[:3, :3].T).as_rotvec()]).max()
            for a, b in zip(one, next_, strict=True)
        )
        for one, next_ in pairwise(ways)
    ]
    taken = [length for length in lengths if length > 0]
    assert 5 < len(taken) < len(lengths)  # it goes on after five, and settles
    assert taken[-1] < 1e-4 <= min(taken[:-1])
