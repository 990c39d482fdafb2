"""Two servers that share a PostgreSQL database and an S3 bucket: they are one service."""

import base64
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import pytest

from fake_pipeline import tiny_map
from rholoc.geometry import Camera
from rholoc.library.cameras import CameraLibrary, CameraProfile
from rholoc.library.data_import import import_data
from rholoc.library.maps import MapLibrary
from rholoc.library.recording_notes import WAYPOINTS_FILE
from rholoc.library.recordings import RecordingStore
from rholoc.library.sites import SiteLibrary
from rholoc.library.stores import CAMERAS, KEYS, SITES, Stores
from rholoc.maps import FramePose, Site, SiteMap
from rholoc.service.access.keys import KeyLimits, KeyStore, Scope
from rholoc.service.settings import KeyPolicy
from waiting import until

BUCKET = "rholoc"
VIDEO = b"\0\0\0\x18ftypmp42" + b"no frames" * 1000
HEARD_WITHIN_S = 20.0  # two seconds, and what a busy machine adds


@pytest.fixture(scope="module")
def s3_url() -> Iterator[str]:
    """An S3 server of our own, with an empty bucket."""
    boto3 = pytest.importorskip("boto3")
    from moto.server import ThreadedMotoServer

    server = ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    environment = {
        "AWS_ENDPOINT_URL": f"http://{host}:{port}",
        "AWS_ACCESS_KEY_ID": "test",
        "AWS_SECRET_ACCESS_KEY": "test",
        "AWS_REGION": "us-east-1",
        "AWS_ALLOW_HTTP": "true",
    }
    with pytest.MonkeyPatch.context() as patch:
        for name, value in environment.items():
            patch.setenv(name, value)
        boto3.client("s3", region_name="us-east-1").create_bucket(Bucket=BUCKET)
        yield f"s3://{BUCKET}/service"
    server.stop()


@pytest.fixture(scope="module")
def servers(serve: Any, s3_url: str, postgres: Any) -> list[str]:
    """Two services' addresses."""
    urls = {"database_url": postgres.create_database("two_servers"), "storage_url": s3_url}
    return [serve(**urls).url for _ in range(2)]


def metadata(**values: str) -> str:
    return ",".join(f"{name} {base64.b64encode(value.encode()).decode()}" for name, value in values.items())


@pytest.mark.slow
def test_two_servers_are_one_service(servers: list[str], picture_world: Any) -> None:
    here, there = servers
    map_file = picture_world.rho()
    assert httpx.put(f"{here}/v1/maps/hall", content=map_file).status_code == 201
    until(lambda: httpx.get(f"{there}/v1/maps/hall").status_code == 200, HEARD_WITHIN_S)
    answer = httpx.post(
        f"{there}/v1/maps/hall/localize",
        content=picture_world.png(),
        headers={"Content-Type": "image/png"},
        params={"fx": 520, "fy": 520, "cx": 319.5, "cy": 239.5, "dof": 6},
    ).json()
    assert answer["localized"], answer
    assert httpx.get(f"{there}/v1/maps/hall/download").content == map_file
    assert httpx.get(f"{there}/v1/maps/hall/preview.png").headers["Content-Type"] == "image/png"
    assert httpx.patch(f"{there}/v1/maps/hall", json={"name": "lobby"}).status_code == 200
    until(lambda: httpx.get(f"{here}/v1/maps/lobby").status_code == 200, HEARD_WITHIN_S)
    camera = {"width": 640, "height": 480, "fx": 500, "fy": 500, "cx": 320, "cy": 240}
    assert httpx.put(f"{here}/v1/cameras/phone", json=camera).status_code == 201
    until(lambda: httpx.get(f"{there}/v1/cameras/phone").status_code == 200, HEARD_WITHIN_S)


@pytest.mark.slow
def test_an_upload_that_lost_its_server_goes_on_at_another(servers: list[str]) -> None:
    here, there = servers
    length, step = len(VIDEO), 4000
    headers = {"Tus-Resumable": "1.0.0", "Upload-Length": str(length)}
    headers["Upload-Metadata"] = metadata(filename="walk.mp4", map="yard")
    begun = httpx.post(f"{here}/v1/recordings", headers=headers)
    assert begun.status_code == 201, begun.text
    path = begun.headers["Location"]
    for number, start in enumerate(range(0, length, step)):
        server = (there, here)[number % 2]
        stands = httpx.head(f"{server}{path}", headers={"Tus-Resumable": "1.0.0"}).headers["Upload-Offset"]
        assert int(stands) == start
        patched = httpx.patch(
            f"{server}{path}",
            content=VIDEO[start : start + step],
            headers={
                "Tus-Resumable": "1.0.0",
                "Upload-Offset": str(start),
                "Content-Type": "application/offset+octet-stream",
            },
        )
        assert patched.status_code == 204, patched.text
    job = httpx.head(f"{here}{path}", headers={"Tus-Resumable": "1.0.0"}).headers["Rholoc-Job"]
    assert [httpx.get(f"{server}/v1/jobs/{job}").json()["map"] for server in servers] == ["yard"] * 2
    listed = [httpx.get(f"{server}/v1/recordings").json()["recordings"] for server in servers]
    assert listed[0] == listed[1]
    assert listed[0][0]["size_bytes"] == length


@pytest.mark.slow
def test_servers_stay_ready_while_the_database_is_gone(serve: Any, tmp_path: Any, postgres: Any) -> None:
    url = serve(database_url=postgres.create_database("gone"), storage_url=f"file://{tmp_path}/storage").url
    answer = httpx.get(f"{url}/readyz")
    assert (answer.status_code, answer.json()["checks"]["maps"], answer.json()["checks"]["jobs"]) == (200, "ok", "ok")
    postgres.stop()
    try:
        answer = httpx.get(f"{url}/readyz")
        assert (answer.status_code, answer.json()["ready"]) == (200, True)
        assert "does not answer" in answer.json()["checks"]["jobs"]
        refused = httpx.put(
            f"{url}/v1/cameras/phone", json={"width": 9, "height": 9, "fx": 9, "fy": 9, "cx": 4, "cy": 4}
        )
        assert (refused.status_code, refused.json()["code"]) == (503, "storage_unavailable")
    finally:
        postgres.start()
    until(lambda: httpx.get(f"{url}/readyz").json()["checks"]["jobs"] == "ok")


@pytest.mark.slow
def test_what_keys_hold_is_counted_together(serve: Any, s3_url: str, postgres: Any, picture_world: Any) -> None:
    urls = {"database_url": postgres.create_database("quotas"), "storage_url": s3_url}
    running = [serve(**urls, keys=KeyPolicy.ALWAYS) for _ in range(2)]
    stores = running[0].settings.stores()
    stores.open()
    secret = KeyStore(stores.documents(KEYS)).create("mapper", Scope.ADMIN, limits=KeyLimits(maps=1))
    stores.close()
    here, there = (httpx.Client(base_url=one.url, headers={"Authorization": f"Bearer {secret}"}) for one in running)
    until(lambda: all(one.get("/v1/maps").status_code == 200 for one in (here, there)), HEARD_WITHIN_S)
    assert here.put("/v1/maps/one", content=picture_world.rho()).status_code == 201
    until(lambda: there.get("/v1/maps/one").status_code == 200, HEARD_WITHIN_S)
    refused = there.put("/v1/maps/two", content=picture_world.rho())
    assert (refused.status_code, refused.json()["code"]) == (429, "quota_exceeded")
    assert [one["path"] for one in there.get("/v1/audit").json()["changes"]] == ["/v1/maps/one"]


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
