"""nerfstudio's ``transforms.json``, also written by Instant NGP and several scanning apps.

::

    transforms.json   camera_model, fl_x, fl_y, cx, cy, w, h, k1, k2, p1, p2, k3, of OPENCV_FISHEYE k1, k2, k3, k4
                      FULL_OPENCV k1, k2, p1, p2, k3, …, k6; camera_angle_x [rad] or x_fov [°] instead of fl_x
                      frames: [{"file_path": "images/frame_00001.png", "transform_matrix": 4×4}]

``transform_matrix`` is T_world_camera of a camera that looks along −z with y up; pixel (0.5, 0.5) is the centre of the
top-left one. Each frame may have its own intrinsics instead. ``applied_transform`` (3×4) and then ``applied_scale``,
which turned the original world into this one, are undone. The unit of length is not stated. A pinhole's k4 is
that of a polynomial. A file_path may lack its suffix. Without the file ``transforms_train.json``, ``…_val.json`` and
``…_test.json`` are read together.
"""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rholoc.errors import InvalidCamera, InvalidImage, InvalidRecording, InvalidTrajectory
from rholoc.geometry import Camera, FloatArray, Lens, is_rotation
from rholoc.recordings.readers._apple import opencv_camera
from rholoc.recordings.readers._camera_models import lens_of_model, three_coefficients, unsupported
from rholoc.recordings.readers._frames import listed_file, untimed_images
from rholoc.recordings.readers._orientation import as_shown, stored_size
from rholoc.recordings.readers.models.colmap import SCALE_WARNING, TRANSFORMS
from rholoc.recordings.recording import GivenPoses, Recording
from rholoc.recordings.tables.csv_table import read_json
from rholoc.reports import RecordingWarning

_FILE, *_PARTS = TRANSFORMS
TABLES = (*TRANSFORMS, "colmap/*", "colmap_*/*", "colmap.db", "sparse_pc.ply")
_LENSES = {"PERSPECTIVE": Lens.PINHOLE}  # names that only nerfstudio has
_FLAGS = {  # Instant NGP's members that are true of a lens
    "latlong": "latlong",
    "equirectangular": "Instant NGP's equirectangular",
    "is_fisheye": "OPENCV_FISHEYE",
}
_COEFFICIENTS = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
_SUFFIXES = (".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG")
_ROTATION_TOLERANCE = 1e-2
_LARGEST = 1e9


def recognises(folder: Path) -> bool:
    """Whether there is a ``transforms.json``, or one of its parts."""
    return bool(_files(folder))


def read(folder: Path) -> Recording:
    """Read a recording of this format from its folder: poses of unknown scale, ``applied_transform`` undone.

    The camera is None, with a warning, if its model is not supported.

    Raises:
        InvalidRecording: ``transforms.json`` or one of its parts is broken, or an image is broken or missing.
        InvalidCamera: the intrinsics are broken.
        InvalidTrajectory: a pose is not a 4×4 matrix with a rotation in it, or implausibly far away; the applied
            transform or scale is none.
    """
    frames = [frame for path in _files(folder) for frame in _frames(path)]
    paths = [_image(folder, frame) for frame in frames]
    cameras, warnings = _cameras(frames, paths)
    cameras, T_stored_shown = as_shown(paths, cameras)
    timed = untimed_images(paths, cameras)
    T_map_camera = opencv_camera(np.array([_pose(frame) for frame in frames])) @ T_stored_shown
    return Recording(
        timed.frames,
        camera=timed.camera,
        poses=GivenPoses(np.ones(len(paths), dtype=np.bool_), T_map_camera[timed.rows], metric=False),
        warnings=(*timed.warnings, SCALE_WARNING, *warnings),
    )


def _files(folder: Path) -> list[Path]:
    """The files of a set: ``transforms.json``, else its parts; empty if there are none."""
    parts = [folder / name for name in _PARTS]
    return [path for path in ([folder / _FILE] if (folder / _FILE).is_file() else parts) if path.is_file()]


def _frames(path: Path) -> list[dict[str, Any]]:
    """The frames of a file, each with the members that the file states for all. Raises InvalidRecording."""
    values = read_json(path)
    frames = values.get("frames") if isinstance(values, dict) else None
    if not isinstance(frames, list) or not frames or not all(isinstance(frame, dict) for frame in frames):
        raise InvalidRecording(f"{path.name} lists no frames.", "It needs 'frames', each with its transform_matrix.")
    return [{**values, **frame} for frame in frames]


def _image(folder: Path, frame: dict[str, Any]) -> Path:
    """File of a frame's picture, its suffix added if missing; it need not exist. Raises InvalidRecording."""
    name = frame.get("file_path")
    if not isinstance(name, str):
        raise InvalidRecording("A frame of the transforms has no file_path.")
    path = listed_file(folder, name)
    named = (path, *(path.with_name(path.name + suffix) for suffix in _SUFFIXES))
    return next((one for one in named if one.is_file()), path)


def _pose(frame: dict[str, Any]) -> FloatArray:
    """The frame's pose (4, 4) in the original world, in nerfstudio's camera axes. Raises InvalidTrajectory."""
    try:
        T = np.array(frame.get("transform_matrix"), dtype=np.float64)
    except (TypeError, ValueError):
        T = np.zeros(0)
    if T.shape != (4, 4) or not np.isfinite(T).all() or not is_rotation(T[:3, :3], _ROTATION_TOLERANCE):
        raise InvalidTrajectory(f"The transform_matrix of {frame['file_path']} is not a pose.")
    scale = _applied_scale(frame)
    if np.abs(T[:3, 3]).max() > _LARGEST * scale:
        raise InvalidTrajectory(f"The pose of {frame['file_path']} is implausibly far away.")
    T[:3, 3] /= scale
    return np.asarray(np.linalg.inv(_applied_transform(frame)) @ T)


