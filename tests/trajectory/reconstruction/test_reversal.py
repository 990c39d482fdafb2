"""A scene turned inside out explains pictures nearly as well where perspective is weak."""

from typing import Any

import numpy as np
import pytest
from scene import arc, cloud

from rholoc.geometry import Camera, FloatArray, umeyama
from rholoc.progress import silent
from rholoc.trajectory.optimization.problem import State
from rholoc.trajectory.optimization.rounds import AdjustmentProgress
from rholoc.trajectory.reconstruction.part import Part, Pictured, adjusted_part
from rholoc.trajectory.reconstruction.reversal import reversed_start, unreversed
from rholoc.trajectory.visual.tracks import Observations

_COUNT, _POINTS, _AWAY = 10, 100, 5.0
_TELE = Camera(640, 480, 2400.0, 2400.0, 319.5, 239.5)
_PROGRESS, _SPAN = AdjustmentProgress(silent), (0.0, 1.0)


def _poses(radians: float = 0.5) -> FloatArray:
    """Cameras 20 m from points that are within 2 m of each other."""
    T = arc(_COUNT, radians)
    T[:, :3, 3] *= _AWAY
    return T


def _seen(T: FloatArray) -> Observations:
    points = cloud(_POINTS)
    pixels = np.array([_TELE.project((points - one[:3, 3]) @ one[:3, :3]) for one in T])
    pixels += np.random.default_rng(0).normal(0, 0.3, pixels.shape)
    keyframes, tracks = (some.ravel() for some in np.indices(pixels.shape[:2]))
    return Observations(keyframes, tracks, pixels.reshape(-1, 2))


def _walk() -> Pictured:
    taken = type("Sights", (), {"steps": ()})()
    things = {"rows": np.arange(_COUNT), "times": np.arange(float(_COUNT)), "camera": _TELE, "take": lambda *_: taken}
    sights: Any = type("Sights", (), things)()
    evidence: Any = type("Evidence", (), {"sequential": []})()
    return Pictured(sights, _TELE, evidence)


def _part(T: FloatArray, seen: Observations) -> Part:
    start = State(T, np.zeros((0, 3)), _TELE), np.arange(_COUNT)
    return adjusted_part(_walk(), seen, start, _PROGRESS, _SPAN)


def _off_m(part: Part, T: FloatArray) -> float:
    positions = part.adjusted.state.positions
    return float(np.abs(umeyama(positions, T[:, :3, 3]).points(positions) - T[:, :3, 3]).max())


def test_what_was_turned_inside_out_is_turned_back() -> None:
    T, seen = _poses(), _seen(_poses())
    right = _part(T, seen)
    wrong = adjusted_part(_walk(), seen, reversed_start(right), _PROGRESS, _SPAN)
    assert _off_m(wrong, T) > 5 * _off_m(right, T)
    assert wrong.inliers < right.inliers
    found = unreversed(wrong, _walk(), seen, _PROGRESS, _SPAN)
    assert _off_m(found, T) == pytest.approx(_off_m(right, T), rel=0.2)


def test_what_is_right_stays_as_it_is() -> None:
    right = _part(_poses(), _seen(_poses()))
    assert unreversed(right, _walk(), _seen(_poses()), _PROGRESS, _SPAN) is right


def test_pictures_from_all_sides_are_not_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    part = _part(_poses(4.0), _seen(_poses(4.0)))
    monkeypatch.setattr("rholoc.trajectory.reconstruction.reversal.adjusted_part", None)
    assert unreversed(part, _walk(), _seen(_poses(4.0)), _PROGRESS, _SPAN) is part
