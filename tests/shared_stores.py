"""Stores that several processes share."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from rholoc.library.stores import Stores

OpenStorage = Callable[..., Stores]


@pytest.fixture
def storage_url(tmp_path: Path) -> str:
    """The URL of a folder that serves as storage."""
    return f"file://{tmp_path}/storage"


@pytest.fixture
def open_storage(tmp_path: Path, storage_url: str) -> Iterator[OpenStorage]:
    """Opens the storage as one more process sees it, by default on one SQLite file; closes it at the end."""
    opened = []

    def open_one(database_url: str | None = None, follow: bool = False, **options: object) -> Stores:
        shared = Stores(tmp_path / "maps", tmp_path / "data", database_url, storage_url, **options)
        shared.copies.folder = tmp_path / f"copies-{len(opened)}"  # each process may be on another machine
        shared.open(follow)
        opened.append(shared)
        return shared

    yield open_one
    for shared in opened:
        shared.close()
