"""Depth pictures and known lengths measure the scale of a reconstruction."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from scene import CAMERA, arc, in_pixels

from rholoc.geometry import BoolArray, FloatArray, Similarity
from rholoc.recordings.frames.depth import DepthImages
from rholoc.trajectory.frame.map_frame import ScaleMeasurement, ScaleSource
from rholoc.trajectory.optimization.problem import Problem, State, Step
from rholoc.trajectory.reconstruction.measured_scale import (
    scale_by_depth,
    scale_by_steps,
    scaled_by_steps,
    scales_by_lengths,
    with_depths,
)
from rholoc.trajectory.visual.tracks import Observations

_COUNT = 12
_UNIT = 0.37  # of the reconstruction, in metres
_SIZE = (160, 120)


@dataclass(frozen=True, eq=False)
class _Adjusted:
    state: State
    used: BoolArray


def _wall() -> FloatArray:
    """Points (N, 3) of the plane z = 0, which all cameras see."""
    x, y = np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-0.8, 0.8, 7))
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])


def _depth_images(folder: Path, factors: FloatArray) -> DepthImages:
    """The wall's depths in mm, times a factor for each camera."""
    own = CAMERA.resized(*_SIZE)
    v, u = np.mgrid[: _SIZE[1], : _SIZE[0]]
    rays = own.rays(np.column_stack([u.ravel(), v.ravel()]).astype(np.float64))
    paths = []
    for k, (T, factor) in enumerate(zip(arc(_COUNT), factors, strict=True)):
        reach = -T[2, 3] / (rays @ T[2, :3])
        metres = (factor * reach * rays[:, 2]).reshape(_SIZE[1], _SIZE[0])
        paths.append(folder / f"{k}.png")
        assert cv2.imwrite(str(paths[-1]), np.clip(1000 * metres, 0, 65534).astype(np.uint16))
    return DepthImages(tuple(paths))


def _measured(depth: DepthImages | None) -> ScaleMeasurement | None:
    """By a reconstruction of the wall whose unit of length is 0.37 m."""
    T, points = arc(_COUNT), _wall()
    pixels = np.concatenate([in_pixels(points, one) for one in T])
    keyframes, tracks = np.repeat(np.arange(_COUNT), len(points)), np.tile(np.arange(len(points)), _COUNT)
    shrunk = Similarity(1 / _UNIT, np.eye(3), np.array([3.0, 1.0, 2.0]))
    state = State(shrunk.poses(T), shrunk.points(points), CAMERA)
    observations = with_depths(Observations(keyframes, tracks, pixels), depth, CAMERA)
    problem = Problem(np.arange(float(_COUNT)), observations)
    return scale_by_depth(problem, _Adjusted(state, np.ones(len(tracks), np.bool_)))  # type: ignore[arg-type]


def test_depth_gives_the_unit_of_a_reconstruction(tmp_path: Path) -> None:
    found = _measured(_depth_images(tmp_path, np.ones(_COUNT)))
    assert found.source is ScaleSource.DEPTH
    assert found.ratio == pytest.approx(_UNIT, rel=2e-3)
    assert 0.01 <= found.sigma < 0.011
    assert found.usable
    assert not found.is_adjusted


def test_depth_that_wavers_along_the_walk_is_less_certain(tmp_path: Path) -> None:
    factors = 1 + 0.08 * np.sin(np.arange(_COUNT))
    found = _measured(_depth_images(tmp_path, factors))
    assert abs(found.ratio / _UNIT - 1) < 2 * found.sigma
    assert found.sigma > 0.02


def test_depth_of_other_places_fixes_no_scale(tmp_path: Path) -> None:
    found = _measured(_depth_images(tmp_path, np.geomspace(0.4, 2.5, _COUNT)))
    assert not found.usable


def test_without_enough_depth_nothing_is_measured(tmp_path: Path) -> None:
    assert _measured(None) is None
    three = _depth_images(tmp_path, np.ones(_COUNT)).paths[:3]
    assert _measured(DepthImages((*three, *[None] * (_COUNT - 3)))) is None
    assert _measured(DepthImages(tuple(tmp_path / f"missing{k}.png" for k in range(_COUNT)))) is None


def test_a_known_length_gives_the_unit_the_surer_the_longer_it_is() -> None:
    T = arc(_COUNT)
    shrunk = Similarity(1 / _UNIT, np.eye(3), np.zeros(3))
    adjusted = _Adjusted(State(shrunk.poses(T), np.zeros((0, 3)), CAMERA), np.zeros(0, np.bool_))
    lengths = [(a, b, float(np.linalg.norm(T[a, :3, 3] - T[b, :3, 3]))) for a, b in ((0, 1), (11, 0))]
    short, long = scales_by_lengths(lengths, adjusted)  # type: ignore[arg-type]
    assert short.source is ScaleSource.LENGTH
    assert short.ratio == pytest.approx(_UNIT)
    assert long.ratio == pytest.approx(_UNIT)
    assert long.sigma < 0.02 < short.sigma
    assert scales_by_lengths([], adjusted) == []  # type: ignore[arg-type]


def _steps(factors: FloatArray, turned: FloatArray | None = None, is_mounting: bool = False) -> list[Step]:
    """From each camera to the next, times a factor and turned by a rotation."""
    T = np.linalg.inv(arc(_COUNT)[:-1]) @ arc(_COUNT)[1:]
    T[:, :3, 3] *= factors[:, None]
    if turned is not None:
        T[:, :3, 3] = T[:, :3, 3] @ turned.T
    return [Step(k, k + 1, one, 0.01, 0.01, is_mounting) for k, one in enumerate(T)]


def _by_steps(steps: list[Step]) -> tuple[ScaleMeasurement | None, State | None]:
    T = arc(_COUNT)
    shrunk = Similarity(1 / _UNIT, np.eye(3), np.array([3.0, 1.0, 2.0]))
    adjusted = _Adjusted(State(shrunk.poses(T), np.zeros((0, 3)), CAMERA), np.zeros(0, np.bool_))
    return scale_by_steps(steps, adjusted), scaled_by_steps(steps, adjusted)  # type: ignore[arg-type]


@pytest.mark.parametrize(("is_mounting", "source"), [(False, ScaleSource.ODOMETRY), (True, ScaleSource.MOUNTING)])
def test_steps_give_the_unit_of_a_reconstruction(is_mounting: bool, source: ScaleSource) -> None:
    found, state = _by_steps(_steps(np.ones(_COUNT - 1), is_mounting=is_mounting))
    assert found.source is source
    assert found.ratio == pytest.approx(_UNIT)
    assert found.sigma == pytest.approx(0.01)
    np.testing.assert_allclose(np.diff(state.positions, axis=0), np.diff(arc(_COUNT)[:, :3, 3], axis=0), atol=1e-9)


def test_steps_that_slip_are_less_certain() -> None:
    found, _ = _by_steps(_steps(np.tile([0.95, 1.0, 1.05], _COUNT)[: _COUNT - 1]))
    assert 0.012 < found.sigma < 0.05
    assert abs(found.ratio / _UNIT - 1) < 2 * found.sigma


def test_steps_of_another_way_fix_no_scale() -> None:
    about = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    for steps in (_steps(np.geomspace(0.4, 2.5, _COUNT - 1)), _steps(np.ones(_COUNT - 1), about)):
        found, state = _by_steps(steps)
        assert not found.usable
        assert state is None
    assert _by_steps(_steps(np.ones(_COUNT - 1))[:4]) == (None, None)
    assert _by_steps([]) == (None, None)
