"""What ``rholoc doctor`` finds, and that it says what to do."""

import json
import os
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

from rholoc.library.maps import MapLibrary
from rholoc.library.sites import SiteLibrary
from rholoc.maps import Site, SiteMap
from rholoc.service import Settings
from rholoc.service.operate import doctor as module
from rholoc.service.operate.doctor import Finding, Level, examine
from rholoc.service.settings import KeyPolicy


@pytest.fixture
def healthy(tmp_path: Path, picture_world) -> dict[str, Any]:
    """The settings of a server with a map."""
    MapLibrary(tmp_path / "maps").put("hall", picture_world.map_)
    (tmp_path / "data").mkdir()
    return {"maps_dir": tmp_path / "maps", "data_dir": tmp_path / "data"}


def found(settings: dict[str, Any], check: str, **changed: Any) -> list[Finding]:
    return [finding for finding in examine(Settings(**{**settings, **changed})) if finding.check == check]


def the_bad_one(findings: list[Finding]) -> Finding:
    (bad,) = [finding for finding in findings if finding.level is not Level.OK]
    assert bad.hint
    return bad


def test_a_healthy_server_has_nothing_to_mend(healthy) -> None:
    findings = examine(Settings(**healthy))
    assert {finding.check for finding in findings} == set(module._CHECKS)
    assert [finding for finding in findings if finding.level is Level.ERROR] == []
    assert found(healthy, "videos") == [Finding("videos", Level.OK, "H.264, HEVC, VP8, VP9 are decoded.")]
    assert list((healthy["data_dir"]).glob(".*.doctor")) == []


def test_before_the_first_start_nothing_is_wrong(tmp_path: Path, command: Callable[..., tuple[int, str, str]]) -> None:
    findings = examine(Settings(maps_dir=tmp_path / "maps", data_dir=tmp_path / "data" / "of-it"))
    assert [finding for finding in findings if finding.level is Level.ERROR] == []
    status, printed, _ = command("doctor", "--maps", tmp_path / "maps", "--data", tmp_path / "data")
    assert status == 0
    assert "the first start creates it" in printed
    assert list(tmp_path.iterdir()) == []


def test_a_missing_folder_that_cannot_be_created_is_found(healthy, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    assert the_bad_one(found(healthy, "storage", maps_dir=tmp_path / "file" / "maps")).level is Level.ERROR


@pytest.mark.parametrize(("free", "level"), [(2**20, Level.ERROR), (2**30, Level.WARNING)])
def test_a_disk_that_fills_is_found(healthy, monkeypatch, free: int, level: Level) -> None:
    usage = os.terminal_size((0, 0))  # any object will do for what is not asked

    class Usage:
        total, used = usage

    Usage.free = free  # type: ignore[attr-defined]
    monkeypatch.setattr(module.shutil, "disk_usage", lambda folder: Usage)
    assert {finding.level for finding in found(healthy, "storage")} == {level}


def test_broken_maps_and_sites_are_found(healthy) -> None:
    (healthy["maps_dir"] / "broken.rho").write_bytes(b"no map")
    SiteLibrary(healthy["maps_dir"]).put("campus", Site(maps=(SiteMap("gone"),)))
    levels = {finding.message.split(" cannot")[0]: finding.level for finding in found(healthy, "maps")}
    assert levels["The map broken"] is Level.ERROR
    assert any("The site campus names maps that there are not: gone" in message for message in levels)


def test_a_database_that_is_none_is_found(healthy) -> None:
    (healthy["data_dir"] / "jobs.sqlite").write_bytes(b"no database" * 1000)
    assert the_bad_one(found(healthy, "jobs")).level is Level.ERROR


def test_a_server_without_a_worker_is_found(healthy) -> None:
    assert "No worker runs" in the_bad_one(found(healthy, "jobs", worker=False)).message


@pytest.mark.parametrize("now", [0.0, 1e9])
def test_a_clock_that_is_wrong_is_found(healthy, monkeypatch, now: float) -> None:
    monkeypatch.setattr(module.time, "time", lambda: now)
    assert the_bad_one(found(healthy, "clock")).level is Level.ERROR


def test_a_video_that_is_not_decoded_is_found(healthy, monkeypatch) -> None:
    decoded = module._is_decoded
    monkeypatch.setattr(module, "_is_decoded", lambda path: "hevc" not in path.name and decoded(path))
    assert "HEVC" in the_bad_one(found(healthy, "videos")).message


def test_a_clip_that_is_another_is_not_decoded(tmp_path: Path) -> None:
    (tmp_path / "x.mp4").write_bytes(b"no film")
    assert not module._is_decoded(tmp_path / "x.mp4")


def test_libraries_of_other_versions_are_found(healthy, monkeypatch) -> None:
    wanted = ["numpy>=99", "no-such-library>=1", "scipy", "gtsam<1; extra == 'other'"]
    monkeypatch.setattr(metadata, "requires", lambda name: wanted)
    findings = found(healthy, "libraries")
    assert [finding.level for finding in findings] == [Level.WARNING, Level.ERROR]
    assert findings[0].hint == "pip install 'numpy>=99'"


def test_fonts_that_are_missing_are_found(healthy, monkeypatch) -> None:
    monkeypatch.setattr(module, "missing_fonts", lambda: ["DejaVu Sans"])
    assert "DejaVu Sans" in the_bad_one(found(healthy, "fonts")).message


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"keys": KeyPolicy.NEVER, "host": "0.0.0.0"}, "Anybody"),
        ({"host": "0.0.0.0"}, "there is none"),
        ({"map_cache_bytes": 1, "max_map_bytes": 2}, "RHOLOC_MAP_CACHE_BYTES"),
        ({"max_map_bytes": 2**31, "max_upload_bytes": 2**30, "map_cache_bytes": 2**31}, "than an upload"),
        ({"map_cache_bytes": 2**60}, "half of the memory"),
        ({"job_memory_gib": 1e6}, "more memory than there is"),
        ({"concurrency": 10_000}, "10000 frames"),
        ({"max_request_bytes": 2**40}, "A frame may be larger"),
    ],
)
def test_settings_that_contradict_each_other_are_found(healthy, changed: dict[str, Any], says: str) -> None:
    assert any(says in finding.message and finding.hint for finding in found(healthy, "settings", **changed))


def test_a_check_that_fails_is_a_finding_itself(healthy, monkeypatch) -> None:
    def failing(settings: Settings) -> Any:
        raise RuntimeError("oh")

    monkeypatch.setitem(module._CHECKS, "clock", failing)
    assert "oh" in the_bad_one(found(healthy, "clock")).message


def test_the_command_says_it_and_its_status_too(
    healthy, command: Callable[..., tuple[int, str, str]], tmp_path
) -> None:
    folders = ("--maps", healthy["maps_dir"], "--data", healthy["data_dir"])
    status, printed, _ = command("doctor", *folders)
    assert status == 0
    assert "ok       maps: 1 maps." in printed
    (tmp_path / "file").write_text("no folder")
    status, printed, _ = command("doctor", "--maps", tmp_path / "file", "--data", healthy["data_dir"], "--json")
    assert status == 1
    assert {"check", "level", "message", "hint"} == set(json.loads(printed)[0])
