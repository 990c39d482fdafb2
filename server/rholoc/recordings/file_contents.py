"""Checks an uploaded file's name and first bytes before anything is decoded."""

from pathlib import PurePath

from rholoc.errors import InvalidRecording
from rholoc.recordings.frames.bag import BAG_SUFFIXES
from rholoc.recordings.frames.video import VIDEO_SUFFIXES

START_BYTES = 12
ZIP_SUFFIXES = (".zip", ".r3d")  # Record3D packs its folder under a suffix of its own

# The first box of a QuickTime or MPEG-4 file, at byte 4; browsers and phones write "ftyp".
_MPEG4_BOXES = frozenset({b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip", b"pnot", b"styp", b"moof"})
_STARTS = {
    ".bag": (b"#ROSBAG V2.0",),
    ".mcap": (b"\x89MCAP",),
    ".db3": (b"SQLite forma",),
    **dict.fromkeys(ZIP_SUFFIXES, (b"PK\x03\x04",)),
    ".jpg": (b"\xff\xd8\xff",),
    ".jpeg": (b"\xff\xd8\xff",),
    ".png": (b"\x89PNG",),
}


def check_file_name(name: str) -> None:
    """Check the name of a recording in a single file.

    Raises:
        InvalidRecording: by its suffix, it is neither a video, a bag nor a ZIP file.
    """
    if PurePath(name).suffix.lower() not in VIDEO_SUFFIXES | BAG_SUFFIXES | {*ZIP_SUFFIXES}:
        videos, bags = (", ".join(sorted(suffixes)) for suffixes in (VIDEO_SUFFIXES, BAG_SUFFIXES))
        raise InvalidRecording(f"{name} is not a recording.", f"Send a video ({videos}), a bag ({bags}) or a ZIP file.")


def check_file_start(name: str, start: bytes) -> None:
    """Check that a video, bag, picture or ZIP file begins as its name suggests; other names pass.

    Args:
        name: the file's name.
        start: its first ``START_BYTES``, or all of it if it is shorter.

    Raises:
        InvalidRecording: the file is of another type, or empty.
    """
    suffix = PurePath(name).suffix.lower()
    if suffix in VIDEO_SUFFIXES:
        right = start[4:8] in _MPEG4_BOXES or start[:4] == b"\x1aE\xdf\xa3" or start[:4] + start[8:12] == b"RIFFAVI "
    else:
        right = start.startswith(_STARTS.get(suffix, (b"",)))
    if not right:
        what = f"not a {suffix.removeprefix('.').upper()} file inside" if start else "empty"
        raise InvalidRecording(f"{name} is {what}.", "Send the file that the recorder wrote, whole.")
