"""Servers that start on a full disk, or while their database is silent: they localize, and say what they cannot do."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import pytest

from rholoc.cli.server_process import running_server
from rholoc.storage.database import open_database
from waiting import until

if TYPE_CHECKING:
    from postgres_server import PostgresServer

pytestmark = pytest.mark.slow
_MAPS = Path(__file__).parents[3] / "maps"
_BLOCK = bytes(4096)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 4 MB."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=4M", "tmpfs", str(disk)]
    if subprocess.run(mount, check=False, capture_output=True).returncode:
        pytest.skip("a disk cannot be mounted here")
    yield disk
    subprocess.run(["umount", "-l", str(disk)], check=True)


def readiness(url: str) -> dict[str, Any]:
    return httpx.get(f"{url}/readyz", timeout=30).json()["checks"]


def localizes(url: str) -> bool:
    picture = (_MAPS / "queries" / "1.jpg").read_bytes()
    headers = {"Content-Type": "image/jpeg"}
    answer = httpx.post(
        f"{url}/v1/maps/testsite/localize?deadline_ms=60000", content=picture, headers=headers, timeout=90
    )
    return bool(answer.json()["localized"])


def fill(file: Path) -> None:
    with file.open("wb", buffering=0) as written:
        while True:
            written.write(_BLOCK)


def test_a_server_is_restarted_on_a_full_disk(small_disk: Path, tmp_path: Path) -> None:
    data, log = small_disk / "data", tmp_path / "log"
    with running_server(_MAPS, data, log) as server:
        assert httpx.get(f"{server.url}/v1/jobs", timeout=30).is_success
    open_database(data).dispose()  # the last connection that closes removes the files beside the database
    assert not list(data.glob("jobs.sqlite-*"))
    filler = small_disk / "filler"
    with pytest.raises(OSError, match="No space"):
        fill(filler)
    with running_server(_MAPS, data, log) as server:
        assert localizes(server.url)
        until(lambda: readiness(server.url)["data"] == "the disk is full")
        until(lambda: readiness(server.url)["jobs"] != "ok")
        until(lambda: httpx.get(f"{server.url}/v1/jobs", timeout=30).status_code in (503, 507))
        filler.unlink()
        until(lambda: readiness(server.url)["jobs"] == "ok")
        assert httpx.get(f"{server.url}/v1/jobs", timeout=30).is_success


def test_a_server_starts_while_its_database_is_silent(
    postgres: PostgresServer, postgres_url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RHOLOC_DATABASE_URL", postgres_url)
    monkeypatch.setenv("RHOLOC_WORKER", "false")
    with postgres.silent(), running_server(_MAPS, tmp_path / "data", tmp_path / "log") as server:
        assert localizes(server.url)
        assert httpx.get(f"{server.url}/v1/jobs", timeout=30).json()["code"] == "storage_unavailable"
    with running_server(_MAPS, tmp_path / "data", tmp_path / "log") as server:
        assert httpx.get(f"{server.url}/v1/jobs", timeout=30).is_success
