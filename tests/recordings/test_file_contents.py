"""What a file's first bytes say of it."""

from __future__ import annotations

import pytest

from rholoc.errors import InvalidRecording
from rholoc.recordings import START_BYTES, check_file_name, check_file_start

MPEG4 = b"\0\0\0\x20ftypisom"
EBML = b"\x1aE\xdf\xa3" + b"\x01" * 8
AVI = b"RIFF\x10\0\0\0AVI "
ZIP = b"PK\x03\x04\x14\0\0\0\0\0\0\0"
JPEG = b"\xff\xd8\xff\xe0\0\x10JFIF\0\1"
PNG = b"\x89PNG\r\n\x1a\n\0\0\0\r"


@pytest.mark.parametrize(
    ("name", "start"),
    [
        ("walk.mp4", MPEG4),
        ("walk.MOV", b"\0\0\0\x08wide\0\0\0\0"),
        ("walk.mov", b"\0\0\x10\0moov\0\0\0\0"),
        ("walk.webm", EBML),
        ("walk.mkv", EBML),
        ("walk.avi", AVI),
        ("walk.zip", ZIP),
        ("frames/0001.jpg", JPEG),
        ("frames/0001.png", PNG),
        ("imu.csv", b"timestamp,ax"),
        ("notes.txt", b""),
    ],
)
def test_files_are_what_they_are_called(name, start):
    assert len(start) in (0, START_BYTES)
    check_file_start(name, start)


@pytest.mark.parametrize(
    ("name", "start"),
    [
        ("walk.mp4", b""),
        ("walk.mp4", b"<html><body>"),
        ("walk.mp4", PNG),
        ("walk.avi", b"RIFF\x10\0\0\0WAVE"),
        ("walk.zip", b"PK\x05\x06" + b"\0" * 8),
        ("frames/0001.png", JPEG),
    ],
)
def test_files_that_are_not_what_they_are_called(name, start):
    with pytest.raises(InvalidRecording, match=name.rsplit("/", 1)[-1]):
        check_file_start(name, start)


def test_a_lone_file_is_a_video_or_a_zip_file():
    for name in ("walk.mp4", "WALK.MOV", "walk.zip"):
        check_file_name(name)
    for name in ("walk", "imu.csv", "walk.mp4.exe", "frame.jpg"):
        with pytest.raises(InvalidRecording):
            check_file_name(name)
