"""Modes of one place: poses along an arc around what a picture shows."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.geometry import Pose
from rholoc.localization import Dof, Localizer, Query
from rholoc.localization.pose.modes import Spread, are_distinct, is_seen_from_afar, poses_on_arcs
from rholoc.localization.pose.pose_evidence import Support
from rholoc.localization.pose.rematching import verify
from rholoc.localization.search import Found, Search


def test_poses_on_arcs_keep_what_is_seen_in_the_middle_and_at_its_distance(point_room: Any) -> None:
    localizer = Localizer(point_room.map_of(point_room.walk(60), "arcs"))
    truth = point_room.walk(60)[20]
    query = Query(point_room.see(truth, 1), point_room.camera, Dof.FREE)
    verified = verify(localizer.index, query, query.camera.rays(query.features.pixels), truth.T_map_camera)
    seen = localizer.index.landmarks[verified.matches.landmarks[verified.optimum.density > 0]]
    centre, T = np.median(seen, axis=0), verified.optimum.T_map_camera
    arcs = list(poses_on_arcs(localizer.index, verified))
    assert len(arcs) == 4
    for carried in arcs:
        np.testing.assert_allclose(
            carried[:3, :3].T @ (centre - carried[:3, 3]), T[:3, :3].T @ (centre - T[:3, 3]), atol=1e-9
        )
        turned = Rotation.from_matrix(carried[:3, :3] @ T[:3, :3].T).magnitude()
        assert np.degrees(turned) == pytest.approx(8)
    assert not is_seen_from_afar(verified)


@pytest.mark.parametrize(("found", "afar"), [(24, True), (26, False)])
def test_a_frame_that_finds_few_of_the_expected_landmarks_is_taken_from_afar(
    verified_at: Any, found: int, afar: bool
) -> None:
    assert is_seen_from_afar(verified_at(Pose(np.eye(4)), Support(9, 1, found, 100))) is afar


def test_the_spread_of_modes_is_that_of_samples_of_them(verified_at: Any) -> None:
    rng = np.random.default_rng(0)
    poses = [Pose.from_heading(rng.normal(0, 0.1, 3), np.array([1.0, 0, 0]) + rng.normal(0, 0.01, 3)) for _ in range(4)]
    weights = np.array([0.4, 0.3, 0.2, 0.1])
    T = poses[0].T_map_camera
    drawn = rng.choice(4, 100_000, p=weights)
    moves = np.array(
        [
            np.r_[one.position - T[:3, 3], Rotation.from_matrix(one.R_map_camera @ T[:3, :3].T).as_rotvec()]
            for one in poses
        ]
    )[drawn]
    modes = [verified_at(one) for one in poses]
    found = Spread.of(modes[0], modes, weights)
    np.testing.assert_allclose(found.moment, moves.T @ moves / len(moves), atol=3e-4)
    near = np.linalg.norm([one.position - poses[0].position for one in poses], axis=1) < 0.1
    assert found.right == pytest.approx(weights[near].sum())
    assert 0.4 <= found.right < 1
    assert are_distinct(verified_at(poses[0]), verified_at(poses[1]))
    assert not are_distinct(verified_at(poses[0]), verified_at(poses[0]))


def test_an_answer_with_two_modes_is_less_exact_but_as_surely_of_the_place(
    point_room: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    localizer = Localizer(point_room.map_of(point_room.walk(60), "modes"))
    query = Query(point_room.see(point_room.walk(60)[20], 1), point_room.camera, Dof.FREE)
    answer = localizer.localize(query)
    assert answer.covariance is not None
    spread = np.diag([0.2**2 / 2, 0, 0, 0, 0, 0])
    monkeypatch.setattr(Search, "outcome", with_modes(Search.outcome, Spread(0.5, spread)))
    wider = localizer.localize(query)
    assert wider.covariance is not None
    np.testing.assert_allclose(wider.covariance, answer.covariance + spread, atol=1e-9)
    assert wider.belief.exact == pytest.approx(0.5 * answer.belief.exact)
    assert wider.recognized == pytest.approx(answer.recognized)


def with_modes(outcome: Callable[..., Found | None], modes: Spread) -> Callable[..., Found | None]:
    def changed(*args: Any) -> Found | None:
        found = outcome(*args)
        return None if found is None else replace(found, modes=modes)

    return changed
