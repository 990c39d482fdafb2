"""Exports of scanning apps: pictures, each with ARKit's intrinsics and pose, mostly with LiDAR depth.

::

    3D Scanner App   frame_00000.jpg, frame_00000.json: intrinsics (3×3) and cameraPoseARFrame (4×4) by rows, time [s],
    ("All data")     depth_00000.png [mm], conf_00000.png
    Polycam          keyframes/images/TIME.jpg [µs], keyframes/cameras/TIME.json: width, height, fx, fy, cx, cy,
    (raw data)       t_00 … t_23 (3×4); corrected_images and corrected_cameras instead where Polycam refined them;
                     keyframes/depth/TIME.png [mm]
    Record3D         metadata or metadata.json: w, h, K (3×3, by columns), poses (qx qy qz qw x y z), frameTimestamps,
    (.r3d, folder)   perFrameIntrinsicCoeffs (fx fy cx cy); rgbd/0.jpg or rgb/0.jpg
    ARKitScenes      lowres_wide/ID_TIME.png, lowres_wide_intrinsics/ID_TIME.pincam (w h fx fy cx cy),
    (a dataset)      lowres_wide.traj (time, rotation vector, position), lowres_depth/ID_TIME.png [mm]

Poses are T_world_camera of a camera that looks along −z with y up, in a world with y up, in metres; ARKitScenes' are of
the world in a camera with OpenCV's axes, z up. All of them drift. The focal length changes from picture to picture.
Record3D's depth, compressed by LZFSE or as OpenEXR, is not read.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidCamera, InvalidImage, InvalidInput, InvalidRecording, InvalidTrajectory
from rholoc.geometry import Camera, FloatArray, is_rotation, pose_matrix
from rholoc.recordings.frames.depth import MILLIMETRE_M
from rholoc.recordings.frames.image_decoding import IMAGE_SUFFIXES, image_size
from rholoc.recordings.frames.image_folder import picture_size
from rholoc.recordings.imu_normalisation import frame_times_s
from rholoc.recordings.readers._apple import opencv_camera, z_up
from rholoc.recordings.readers._frames import depth_images, timed_images, untimed_images
from rholoc.recordings.recording import GivenPoses, PoseKind, Recording, RecordingFormat
from rholoc.recordings.tables.csv_table import read_json
from rholoc.recordings.tables.logged_table import read_logged_table
from rholoc.recordings.tables.pose_table import PoseTable, match_poses, poses_from_rows

_ROTATION_TOLERANCE = 1e-3
_PINCAM_SHIFT_S = 0.001  # between the times in the names of ARKitScenes' pictures and of their intrinsics
_ADVICE = "Export all data again."


@dataclass(frozen=True, eq=False)
class _Shot:
    """A picture of a scan.

    Attributes:
        picture: its file.
        camera: at the size that its intrinsics refer to.
        T_map_camera: (4, 4), z up; NaN if unknown.
        time: in the app's unit; None if unknown.
        depth: its depth image, which need not exist.
    """

    picture: Path
    camera: Camera
    T_map_camera: FloatArray
    time: float | None = None
    depth: Path | None = None


@dataclass(frozen=True)
class ScanningApp:
    """A scanning app's layout.

    Attributes:
        format: its name.
        tables: lower-case patterns of the paths of its files, except pictures that are read.
        recognises: whether a folder has this layout.
        shots: the pictures of such a folder, in the order of their times.
        time_unit: of these times.
    """

    format: RecordingFormat
    tables: tuple[str, ...]
    recognises: Callable[[Path], bool]
    shots: Callable[[Path], list[_Shot]]
    time_unit: str = "s"

    def read(self, folder: Path) -> Recording:
        """Read a folder of this layout: poses by ARKit, which drift, and depth, if any.

        Raises:
            InvalidRecording: a picture or its description is broken or missing, or over 5 % of the times go back.
            InvalidCamera: intrinsics are broken.
            InvalidTrajectory: a pose is broken.
        """
        shots = self.shots(folder)
        pictures, cameras = [shot.picture for shot in shots], [shot.camera for shot in shots]
        times = [shot.time for shot in shots if shot.time is not None]
        if len(times) == len(shots) > 0:
            times_s, unit_warnings = frame_times_s(np.array(times), self.time_unit)
            timed = timed_images(pictures, times_s, cameras)
        else:
            timed, unit_warnings = untimed_images(pictures, cameras), ()
        shots = [shots[row] for row in timed.rows]
        T = np.array([shot.T_map_camera for shot in shots])
        known = np.isfinite(T[:, 0, 0])
        depths = [shot.depth for shot in shots]
        return Recording(
            timed.frames,
            camera=timed.camera,
            poses=GivenPoses(known, T, kind=PoseKind.ODOMETRY) if known.any() else None,
            depth=depth_images(depths, MILLIMETRE_M, camera=_depth_camera(depths, shots[0].camera)),
            warnings=(*unit_warnings, *timed.warnings),
        )


def _depth_camera(depths: Sequence[Path | None], camera: Camera) -> Camera | None:
    """Intrinsics of the depth images: the pictures' own ``camera``, at the size of the first depth image
    with a readable header; None if there is none.
    """
    for path in depths:
        if path is not None and path.is_file():
            with suppress(InvalidImage):
                return camera.resized(*image_size(path))
    return None


def _scanner_app(folder: Path) -> list[_Shot]:
    """Pictures of a 3D Scanner App export. Raises InvalidRecording, InvalidCamera, InvalidTrajectory."""
    shots = []
    for picture in _pictures(folder, "frame_*.jpg"):
        values, source = _members(picture.with_suffix(".json")), f"{picture.stem}.json"
        K = _numbers(values, ("intrinsics",), 9, source, InvalidCamera)
        T = _numbers(values, ("cameraPoseARFrame",), 16, source, InvalidTrajectory).reshape(4, 4)
        time = _numbers(values, ("time",), 1, source)[0]
        depth = picture.with_name(picture.stem.replace("frame", "depth", 1) + ".png")
        camera = Camera(*picture_size(picture), *K[[0, 4, 2, 5]].tolist())
        shots.append(_Shot(picture, camera, _from_arkit(T, source), float(time), depth))
    return shots


def _is_scanner_app(folder: Path) -> bool:
    """Whether ``frame_*.jpg`` have descriptions with a pose, by the first one."""
    pictures = _pictures(folder, "frame_*.jpg")
    return bool(pictures) and "cameraPoseARFrame" in _members_if_any(pictures[0].with_suffix(".json"))


def _polycam(folder: Path) -> list[_Shot]:
    """Pictures of a Polycam export. Raises InvalidRecording, InvalidCamera, InvalidTrajectory."""
    keyframes, shots = folder / "keyframes", []
    kind = "corrected_" if _pictures(keyframes / "corrected_images") else ""
    for picture in _pictures(keyframes / f"{kind}images"):
        values, source = _members(keyframes / f"{kind}cameras" / f"{picture.stem}.json"), f"{picture.stem}.json"
        camera = _camera(_numbers(values, ("width", "height", "fx", "fy", "cx", "cy"), 6, source, InvalidCamera))
        names = [f"t_{row}{column}" for row in range(3) for column in range(4)]
        T = np.vstack([_numbers(values, names, 12, source, InvalidTrajectory).reshape(3, 4), [0, 0, 0, 1]])
        time = float(picture.stem) if picture.stem.isdecimal() else None
        depth = keyframes / "depth" / f"{picture.stem}.png"
        shots.append(_Shot(picture, camera, _from_arkit(T, source), time, depth))
    return shots


def _is_polycam(folder: Path) -> bool:
    """Whether ``keyframes`` has a folder of cameras."""
    return any((folder / "keyframes" / name).is_dir() for name in ("cameras", "corrected_cameras"))


def _record3d(folder: Path) -> list[_Shot]:
    """Pictures of a Record3D export. Raises InvalidRecording, InvalidCamera, InvalidTrajectory."""
    source = _record3d_file(folder)
    assert source is not None
    values = _members(source)
    size = _numbers(values, ("w", "h"), 2, source.name, InvalidCamera)
    K = _numbers(values, ("K",), 9, source.name, InvalidCamera)
    count = len(values["poses"])
    rows = _numbers(values, ("poses",), 7 * count, source.name, InvalidTrajectory).reshape(count, 7)
    poses = z_up(opencv_camera(poses_from_rows(rows[:, [4, 5, 6, 0, 1, 2, 3]], source.name)))
    each = _list(values, "perFrameIntrinsicCoeffs", source) or [K[[0, 4, 6, 7]].tolist()] * count
    times = _list(values, "frameTimestamps", source) or [None] * count
    if not (len(each) == len(times) == count):
        raise InvalidRecording(
            f"{source.name} describes {count} poses, {len(each)} cameras, {len(times)} times.", _ADVICE
        )
    shots = []
    for picture in _pictures(folder / "rgbd") or _pictures(folder / "rgb"):
        number = int(picture.stem) if picture.stem.isdecimal() else count
        if number >= count:
            raise InvalidRecording(f"{source.name} has no pose of {picture.name}.", _ADVICE)
        camera = _camera(
            np.append(size, _numbers({"camera": each[number]}, ("camera",), 4, source.name, InvalidCamera))
        )
        time = None if times[number] is None else _numbers({"time": times[number]}, ("time",), 1, source.name)[0]
        shots.append(_Shot(picture, camera, poses[number], time))
    return shots


def _list(values: dict[str, Any], name: str, source: Path) -> list[Any]:
    """The member ``name``, empty if missing. Raises InvalidRecording, naming the file, if it is no list."""
    found = values.get(name) or []
    if not isinstance(found, list):
        raise InvalidRecording(f"{source.name}: {name} is not a list.", _ADVICE)
    return found


def _record3d_file(folder: Path) -> Path | None:
    """The file of the poses, ``metadata`` or ``metadata.json``; None if there is none."""
    named = (folder / name for name in ("metadata", "metadata.json"))
    return next((path for path in named if isinstance(_members_if_any(path).get("poses"), list)), None)


def _arkit_scenes(folder: Path) -> list[_Shot]:
    """Pictures of an ARKitScenes scan. Raises InvalidRecording, InvalidCamera, InvalidTrajectory."""
    root = _arkit_scenes_root(folder)
    assert root is not None
    rows = read_logged_table(root / "lowres_wide.traj").numbered(*range(7))
    T_camera_map = pose_matrix(Rotation.from_rotvec(rows[:, 1:4]).as_matrix(), rows[:, 4:7])
    pictures = sorted(_pictures(root / "lowres_wide"), key=_time_of)
    times = [_time_of(picture) for picture in pictures]
    timed = timed_images(pictures, np.array(times))
    T = np.full((len(pictures), 4, 4), np.nan)  # also of pictures that are left out, because their time is another's
    T[timed.rows] = match_poses(PoseTable(rows[:, 0], np.linalg.inv(T_camera_map)), timed.frames).T_map_camera
    shots = []
    for picture, time, pose in zip(pictures, times, T, strict=True):
        pincam = _pincam(root / "lowres_wide_intrinsics", picture.stem)
        camera = _camera(read_logged_table(pincam).numbered(*range(6))[0])
        shots.append(_Shot(picture, camera, pose, time, root / "lowres_depth" / picture.name))
    return shots


def _pincam(folder: Path, stem: str) -> Path:
    """File of the intrinsics of picture ``stem``, whose name may differ from the picture's by a millisecond; the
    picture's own name if there is none.
    """
    scan, _, time = stem.rpartition("_")
    shifted = (f"{scan}_{float(time) + shift_s:.3f}" for shift_s in (-_PINCAM_SHIFT_S, _PINCAM_SHIFT_S))
    paths = [folder / f"{name}.pincam" for name in (stem, *shifted)]
    return next((path for path in paths if path.is_file()), paths[0])


def _arkit_scenes_root(folder: Path) -> Path | None:
    """The folder of ``lowres_wide.traj``, which may be a subfolder named after the scan; None if there is none."""
    found = sorted([*folder.glob("lowres_wide.traj"), *folder.glob("*_frames/lowres_wide.traj")])
    return found[0].parent if found else None


def _time_of(picture: Path) -> float:
    """Seconds in the name of ARKitScenes' picture. Raises InvalidRecording if there are none."""
    try:
        return float(picture.stem.rpartition("_")[2])
    except ValueError as error:
        raise InvalidRecording(f"{picture.name} is not named after its time.", "Download it again.") from error


