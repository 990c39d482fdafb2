"""Features of keyframes → their poses, by incremental structure from motion (COLMAP)."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap

from rholoc.geometry import FloatArray, IntArray, pose_matrix
from rholoc.trajectory.self_calibration import refine_camera
from rholoc.trajectory.two_view import VerifiedPair

_FEWEST_MATCHES = 20
_ENOUGH = 0.7  # of the keyframes; where fewer are placed, another first pair is tried


@dataclass(frozen=True)
class _Parallax:
    """How much parallax is asked for: degrees between the rays of the first pair, its inliers, degrees of any point."""

    first_deg: float
    first_inliers: int
    least_deg: float


# At first what makes a firm start, then what a narrow view can offer, then what a walk that mostly turns can.
_PARALLAXES = (_Parallax(16.0, 100, 1.5), _Parallax(4.0, 50, 1.5), _Parallax(1.5, 50, 0.5))


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Poses of keyframes in a frame and scale of their own.

    Attributes:
        placed: (K,) int64, the keyframes that have a pose, increasing.
        T_world_camera: (K, 4, 4).
        parameters: the camera's, in COLMAP's order and pixel convention.
        sigmas: their standard deviations, NaN for those that were held.
        reprojection_error_px: the mean over all observations.
        landmarks: how many points were triangulated.
        median_depth: of the points before the cameras that see them, in the frame's own unit.
    """

    placed: IntArray
    T_world_camera: FloatArray
    parameters: FloatArray
    sigmas: FloatArray
    reprojection_error_px: float
    landmarks: int
    median_depth: float


def reconstruct(
    camera: pycolmap.Camera,
    camera_is_known: bool,
    pixels: Sequence[FloatArray],
    pairs: Sequence[VerifiedPair],
    seed: int,
    told: Callable[[int], None] = lambda placed: None,
) -> Reconstruction | None:
    """The largest model that the verified pairs give, or None.

    Args:
        camera: one camera for all keyframes.
        camera_is_known: whether its intrinsics are right as they are; else they are where to start from.
        pixels: the features' places in every keyframe, (N, 2), COLMAP's pixel convention.
        pairs: verified pairs of keyframes.
        seed: for COLMAP's random choices. One thread is used, so the same input gives the same result.
        told: hears how many keyframes have been placed.
    """
    model: pycolmap.Reconstruction | None = None
    with tempfile.TemporaryDirectory(prefix="rholoc-sfm-") as folder:
        database = Path(folder) / "database.db"
        _write_database(database, camera, pixels, pairs)
        for parallax in _PARALLAXES:
            options = _options(camera_is_known, parallax, seed)
            found = _largest(database, Path(folder), options, told)
            if found is not None and (model is None or found.num_reg_images() > model.num_reg_images()):
                model = found
            if model is not None and model.num_reg_images() >= _ENOUGH * len(pixels):
                break
    if model is None:
        return None
    sigmas = np.full(len(camera.params), np.nan) if camera_is_known else refine_camera(model)
    return _as_reconstruction(model, sigmas)


def _largest(
    database: Path, folder: Path, options: pycolmap.IncrementalPipelineOptions, told: Callable[[int], None]
) -> pycolmap.Reconstruction | None:
    """The model with the most images, if any has points."""
    count = 0

    def next_image() -> None:
        nonlocal count
        count += 1
        told(count)

    models = pycolmap.incremental_mapping(database, folder, folder, options, next_image_callback=next_image)
    largest = max(models.values(), key=lambda model: int(model.num_reg_images()), default=None)
    return largest if largest is not None and largest.num_points3D() > 0 else None


def _options(camera_is_known: bool, parallax: _Parallax, seed: int) -> pycolmap.IncrementalPipelineOptions:
    options = pycolmap.IncrementalPipelineOptions()
    options.min_num_matches = _FEWEST_MATCHES
    options.multiple_models = False
    options.min_model_size = 3
    options.extract_colors = False
    options.mapper.init_min_tri_angle = parallax.first_deg
    options.mapper.init_min_num_inliers = parallax.first_inliers
    options.mapper.filter_min_tri_angle = parallax.least_deg
    options.triangulation.min_angle = parallax.least_deg
    options.num_threads = 1
    options.random_seed = seed
    options.mapper.random_seed = seed
    options.mapper.num_threads = 1
    options.triangulation.random_seed = seed
    options.ba_refine_focal_length = not camera_is_known
    options.ba_refine_extra_params = not camera_is_known
    options.mapper.abs_pose_refine_focal_length = not camera_is_known
    options.mapper.abs_pose_refine_extra_params = not camera_is_known
    options.ba_global_frames_ratio = 1.3
    options.ba_global_points_ratio = 1.3
    options.ba_global_max_refinements = 2
    options.ba_local_max_refinements = 1
    return options


def _write_database(
    path: Path, camera: pycolmap.Camera, pixels: Sequence[FloatArray], pairs: Sequence[VerifiedPair]
) -> None:
    with pycolmap.Database.open(path) as database, pycolmap.DatabaseTransaction(database):
        camera_id = database.write_camera(camera)
        rig = pycolmap.Rig()
        sensor = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera_id)
        rig.add_ref_sensor(sensor)
        rig_id = database.write_rig(rig)
        ids = []
        for number, places in enumerate(pixels):
            image = pycolmap.Image(name=f"{number:06d}", camera_id=camera_id)
            image_id = database.write_image(image)
            frame = pycolmap.Frame()
            frame.rig_id = rig_id
            frame.add_data_id(pycolmap.data_t(sensor, image_id))
            database.write_frame(frame)
            database.write_keypoints(image_id, places.astype(np.float32))
            ids.append(image_id)
        for pair in pairs:
            first, second = ids[pair.first], ids[pair.second]
            database.write_matches(first, second, pair.matches.astype(np.uint32))
            database.write_two_view_geometry(first, second, pair.geometry)


def _as_reconstruction(model: pycolmap.Reconstruction, sigmas: FloatArray) -> Reconstruction:
    images = sorted((model.images[i] for i in model.reg_image_ids()), key=lambda image: str(image.name))
    poses = []
    depths = []
    for image in images:
        T_camera_world = np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]])
        R = T_camera_world[:3, :3].T
        poses.append(pose_matrix(R, -R @ T_camera_world[:3, 3]))
        seen = [model.points3D[p.point3D_id].xyz for p in image.points2D if p.has_point3D()]
        if seen:
            depths.append(np.array(seen) @ T_camera_world[2, :3] + T_camera_world[2, 3])
    (camera,) = model.cameras.values()
    return Reconstruction(
        np.array([int(image.name) for image in images], dtype=np.int64),
        np.array(poses),
        np.array(camera.params),
        sigmas,
        float(model.compute_mean_reprojection_error()),
        int(model.num_points3D()),
        float(np.median(np.concatenate(depths))),
    )
