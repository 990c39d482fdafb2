"""Fisheyes and panoramas: relative poses, positions, mappers and adjustments by rays in all directions."""

import numpy as np
import pytest
from scene import descriptors_of, sift_like
from scipy.spatial.transform import Rotation
from synthetic_walk import followed

from rholoc.geometry import Camera, FloatArray, Lens, pose_matrix, rotation_angles, umeyama
from rholoc.trajectory.checks.given_poses import epipolar_errors
from rholoc.trajectory.initialization.global_positioning import global_positions
from rholoc.trajectory.initialization.mapper_starts import Mapper, PycolmapStarts
from rholoc.trajectory.optimization.adjustment import adjust
from rholoc.trajectory.optimization.points import residuals_px
from rholoc.trajectory.optimization.problem import Problem, State
from rholoc.trajectory.reconstruction import Sights, reconstruct
from rholoc.trajectory.visual.matching import match_pictures
from rholoc.trajectory.visual.tracks import Observations
from rholoc.trajectory.visual.two_view import absolute_pose, relative_pose

FISHEYE = Camera(960, 960, 310.0, 312.0, 479.5, 479.5, (0.001, 0.03, -0.03, 0.005), Lens.FISHEYE)
PANORAMA = Camera.panorama(2000, 1000)
LENSES = pytest.mark.parametrize("camera", [FISHEYE, PANORAMA], ids=["fisheye", "equirectangular"])
COUNT, NOISE_PX = 12, 0.4


def poses(count: int = COUNT) -> FloatArray:
    """Cameras (N, 4, 4) on an arc, which look sideways and up and down a little."""
    angles = np.linspace(0, 1.6, count)
    R = Rotation.from_euler("yxz", np.column_stack([0.5 * angles, 0.2 * np.sin(5 * angles), 0.1 * np.cos(4 * angles)]))
    return pose_matrix(
        R.as_matrix(), np.column_stack([1.5 * angles, 0.3 * np.sin(6 * angles), 0.8 * np.cos(2 * angles)])
    )


def points(count: int = 300) -> FloatArray:
    """Points (N, 3) all around."""
    rng = np.random.default_rng(5)
    away = rng.normal(size=(count, 3))
    return np.asarray(away / np.linalg.norm(away, axis=1, keepdims=True) * rng.uniform(3, 6, (count, 1)) + [1, 0, 0])


def sightings(camera: Camera, T: FloatArray, seen: FloatArray) -> Observations:
    """What the lens shows of the points, with noise."""
    rng = np.random.default_rng(6)
    keyframes, tracks, pixels = [], [], []
    for k, one in enumerate(T):
        shown = camera.project((seen - one[:3, 3]) @ one[:3, :3]) + NOISE_PX * rng.normal(size=(len(seen), 2))
        inside = np.flatnonzero(camera.contains(shown))
        keyframes.append(np.full(len(inside), k))
        tracks.append(inside)
        pixels.append(shown[inside])
    return Observations(np.concatenate(keyframes), np.concatenate(tracks), np.concatenate(pixels))


def off(found: FloatArray, truth: FloatArray) -> float:
    """The largest distance of positions (N, 3) from the truth after a similarity alignment."""
    return float(np.linalg.norm(umeyama(found, truth).points(found) - truth, axis=1).max())


@LENSES
def test_a_relative_pose_outvotes_wrong_matches(camera: Camera) -> None:
    T, rng = poses()[[0, 6]], np.random.default_rng(1)
    seen = sightings(camera, T, points())
    both = np.intersect1d(seen.tracks[seen.keyframes == 0], seen.tracks[seen.keyframes == 1])
    a, b = (camera.rays(seen.pixels[(seen.keyframes == k) & np.isin(seen.tracks, both)]) for k in range(2))
    wrong = rng.random(len(both)) < 0.3
    b[wrong] = rng.permutation(b[wrong])
    view = relative_pose(a, b, 3 / camera.focal)
    R = T[1, :3, :3].T @ T[0, :3, :3]
    assert np.degrees(rotation_angles(view.R_second_first, R)) < 0.5
    assert view.inliers[~wrong].mean() > 0.95
    assert view.inliers[wrong].mean() < 0.4
    errors = epipolar_errors(np.linalg.inv(T[1]) @ T[0], a, b) * camera.focal
    assert np.median(errors[~wrong]) < 1.0
    assert np.median(errors[wrong]) > 20


