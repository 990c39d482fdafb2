"""First poses of pictures by pycolmap's incremental and global mappers, from verified matches."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np
import pycolmap

from rholoc.errors import InvalidCamera
from rholoc.geometry import Camera, FloatArray, IntArray, Lens, on_plane
from rholoc.trajectory.visual.matching import VerifiedPair
from rholoc.trajectory.visual.sphere import on_sphere, sphere_camera

_MIN_PIECE = 3  # pictures
_SEED = 1
_THREADS = 2
_CAMERA = 1
_TRACKS_PER_PICTURE = 300  # more take the global mapper's time, and place no more pictures
_SECONDS = 20  # and one more a picture: the incremental mapper once tried first pairs of 28 pictures for five minutes
_GROWTH = 1.3  # of an incremental model, after which all of it is adjusted again
_TOLERANCE = 1e-5  # relative, of the cost
_CENTRE_SHIFT = 0.5  # COLMAP's pixel (0.5, 0.5) is the centre of the top-left one


class Mapper(StrEnum):
    """A method for first poses."""

    DEPTH = "depth"  # metric relative poses by depth pictures
    OWN = "own"  # rotation averaging, then global positioning
    INCREMENTAL = "incremental"  # pycolmap's incremental mapper, which takes less time
    GLOBAL = "global"  # pycolmap's global mapper


@dataclass(frozen=True, eq=False)
class Piece:
    """First poses of some of K pictures, in a frame and unit of their own.

    Attributes:
        mapper: which produced the poses.
        members: (N,) picture numbers, increasing.
        T_world_camera: (N, 4, 4).
        camera: the intrinsics.
    """

    mapper: Mapper
    members: IntArray
    T_world_camera: FloatArray
    camera: Camera


def largest_piece(
    mapper: Mapper, camera: Camera, is_known: bool, pixels: Sequence[FloatArray], pairs: Sequence[VerifiedPair]
) -> Piece | None:
    """Largest model of a pycolmap mapper; None if it has fewer than three pictures.

    Args:
        mapper: ``GLOBAL`` or ``INCREMENTAL``.
        camera: of all pictures.
        is_known: whether to hold the intrinsics; otherwise they are refined.
        pixels: features of each of K pictures, (F, 2).
        pairs: verified matches.
    """
    pycolmap.logging.minloglevel = 3  # a failure shows in the result
    with tempfile.TemporaryDirectory(prefix="rholoc-mapper-") as name:
        folder = Path(name)
        database = folder / "pictures.db"
        model, places = _model(camera, pixels) if is_known else _guessed_model(camera, pixels)
        _write(database, model, places, pairs)
        found = _run(mapper, database, folder, is_known, len(pixels))
    if not found:
        return None
    return _piece(mapper, max(found, key=lambda one: one.num_reg_images()), camera, is_known)


def _model(camera: Camera, pixels: Sequence[FloatArray]) -> tuple[pycolmap.Camera, list[FloatArray]]:
    """An ideal camera for pycolmap in place of a calibrated one, and the features' pixels (F, 2) of each picture in
    it.
    """
    rays = [camera.rays(some) for some in pixels]
    if camera.lens is not Lens.PINHOLE:
        return sphere_camera(_CAMERA), [on_sphere(some) for some in rays]
    centre = np.array([camera.cx, camera.cy]) + _CENTRE_SHIFT
    model = _pycolmap_camera(camera, "SIMPLE_PINHOLE", [camera.focal, *centre])
    return model, [on_plane(some) * camera.focal + centre for some in rays]


def _guessed_model(camera: Camera, pixels: Sequence[FloatArray]) -> tuple[pycolmap.Camera, list[FloatArray]]:
    """A camera with one distortion coefficient, to be refined, and the pixels in pycolmap's convention."""
    centre = camera.cx + _CENTRE_SHIFT, camera.cy + _CENTRE_SHIFT
    model = _pycolmap_camera(camera, "SIMPLE_RADIAL", [camera.focal, *centre, 0.0])
    return model, [some + _CENTRE_SHIFT for some in pixels]


def _pycolmap_camera(camera: Camera, kind: str, params: list[float]) -> pycolmap.Camera:
    model = pycolmap.Camera(camera_id=_CAMERA, model=kind, width=camera.width, height=camera.height, params=params)
    model.has_prior_focal_length = True
    return model


