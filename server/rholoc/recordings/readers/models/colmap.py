"""A COLMAP model as text or binary, beside its images, as Gaussian splatting has it too.

::

    images/                    or the folder itself
    sparse/0/cameras.txt       CAMERA_ID MODEL WIDTH HEIGHT PARAMS…       or sparse/1/, …, sparse/, the folder itself
    sparse/0/images.txt        IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then a line of points
    sparse/0/*.bin             the same as binary
    outputs/sfm*/              a model by hloc, or sfm*/; its features-*.h5 and matches-*.h5 are not used
    colmap/sparse/0/           by nerfstudio, if there is no transforms.json, which it makes from this
    colmap_sparse/0/           the same by Instant NGP, or colmap_text/

Poses are of the world in the camera; pixel (0.5, 0.5) is the centre of the top-left one. The unit of length is not
stated. Of several models, which have no common frame, the one with most images is read.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath

import numpy as np

from rholoc.errors import InvalidCamera, InvalidRecording
from rholoc.geometry import Camera
from rholoc.recordings.readers._camera_models import camera_of_model, unsupported
from rholoc.recordings.readers._frames import listed_file, untimed_images
from rholoc.recordings.readers._orientation import as_shown
from rholoc.recordings.recording import GivenPoses, Recording
from rholoc.recordings.tables.csv_table import read_text
from rholoc.recordings.tables.pose_table import poses_from_rows
from rholoc.reports import RecordingWarning, WarningKind

SCALE_WARNING = RecordingWarning(
    WarningKind.SCALE_UNKNOWN, "The poses' unit of length is not stated: a map from them is not metric."
)

TABLES = (
    "sparse/*",
    "cameras.*",
    "images.*",
    "points3d.*",
    "frames.*",
    "rigs.*",
    "database.db",
    "project.ini",
    "sfm*/*",
    "outputs/sfm*/*",
    "*pairs*.txt",
    "colmap/*",
    "colmap_*/*",
    "colmap.db",
)

TRANSFORMS = ("transforms.json", "transforms_train.json", "transforms_val.json", "transforms_test.json")  # nerfstudio's
_PLACES = (("sparse/[0-9]*",), ("sparse",), ("",), ("sfm*", "outputs/sfm*"))
_SOURCES_OF_TRANSFORMS = (("colmap/sparse/[0-9]*",), ("colmap_sparse/[0-9]*",), ("colmap_text",))

# COLMAP's numbers of the models in binary files, and how many parameters each has.
_BINARY_MODELS = {
    0: ("SIMPLE_PINHOLE", 3),
    1: ("PINHOLE", 4),
    2: ("SIMPLE_RADIAL", 4),
    3: ("RADIAL", 5),
    4: ("OPENCV", 8),
    5: ("OPENCV_FISHEYE", 8),
    6: ("FULL_OPENCV", 12),
    7: ("FOV", 5),
    8: ("SIMPLE_RADIAL_FISHEYE", 4),
    9: ("RADIAL_FISHEYE", 5),
    10: ("THIN_PRISM_FISHEYE", 12),
    11: ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    12: ("SIMPLE_DIVISION", 4),
    13: ("DIVISION", 5),
    14: ("SIMPLE_FISHEYE", 3),
    15: ("FISHEYE", 4),
    16: ("EUCM", 6),
    17: ("EQUIRECTANGULAR", 2),
}
_CAMERA_HEAD, _IMAGE_HEAD, _COUNT = struct.Struct("<iiQQ"), struct.Struct("<i7di"), struct.Struct("<Q")
_POINT_BYTES = 24  # of a point in an image: x, y, and the point's number
_MAX_NAME_BYTES = 4096


@dataclass(frozen=True, eq=False)
class _Image:
    """An image of the model: its camera's identifier, and tx ty tz qx qy qz qw of the world in the camera."""

    name: str
    camera: str
    pose: list[float]


def recognises(folder: Path) -> bool:
    """Whether the folder has a COLMAP model, as text or binary."""
    return bool(_models(folder))


