"""Adjusting in rounds: from far off, sightings that look wrong at first are right in the end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scene import CAMERA, in_pixels

from rholoc.geometry import FloatArray, pose_matrix, umeyama
from rholoc.progress import silent
from rholoc.trajectory.optimization.adjustment import GUESSED, Problem, State
from rholoc.trajectory.reconstruction import rounds as module
from rholoc.trajectory.reconstruction.rounds import AdjustmentProgress, adjusted_in_rounds
from rholoc.trajectory.visual.tracks import Observations

_CAMERAS, _POINTS = 40, 1200


def _outward(count: int, turn_rad: float, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """A way around the middle of a room looking at its walls, and what hangs there."""
    angles = np.linspace(0, turn_rad, count)
    ahead = np.column_stack([np.sin(angles), np.cos(angles), np.zeros(count)])
    right = np.column_stack([np.cos(angles), -np.sin(angles), np.zeros(count)])
    down = np.tile([0.0, 0.0, -1.0], (count, 1))
    around = rng.uniform(0, 2 * np.pi, _POINTS)
    walls = np.column_stack([np.sin(around), np.cos(around)]) * rng.uniform(2.5, 4, (_POINTS, 1))
    return pose_matrix(np.stack([right, down, ahead], axis=2), 1.2 * ahead), np.column_stack(
        [walls, rng.uniform(-1, 1, _POINTS)]
    )


def test_a_focal_length_far_off_is_found_though_the_walk_is_bent_by_it() -> None:
    """Around a room, from rotations that are short by as much as the guessed focal length is long."""
    rng = np.random.default_rng(0)
    T, points = _outward(_CAMERAS, 2 * np.pi, rng)
    pixels = np.array([in_pixels(points, one) for one in T])
    ahead = np.einsum("kij,nki->nkj", T[:, :3, :3], points[:, None] - T[None, :, :3, 3])[..., 2].T > 0.3
    inside = np.all((pixels >= 0) & (pixels < [CAMERA.width, CAMERA.height]), axis=2)
    keyframes, tracks = np.nonzero(ahead & inside)
    observations = Observations(keyframes, tracks, pixels[keyframes, tracks] + rng.normal(0, 0.1, (len(tracks), 2)))
    guess = replace(CAMERA, fx=1.08 * CAMERA.fx, fy=1.08 * CAMERA.fy, distortion=(0.0, 0.0, 0.0, 0.0))
    problem = Problem(np.arange(_CAMERAS) / 2, observations, camera_sigmas=GUESSED, pixel_sigma_px=0.5)
    bent, _ = _outward(_CAMERAS, 2 * np.pi / 1.08, rng)
    start = State(bent, np.zeros((_POINTS, 3)), guess)
    _, adjusted = adjusted_in_rounds(problem, start, AdjustmentProgress(silent), (0.0, 1.0), 3)
    assert abs(adjusted.state.camera.fx / CAMERA.fx - 1) < 0.015
    to_truth = umeyama(adjusted.state.positions[1:], T[1:, :3, 3])
    assert np.median(np.linalg.norm(to_truth.points(adjusted.state.positions) - T[:, :3, 3], axis=1)) < 0.03


@pytest.mark.parametrize("rounds", [1, 2, 3])
def test_each_round_starts_where_the_last_ended_and_all_but_the_last_are_coarse(
    rounds: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Sightings are judged among all there are, not among those of the round before."""
    rng = np.random.default_rng(0)
    T, _ = _outward(4, 1.0, rng)
    points = np.array([1.5, 2.6, 0.0]) + rng.uniform(-0.5, 0.5, (30, 3))  # before all four cameras
    pixels = np.array([in_pixels(points, one) for one in T])
    keyframes, tracks = (grid.ravel() for grid in np.meshgrid(np.arange(4), np.arange(30), indexing="ij"))
    problem = Problem(np.arange(4.0), Observations(keyframes, tracks, pixels.reshape(-1, 2)))
    asked: list[tuple[int, int, bool]] = []

    class Found:
        def __init__(self, state: State) -> None:
            self.state = state

    def adjust(given: Problem, state: State, iterations: int, progress: object, coarsely: bool = False) -> Found:
        asked.append((int(state.points[0, 0]), iterations, coarsely))
        return Found(replace(state, points=np.full((30, 3), len(asked))))

    judged: list[int] = []
    clean = module._cleaned

    def cleaned(given: Problem, observations: Observations, off: FloatArray) -> Problem:
        judged.append(len(observations))
        return clean(given, observations, np.where(np.arange(len(off)) < 9, 50.0, 0.1))

    monkeypatch.setattr(module, "adjust", adjust)
    monkeypatch.setattr(module, "_cleaned", cleaned)
    heard: list[tuple[float, str]] = []
    progress = AdjustmentProgress(lambda stage, share, text="": heard.append((share, text)))
    state = State(T, np.zeros((30, 3)), CAMERA)
    found, _ = adjusted_in_rounds(problem, state, progress, (0.2, 0.8), rounds)
    assert [start for start, *_ in asked] == list(range(rounds))
    assert {iterations for _, iterations, _ in asked} == {12}
    assert [coarse for *_, coarse in asked] == [True, *[k < rounds for k in range(2, rounds + 1)]]
    assert judged == [120] * (rounds - 1)
    assert [share for share, _ in heard] == pytest.approx(0.2 + 0.6 * np.arange(rounds) / rounds)
    assert [text for _, text in heard] == ["all measurements adjusted together", *["adjusted anew"] * (rounds - 1)]
    assert (len(found.observations) < 120) is (rounds > 1)
    assert found.pixel_sigma_px == (0.35 if rounds > 1 else problem.pixel_sigma_px)


def test_before_the_first_step_progress_is_where_the_poses_begin() -> None:
    heard: list[float] = []
    progress = AdjustmentProgress(lambda stage, share, text="": heard.append(share))
    progress(0.0)
    progress(1.0)
    assert heard == pytest.approx([0.4, 0.45])
