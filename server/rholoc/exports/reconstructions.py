"""A map as a reconstruction of other programs: COLMAP's text model, and nerfstudio's ``transforms.json``.

A map does not keep its pictures' files: view k is the picture ``000123.jpg`` for k = 123.
"""

import io
import json
import zipfile
from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidInput
from rholoc.geometry import Camera, FloatArray, Lens
from rholoc.maps import Map, check_memory, source_cameras

_MIN_VIEWS = 2  # of a point of a COLMAP model
_NERFSTUDIO_MODELS = {
    Lens.PINHOLE: "OPENCV",
    Lens.FISHEYE: "OPENCV_FISHEYE",
    Lens.EQUIRECTANGULAR: "EQUIRECTANGULAR",
}
_TO_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])  # x right, y up, looking along −z


def colmap_model(map_: Map) -> bytes:
    """A ZIP file of ``sparse/0/cameras.txt``, ``images.txt`` and ``points3D.txt``, of the views and landmarks.

    Raises:
        InvalidInput: the map does not keep its observations, or COLMAP has no such camera.
        InvalidMap: the observations contradict the rest of the map.
    """
    check_memory(map_, "The map")
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, lines in (("cameras", _cameras(map_)), ("images", _images(map_)), ("points3D", _points(map_))):
            archive.writestr(f"sparse/0/{name}.txt", "\n".join(lines) + "\n")
    return data.getvalue()


def nerfstudio_transforms(map_: Map) -> str:
    """The content of ``transforms.json``: intrinsics and pose of every view.

    Raises:
        InvalidInput: the lenses are of several kinds, one has a distortion without counterpart in nerfstudio, or one
            shows a part of a panorama.
    """
    used = source_cameras(map_.info)
    model, *others = sorted({_NERFSTUDIO_MODELS[camera.lens] for camera in used})
    if others:
        raise InvalidInput("nerfstudio has no files with lenses of several kinds.", "Export the map as colmap.")
    cameras = [_nerfstudio_camera(camera) for camera in used]
    poses = map_.views.T_map_camera @ _TO_OPENGL
    frames = [
        {"file_path": f"images/{_name(view)}", **cameras[source], "transform_matrix": T.tolist()}
        for view, (source, T) in enumerate(zip(map_.views.known_sources.tolist(), poses, strict=True))
    ]
    return json.dumps({"camera_model": model, "frames": frames}, indent=1) + "\n"


def _name(view: int) -> str:
    """File name of a view's picture."""
    return f"{view:06d}.jpg"


def _nerfstudio_camera(camera: Camera) -> dict[str, Any]:
    """A camera as nerfstudio writes it. Raises InvalidInput if it cannot."""
    if any(camera.distortion[5:]):
        raise InvalidInput("nerfstudio has no lens with a rational distortion.", "Export the map as colmap.")
    fx, fy = camera.fx, camera.fy
    if camera.lens is Lens.EQUIRECTANGULAR:
        _require_whole(camera, "nerfstudio")
        fx, fy = camera.width / 2, float(camera.height)  # nerfstudio's convention, not pixels per radian
    centre = {"cx": camera.cx + 0.5, "cy": camera.cy + 0.5}  # (0.5, 0.5) is the centre of the top-left pixel
    names = ("k1", "k2", "k3", "k4") if camera.lens is Lens.FISHEYE else ("k1", "k2", "p1", "p2", "k3")
    bent = dict(zip(names, camera.distortion, strict=False))
    return {"w": camera.width, "h": camera.height, "fl_x": fx, "fl_y": fy, **centre, **bent}


def _require_whole(camera: Camera, program: str) -> None:
    """Raise InvalidInput, naming ``program``, if an equirectangular camera shows a part of a panorama."""
    if camera != Camera.panorama(camera.width, camera.height):
        raise InvalidInput(f"{program} has no panorama that is not whole.", "Export the map as ply.")


def _cameras(map_: Map) -> Iterator[str]:
    """Yield the lines of ``cameras.txt``: a camera for each source, numbered from 1. Raises InvalidInput."""
    yield "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"
    for number, camera in enumerate(source_cameras(map_.info), 1):
        model, values = _colmap_camera(camera)
        yield f"{number} {model} {camera.width} {camera.height} {_numbers(values)}"


