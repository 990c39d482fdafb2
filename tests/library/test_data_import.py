"""What a single server had in its folders is all in the storage afterwards."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from fake_pipeline import tiny_map
from rholoc.geometry import Camera
from rholoc.library import CameraLibrary, CameraProfile, MapLibrary, RecordingStore, SiteLibrary, Stores, import_data
from rholoc.library.recording_notes import WAYPOINTS_FILE
from rholoc.library.stores import CAMERAS, KEYS, SITES
from rholoc.maps import FramePose, Site, SiteMap
from rholoc.service.access.keys import KeyStore, Scope


def test_maps_cameras_keys_and_recordings_are_brought_in(storage_url: str, tmp_path: Path) -> None:
    maps_dir, data_dir = tmp_path / "maps", tmp_path / "old"
    folder = MapLibrary(maps_dir)
    for number in range(3):
        folder.put("hall", replace(tiny_map(), info=replace(tiny_map().info, id=f"{number:032x}")))
    folder.put("room", tiny_map())
    profile = CameraProfile(Camera(640, 480, 500.0, 500.0, 320.0, 240.0))
    CameraLibrary(maps_dir).put("phone", profile)
    site = SiteLibrary(maps_dir).put("campus", Site(maps=(SiteMap("hall", pose=FramePose()),)))
    secret = KeyStore(data_dir).create("robot", Scope.LOCALIZE)
    kept = RecordingStore(data_dir)
    entry = kept.create([("walk.mp4", [b"12345"]), ("a/b.csv", [b"6"])])
    kept.note(entry.id, {WAYPOINTS_FILE: b"name,x,y,z\n"})
    stores = Stores(tmp_path / "m", tmp_path / "elsewhere", storage_url=storage_url)
    stores.open()
    shared = stores
    shared.library.put("room", tiny_map())

    moved = import_data(maps_dir, data_dir, stores)
    assert (moved.maps, moved.cameras, moved.sites, moved.keys, moved.recordings) == (1, 1, 1, 1, 1)
    assert moved.left == ("maps: room",)
    assert shared.library.get("hall").info == folder.get("hall").info
    assert {n: info.id for n, info in shared.library.versions("hall").items()} == {1: f"{1:032x}", 2: f"{0:032x}"}
    assert CameraLibrary(shared.documents(CAMERAS)).get("phone") == profile
    assert SiteLibrary(shared.documents(SITES)).get("campus") == site
    found = KeyStore(shared.documents(KEYS)).find(secret)
    assert found is not None
    assert found.name == "robot"
    recordings = stores.recordings
    assert recordings.list() == [entry]
    assert (recordings.path(entry.id) / "a" / "b.csv").read_bytes() == b"6"
    assert recordings.notes(entry.id) == {WAYPOINTS_FILE: b"name,x,y,z\n"}
    assert folder.names() == ["hall", "room"], "the folders stay as they are"
    assert (kept.path(entry.id) / "walk.mp4").is_file()
    again = import_data(maps_dir, data_dir, stores)
    stores.close()
    assert (again.maps, again.recordings, len(again.left)) == (0, 0, 6)


@pytest.mark.slow
def test_the_command_needs_a_storage_and_counts_what_it_brought(tmp_path: Path, storage_url: str) -> None:
    MapLibrary(tmp_path / "maps").put("hall", tiny_map())
    command = [sys.executable, "-m", "rholoc", "storage", "import", "--json"]
    folders = ["--maps", str(tmp_path / "maps"), "--data", str(tmp_path / "data")]

    def run(url: str) -> subprocess.CompletedProcess[str]:
        environment = {**os.environ, "RHOLOC_STORAGE_URL": url}
        return subprocess.run([*command, *folders], env=environment, capture_output=True, text=True, check=False)

    refused = run("")
    assert (refused.returncode, "RHOLOC_STORAGE_URL is not set" in refused.stderr) == (1, True)
    wrong = run("ftp://user:secret@host/x")
    assert (wrong.returncode, "secret" in wrong.stderr, "Traceback" in wrong.stderr) == (1, False, False)
    done = run(storage_url)
    counts = json.loads(done.stdout)
    assert counts == {"maps": 1, "cameras": 0, "sites": 0, "keys": 0, "recordings": 0, "left": [], "unreadable": []}
