"""Global positioning: all camera positions at once from known rotations and bearings, without a first guess.

Pan et al., 2024, "Global Structure-from-Motion Revisited"; by pycolmap.
"""

import itertools

import numpy as np
import pycolmap

from rholoc.errors import MappingFailed
from rholoc.geometry import FloatArray, IntArray, on_plane
from rholoc.geometry.resection import is_narrow
from rholoc.trajectory.visual.sphere import on_sphere, sphere_camera

_UNIT_PX = 1000.0  # focal length of the ideal pinhole camera passed to pycolmap
_SIDE_PX = 4000  # of its image: wide enough for any narrow lens
_CAMERA = 1
_SEED = 1  # of the random initial positions


def global_positions(R_world_camera: FloatArray, keyframes: IntArray, tracks: IntArray, rays: FloatArray) -> FloatArray:
    """Camera positions (K, 3) in the frame of the rotations, at an arbitrary scale.

    Args:
        R_world_camera: (K, 3, 3).
        keyframes, tracks: (N,) camera and point of each sighting.
        rays: (N, 3) of each sighting, in the camera frame.

    Raises:
        MappingFailed: no positions were found.
    """
    pycolmap.logging.minloglevel = 3  # a failure raises an error instead
    model = pycolmap.Reconstruction()
    camera, pixels = _ideal_camera(rays)
    model.add_camera_with_trivial_rig(camera)
    count = len(R_world_camera)
    order = np.argsort(keyframes, kind="stable")
    starts = np.searchsorted(keyframes[order], np.arange(count + 1))
    number_in_image = np.empty(len(keyframes), dtype=np.int64)
    for k in range(count):
        rows = order[starts[k] : starts[k + 1]]
        number_in_image[rows] = np.arange(len(rows))
        image = pycolmap.Image(name=f"{k:06d}", camera_id=_CAMERA, image_id=k + 1)
        image.points2D = pycolmap.Point2DList([pycolmap.Point2D(xy) for xy in pixels[rows]])
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(R_world_camera[k].T), np.zeros(3))
        model.add_image_with_trivial_frame(image, pose)
    by_track = np.argsort(tracks, kind="stable")
    starts = np.searchsorted(tracks[by_track], np.arange(tracks.max(initial=-1) + 2))
    for first, last in itertools.pairwise(starts):
        track = pycolmap.Track()
        for row in by_track[first:last].tolist():
            track.add_element(int(keyframes[row]) + 1, int(number_in_image[row]))
        model.add_point3D(np.zeros(3), track, np.zeros(3, np.uint8))
    options = pycolmap.GlobalPositionerOptions()
    options.use_gpu = False
    options.random_seed = _SEED
    if not pycolmap.run_global_positioning(options, pycolmap.PoseGraph(), model):
        raise MappingFailed(
            "No positions of the camera explain what the pictures show.", "Walk slower, keep more texture in view."
        )
    return np.array([model.images[k + 1].projection_center() for k in range(count)])


def _ideal_camera(rays: FloatArray) -> tuple[pycolmap.Camera, FloatArray]:
    """An ideal camera that sees rays (N, 3), and its pixels (N, 2): a pinhole, or a panorama if the rays need one."""
    if not is_narrow(rays):
        return sphere_camera(_CAMERA), on_sphere(rays)
    centre = _SIDE_PX / 2
    params = [_UNIT_PX, _UNIT_PX, centre, centre]
    camera = pycolmap.Camera(camera_id=_CAMERA, model="PINHOLE", width=_SIDE_PX, height=_SIDE_PX, params=params)
    camera.has_prior_focal_length = True
    return camera, on_plane(rays) * _UNIT_PX + centre
