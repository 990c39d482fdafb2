"""Rotation averaging: wrong pairs are outvoted."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from rholoc.geometry import FloatArray
from rholoc.trajectory.initialization.rotation_averaging import average_rotations
from rholoc.trajectory.visual.two_view import PairRotation

_COUNT = 40
_TIMES = 0.5 * np.arange(_COUNT)


def _true() -> Rotation:
    rng = np.random.default_rng(1)
    return Rotation.from_rotvec(np.cumsum(rng.normal(0, 0.15, (_COUNT, 3)), axis=0))


def _pairs(true: Rotation, wrong: float, without: tuple[int, ...] = ()) -> list[PairRotation]:
    """Neighbours and next but ones, right to 0.3°, a share of them entirely wrong; none across some keyframes."""
    rng = np.random.default_rng(2)
    pairs = []
    for step in (1, 2, 4):
        for i in range(_COUNT - step):
            if any(i < k <= i + step for k in without):
                continue
            R = (true[i + step].inv() * true[i]).as_matrix()
            R = Rotation.from_rotvec(np.radians(rng.normal(0, 0.3, 3))).as_matrix() @ R
            mistaken = rng.random() < wrong  # what is wrong has fewer matches that agree with it
            R = Rotation.random(rng=rng).as_matrix() if mistaken else R
            pairs.append(PairRotation(i, i + step, R, 30 if mistaken else 100))
    return pairs


def _off_deg(found: FloatArray, true: Rotation, of: slice = slice(None)) -> FloatArray:
    """The angles by which rotations differ from the true ones, the first of them taken for right."""
    estimated = Rotation.from_matrix(found[of])
    truth = true[of]
    return np.degrees((estimated.inv() * estimated[0] * truth[0].inv() * truth).magnitude())


def _felt(true: Rotation) -> Rotation:
    """What a gyroscope makes of them: right from one to the next, 1° off at the end, in a frame of its own."""
    drift = Rotation.from_rotvec(np.outer(np.linspace(0, np.radians(1), _COUNT), [0.0, 0.6, 0.8]))
    return Rotation.from_euler("x", 40, degrees=True) * true * drift


def test_pairs_without_noise_give_the_rotations_back() -> None:
    true = _true()
    exact = [PairRotation(i, i + 1, (true[i + 1].inv() * true[i]).as_matrix(), 50) for i in range(_COUNT - 1)]
    found, component = average_rotations(_COUNT, exact, _TIMES, None)
    assert _off_deg(found, true).max() < 1e-4
    assert set(component.tolist()) == {0}
    np.testing.assert_allclose(found[0], np.eye(3), atol=1e-6)


@pytest.mark.parametrize("gyroscope", [False, True])
def test_wrong_pairs_are_outvoted(gyroscope: bool) -> None:
    true = _true()
    found, _ = average_rotations(_COUNT, _pairs(true, wrong=0.12), _TIMES, _felt(true) if gyroscope else None)
    assert _off_deg(found, true).max() < 3.0


def test_a_gyroscope_carries_across_where_pictures_show_nothing() -> None:
    true = _true()
    pairs = _pairs(true, wrong=0.0, without=(20,))
    found, component = average_rotations(_COUNT, pairs, _TIMES, _felt(true))
    assert set(component.tolist()) == {0}
    assert _off_deg(found, true).max() < 2.0


def test_without_a_gyroscope_pieces_have_frames_of_their_own() -> None:
    true = _true()
    found, component = average_rotations(_COUNT, _pairs(true, wrong=0.0, without=(20,)), _TIMES, None)
    assert component[:20].tolist() == [0] * 20
    assert component[20:].tolist() == [20] * 20
    for part in (slice(0, 20), slice(20, None)):
        assert _off_deg(found, true, part).max() < 1.5


def test_without_pairs_every_keyframe_is_alone() -> None:
    found, component = average_rotations(3, [], np.arange(3.0), None)
    assert component.tolist() == [0, 1, 2]
    np.testing.assert_allclose(found, np.tile(np.eye(3), (3, 1, 1)), atol=1e-9)


def _gyro_sigma_deg(seconds: float) -> float:
    """A fiftieth of a degree at once, a twentieth for the root of every second, a milliradian a second of bias."""
    return float(np.sqrt(0.02**2 + 0.05**2 * seconds + (np.degrees(1e-3) * seconds) ** 2))


@pytest.mark.parametrize(("apart_deg", "seconds"), [(0.3, 2.0), (0.8, 5.0), (3.0, 5.0), (0.5, 60.0)])
def test_pictures_and_gyroscope_meet_by_what_they_are_worth(apart_deg: float, seconds: float) -> None:
    """Two keyframes, about one axis: pictures to 0.4°, doubted from twice that on."""

    def cost(deg: float) -> float:
        by_pictures = ((apart_deg - deg) / 0.4) ** 2
        return float(2 * np.log1p(by_pictures / 4) + (deg / _gyro_sigma_deg(seconds)) ** 2 / 2)

    expected = minimize_scalar(cost, bounds=(0, apart_deg), method="bounded", options={"xatol": 1e-7}).x
    seen = Rotation.from_euler("z", apart_deg, degrees=True)
    pair = PairRotation(0, 1, seen.inv().as_matrix(), 100)
    found, _ = average_rotations(2, [pair], np.array([0.0, seconds]), Rotation.identity(2))
    turned = Rotation.from_matrix(found[0].T @ found[1]).as_rotvec(degrees=True)
    np.testing.assert_allclose(turned, [0, 0, expected], atol=2e-3)
