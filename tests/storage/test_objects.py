"""Objects in a storage: whole or not there."""

import errno
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from rholoc.errors import InvalidInput, MissingObject, StorageUnavailable
from rholoc.storage import ObjectStorage


@pytest.fixture(params=["file", "folder", "memory"])
def objects(request: pytest.FixtureRequest, tmp_path: Path) -> ObjectStorage:
    places = {"file": f"file://{tmp_path}/storage", "folder": tmp_path / "storage", "memory": "memory:///"}
    return ObjectStorage(places[request.param])


@pytest.mark.parametrize("content", [b"", b"a map", bytes(20_000_000)])
def test_what_is_put_is_fetched(objects: ObjectStorage, tmp_path: Path, content: bytes) -> None:
    (tmp_path / "given").write_bytes(content)
    for key, given in (("maps/bytes", content), ("maps/file", tmp_path / "given")):
        objects.put(key, given)
        assert objects.fetch(key, tmp_path / "got") == len(content)
        assert (tmp_path / "got").read_bytes() == content


@pytest.mark.parametrize("elsewhere", [False, True])
def test_a_folder_is_put_whole(
    objects: ObjectStorage, tmp_path: Path, elsewhere: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where the storage is in another file system, and where an earlier attempt broke off."""
    if elsewhere:
        monkeypatch.setattr(Path, "rename", lambda *_: (_ for _ in ()).throw(OSError(errno.EXDEV, "cross-device")))
    for attempt in range(2):
        folder = tmp_path / "given"
        (folder / "frames").mkdir(parents=True)
        (folder / "a").write_bytes(b"1")
        (folder / "frames" / "b").write_bytes(b"23")
        objects.put_folder("recordings/0", folder, ["a", "frames/b"])
        assert not folder.exists()
        assert sorted((one.key, one.size_bytes) for one in objects.list("recordings")) == [
            ("recordings/0/a", 1),
            ("recordings/0/frames/b", 2),
        ], attempt


def test_a_folder_storage_keeps_no_empty_folders_and_is_written_and_emptied_at_once(tmp_path: Path) -> None:
    objects = ObjectStorage(tmp_path / "storage")

    def put_and_delete(number: int) -> None:
        objects.put(f"uploads/1/{number}", b"12")
        objects.delete(f"uploads/1/{number}")

    with ThreadPoolExecutor(8) as threads:
        list(threads.map(put_and_delete, range(400)))
    assert not (tmp_path / "storage" / "uploads" / "1").exists()


def test_what_is_not_there_leaves_no_file(objects: ObjectStorage, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(MissingObject):
        objects.fetch("maps/none", tmp_path / "empty" / "got")
    assert list((tmp_path / "empty").iterdir()) == []


def test_objects_are_listed_by_folder_and_deleted(objects: ObjectStorage) -> None:
    for key in ("maps/a", "maps/b", "uploads/1/c"):
        objects.put(key, b"12")
    assert [(one.key, one.size_bytes) for one in sorted(objects.list("maps"), key=lambda one: one.key)] == [
        ("maps/a", 2),
        ("maps/b", 2),
    ]
    objects.delete("maps/a")
    objects.delete("maps/a")
    assert [one.key for one in objects.list("maps")] == ["maps/b"]
    assert list(objects.list("recordings")) == []


def test_a_storage_that_cannot_be_written_says_so(tmp_path: Path) -> None:
    objects = ObjectStorage(f"file://{tmp_path}/storage")
    (tmp_path / "storage" / "maps").write_text("a file stands where the folder would")
    with pytest.raises(StorageUnavailable):
        objects.put("maps/a", b"12")


@pytest.mark.parametrize(
    "url", ["", "s3", "/folder", "ftp://secret@host/x", "file://host/x", "file:///", "s3://", "://"]
)
def test_what_is_no_storage_is_refused_without_its_secrets(url: str) -> None:
    with pytest.raises(InvalidInput, match="RHOLOC_STORAGE_URL") as caught:
        ObjectStorage(url)
    assert "secret" not in str(caught.value)
