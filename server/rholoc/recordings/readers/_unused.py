"""Warn about files of a recording's folder that no reader uses."""

from dataclasses import replace
from fnmatch import fnmatchcase
from itertools import groupby
from pathlib import Path, PurePath

from rholoc.recordings.frame_slice import SelectedFrames
from rholoc.recordings.frames.bag import BagFrames
from rholoc.recordings.frames.image_folder import ImageFolderFrames
from rholoc.recordings.frames.unified_pictures import SteadyFrames, UnifiedPictures
from rholoc.recordings.frames.video import VideoFrames
from rholoc.recordings.recording import FrameSource, Recording
from rholoc.reports import RecordingWarning, WarningKind

_ALWAYS = (
    "waypoints.csv",
    "lengths.csv",
    "camera.json",
    "readme*",
    "*/readme*",
    "licen[cs]e*",
    "__macosx/*",
    "*thumbs.db",
    "*desktop.ini",
)
_MAX_NAMED = 4


def with_unused_files(recording: Recording, folder: Path, tables: tuple[str, ...]) -> Recording:
    """Add a warning that names the unused files of a recording's folder, if any.

    Args:
        recording: as read from the folder.
        tables: lower-case patterns of the paths of used files, except pictures and videos.
    """
    depths = filter(None, recording.depth.paths if recording.depth else ())
    used = {path.resolve() for path in (*_files_of(recording.frames), *depths)}
    unused = [
        path.relative_to(folder)
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.resolve() not in used and not _is_known(path.relative_to(folder), tables)
    ]
    if not unused:
        return recording
    named = [_described(top, list(paths)) for top, paths in groupby(unused, key=lambda path: path.parts[0])]
    rest = len(named) - _MAX_NAMED
    listed = ", ".join(named[:_MAX_NAMED]) + (f" and {rest} more" if rest > 0 else "")
    text = f"Not used, since a recording of this format has no such files: {listed}."
    return replace(recording, warnings=(*recording.warnings, RecordingWarning(WarningKind.NOT_USED, text)))


def _described(top: str, paths: list[PurePath]) -> str:
    """Name of a file at the top, path of the only file in the subfolder ``top``, or its name and number of files."""
    return (
        top if len(paths[0].parts) == 1 else paths[0].as_posix() if len(paths) == 1 else f"{top}/ ({len(paths)} files)"
    )


def _is_known(path: PurePath, tables: tuple[str, ...]) -> bool:
    """Whether a path is hidden or matches a pattern (lower-case glob) of ``tables``, or one that all readers know."""
    name = path.as_posix().lower()
    hidden = any(part.startswith(".") for part in path.parts)
    return hidden or any(fnmatchcase(name, pattern) for pattern in (*_ALWAYS, *tables))


def _files_of(frames: FrameSource) -> tuple[Path, ...]:
    """Files that the frames are read from: pictures, or a video or bag; none for frames in memory."""
    match frames:
        case SelectedFrames() | SteadyFrames():
            return _files_of(frames.source)
        case ImageFolderFrames() | UnifiedPictures():
            return frames.paths
        case VideoFrames() | BagFrames():
            return (frames.path,)
        case _:
            return ()
