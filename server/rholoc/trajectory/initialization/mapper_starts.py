"""First poses of pictures by pycolmap's incremental and global mappers, from verified matches."""

import tempfile
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from enum import StrEnum
from pathlib import Path
from typing import Self

import numpy as np
import pycolmap

from rholoc.errors import InvalidCamera
from rholoc.geometry import Camera, FloatArray, IntArray, Lens, on_plane
from rholoc.trajectory.visual.matching import VerifiedPair
from rholoc.trajectory.visual.sphere import on_sphere, sphere_camera
from rholoc.trajectory.visual.tracks import thinned_matches

_MIN_PIECE = 3  # pictures
_SEED = 1
_THREADS = 2
_CAMERA = 1
_DATABASE = "pictures.db"
_FEATURES_PER_PICTURE = 300  # matched ones; more take the mappers' time, and place no more pictures
_PAIRS_PER_PICTURE = 10
_SECONDS = 20  # and one more a picture: the incremental mapper once tried first pairs of 28 pictures for five minutes
_FIRST_PAIR, _FIRST_ANGLE_DEG = 50, 8.0  # matches and parallax; else searched for twice in vain where steps are small
_GROWTH = 1.3  # of an incremental model, after which all of it is adjusted again
_TOLERANCE = 1e-5  # relative, of the cost
_CENTRE_SHIFT = 0.5  # COLMAP's pixel (0.5, 0.5) is the centre of the top-left one


class Mapper(StrEnum):
    """A method for first poses."""

    DEPTH = "depth"  # metric relative poses by depth pictures
    OWN = "own"  # rotation averaging, then global positioning
    INCREMENTAL = "incremental"  # pycolmap's incremental mapper, which takes less time
    GLOBAL = "global"  # pycolmap's global mapper


Piece = tuple[IntArray, FloatArray, Camera]
"""Numbers (N,) of some pictures, increasing, their first poses T_world_camera (N, 4, 4), and the intrinsics."""


class PycolmapStarts:
    """pycolmap's mappers on the verified matches of K pictures.

    A context manager: their databases exist, and a thread computes, within it.
    """

    def __init__(
        self, camera: Camera, is_known: bool, pixels: Sequence[FloatArray], pairs: Sequence[VerifiedPair]
    ) -> None:
        """Take the measurements and choose the matches to use; no mapper runs yet.

        Args:
            camera: of all pictures.
            is_known: whether to hold the intrinsics; otherwise they are refined.
            pixels: features of each of K pictures, (F, 2).
            pairs: verified matches, of which the mappers are given the best.
        """
        self._camera, self._is_known = camera, is_known
        best = _best_pairs(pairs, len(pixels))
        self._pixels, self._pairs = pixels, thinned_matches(best, [len(some) for some in pixels], _FEATURES_PER_PICTURE)
        self._folder = tempfile.TemporaryDirectory(prefix="rholoc-mapper-")
        self._pool = ThreadPoolExecutor(1)
        self._begun: dict[Mapper, Future[list[Piece]]] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown()
        self._folder.cleanup()

    def begin(self, mapper: Mapper) -> None:
        """Start a mapper, ``GLOBAL`` or ``INCREMENTAL``, in a thread. Each writes a database of its own."""
        self._begun[mapper] = self._pool.submit(self._pieces, mapper)

    def pieces(self, mapper: Mapper) -> list[Piece]:
        """Models of a mapper, largest first, each of at least three pictures; models may share pictures.

        Waits for the mapper, which is begun if it was not.
        """
        if mapper not in self._begun:
            self.begin(mapper)
        return self._begun[mapper].result()

    def _pieces(self, mapper: Mapper) -> list[Piece]:
        """Run a mapper: its models of at least three pictures, largest first."""
        pycolmap.logging.minloglevel = 3  # a failure shows in the result
        output = Path(self._folder.name) / mapper
        output.mkdir()
        self._write(output / _DATABASE, mapper)
        models = _run(mapper, output, self._is_known, len(self._pixels))
        large = [model for model in models if model.num_reg_images() >= _MIN_PIECE]
        found = [_piece(model, self._camera, self._is_known) for model in large]
        return sorted((piece for piece in found if piece is not None), key=lambda piece: -len(piece[0]))

    def _write(self, path: Path, mapper: Mapper) -> None:
        """Write pictures, features and verified matches to a new pycolmap database; for the global mapper, which needs
        them, with an estimate of each pair's relative pose.
        """
        kind = _model if self._is_known else _guessed_model
        model, places = kind(self._camera, self._pixels)
        options = pycolmap.TwoViewGeometryOptions()
        options.compute_relative_pose = True
        options.ransac.random_seed = _SEED

        def estimated(pair: VerifiedPair) -> pycolmap.TwoViewGeometry:
            seen = places[pair.first], model, places[pair.second], pair.matches.astype(np.uint32)
            return pycolmap.estimate_two_view_geometry(model, *seen, options)

        database = pycolmap.Database.open(str(path))
        try:
            ids = _write_pictures(database, model, places)
            with ThreadPoolExecutor(_THREADS) as pool:
                found_by = pool.map(estimated if mapper is Mapper.GLOBAL else _as_verified, self._pairs)
                for pair, found in zip(self._pairs, found_by, strict=True):
                    first, second = ids[pair.first], ids[pair.second]
                    database.write_matches(first, second, pair.matches.astype(np.uint32))
                    database.write_two_view_geometry(first, second, found)
        finally:
            database.close()


