"""Autofocus zooms pictures: their zooms are told from how near they were, and taken out."""

from dataclasses import replace
from typing import Any

import numpy as np
from scene import CAMERA, arc, cloud, in_pixels

from rholoc.features import Channel, FeatureSet
from rholoc.geometry import FloatArray, umeyama
from rholoc.progress import silent
from rholoc.reports import TrajectoryReport
from rholoc.trajectory import Scale, Trajectory
from rholoc.trajectory.optimization.problem import State
from rholoc.trajectory.optimization.rounds import AdjustmentProgress
from rholoc.trajectory.optimization.zooms import measure_zooms, zoomed
from rholoc.trajectory.reconstruction import from_pictures
from rholoc.trajectory.reconstruction.part import Part, Pictured, adjusted_part, agreement_of
from rholoc.trajectory.visual.tracks import Observations

COUNT, POINTS, NOISE_PX = 14, 150, 0.3
T, PLACES = arc(COUNT), cloud(POINTS)
PROGRESS = AdjustmentProgress(silent)
ZOOMS = 1 + np.random.default_rng(1).uniform(-0.02, 0.02, COUNT)


def seen(zooms: FloatArray) -> Observations:
    """All points in all pictures, with noise."""
    noise = np.random.default_rng(2).normal(0, NOISE_PX, (COUNT, POINTS, 2))
    pixels = np.array([in_pixels(PLACES, one) for one in T]) + noise
    keyframes, tracks = np.repeat(np.arange(COUNT), POINTS), np.tile(np.arange(POINTS), COUNT)
    return zoomed(Observations(keyframes, tracks, pixels.reshape(-1, 2)), 1 / zooms, CAMERA)


def test_a_zoom_is_told_from_having_been_nearer() -> None:
    nearer = T.copy()
    nearer[:, :3, 3] += 0.05 * T[:, :3, 2]
    found, differ = measure_zooms(seen(ZOOMS), State(nearer, PLACES, CAMERA), NOISE_PX)
    assert differ
    np.testing.assert_allclose(found, ZOOMS / np.median(ZOOMS), atol=0.006)


def test_pictures_of_one_zoom_do_not_differ() -> None:
    assert not measure_zooms(seen(np.ones(COUNT)), State(T, PLACES, CAMERA), NOISE_PX)[1]


def reconstructed(zooms: FloatArray) -> tuple[Part, Pictured, Observations]:
    """A reconstruction of pictures with these zooms, which it does not know, of the walk, and its sightings."""
    taken: Any = type("Sights", (), {"steps": ()})()
    things = {"rows": np.arange(COUNT), "times": np.arange(float(COUNT)), "camera": CAMERA, "take": lambda *_: taken}
    sights: Any = type("Sights", (), things)()
    evidence: Any = None
    walk, whole = Pictured(sights, CAMERA, evidence), seen(zooms)
    start = State(T, np.zeros((0, 3)), CAMERA), np.arange(COUNT)
    return adjusted_part(walk, whole, start, PROGRESS, (0.0, 0.5)), walk, whole


def test_zooms_are_taken_out_of_a_reconstruction() -> None:
    part, walk, whole = reconstructed(ZOOMS)
    found = from_pictures._unzoomed(part, part, walk, whole, PROGRESS)

    def off_m(positions: FloatArray) -> float:
        return float(np.median(np.linalg.norm(umeyama(positions, T[:, :3, 3]).points(positions) - T[:, :3, 3], axis=1)))

    assert found.zooms is not None
    assert np.corrcoef(found.zooms, ZOOMS)[0, 1] > 0.95
    assert off_m(found.adjusted.state.positions) < 0.4 * off_m(part.adjusted.state.positions)


def test_where_zooms_are_alike_a_reconstruction_stays() -> None:
    part, walk, whole = reconstructed(np.ones(COUNT))
    assert from_pictures._unzoomed(part, None, walk, whole, PROGRESS) is part


def test_where_another_reconstruction_contradicts_the_zooms_it_stays() -> None:
    """Measured zooms bent a set that two reconstructions had agreed on: the map without them was not tried."""
    part, walk, whole = reconstructed(ZOOMS)
    state = part.adjusted.state
    bent = state.T_map_camera.copy()
    bent[:, 1, 3] += np.linspace(-1, 1, COUNT) ** 2 * 6
    other = replace(part, adjusted=replace(part.adjusted, state=replace(state, T_map_camera=bent)))
    assert agreement_of(part, other).contradicts
    assert from_pictures._unzoomed(part, other, walk, whole, PROGRESS) is part


def test_features_of_a_map_are_unzoomed() -> None:
    pixels = np.array([[CAMERA.cx + 100, CAMERA.cy - 50]], np.float32)
    features = FeatureSet(
        pixels, np.full(1, Channel.SIFT, np.uint8), np.zeros((1, 128), np.uint8), np.full(1, 4, np.float32),
        np.zeros(1, np.float32),
    )  # fmt: skip
    report = TrajectoryReport("visual", 2, True, "")
    walk = Trajectory(
        np.arange(2), np.arange(2.0), T[:2], CAMERA, Scale.METRIC, True, report, zooms=np.array([1.0, 1.25])
    )
    assert walk.at_once(0, features).pixels.tolist() == pixels.tolist()
    unzoomed = walk.at_once(1, features)
    np.testing.assert_allclose(unzoomed.pixels, [[CAMERA.cx + 80, CAMERA.cy - 40]], atol=1e-3)
    np.testing.assert_allclose(unzoomed.sizes, [3.2])