def _applied_scale(values: dict[str, Any]) -> float:
    """Factor applied to the original positions after the transform; 1 if none is stated. Raises InvalidTrajectory."""
    scale = values.get("applied_scale", 1.0)
    if not isinstance(scale, int | float) or not 0 < scale < _LARGEST:
        raise InvalidTrajectory(
            "The transforms' applied_scale is not a scale.", "Leave it out, or give a positive number."
        )
    return float(scale)


def _applied_transform(values: dict[str, Any]) -> FloatArray:
    """Transform (4, 4) applied to the original world; the identity if none is stated. Raises InvalidTrajectory."""
    try:
        given = np.array(values.get("applied_transform", np.eye(4)[:3]), dtype=np.float64)
    except (TypeError, ValueError):
        given = np.zeros(0)
    is_transform = given.shape in ((3, 4), (4, 4)) and np.isfinite(given).all()
    if not is_transform or not is_rotation(given[:3, :3], _ROTATION_TOLERANCE):
        raise InvalidTrajectory(
            "The transforms' applied_transform is not a pose.", "Leave it out, or give 3×4 numbers."
        )
    return np.vstack([given[:3], [0, 0, 0, 1]])


def _cameras(
    frames: list[dict[str, Any]], paths: list[Path]
) -> tuple[list[Camera] | None, tuple[RecordingWarning, ...]]:
    """Camera of each frame; None, with warnings, if one is unknown or of an unsupported model. Raises InvalidCamera."""
    cameras = []
    for frame, path in zip(frames, paths, strict=True):
        camera, warnings = _camera(frame, _size(path))
        if camera is None:
            return None, warnings
        cameras.append(camera)
    return cameras, ()


def _size(path: Path) -> tuple[int, int]:
    """Width and height of a stored picture [px]. Raises InvalidRecording if it is missing or broken."""
    try:
        return stored_size(path)
    except (InvalidImage, OSError) as error:
        raise InvalidRecording(f"The image {path.name} is missing or broken.", "Leave it out of the list.") from error


def _number(values: dict[str, Any], name: str) -> float:
    """The member ``name`` as a float; NaN if missing. Raises InvalidCamera if it is not a number, or its absolute value
    is 1e9 or more.
    """
    if name not in values:
        return math.nan
    value = values[name]
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < _LARGEST:
        raise InvalidCamera(f"The transforms' {name} is not a number that a camera can have.")
    return float(value)


def _camera(values: dict[str, Any], size: tuple[int, int]) -> tuple[Camera | None, tuple[RecordingWarning, ...]]:
    """Camera of a frame's members; None without a focal length, or, with a warning, for an unsupported model."""
    flagged = next((model for name, model in _FLAGS.items() if values.get(name)), None)
    flagged = "f-theta" if "ftheta_p0" in values else flagged
    model = flagged or str(values.get("camera_model") or "OPENCV").upper()
    lens = _LENSES.get(model) or lens_of_model(model)
    if lens is None:
        return None, (unsupported(model),)
    if lens is Lens.EQUIRECTANGULAR:
        return Camera.panorama(*size), ()
    width, height = (_number(values, name) for name in ("w", "h"))
    width, height = (width, height) if width > 0 and height > 0 else size
    fx, fy = _focal(values, "x", width), _focal(values, "y", height)
    if not (math.isfinite(fx) or math.isfinite(fy)):
        return None, ()
    fx, fy = fx if math.isfinite(fx) else fy, fy if math.isfinite(fy) else fx
    cx, cy = _number(values, "cx"), _number(values, "cy")
    camera = Camera(
        int(width),
        int(height),
        fx,
        fy,
        (cx if math.isfinite(cx) else width / 2) - 0.5,
        (cy if math.isfinite(cy) else height / 2) - 0.5,
        lens=lens,
    )
    return replace(camera, distortion=_distortion(values, model, camera)), ()


def _focal(values: dict[str, Any], axis: str, size_px: float) -> float:
    """Focal length [px] along an axis, ``x`` or ``y``, as stated or by the field of view; NaN if missing."""
    focal_px, angle_rad = _number(values, f"fl_{axis}"), _number(values, f"camera_angle_{axis}")
    if math.isnan(angle_rad):
        angle_rad = math.radians(_number(values, f"{axis}_fov"))
    if math.isnan(focal_px) and 0 < angle_rad < math.pi:
        return size_px / (2 * math.tan(angle_rad / 2))
    return focal_px


def _distortion(values: dict[str, Any], model: str, camera: Camera) -> tuple[float, ...]:
    """Distortion coefficients in the order of the camera's lens; empty if all are 0."""
    k1, k2, k3, k4, k5, k6, p1, p2 = (_number({name: 0.0} | values, name) for name in _COEFFICIENTS)
    if camera.lens is Lens.FISHEYE:
        found: tuple[float, ...] = k1, k2, k3, k4
    elif model == "FULL_OPENCV":
        found = k1, k2, p1, p2, k3, k4, k5, k6
    else:
        k1, k2, k3 = three_coefficients((k1, k2, k3, k4), camera)
        found = (k1, k2, p1, p2, k3) if k3 else (k1, k2, p1, p2)
    return found if any(found) else ()