def _best_pairs(pairs: Sequence[VerifiedPair], count: int) -> list[VerifiedPair]:
    """Pairs that are among the best ten of either of their pictures, by matches; more take time and place no more of
    ``count`` pictures.
    """
    ranked: list[list[int]] = [[] for _ in range(count)]
    for k in sorted(range(len(pairs)), key=lambda k: -len(pairs[k].matches)):
        ranked[pairs[k].first].append(k)
        ranked[pairs[k].second].append(k)
    kept = {k for some in ranked for k in some[:_PAIRS_PER_PICTURE]}
    return [pairs[k] for k in sorted(kept)]


def _model(camera: Camera, pixels: Sequence[FloatArray]) -> tuple[pycolmap.Camera, list[FloatArray]]:
    """An ideal camera for pycolmap in place of a calibrated one, and the pixels (F, 2) of each picture in it."""
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
    """pycolmap's camera of the same size, of the model ``kind`` with its parameters, the focal length a prior."""
    model = pycolmap.Camera(camera_id=_CAMERA, model=kind, width=camera.width, height=camera.height, params=params)
    model.has_prior_focal_length = True
    return model


def _write_pictures(database: pycolmap.Database, model: pycolmap.Camera, places: Sequence[FloatArray]) -> list[int]:
    """Write a camera and its pictures' features; returns the pictures' ids."""
    camera_id = database.write_camera(model)
    sensor = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera_id)
    rig = pycolmap.Rig()
    rig.add_ref_sensor(sensor)
    rig_id = database.write_rig(rig)
    ids = []
    for k, some in enumerate(places):
        ids.append(database.write_image(pycolmap.Image(name=f"{k:06d}", camera_id=camera_id)))
        frame = pycolmap.Frame()
        frame.rig_id = rig_id
        frame.add_data_id(pycolmap.data_t(sensor, ids[-1]))
        database.write_frame(frame)
        database.write_keypoints(ids[-1], some.astype(np.float32))
    return ids


def _as_verified(pair: VerifiedPair) -> pycolmap.TwoViewGeometry:
    """All of a pair's matches as inliers, without a relative pose."""
    found = pycolmap.TwoViewGeometry()
    found.config = pycolmap.TwoViewGeometryConfiguration.CALIBRATED
    found.inlier_matches = pair.matches.astype(np.uint32)
    return found


def _run(mapper: Mapper, folder: Path, is_known: bool, pictures: int) -> list[pycolmap.Reconstruction]:
    """Models by a mapper of the database in ``folder``; empty if it fails."""
    arguments = str(folder / _DATABASE), str(folder), str(folder)
    try:
        if mapper is Mapper.GLOBAL:
            return list(pycolmap.global_mapping(*arguments, _global_options(is_known)).values())
        return list(pycolmap.incremental_mapping(*arguments, _incremental_options(is_known, pictures)).values())
    except (RuntimeError, ValueError):  # raised by a mapper without an initial pair
        return []


def _global_options(is_known: bool) -> pycolmap.GlobalPipelineOptions:
    """Options of the global mapper, which refines intrinsics unless they are known."""
    options = pycolmap.GlobalPipelineOptions()
    options.mapper.bundle_adjustment.refine_focal_length = not is_known
    options.mapper.bundle_adjustment.refine_extra_params = not is_known
    options.mapper.track_required_tracks_per_view = _FEATURES_PER_PICTURE
    options.random_seed, options.num_threads, options.min_model_size = _SEED, _THREADS, _MIN_PIECE
    return options


def _incremental_options(is_known: bool, pictures: int) -> pycolmap.IncrementalPipelineOptions:
    """Options of the incremental mapper, which refines intrinsics unless they are known."""
    options = pycolmap.IncrementalPipelineOptions()
    options.max_runtime_seconds = _SECONDS + pictures
    options.ba_refine_focal_length = options.ba_refine_extra_params = not is_known
    options.extract_colors = False
    options.mapper.init_min_num_inliers, options.mapper.init_min_tri_angle = _FIRST_PAIR, _FIRST_ANGLE_DEG
    options.ba_global_frames_ratio = options.ba_global_points_ratio = _GROWTH
    options.ba_global_max_refinements, options.ba_local_max_refinements = 2, 1  # first poses need not be exact
    options.ba_global_function_tolerance = options.ba_local_function_tolerance = _TOLERANCE
    options.random_seed, options.num_threads, options.min_model_size = _SEED, _THREADS, _MIN_PIECE
    return options


def _piece(model: pycolmap.Reconstruction, camera: Camera, is_known: bool) -> Piece | None:
    """Pictures (N,) of a model, increasing, their poses, and the camera; None if the intrinsics are impossible."""
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
    return np.array(members, dtype=np.int64), T, camera