@LENSES
def test_a_camera_is_placed_by_points_that_are_known(camera: Camera) -> None:
    T = poses()[:1]
    seen = sightings(camera, T, points())
    found, agreeing = absolute_pose(camera.rays(seen.pixels), points()[seen.tracks], 4 / camera.focal)
    assert np.linalg.norm(found[:3, 3] - T[0, :3, 3]) < 0.01
    assert agreeing > 0.95 * len(seen)


@LENSES
def test_positions_come_back_from_rays_in_all_directions(camera: Camera) -> None:
    T = poses()
    seen = sightings(camera, T, points())
    found = global_positions(T[:, :3, :3], seen.keyframes, seen.tracks, camera.rays(seen.pixels))
    assert off(found, T[:, :3, 3]) < 0.05


@pytest.mark.parametrize(("camera", "mapper"), [(FISHEYE, Mapper.GLOBAL), (PANORAMA, Mapper.INCREMENTAL)])
def test_pycolmaps_mappers_place_all(camera: Camera, mapper: Mapper) -> None:
    T = poses()
    seen = sightings(camera, T, points())
    descriptors = descriptors_of(300)
    features = [
        sift_like(seen.pixels[seen.keyframes == k], descriptors[seen.tracks[seen.keyframes == k]]) for k in range(COUNT)
    ]
    rays = [camera.rays(one.pixels) for one in features]
    pairs, _ = match_pictures(features, rays, camera.focal)
    pixels = [one.pixels.astype(np.float64) for one in features]
    with PycolmapStarts(camera, True, pixels, pairs) as starts:
        ((members, found, _),) = starts.pieces(mapper)
    assert len(members) == COUNT
    assert off(found[:, :3, 3], T[:, :3, 3]) < 0.02


@LENSES
def test_an_adjustment_brings_disturbed_poses_back(camera: Camera) -> None:
    T, rng = poses(), np.random.default_rng(2)
    seen = sightings(camera, T, points())
    turned = Rotation.from_rotvec(0.005 * rng.normal(size=(COUNT, 3))).as_matrix()
    disturbed = pose_matrix(T[:, :3, :3] @ turned, T[:, :3, 3] + 0.02 * rng.normal(size=(COUNT, 3)))
    problem = Problem(np.arange(COUNT) / 2, seen, pixel_sigma_px=NOISE_PX)
    adjusted = adjust(problem, State(disturbed, np.zeros((300, 3)), camera), 15)
    assert off(adjusted.state.positions, T[:, :3, 3]) < 0.005
    assert np.median(residuals_px(seen, adjusted.state)) == pytest.approx(1.177 * NOISE_PX, rel=0.25)
    sigmas_m = np.sqrt(np.trace(adjusted.covariances([COUNT // 2])[0, :3, :3]))
    assert 1e-5 < sigmas_m < 0.01


@pytest.mark.parametrize("camera", [FISHEYE, pytest.param(PANORAMA, marks=pytest.mark.slow)])
def test_pictures_become_a_reconstruction(camera: Camera) -> None:
    T = poses()
    seen = sightings(camera, T, points())
    descriptors = descriptors_of(300)
    features = [
        sift_like(seen.pixels[seen.keyframes == k], descriptors[seen.tracks[seen.keyframes == k]]) for k in range(COUNT)
    ]
    nothing = np.zeros((COUNT, 1), dtype=np.bool_)
    flow = followed(np.arange(float(COUNT)), (camera.width, camera.height), np.zeros((COUNT, 1, 2)), nothing)
    found = reconstruct(Sights(flow, np.arange(COUNT), features, camera, is_film=False), None, [])
    assert found.placed.all()
    assert found.camera == camera
    assert off(found.T_map_camera[:, :3, 3], T[:, :3, 3]) < 0.01