def read(folder: Path) -> Recording:
    """Read the model with most images: poses of unknown scale. Images that it does not place are ignored.

    Raises:
        InvalidRecording: the model or an image is broken.
        InvalidCamera: a camera is broken.
        InvalidTrajectory: a pose is broken.
    """
    models = [(model, *_read_model(model)) for model in _models(folder)]
    chosen, images, fields = max(models, key=lambda one: len(one[1]))
    others = [f"{path.relative_to(folder)} ({len(listed)})" for path, listed, _ in models if path != chosen]
    source = _pictures_folder(folder, images[0].name)
    cameras, warnings = _cameras(fields, [image.camera for image in images])
    paths = [listed_file(source, image.name) for image in images]
    cameras, T_stored_shown = as_shown(paths, cameras)
    timed = untimed_images(paths, cameras)
    T_stored_map = poses_from_rows(np.array([image.pose for image in images]), "the model's images")
    T_map_camera = np.linalg.inv(T_stored_map) @ T_stored_shown
    return Recording(
        timed.frames,
        camera=timed.camera,
        poses=GivenPoses(np.ones(len(timed.rows), dtype=np.bool_), T_map_camera[timed.rows], metric=False),
        warnings=(*timed.warnings, SCALE_WARNING, *warnings, *_not_read(others, chosen.relative_to(folder))),
    )


def _pictures_folder(folder: Path, name: str) -> Path:
    """The folder that contains the picture ``name``: ``images``, ``folder`` itself, or another subfolder, by name.

    If none contains the picture, the first of these that exists. Raises InvalidRecording for an unsafe name.
    """
    some = [path for path in (folder / "images", folder, *sorted(folder.iterdir())) if path.is_dir()]
    return next((path for path in some if listed_file(path, name).is_file()), some[0])


def _models(folder: Path) -> list[Path]:
    """The folders of the models in the first place that has any; empty if there are none."""
    has_transforms = any((folder / name).is_file() for name in TRANSFORMS)
    sought = _PLACES if has_transforms else (*_PLACES, *_SOURCES_OF_TRANSFORMS)
    for patterns in sought:
        places = sorted(path for pattern in patterns for path in (folder.glob(pattern) if pattern else [folder]))
        found = [place for place in places if _is_complete(place, "bin") or _is_complete(place, "txt")]
        if found:
            return found
    return []


def _not_read(others: Sequence[str], chosen: PurePath) -> tuple[RecordingWarning, ...]:
    """Warning that names the models that are not read, and their numbers of pictures; none without others."""
    if not others:
        return ()
    text = f"Of {len(others) + 1} models {chosen} is read, which places most pictures; not {', '.join(others)}."
    return (RecordingWarning(WarningKind.NOT_USED, text),)


def _is_complete(place: Path, ending: str) -> bool:
    """Whether a folder has the files of the cameras and of the images with this ending."""
    return all((place / f"{name}.{ending}").is_file() for name in ("cameras", "images"))


def _read_model(model: Path) -> tuple[list[_Image], dict[str, list[str]]]:
    """The images, and the fields of each camera by identifier, of a binary model, else of text. Raises
    InvalidRecording.
    """
    if _is_complete(model, "bin"):
        return _read_binary(model)
    return _read_images(model / "images.txt"), _read_cameras(model / "cameras.txt")


def _read_binary(model: Path) -> tuple[list[_Image], dict[str, list[str]]]:
    """The images, and the fields of each camera as a text file has them, by identifier. Raises InvalidRecording: a file
    is cut off, is something else or lists no images.
    """
    try:
        return _binary_images((model / "images.bin").read_bytes()), _binary_cameras(
            (model / "cameras.bin").read_bytes()
        )
    except (struct.error, KeyError, ValueError) as error:
        raise InvalidRecording(
            f"The binary model in {model.name} is broken or cut off.", "Export it again, or as text."
        ) from error


