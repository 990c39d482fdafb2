"""Objects in a storage: whole or not there."""

from __future__ import annotations

from pathlib import Path

import pytest

from rholoc.errors import InvalidInput, StorageUnavailable
from rholoc.storage import MissingObject, ObjectStorage


@pytest.fixture
def objects(tmp_path: Path) -> ObjectStorage:
    return ObjectStorage(f"file://{tmp_path}/storage")


@pytest.mark.parametrize("content", [b"", b"a map", bytes(20_000_000)])
def test_what_is_put_is_fetched(objects: ObjectStorage, tmp_path: Path, content: bytes) -> None:
    (tmp_path / "given").write_bytes(content)
    for key, given in (("maps/bytes", content), ("maps/file", tmp_path / "given")):
        objects.put(key, given)
        assert objects.fetch(key, tmp_path / "got") == len(content)
        assert (tmp_path / "got").read_bytes() == content


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
