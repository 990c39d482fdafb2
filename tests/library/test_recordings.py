"""Recordings on disk: complete or not there."""

import errno
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rholoc.errors import Conflict, InvalidRecording, StorageFull, StorageUnavailable, TooLarge, UnknownRecording
from rholoc.library.recording_notes import WAYPOINTS_FILE
from rholoc.library.recordings import RecordingStore, sanitized
from rholoc.storage import ObjectStorage
from rholoc.storage.database import open_database


@pytest.fixture(params=["in place", "file", "memory"])
def objects(request: pytest.FixtureRequest, tmp_path: Path) -> ObjectStorage:
    """A server's own folder, a folder that servers share, and a storage that is none."""
    places = {"in place": tmp_path / "a", "file": f"file://{tmp_path}/storage", "memory": "memory:///"}
    return ObjectStorage(places[request.param])


@pytest.fixture
def stores(objects: ObjectStorage, tmp_path: Path) -> Iterator[list[RecordingStore]]:
    """The stores of two processes, on two machines if they share a storage."""
    engine = open_database(tmp_path / "database")
    in_place = objects.is_at(tmp_path / "a")
    yield [RecordingStore(tmp_path / machine, objects, engine) for machine in ("a", "a" if in_place else "b")]
    engine.dispose()


@pytest.fixture
def store(stores: list[RecordingStore]) -> RecordingStore:
    return stores[0]


def _nothing_left(store: RecordingStore) -> bool:
    stored = [one.key for one in store.objects.list("recordings")]
    return store.list() == stored == list(store.root.iterdir()) == []


def test_what_was_stored_is_found_again(stores: list[RecordingStore]) -> None:
    store, there = stores
    files = [("video.mp4", [b"abc", b"def"]), ("imu.csv", [b"timestamp"]), ("frames/0001.jpg", [b"x"])]
    entry = store.create(files, max_bytes=100)
    assert entry.files == ("frames/0001.jpg", "imu.csv", "video.mp4")
    assert entry.size_bytes == 16
    assert store.get(entry.id) == entry
    assert there.list() == [entry]
    for _ in range(2):
        folder = there.path(entry.id)
        assert (folder / "video.mp4").read_bytes() == b"abcdef"
        assert (folder / "frames" / "0001.jpg").read_bytes() == b"x"
        there.release(entry.id)
        assert folder.exists() == there.in_place, "only copies are removed, and fetched again"


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


def test_an_upload_that_breaks_off_leaves_nothing(store: RecordingStore) -> None:
    def chunks() -> Iterator[bytes]:
        yield b"half of it"
        raise ConnectionResetError

    with pytest.raises(ConnectionResetError):
        store.create([("video.mp4", chunks())])
    assert _nothing_left(store)


def test_an_upload_is_not_seen_before_it_is_complete(store: RecordingStore) -> None:
    pending = store.begin()
    pending.write("video.mp4", b"abc")
    assert store.list() == []
    with pytest.raises(UnknownRecording):
        store.get(pending.id)
    pending.abort()
    with pytest.raises(Conflict):
        pending.commit()


def test_an_upload_that_is_too_large_leaves_nothing(store: RecordingStore) -> None:
    with pytest.raises(TooLarge):
        store.create([("video.mp4", [b"12345", b"67890", b"!"])], max_bytes=10)
    assert _nothing_left(store)


def test_an_empty_upload_is_refused(store: RecordingStore) -> None:
    with pytest.raises(InvalidRecording):
        store.create([])
    assert _nothing_left(store)


def test_two_files_of_one_name_are_refused(store: RecordingStore) -> None:
    with pytest.raises(InvalidRecording):
        store.create([("a b.csv", [b"1"]), ("a?b.csv", [b"2"])])
    with pytest.raises(InvalidRecording):
        store.create([("a", [b"1"]), ("a/b", [b"2"])])
    assert _nothing_left(store)


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
    store: RecordingStore, monkeypatch: pytest.MonkeyPatch, until_flush: bool
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
    assert {one.key.split("/")[1] for one in store.objects.list("recordings")} == {kept.id}
    assert not list(store.root.glob(".*"))


def test_a_deleted_recording_is_gone(stores: list[RecordingStore]) -> None:
    store, there = stores
    entry = store.create([("video.mp4", [b"abc"])])
    store.note(entry.id, {WAYPOINTS_FILE: b"name,x,y,z"})
    there.delete(entry.id)
    assert _nothing_left(store)
    for ask in (store.get, store.path, store.delete):
        with pytest.raises(UnknownRecording):
            ask(entry.id)


