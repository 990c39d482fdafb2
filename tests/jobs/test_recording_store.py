"""Recordings on disk: complete or not there."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rholoc.errors import Conflict, InvalidRecording, StorageFull, TooLarge, UnknownRecording
from rholoc.jobs import RecordingStore
from rholoc.jobs.recording_store import sanitized


@pytest.fixture
def store(tmp_path: Path) -> RecordingStore:
    return RecordingStore(tmp_path)


def _nothing_left(store: RecordingStore, tmp_path: Path) -> bool:
    return store.list() == [] and list((tmp_path / "recordings").iterdir()) == []


def test_what_was_stored_is_found_again(store: RecordingStore, tmp_path: Path) -> None:
    files = [("video.mp4", [b"abc", b"def"]), ("imu.csv", [b"timestamp"]), ("frames/0001.jpg", [b"x"])]
    entry = store.create(files, max_bytes=100)
    assert entry.files == ("frames/0001.jpg", "imu.csv", "video.mp4")
    assert entry.size_bytes == 16
    assert store.get(entry.id) == entry
    assert RecordingStore(tmp_path).list() == [entry]
    folder = store.path(entry.id)
    assert (folder / "video.mp4").read_bytes() == b"abcdef"
    assert (folder / "frames" / "0001.jpg").read_bytes() == b"x"


def test_a_single_file_is_the_recording(store: RecordingStore) -> None:
    entry = store.create([("my walk.zip", [b"PK"])])
    assert store.path(entry.id).name == "my_walk.zip"
    assert store.path(entry.id).read_bytes() == b"PK"


def test_the_newest_comes_first(store: RecordingStore) -> None:
    first = store.create([("a.mp4", [b"a"])])
    time.sleep(0.01)
    second = store.create([("b.mp4", [b"b"])])
    assert [entry.id for entry in store.list()] == [second.id, first.id]


def test_chunks_of_several_files_may_be_mixed(store: RecordingStore) -> None:
    with store.begin() as pending:
        for name, chunk in [("a", b"1"), ("b", b"2"), ("a", b"3")]:
            pending.write(name, chunk)
        entry = pending.commit()
    assert (store.path(entry.id) / "a").read_bytes() == b"13"


def test_an_upload_that_breaks_off_leaves_nothing(store: RecordingStore, tmp_path: Path) -> None:
    def chunks() -> Iterator[bytes]:
        yield b"half of it"
        raise ConnectionResetError

    with pytest.raises(ConnectionResetError):
        store.create([("video.mp4", chunks())])
    assert _nothing_left(store, tmp_path)


def test_an_upload_is_not_seen_before_it_is_complete(store: RecordingStore) -> None:
    pending = store.begin()
    pending.write("video.mp4", b"abc")
    assert store.list() == []
    with pytest.raises(UnknownRecording):
        store.get(pending.id)
    pending.abort()
    with pytest.raises(Conflict):
        pending.commit()


def test_an_upload_that_is_too_large_leaves_nothing(store: RecordingStore, tmp_path: Path) -> None:
    with pytest.raises(TooLarge):
        store.create([("video.mp4", [b"12345", b"67890", b"!"])], max_bytes=10)
    assert _nothing_left(store, tmp_path)


def test_an_empty_upload_is_refused(store: RecordingStore, tmp_path: Path) -> None:
    with pytest.raises(InvalidRecording):
        store.create([])
    assert _nothing_left(store, tmp_path)


def test_two_files_of_one_name_are_refused(store: RecordingStore, tmp_path: Path) -> None:
    with pytest.raises(InvalidRecording):
        store.create([("a b.csv", [b"1"]), ("a?b.csv", [b"2"])])
    with pytest.raises(InvalidRecording):
        store.create([("a", [b"1"]), ("a/b", [b"2"])])
    assert _nothing_left(store, tmp_path)


class _FullDisk:
    """A file on a disk that takes no more."""

    def __init__(self, file: IO[Any], *, until_flush: bool) -> None:
        self._file = file
        self._until_flush = until_flush

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)

    def write(self, data: bytes) -> int:
        if not self._until_flush:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return self._file.write(data)

    def flush(self) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize("until_flush", [False, True])
def test_a_full_disk_is_reported_and_leaves_nothing(
    store: RecordingStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, until_flush: bool
) -> None:
    kept = store.create([("kept.mp4", [b"kept"])])
    really_open = Path.open

    def full(path: Path, mode: str = "r", *args: Any, **kwargs: Any) -> Any:
        file = really_open(path, mode, *args, **kwargs)
        return _FullDisk(file, until_flush=until_flush) if "r" not in mode else file

    monkeypatch.setattr(Path, "open", full)
    with pytest.raises(StorageFull):
        store.create([("video.mp4", [b"abc"])])
    assert store.list() == [kept]
    assert [path.name for path in (tmp_path / "recordings").iterdir()] == [kept.id]


def test_a_deleted_recording_is_gone(store: RecordingStore, tmp_path: Path) -> None:
    entry = store.create([("video.mp4", [b"abc"])])
    store.delete(entry.id)
    assert _nothing_left(store, tmp_path)
    for ask in (store.get, store.path, store.delete):
        with pytest.raises(UnknownRecording):
            ask(entry.id)


@pytest.mark.parametrize("name", ["", "..", "../../etc", "f" * 300, "0" * 32, ".pending-x", "a/b", "\0"])
def test_an_id_that_is_none_is_unknown(store: RecordingStore, name: str) -> None:
    for ask in (store.get, store.path, store.delete):
        with pytest.raises(UnknownRecording):
            ask(name)


def test_uploads_of_dead_processes_are_cleared_after_a_day(store: RecordingStore, tmp_path: Path) -> None:
    folders = []
    for age_s in (60.0, 2 * 24 * 3600.0):
        pending = store.begin()
        pending.write("video.mp4", b"abc")
        folder = tmp_path / "recordings" / f".pending-{pending.id}"
        os.utime(folder, (time.time() - age_s,) * 2)
        folders.append(folder)
    RecordingStore(tmp_path)
    assert [folder.exists() for folder in folders] == [True, False]


@given(st.text(max_size=200))
def test_a_sanitized_name_stays_inside_and_is_visible(name: str) -> None:
    try:
        parts = sanitized(name).split("/")
    except InvalidRecording:
        return
    assert all(part and not part.startswith(".") and len(part) <= 100 for part in parts)
    assert all(character.isascii() and (character.isalnum() or character in "._-") for character in "".join(parts))
    assert sanitized("/".join(parts)) == "/".join(parts)


@pytest.mark.parametrize(
    ("given_name", "kept"),
    [
        ("../../etc/passwd", "etc/passwd"),
        ("/abs/video.mp4", "abs/video.mp4"),
        ("C:\\walks\\küche 1.mp4", "C_/walks/k_che_1.mp4"),
        (".hidden", "hidden"),
    ],
)
def test_names_are_sanitized(given_name: str, kept: str) -> None:
    assert sanitized(given_name) == kept
