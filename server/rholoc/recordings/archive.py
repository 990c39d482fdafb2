"""Unpack untrusted ZIP files of recordings."""

import os
import shutil
import stat
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

from rholoc.disk import is_full, is_system_file
from rholoc.errors import InvalidRecording, StorageFull, TooLarge
from rholoc.recordings.file_contents import START_BYTES, check_file_start
from rholoc.recordings.frames.video import VIDEO_SUFFIXES

DEFAULT_MAX_BYTES = 8 * 2**30  # unpacked
MAX_FILES = 100_000
_ENTRY_BYTES = 512  # of a directory entry with a long path
_END, _END64, _ENTRY = b"PK\x05\x06", b"PK\x06\x06", b"PK\x01\x02"
_END_BYTES, _MAX_COMMENT_BYTES, _END64_BYTES = 22, 65535, 76
MAX_RATIO = 200.0  # unpacked to packed; tables of numbers reach 20, zip bombs 1000
_PACK_AGAIN = "Pack the recording's own files, and nothing else."
_RATIO_FREE_BYTES = 2**20  # below this size the ratio does not matter


def unpack(archive: Path, folder: Path, max_bytes: int = DEFAULT_MAX_BYTES, max_files: int = MAX_FILES) -> None:
    """Unpack a ZIP file into ``folder``.

    Raises:
        InvalidRecording: not a ZIP file, damaged, encrypted, or with an entry that is a link, leads out of the folder,
            or has content of another type than its name.
        TooLarge: it would unpack to more than ``max_bytes`` or ``max_files``, or an entry over 1 MiB is compressed more
            than 200-fold.
        StorageFull: the disk is full.

    Files that were unpacked before an error stay in ``folder``: the caller must remove it.
    """
    with _opened(archive, max_files) as packed:
        for entry in _checked_entries(packed, archive, max_bytes):
            _unpack_entry(packed, entry, folder)


def check_archive(archive: Path, max_files: int = MAX_FILES) -> None:
    """Check a ZIP file's directory and the first bytes of its videos as :func:`unpack` would, without unpacking.

    Raises:
        InvalidRecording: not a ZIP file, damaged, encrypted, or with an entry that :func:`unpack` refuses.
        TooLarge: over ``DEFAULT_MAX_BYTES`` or ``max_files``, or an entry over 1 MiB is compressed more than 200-fold.
    """
    with _opened(archive, max_files) as packed:
        for entry in _checked_entries(packed, archive, DEFAULT_MAX_BYTES):
            if PurePosixPath(entry.filename).suffix.lower() in VIDEO_SUFFIXES and not entry.is_dir():
                with packed.open(entry) as source:
                    check_file_start(entry.filename, source.read(START_BYTES))


@contextmanager
def _opened(archive: Path, max_files: int) -> Iterator[zipfile.ZipFile]:
    """Open a ZIP file for the block; errors of reading it become InvalidRecording, a full disk StorageFull."""
    try:
        _check_directory(archive, max_files)
        with zipfile.ZipFile(archive) as packed:
            yield packed
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, UnicodeError) as error:
        raise InvalidRecording(
            f"{archive.name} is not a complete ZIP file: {error}.", "Pack it or send it again."
        ) from error
    except OSError as error:
        if is_full(error):
            raise StorageFull(f"No space left to unpack {archive.name}.", "Free some space and try again.") from error
        raise InvalidRecording(f"{archive.name} cannot be unpacked: {error.strerror}.") from error


def _check_directory(archive: Path, max_files: int) -> None:
    """Check the number of entries before the directory is parsed, since a parsed entry takes far more memory.

    Raises:
        TooLarge: there are more than ``max_files``.
    """
    with archive.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - _END_BYTES - _MAX_COMMENT_BYTES - _END64_BYTES))
        tail = file.read()
        end = len(tail) - _END_BYTES if tail[-_END_BYTES:].startswith(_END) else tail.rfind(_END)
        if end < 0:
            return  # not a ZIP file, which is reported later
        length = int.from_bytes(tail[end + 12 : end + 16], "little")
        end64 = tail.rfind(_END64, 0, end)
        if end64 >= 0:
            length = max(length % 2**32, int.from_bytes(tail[end64 + 40 : end64 + 48], "little"))
        too_many = length > _ENTRY_BYTES * max_files and length < size
        if not too_many:
            start = max(0, size - len(tail) + end - length - _END64_BYTES)
            file.seek(start)
            too_many = file.read(min(length, size) + _END64_BYTES).count(_ENTRY) > max_files
    if too_many:
        raise TooLarge(f"{archive.name} holds more than {max_files} files and folders.", _PACK_AGAIN)


def _checked_entries(packed: zipfile.ZipFile, archive: Path, max_bytes: int) -> list[zipfile.ZipInfo]:
    """Entries of a zip file that are neither its own folder (``./``) nor added by an operating system; raises as
    :func:`_check` does.
    """
    entries = [entry for entry in packed.infolist() if _path(entry).parts and not is_system_file(_path(entry))]
    _check(entries, archive, max_bytes)
    return entries


def _path(entry: zipfile.ZipInfo) -> PurePosixPath:
    """An entry's path inside the archive; also with Windows' separators."""
    return PurePosixPath(entry.filename.replace("\\", "/"))


def _check(entries: list[zipfile.ZipInfo], archive: Path, max_bytes: int) -> None:
    """Raise InvalidRecording for unsafe paths, links and devices; TooLarge above ``max_bytes``, ``MAX_FILES`` entries,
    or 200-fold compression of an entry over 1 MiB.
    """
    for entry in entries:
        path = _path(entry)
        if path.is_absolute() or ".." in path.parts or ":" in path.parts[0]:
            raise InvalidRecording(f"{archive.name} holds a file outside its folder: '{entry.filename}'.", _PACK_AGAIN)
        kind = stat.S_IFMT(entry.external_attr >> 16)
        if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
            raise InvalidRecording(
                f"{archive.name} holds '{entry.filename}', which is a link or device, not a file.", _PACK_AGAIN
            )
        if entry.file_size > _RATIO_FREE_BYTES and entry.file_size > MAX_RATIO * entry.compress_size:
            raise TooLarge(
                f"{archive.name}: '{entry.filename}' has a suspiciously high compression ratio.",
                "Pack it uncompressed.",
            )
    total = sum(entry.file_size for entry in entries)
    if total > max_bytes or len(entries) > MAX_FILES:
        raise TooLarge(
            f"{archive.name} would unpack to {total / 2**20:.0f} MiB in {len(entries)} files.",
            f"{max_bytes / 2**20:.0f} MiB in {MAX_FILES} files are allowed.",
        )


def _unpack_entry(packed: zipfile.ZipFile, entry: zipfile.ZipInfo, folder: Path) -> None:
    """Write an entry below ``folder``. Raises InvalidRecording if its content is of another type than its name."""
    target = folder / _path(entry)
    if entry.is_dir():
        target.mkdir(parents=True, exist_ok=True)
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    # zipfile stops at the declared size, which therefore bounds the bytes written.
    with packed.open(entry) as source:
        start = source.read(START_BYTES)
        check_file_start(entry.filename, start)
        with target.open("wb") as sink:
            sink.write(start)
            shutil.copyfileobj(source, sink, 2**20)