def _camera(numbers: FloatArray) -> Camera:
    """The camera of a width, height, fx, fy, cx and cy (6,). Raises InvalidCamera if they are impossible."""
    width, height, *intrinsics = numbers.tolist()
    return Camera(int(width), int(height), *intrinsics)


def _from_arkit(T_arkit_camera: FloatArray, source: str) -> FloatArray:
    """T_map_camera (4, 4) of ARKit's pose, z up; raises InvalidTrajectory, naming ``source``, if it has no rotation."""
    if not is_rotation(T_arkit_camera[:3, :3], _ROTATION_TOLERANCE):
        raise InvalidTrajectory(f"The pose in {source} has no rotation.", _ADVICE)
    return z_up(opencv_camera(T_arkit_camera))


def _pictures(folder: Path, pattern: str = "*") -> list[Path]:
    """The pictures of a folder by name, or by number if their names are numbers."""
    found = [path for path in folder.glob(pattern) if path.suffix.lower() in IMAGE_SUFFIXES and path.name[0] != "."]
    return sorted(found, key=lambda path: (int(path.stem) if path.stem.isdecimal() else 0, path.name))


def _members(path: Path) -> dict[str, Any]:
    """The members of a JSON file; raises InvalidRecording if it is missing or broken."""
    values = read_json(path) if path.is_file() else None
    if not isinstance(values, dict):
        raise InvalidRecording(f"{path.name} is missing or describes nothing.", _ADVICE)
    return values