def _colmap_camera(camera: Camera) -> tuple[str, tuple[float, ...]]:
    """A camera's model as COLMAP calls it, and its parameters [px]. Raises InvalidInput for part of a panorama."""
    if camera.lens is Lens.EQUIRECTANGULAR:
        _require_whole(camera, "COLMAP")
        return "EQUIRECTANGULAR", (camera.width, camera.height)
    bent = camera.distortion
    if camera.lens is Lens.FISHEYE:
        model, count = "OPENCV_FISHEYE", 4
    else:
        model, count = ("PINHOLE", 0) if not bent else ("OPENCV", 4) if len(bent) <= 4 else ("FULL_OPENCV", 8)
    coefficients = (*bent, *[0.0] * (count - len(bent)))
    return model, (camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5, *coefficients)


def _images(map_: Map) -> Iterator[str]:
    """Yield the lines of ``images.txt``: each view's T_camera_map, and pixel and landmark of its observations."""
    yield "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME"
    yield "# POINTS2D[] as (X, Y, POINT3D_ID)"
    seen, offsets = map_.observations, map_.view_offsets
    assert seen.pixels is not None
    T_camera_map = np.linalg.inv(map_.views.T_map_camera)
    quaternions = Rotation.from_matrix(T_camera_map[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
    points = _point_numbers(map_)[seen.features]
    for view, source in enumerate(map_.views.known_sources.tolist()):
        pose = _numbers((*quaternions[view], *T_camera_map[view, :3, 3]))
        yield f"{view + 1} {pose} {source + 1} {_name(view)}"
        rows = slice(offsets[view], offsets[view + 1])
        found = zip((seen.pixels[rows] + 0.5).tolist(), points[rows].tolist(), strict=True)
        yield " ".join(f"{u:.4f} {v:.4f} {point}" for (u, v), point in found)


def _points(map_: Map) -> Iterator[str]:
    """Yield the lines of ``points3D.txt``: landmarks that two views or more see, colour, mean error [px], views."""
    yield "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)"
    seen, numbers, errors = map_.observations, _point_numbers(map_), reprojection_errors_px(map_)
    places = np.arange(len(seen)) - map_.view_offsets[seen.views]
    order = np.argsort(seen.features, kind="stable")
    starts = np.searchsorted(seen.features[order], np.arange(len(map_) + 1))
    for feature in np.flatnonzero(numbers > 0).tolist():
        rows = order[starts[feature] : starts[feature + 1]]
        colour = " ".join(map(str, map_.landmarks.known_colours[feature].tolist()))
        position = _numbers(map_.landmarks.positions[feature].astype(np.float64))
        track = " ".join(f"{view + 1} {place}" for view, place in zip(seen.views[rows], places[rows], strict=True))
        yield f"{numbers[feature]} {position} {colour} {_mean_error_px(errors[rows]):.6g} {track}"


def _mean_error_px(errors: FloatArray) -> float:
    """Mean of the errors (V,) [px] that are not NaN; 0 if all are."""
    known = errors[~np.isnan(errors)]
    return float(known.mean()) if len(known) else 0.0


def reprojection_errors_px(map_: Map) -> FloatArray:
    """Reprojection errors (V,) of the observations [px]; NaN behind the camera."""
    seen, cameras, sources = map_.observations, source_cameras(map_.info), map_.views.known_sources
    assert seen.pixels is not None
    T = map_.views.T_map_camera[seen.views]
    points = np.einsum("nji,nj->ni", T[:, :3, :3], map_.landmarks.positions[seen.features] - T[:, :3, 3])
    errors = np.full(len(seen), np.nan)
    for source, camera in enumerate(cameras):
        rows = sources[seen.views] == source
        errors[rows] = np.linalg.norm(camera.project(points[rows]) - seen.pixels[rows], axis=1)
    return errors


def _point_numbers(map_: Map) -> np.ndarray:
    """The number (F,) of each landmark among the model's points, from 1; -1 if fewer than two views see it."""
    often = np.bincount(map_.observations.features, minlength=len(map_)) >= _MIN_VIEWS
    return np.where(often, np.arange(1, len(map_) + 1), -1)


def _numbers(values: Any) -> str:
    """Numbers as text, 12 significant digits each, separated by spaces."""
    return " ".join(f"{float(value):.12g}" for value in values)