def _write(path: Path, model: pycolmap.Camera, places: Sequence[FloatArray], pairs: Sequence[VerifiedPair]) -> None:
    """Write pictures, features and verified matches to a new pycolmap database; estimates each pair's two-view
    geometry.
    """
    database = pycolmap.Database.open(str(path))
    try:
        camera_id = database.write_camera(model)
        sensor = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera_id)
        rig = pycolmap.Rig()
        rig.add_ref_sensor(sensor)
        rig_id = database.write_rig(rig)
        ids = []
        for k, some in enumerate(places):
            ids.append(database.write_image(pycolmap.Image(name=_name(k), camera_id=camera_id)))
            frame = pycolmap.Frame()
            frame.rig_id = rig_id
            frame.add_data_id(pycolmap.data_t(sensor, ids[-1]))
            database.write_frame(frame)
            database.write_keypoints(ids[-1], some.astype(np.float32))
        options = pycolmap.TwoViewGeometryOptions()
        options.compute_relative_pose = True
        options.ransac.random_seed = _SEED
        for pair in pairs:
            matches = pair.matches.astype(np.uint32)
            geometry = pycolmap.estimate_two_view_geometry(
                model, places[pair.first], model, places[pair.second], matches, options
            )
            database.write_matches(ids[pair.first], ids[pair.second], matches)
            database.write_two_view_geometry(ids[pair.first], ids[pair.second], geometry)
    finally:
        database.close()


def _run(mapper: Mapper, database: Path, folder: Path, is_known: bool, pictures: int) -> list[pycolmap.Reconstruction]:
    output = folder / "models"
    output.mkdir()
    arguments = str(database), str(folder), str(output)
    try:
        if mapper is Mapper.GLOBAL:
            return list(pycolmap.global_mapping(*arguments, _global_options(is_known)).values())
        return list(pycolmap.incremental_mapping(*arguments, _incremental_options(is_known, pictures)).values())
    except (RuntimeError, ValueError):  # raised by a mapper without an initial pair
        return []


def _global_options(is_known: bool) -> pycolmap.GlobalPipelineOptions:
    options = pycolmap.GlobalPipelineOptions()
    options.mapper.bundle_adjustment.refine_focal_length = not is_known
    options.mapper.bundle_adjustment.refine_extra_params = not is_known
    options.mapper.track_required_tracks_per_view = _TRACKS_PER_PICTURE
    options.random_seed, options.num_threads, options.min_model_size = _SEED, _THREADS, _MIN_PIECE
    return options


def _incremental_options(is_known: bool, pictures: int) -> pycolmap.IncrementalPipelineOptions:
    options = pycolmap.IncrementalPipelineOptions()
    options.max_runtime_seconds = _SECONDS + pictures
    options.ba_refine_focal_length = options.ba_refine_extra_params = not is_known
    options.extract_colors = False
    options.ba_global_frames_ratio = options.ba_global_points_ratio = _GROWTH
    options.ba_global_max_refinements, options.ba_local_max_refinements = 2, 1  # first poses need not be exact
    options.ba_global_function_tolerance = options.ba_local_function_tolerance = _TOLERANCE
    options.random_seed, options.num_threads, options.min_model_size = _SEED, _THREADS, _MIN_PIECE
    return options


def _piece(mapper: Mapper, model: pycolmap.Reconstruction, camera: Camera, is_known: bool) -> Piece | None:
    """A model as a piece, its pictures in increasing order; None if its intrinsics are impossible."""
    poses = {
        int(image.name): image.cam_from_world().inverse().matrix() for image in model.images.values() if image.has_pose
    }
    members = sorted(poses)
    T = np.tile(np.eye(4), (len(members), 1, 1))
    T[:, :3] = [poses[k] for k in members]
    if not is_known:
        focal, cx, cy, k1 = next(iter(model.cameras.values())).params
        centre = cx - _CENTRE_SHIFT, cy - _CENTRE_SHIFT
        try:
            camera = Camera(camera.width, camera.height, focal, focal, *centre, (k1, 0.0, 0.0, 0.0))
        except InvalidCamera:
            return None
    return Piece(mapper, np.array(members, dtype=np.int64), T, camera)


def _name(k: int) -> str:
    return f"{k:06d}"