def _members_if_any(path: Path) -> dict[str, Any]:
    """The members of a JSON file; empty if it is missing or broken."""
    try:
        return _members(path)
    except InvalidRecording:
        return {}


def _numbers(
    values: dict[str, Any], names: Sequence[str], count: int, source: str, error: type[InvalidInput] = InvalidRecording
) -> FloatArray:
    """The members' finite numbers (count,), flattened one after the other. Raises ``error``, naming ``source``, if a
    member is missing or the numbers are not ``count``.
    """
    try:
        found = np.concatenate([np.ravel(np.array(values[name], dtype=np.float64)) for name in names])
    except (KeyError, TypeError, ValueError):
        found = np.zeros(0)
    if found.shape != (count,) or not np.isfinite(found).all():
        raise error(
            f"{source}: {names[0]} is not {count} numbers."
            if len(names) == 1
            else f"{source} lacks one of {', '.join(names)}.",
            _ADVICE,
        )
    return found


APPS = (
    ScanningApp(
        RecordingFormat.SCANNER_APP,
        ("frame_*.json", "depth_*.png", "conf_*.png", "info.json"),
        _is_scanner_app,
        _scanner_app,
    ),
    ScanningApp(
        RecordingFormat.POLYCAM, ("keyframes/*", "mesh_info.json", "*.glb", "thumbnail.*"), _is_polycam, _polycam, "µs"
    ),
    ScanningApp(
        RecordingFormat.RECORD3D,
        ("metadata", "metadata.json", "icon", "sound.*"),
        lambda folder: _record3d_file(folder) is not None,
        _record3d,
    ),
    ScanningApp(
        RecordingFormat.ARKIT_SCENES,
        ("*lowres_*", "*confidence/*", "*annotation.json", "*mesh.ply"),
        lambda folder: _arkit_scenes_root(folder) is not None,
        _arkit_scenes,
    ),
)
