"""Zoom of each picture relative to a common camera, as autofocus changes it."""

from dataclasses import replace

import numpy as np

from rholoc.geometry import Camera, FloatArray, cross, on_plane
from rholoc.trajectory.optimization.problem import State
from rholoc.trajectory.visual.tracks import Observations
from rholoc.trajectory.visual.unzooming import unzoomed

_MIN_SIGHTINGS = 20
_PRIOR_SIGMA = 0.02  # of a zoom: lenses breathe by so much
_CAUCHY = 2.0  # sigmas
_STEPS = 4
_MIN_SPREAD, _MIN_SIGMAS = 0.002, 2.0  # of zooms that are more than noise: absolute, and in their standard deviations
_MAD_TO_SIGMA = 1.4826


def zoomed(observations: Observations, zooms: FloatArray, camera: Camera) -> Observations:
    """The observations as if no picture were zoomed: each pixel's offset from the principal point of ``camera`` is
    divided by its keyframe's zoom, ``zooms`` (K,).
    """
    factor = 1 / zooms[observations.keyframes]
    return replace(observations, pixels=unzoomed(observations.pixels, factor[:, None], camera))


def measure_zooms(observations: Observations, state: State, sigma_px: float) -> tuple[FloatArray, bool]:
    """Zoom (K,) of each picture relative to the median zoom, and whether the zooms clearly differ.

    A picture's zoom and pose are estimated from its sightings with the points held. Pictures with fewer than 20
    sightings get zoom 1.

    Args:
        observations: of K pictures, inliers.
        state: solution for them.
        sigma_px: of a sighting's coordinates.
    """
    count = len(state.T_map_camera)
    zooms, sigmas = np.ones(count), np.full(count, np.inf)
    measured = on_plane(state.camera.rays(observations.pixels))
    T = state.T_map_camera[observations.keyframes]
    seen = np.einsum("nji,nj->ni", T[:, :3, :3], state.points[observations.tracks] - T[:, :3, 3])
    sigma = sigma_px / state.camera.focal
    good = np.isfinite(seen).all(axis=1) & (seen[:, 2] > 0)
    order = np.argsort(observations.keyframes, kind="stable")
    order = order[good[order]]
    starts = np.searchsorted(observations.keyframes[order], np.arange(count + 1))
    for k in range(count):
        rows = order[starts[k] : starts[k + 1]]
        if len(rows) >= _MIN_SIGHTINGS:
            zooms[k], sigmas[k] = _zoom(seen[rows], measured[rows], sigma)
    known = np.isfinite(sigmas)
    if not known.any():
        return np.ones(count), False
    middle = float(np.median(zooms[known]))
    spread = _MAD_TO_SIGMA * float(np.median(np.abs(zooms[known] - middle)))
    zooms[~known] = middle
    return zooms / middle, spread >= max(_MIN_SPREAD, _MIN_SIGMAS * float(np.median(sigmas[known])))


def _zoom(points: FloatArray, measured: FloatArray, sigma: float) -> tuple[float, float]:
    """Zoom and its standard deviation, by Gauss–Newton with Cauchy's weights over a picture's pose and zoom.

    Args:
        points: (N, 3) in the camera frame of the start.
        measured: (N, 2) on the plane z = 1.
        sigma: of its coordinates.
    """
    zoom, prior = 1.0, np.diag([0.0] * 6 + [1 / _PRIOR_SIGMA**2])
    information = prior
    for _ in range(_STEPS):
        plane = on_plane(points)
        off = measured - zoom * plane
        weight = 1 / (1 + np.sum(off**2, axis=1) / (_CAUCHY * sigma) ** 2) / sigma**2
        by_point = np.zeros((len(points), 2, 3))
        by_point[:, 0, 0] = by_point[:, 1, 1] = 1
        by_point[:, :, 2] = -plane
        by_point *= zoom / points[:, 2, None, None]
        by_turn = np.stack([np.einsum("nij,nj->ni", by_point, cross(axis, points)) for axis in np.eye(3)], axis=2)
        slopes = np.concatenate([by_turn, by_point, plane[:, :, None]], axis=2)  # (N, 2, 7)
        information = prior + np.einsum("n,nij,nik->jk", weight, slopes, slopes)
        target = np.einsum("n,nij,ni->j", weight, slopes, off)
        target[6] -= (zoom - 1) / _PRIOR_SIGMA**2
        step = np.linalg.solve(information + 1e-9 * np.eye(7), target)
        points = points + cross(step[:3], points) + step[3:6]
        zoom += step[6]
    return zoom, float(np.sqrt(np.linalg.inv(information)[6, 6]))