@pytest.mark.parametrize("name", ["", "..", "../../etc", "f" * 300, "0" * 32, ".pending-x", "a/b", "\0"])
def test_an_id_that_is_none_is_unknown(store: RecordingStore, name: str) -> None:
    for ask in (store.get, store.path, store.delete):
        with pytest.raises(UnknownRecording):
            ask(name)


def test_uploads_of_dead_processes_are_cleared_after_a_day(store: RecordingStore) -> None:
    folders = []
    for age_s in (60.0, 2 * 24 * 3600.0):
        pending = store.begin()
        pending.write("video.mp4", b"abc")
        folder = store.root / f".pending-{pending.id}"
        os.utime(folder, (time.time() - age_s,) * 2)
        folders.append(folder)
    RecordingStore(store.root.parent, store.objects, store.engine)
    assert [folder.exists() for folder in folders] == [True, False]


def test_notes_are_shared_without_the_files(stores: list[RecordingStore]) -> None:
    here, there = stores
    entry = here.create([("walk.mp4", [b"12345"])])
    assert there.notes(entry.id) == {}
    here.note(entry.id, {WAYPOINTS_FILE: b"name,x,y,z", ".notes.json": b"{}"})
    there.note(entry.id, {".notes.json": b"[]"})
    assert here.notes(entry.id) == {WAYPOINTS_FILE: b"name,x,y,z", ".notes.json": b"[]"}
    there.note(entry.id, {WAYPOINTS_FILE: None})
    assert here.notes(entry.id) == {".notes.json": b"[]"}
    with pytest.raises(UnknownRecording):
        here.notes("0" * 32)


def test_a_recording_that_the_storage_cut_short_is_not_mapped(stores: list[RecordingStore]) -> None:
    here, there = stores
    if there.in_place:
        pytest.skip("nothing is fetched, and files that are kept here may have been mended by hand")
    entry = here.create([("walk.mp4", [b"12345"])])
    key = f"recordings/{entry.id}/walk.mp4"
    here.objects.put(key, b"12")
    with pytest.raises(StorageUnavailable):
        there.path(entry.id)
    here.objects.put(key, b"12345")
    assert there.path(entry.id).read_bytes() == b"12345"


def test_what_a_broken_off_upload_left_is_swept_up(stores: list[RecordingStore], monkeypatch: Any) -> None:
    here, there = stores
    entry = here.create([("walk.mp4", [b"12345"])])
    here.objects.put(f"recordings/{'0' * 32}/walk.mp4", b"123")
    there.sweep()
    assert len(list(here.objects.list("recordings"))) == 3
    monkeypatch.setattr("rholoc.library.recordings._ORPHANED_AFTER_S", -10)
    there.sweep()
    assert {one.key.split("/")[1] for one in here.objects.list("recordings")} == {entry.id}


def test_recordings_outlive_their_database(stores: list[RecordingStore], tmp_path: Path) -> None:
    entry = stores[0].create([("walk.mp4", [b"12345"]), ("frames/1.csv", [b"6"])])
    deleted = stores[0].create([("walk.mp4", [b"1"])])
    stores[0].delete(deleted.id)
    other = RecordingStore(stores[1].root.parent, stores[1].objects, open_database(tmp_path / "new"))
    other.sweep()
    assert other.list() == [entry]
    assert (other.path(entry.id) / "frames" / "1.csv").read_bytes() == b"6"
    other.engine.dispose()


def test_a_crash_before_a_recording_has_its_entry_loses_nothing(stores: list[RecordingStore], tmp_path: Path) -> None:
    here, there = stores
    entry = here.create([("walk.mp4", [b"12345"])])
    here.objects.delete(f"recordings/{entry.id}/.entry.json")
    there.sweep()
    assert here.objects.read(f"recordings/{entry.id}/.entry.json", 0, 1000)
    assert here.list() == [entry]


def test_originals_of_a_time_before_the_storage_are_no_copies(tmp_path: Path) -> None:
    alone = RecordingStore(tmp_path)
    entry = alone.create([("walk.mp4", [b"12345"])])
    shared = RecordingStore(tmp_path, ObjectStorage("memory:///"), alone.engine)
    shared.release(entry.id)
    assert alone.path(entry.id).read_bytes() == b"12345"
    alone.engine.dispose()


def test_a_full_database_leaves_nothing(store: RecordingStore, monkeypatch: pytest.MonkeyPatch) -> None:
    @contextmanager
    def full() -> Iterator[None]:
        raise StorageFull("The disk is full.")
        yield

    monkeypatch.setattr("rholoc.library.recordings.reporting_full_database", full)
    with pytest.raises(StorageFull):
        store.create([("video.mp4", [b"abc"])])
    assert _nothing_left(store)


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
