"""Patches as files keep them: near what they were, and rounded once."""

from __future__ import annotations

import numpy as np

from rholoc.geometry import angles_between
from rholoc.maps import packed_patches, storable_patches, unpacked_patches


def test_packing_keeps_directions_to_a_degree_and_lengths_to_five_percent() -> None:
    rng = np.random.default_rng(0)
    lengths = np.exp(rng.uniform(np.log(1e-4), np.log(1e3), (5000, 1)))
    units = rng.normal(size=(5000, 3))
    units /= np.linalg.norm(units, axis=1, keepdims=True)
    rounded = unpacked_patches(packed_patches(units * lengths)).astype(np.float64)
    kept = np.linalg.norm(rounded, axis=1, keepdims=True)
    assert np.rad2deg(angles_between(rounded / kept, units)).max() < 1
    assert np.abs(np.log(kept / lengths)).max() < np.log(1.05)


def test_what_is_rounded_once_stays_as_it_is() -> None:
    coordinates = np.arange(-127, 128, dtype=np.int8)
    every = np.stack(np.meshgrid(coordinates, coordinates, np.array([-127, 3, 127], np.int8)), axis=-1).reshape(-1, 3)
    once = unpacked_patches(every)
    assert np.isfinite(once).all()
    np.testing.assert_array_equal(unpacked_patches(packed_patches(once)), once)


def test_the_axes_are_exact() -> None:
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    np.testing.assert_array_equal(unpacked_patches(packed_patches(axes)), axes)


def test_what_is_not_known_stays_unknown() -> None:
    patches = np.array([[0.1, 0, 0], [np.nan, np.nan, np.nan], [0, 0, 0]])
    np.testing.assert_array_equal(np.isnan(storable_patches(patches)).all(axis=1), [False, True, True])
    assert storable_patches(patches[1:]) is None
