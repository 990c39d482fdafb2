"""Places that share a storage."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from rholoc.jobs import Stores

sys.path.insert(0, str(Path(__file__).parents[1] / "jobs"))  # of the tiny map and the sites of jobs

from job_site import Site

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


@pytest.fixture
def campus(tmp_path: Path, postgres_url: str, storage_url: str) -> Iterator[Site]:
    """A site whose workers share no folder."""
    site = Site(tmp_path, postgres_url, storage_url)
    yield site
    site.close()
