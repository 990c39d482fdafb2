"""One reader per format, chosen by the folder's files, their headers and numbers of columns.

A new format is one new file with ``recognises`` and ``read``, and one line here; a new scanning app is a row of
:mod:`rholoc.recordings.readers.apps.scanning_apps`. Apps of phones, datasets and the models of other programs have a
folder each; rholoc's own layout and ROS bags are here.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePath

from rholoc.disk import is_system_file
from rholoc.errors import InvalidRecording
from rholoc.recordings.frames.unified_pictures import require_one_camera, with_logged_intrinsics
from rholoc.recordings.readers import bag, own
from rholoc.recordings.readers._unused import with_unused_files
from rholoc.recordings.readers.apps import (
    android_csv,
    ios_logger,
    mars_logger,
    opencamera_sensors,
    sensor_logger,
    spectacular,
    stray_scanner,
)
from rholoc.recordings.readers.apps.scanning_apps import APPS
from rholoc.recordings.readers.datasets import advio, euroc, seven_scenes, tum_rgbd
from rholoc.recordings.readers.models import colmap, kapture, metashape, nerfstudio
from rholoc.recordings.recording import Recording, RecordingFormat
from rholoc.recordings.tables.own_tables import read_lengths_csv
from rholoc.recordings.tables.waypoints import read_waypoints_csv


@dataclass(frozen=True)
class Reader:
    """Reader of one format.

    Attributes:
        read: folder → its recording; :func:`read_folder` adds name, path and format.
        tables: lower-case patterns of the paths of its files, except pictures and videos.
    """

    format: RecordingFormat
    recognises: Callable[[Path], bool]
    read: Callable[[Path], Recording]
    tables: tuple[str, ...]


READERS = tuple(
    Reader(kind, module.recognises, module.read, module.TABLES)
    for kind, module in (
        (RecordingFormat.ANDROID_CSV, android_csv),
        (RecordingFormat.OPENCAMERA_SENSORS, opencamera_sensors),
        (RecordingFormat.MARS_LOGGER, mars_logger),
        (RecordingFormat.SENSOR_LOGGER, sensor_logger),
        (RecordingFormat.SPECTACULAR, spectacular),
        (RecordingFormat.STRAY_SCANNER, stray_scanner),
        (RecordingFormat.IOS_LOGGER, ios_logger),
        (RecordingFormat.ADVIO, advio),
        (RecordingFormat.EUROC, euroc),
        (RecordingFormat.TUM_RGBD, tum_rgbd),
        (RecordingFormat.SEVEN_SCENES, seven_scenes),
        (RecordingFormat.COLMAP, colmap),
        (RecordingFormat.NERFSTUDIO, nerfstudio),
        (RecordingFormat.METASHAPE, metashape),
        (RecordingFormat.KAPTURE, kapture),
        (RecordingFormat.BAG, bag),
    )
) + tuple(Reader(app.format, app.recognises, app.read, app.tables) for app in APPS)


_FORMATS_FOLDERS = ("frames", "images", "keyframes", "sensors")  # of rholoc, Polycam and kapture
_NOTES = ("readme", "licence", "license")


def read_folder(folder: Path, topics: Sequence[str] = ()) -> Recording:
    """Read a folder, or the only folder in it (:func:`_innermost`), in the recognised format, by default rholoc's own.

    ``waypoints.csv``, ``lengths.csv`` and ``camera.json`` may be added to any format. Unused files cause a warning.
    ``topics`` names a bag's topics to use, if there are several of a kind.

    Raises:
        InvalidRecording: no frames, files of several formats, or a file that cannot be read or contradicts another.
        InvalidCamera: the intrinsics are broken, or of another image shape than the frames, or ``camera.json`` lies
            beside pictures of several sizes or lenses.
        InvalidWaypoints: ``waypoints.csv`` is broken.
        InvalidTrajectory: the poses are broken.
    """
    name, folder = folder.resolve().name, _innermost(folder)
    found = [reader for reader in READERS if reader.recognises(folder)]
    if len(found) > 1:
        formats = " and ".join(reader.format.value for reader in found)
        raise InvalidRecording(f"The folder {name} contains files of {formats}.", "Keep those of one.")
    if found:
        read = found[0].read(folder) if found[0].format is not RecordingFormat.BAG else bag.read(folder, topics)
        recording, tables = _with_additions(replace(read, format=found[0].format), folder), found[0].tables
    else:
        recording, tables = own.read(folder), own.TABLES
    recording = replace(recording, name=name, path=folder)
    lengths_csv = folder / "lengths.csv"
    if lengths_csv.is_file():
        recording = replace(recording, lengths=read_lengths_csv(lengths_csv, recording.frames.numbers))
    return with_unused_files(recording, folder, tables)


def _innermost(folder: Path) -> Path:
    """The folder or, while it holds nothing but one folder that is no format's own, that folder. Hidden and system
    files and notes (readme, licence) do not count.
    """
    inside = [path for path in folder.iterdir() if not _is_aside(path)]
    wrapped = len(inside) == 1 and inside[0].is_dir() and not inside[0].is_symlink()
    return _innermost(inside[0]) if wrapped and inside[0].name not in _FORMATS_FOLDERS else folder


def _is_aside(path: Path) -> bool:
    """Whether a path is hidden, of an operating system, or a file of notes."""
    is_note = path.name.lower().startswith(_NOTES) and path.is_file()
    return path.name.startswith(".") or is_system_file(PurePath(path.name)) or is_note


def _with_additions(recording: Recording, folder: Path) -> Recording:
    """The recording with the intrinsics, mounting, read-out time and waypoints of files added to the folder. Raises
    InvalidCamera, InvalidWaypoints.
    """
    description = own.read_description(folder)
    if description.camera is not None and 0 not in recording.frames.size:
        require_one_camera(recording.frames)
        recording = replace(recording, camera=description.camera.fitted(*recording.frames.size))
    else:
        recording = with_logged_intrinsics(recording)
    if description.R_camera_imu is not None and recording.imu is not None:
        recording = replace(recording, imu=replace(recording.imu, R_camera_imu=description.R_camera_imu))
    if description.readout_s is not None:
        recording = replace(recording, readout_s=description.readout_s)
    waypoints_csv = folder / "waypoints.csv"
    if waypoints_csv.is_file():
        recording = replace(recording, waypoints=read_waypoints_csv(waypoints_csv, recording.frames))
    return recording
