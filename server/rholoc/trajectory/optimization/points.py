"""Points from their sightings, with all else held: triangulated, refined and judged."""

import numpy as np

from rholoc.geometry import BoolArray, FloatArray, angles_between, on_plane
from rholoc.trajectory.optimization.problem import State
from rholoc.trajectory.visual.tracks import Observations

CAUCHY_PIXELS = 2.0  # sigmas
_MIN_PARALLAX_DEG = 1.5  # between the rays to a usable point
_SETTLING_STEPS = 6


def triangulate(observations: Observations, state: State) -> tuple[FloatArray, FloatArray]:
    """Points (M, 3) nearest to the rays of their sightings, and twice each one's largest angle [°] of a ray to the
    mean.
    """
    rays = np.einsum("nij,nj->ni", state.R_map_camera[observations.keyframes], state.camera.rays(observations.pixels))
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    seen_from = np.einsum("nij,nj->ni", across, state.positions[observations.keyframes])
    count = observations.points
    information, target, middle = np.zeros((count, 3, 3)), np.zeros((count, 3)), np.zeros((count, 3))
    np.add.at(information, observations.tracks, across)
    np.add.at(target, observations.tracks, seen_from)
    np.add.at(middle, observations.tracks, rays)
    points = np.linalg.solve(information + 1e-9 * np.eye(3), target[..., None])[..., 0]
    middle /= np.maximum(np.linalg.norm(middle, axis=1, keepdims=True), 1e-12)
    off = angles_between(rays, middle[observations.tracks])
    widest = np.zeros(count)
    np.maximum.at(widest, observations.tracks, off)
    return points, 2 * np.degrees(widest)


def residuals_px(observations: Observations, state: State, points: FloatArray | None = None) -> FloatArray:
    """Reprojection errors (N,) of the sightings [px], with ``points`` (M, 3) or the state's; inf behind the camera."""
    points = state.points if points is None else points
    R_map_plane, measured = _image_planes(observations, state)
    seen = np.einsum("nji,nj->ni", R_map_plane, points[observations.tracks] - state.positions[observations.keyframes])
    ahead = seen[:, 2] > 1e-6
    off = np.full(len(observations), np.inf)
    off[ahead] = np.linalg.norm(on_plane(seen[ahead]) - measured[ahead], axis=1) * state.camera.focal
    return off


def usable_points(observations: Observations, state: State, sigma_px: float) -> tuple[FloatArray, BoolArray]:
    """Points (M, 3), triangulated and refined, and a mask (N,) of the usable sightings.

    A usable sighting has a residual below 20 px (or 4 × the median, if larger), and belongs to a point with
    ``observations.fewest`` such sightings and more than 1.5° of parallax.
    """
    points, parallax_deg = triangulate(observations, state)
    off = residuals_px(observations, state, points)
    near = off < max(20.0, 4 * float(np.median(off)))
    often = np.bincount(observations.tracks[near], minlength=observations.points) >= observations.fewest
    good = (parallax_deg > _MIN_PARALLAX_DEG) & often
    used = near & good[observations.tracks]
    return settled(points, observations.at(used), state, sigma_px), used


def settled(points: FloatArray, observations: Observations, state: State, sigma_px: float) -> FloatArray:
    """Points (M, 3) of least reprojection error with all else held (Gauss–Newton, Cauchy's weights). Triangulated
    points are not optimal; refining them here saves the joint problem iterations.
    """
    tracks, positions = observations.tracks, state.positions[observations.keyframes]
    R, measured = _image_planes(observations, state)
    scale = CAUCHY_PIXELS * sigma_px / state.camera.focal
    points = points.copy()
    for _ in range(_SETTLING_STEPS):
        seen = np.einsum("nji,nj->ni", R, points[tracks] - positions)
        depth = np.maximum(seen[:, 2], 1e-6)
        plane = seen[:, :2] / depth[:, None]
        off = measured - plane
        weight = np.where(seen[:, 2] > 1e-6, 1 / (1 + np.sum(off**2, axis=1) / scale**2), 0.0)
        slope = (R[:, :, :2] - R[:, :, 2:] * plane[:, None, :]) / depth[:, None, None]  # (n, 3, 2)
        weighted = weight[:, None, None] * slope
        information, target = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
        np.add.at(information, tracks, weighted @ np.swapaxes(slope, 1, 2))
        np.add.at(target, tracks, np.einsum("nij,nj->ni", weighted, off))
        damping = 1e-3 * np.trace(information, axis1=1, axis2=2) + 1e-12
        points += np.linalg.solve(information + damping[:, None, None] * np.eye(3), target[..., None])[..., 0]
    return points


def _image_planes(observations: Observations, state: State) -> tuple[FloatArray, FloatArray]:
    """R_map_plane (N, 3, 3) of each sighting's image plane, and its coordinates (N, 2) on this plane."""
    R_plane_camera, measured = state.camera.planes(observations.pixels)
    return state.R_map_camera[observations.keyframes] @ np.swapaxes(R_plane_camera, 1, 2), measured