def _binary_cameras(data: bytes) -> dict[str, list[str]]:
    """Fields of each camera by identifier: model, width, height, parameters. Raises struct.error, KeyError."""
    fields, place = {}, _COUNT.size
    for _ in range(_COUNT.unpack_from(data)[0]):
        number, model, width, height = _CAMERA_HEAD.unpack_from(data, place)
        name, count = _BINARY_MODELS[model]
        place += _CAMERA_HEAD.size
        values = struct.unpack_from(f"<{count}d", data, place)
        place += 8 * count
        fields[str(number)] = [name, str(width), str(height), *map(repr, values)]
    return fields


def _binary_images(data: bytes) -> list[_Image]:
    """Images of a binary file. Raises struct.error or ValueError if it is cut off, InvalidRecording if it is empty."""
    images, place = [], _COUNT.size
    for _ in range(_COUNT.unpack_from(data)[0]):
        _, qw, qx, qy, qz, tx, ty, tz, camera = _IMAGE_HEAD.unpack_from(data, place)
        place += _IMAGE_HEAD.size
        end = data.index(b"\0", place, place + _MAX_NAME_BYTES)
        images.append(_Image(data[place:end].decode(), str(camera), [tx, ty, tz, qx, qy, qz, qw]))
        points = _COUNT.unpack_from(data, end + 1)[0]
        place = end + 1 + _COUNT.size + points * _POINT_BYTES
        if place > len(data):
            raise ValueError("The file ends within an image.")
    if not images:
        raise InvalidRecording("The binary model lists no images.")
    return images


def _read_images(path: Path) -> list[_Image]:
    """Images of a text file. Raises InvalidRecording if it is broken, or lists none."""
    lines = iter(read_text(path).splitlines())
    images = []
    for line in lines:
        if not line.strip() or line.startswith("#"):
            continue
        points, parts = next(lines, ""), line.split(maxsplit=9)
        try:
            qw, qx, qy, qz, tx, ty, tz = (float(part) for part in parts[1:8])
            images.append(_Image(parts[9].strip(), parts[8], [tx, ty, tz, qx, qy, qz, qw]))
        except (ValueError, IndexError) as error:
            raise InvalidRecording(f"{path.name}: '{line[:60]}' is not a valid image line.") from error
        if len(points.split()) % 3 != 0:
            raise InvalidRecording(
                f"{path.name}: the line after {images[-1].name[:60]} is not a list of its points (X Y POINT3D_ID).",
                "Leave a line empty where an image has no points.",
            )
    if not images:
        raise InvalidRecording(f"{path.name} lists no images.")
    return images


def _read_cameras(path: Path) -> dict[str, list[str]]:
    """The fields after the identifier, by identifier, of a text file. Raises InvalidRecording if it cannot be read."""
    rows = (line.split() for line in read_text(path).splitlines() if line.strip() and not line.startswith("#"))
    return {row[0]: row[1:] for row in rows}


def _camera(fields: list[str]) -> Camera | None:
    """The camera of a line's fields; None if the model is not supported. Raises InvalidCamera if they are broken."""
    try:
        values = [float(field) for field in fields[3:]]
        return camera_of_model(fields[0], (int(fields[1]), int(fields[2])), values)
    except InvalidCamera:
        raise
    except (ValueError, IndexError) as error:
        raise InvalidCamera(f"cameras.txt: '{' '.join(fields)[:60]}' is not a camera.") from error


def _cameras(
    fields: dict[str, list[str]], used: Sequence[str]
) -> tuple[list[Camera] | None, tuple[RecordingWarning, ...]]:
    """Camera of each image by the numbers ``used``; None, with a warning, if one is of a model that is not supported.
    Raises InvalidCamera if a camera is missing or broken.
    """
    found: dict[str, Camera] = {}
    for number in dict.fromkeys(used):
        if number not in fields:
            raise InvalidCamera(f"The model has no camera {number}, which its images use.")
        camera = _camera(fields[number])
        if camera is None:
            return None, (unsupported(fields[number][0]),)
        found[number] = camera
    return [found[number] for number in used], ()
