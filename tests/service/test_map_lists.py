"""Maps are listed by the headers of their files; what is stored again makes no version; PUT takes If-Match."""

import io
import zlib
from contextlib import nullcontext, suppress
from itertools import pairwise

import httpx
import pytest
from PIL import Image

from rholoc.errors import InvalidInput, UnknownRecording
from rholoc.library.maps import MapLibrary
from rholoc.library.recordings import RecordingStore
from rholoc.maps import FloorPlan
from rholoc.maps.floor_plan import check_plan
from rholoc.service.settings import KeyPolicy
from rholoc.storage.replica import Replica
from waiting import until

_RHO = {"Content-Type": "application/octet-stream"}


@pytest.fixture(params=["folder", "shared"])
def running(request, serve, tmp_path):
    """A service that keeps maps in a folder, or in a storage that it shares."""
    return serve(**({} if request.param == "folder" else {"storage_url": f"file://{tmp_path}/storage"}))


def put(running, name: str, content: bytes, **headers: str) -> httpx.Response:
    return httpx.put(f"{running.url}/v1/maps/{name}", content=content, headers={**_RHO, **headers})


def test_a_list_reads_no_map(running, picture_world, monkeypatch):
    for name in ("a", "b"):
        put(running, name, picture_world.rho()).raise_for_status()
    library = running.app.state.rholoc.maps.sync
    wanted = httpx.get(f"{running.url}/v1/maps/a").json()
    until(lambda: running.app.state.rholoc.frames.finder._fetched.keys() == {"a", "b"})
    library._cache.drop("a")
    for copy in library.folder.glob("*.rho") if running.settings.shared_storage else ():
        copy.unlink()
    read = []
    monkeypatch.setattr(MapLibrary, "get", lambda self, name: read.append(name))
    listed = httpx.get(f"{running.url}/v1/maps").json()
    assert not read
    assert not listed["unreadable"]
    assert [one["name"] for one in listed["maps"]] == ["a", "b"]
    assert listed["maps"][0] == {name: wanted[name] for name in listed["maps"][0]}
    if running.settings.shared_storage:
        assert not list(library.folder.glob("*.rho"))  # nothing was downloaded


def test_the_same_content_makes_no_version(running, picture_world):
    assert put(running, "room", picture_world.rho()).status_code == 201
    for _ in range(4):
        assert put(running, "room", picture_world.rho()).status_code == 200
    assert httpx.get(f"{running.url}/v1/maps/room/versions").json()["versions"] == []
    put(running, "room", picture_world.rho(version=4)).raise_for_status()
    assert [one["version"] for one in httpx.get(f"{running.url}/v1/maps/room/versions").json()["versions"]] == [3]


def test_a_map_that_was_changed_is_not_replaced_if_the_request_says_so(running, picture_world):
    first, second = picture_world.rho(version=4), picture_world.rho(version=5)
    missing = put(running, "room", first, **{"If-Match": "*"})
    assert (missing.status_code, missing.json()["code"]) == (412, "precondition_failed")
    tag = put(running, "room", first, **{"If-None-Match": "*"}).headers["ETag"]
    assert httpx.get(f"{running.url}/v1/maps/room").headers["ETag"] == tag
    assert put(running, "room", second, **{"If-None-Match": "*"}).status_code == 412
    newer = put(running, "room", second, **{"If-Match": tag})
    assert newer.status_code == 200
    assert put(running, "room", first, **{"If-Match": tag}).status_code == 412
    assert httpx.get(f"{running.url}/v1/maps/room").json()["version"] == 5
    assert put(running, "room", first, **{"If-Match": newer.headers["ETag"]}).status_code == 200


def test_a_picture_is_refused_by_its_header_before_it_is_decoded(running, picture_world, monkeypatch):
    put(running, "room", picture_world.rho()).raise_for_status()
    decoded = []
    monkeypatch.setattr("rholoc.service.frames.frame_features.decode_image", lambda *_: decoded.append(1))
    file = io.BytesIO()
    Image.new("L", (7000, 7000)).save(file, "PNG")
    answer = httpx.post(
        f"{running.url}/v1/maps/room/localize", content=file.getvalue(), headers={"Content-Type": "image/png"}
    )
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid_camera")
    assert not decoded


@pytest.mark.slow
def test_a_large_site_is_stored(serve, picture_world):
    running = serve()
    running.app.state.rholoc.operation.watch.stop()  # 600 maps' views are beside the point
    names = [f"m{number}" for number in range(600)]
    content = picture_world.rho()
    for name in names:
        (running.settings.maps_dir / f"{name}.rho").write_bytes(content)
    pose = {"position": [1, 0, 0], "quaternion_xyzw": [0, 0, 0, 1]}
    links = [{"first": a, "second": b, "pose": pose} for a, b in pairwise(names)]
    site = {"maps": [{"map": name, "floor": "1"} for name in names], "links": links}
    answer = httpx.put(f"{running.url}/v1/sites/campus", json=site, timeout=120)
    assert answer.status_code == 201, answer.text[:300]
    assert len(answer.json()["maps"]) == 600


def test_recordings_are_listed_while_one_is_deleted(serve, monkeypatch):
    running = serve()
    store = running.app.state.rholoc.recordings.sync
    other = RecordingStore(running.settings.data_dir, engine=store.engine)
    kept, gone = (store.create([("walk.mp4", [b"x"])]).id for _ in range(2))
    really = store.get

    def deleted_meanwhile(recording_id: str):
        if recording_id == gone:
            with suppress(UnknownRecording):
                other.delete(gone)
        return really(recording_id)

    monkeypatch.setattr(store, "get", deleted_meanwhile)
    answer = httpx.get(f"{running.url}/v1/recordings")
    assert answer.status_code == 200
    assert [one["id"] for one in answer.json()["recordings"]] == [kept]


def test_pictures_of_maps_on_a_full_disk_say_so(serve, picture_world, monkeypatch):
    running = serve()
    (running.settings.maps_dir / "room.rho").write_bytes(picture_world.rho())

    class Full:
        running = True

        async def ask(self, _request):
            pass

        async def read_line(self, _timeout_s):
            return b'{"code": "storage_full", "error": "No space left.", "hint": "Free some."}'

        async def kill(self):
            pass

    async def start(*_args, **_options):
        return Full()

    monkeypatch.setattr("rholoc.service.maps.renderings.AsyncProgram.start", start)
    for path in ("preview.png", "report.png", "coverage", "download?format=png"):
        answer = httpx.get(f"{running.url}/v1/maps/room/{path}")
        assert (answer.status_code, answer.json()["code"]) == (507, "storage_full"), path


def png_with(*chunks: tuple[bytes, bytes]) -> bytes:
    """A PNG file of one pixel with further chunks before its end."""
    file = io.BytesIO()
    Image.new("L", (1, 1)).save(file, "PNG")
    whole = file.getvalue()
    further = b"".join(
        len(data).to_bytes(4) + kind + data + zlib.crc32(kind + data).to_bytes(4) for kind, data in chunks
    )
    return whole[:-12] + further + whole[-12:]


@pytest.mark.parametrize(
    ("kind", "start", "text_bytes", "chunks", "accepted"),
    [
        (b"zTXt", b"a\0\0", 7, 1, True),
        (b"zTXt", b"a\0\0", 400 * 2**20, 1, False),
        (b"iTXt", b"a\0\1\0en\0b\0", 2**22, 1, False),
        (b"zTXt", b"a\0\0", 2**18, 8, False),
        (b"teSt", b"", 0, 20_000, False),
    ],
)
def test_texts_in_floor_plans_are_bounded(kind, start, text_bytes, chunks, accepted):
    plan = FloorPlan("image/png", (0.0, 0.0), 0.0, 1.0)
    text = start + zlib.compress(bytes(text_bytes), 1) if start else b""
    with nullcontext() if accepted else pytest.raises(InvalidInput):
        check_plan(png_with(*[(kind, text)] * chunks), plan)


def test_metrics_need_no_key_where_the_setting_says_so(serve):
    closed, opened = (serve(keys=KeyPolicy.ALWAYS, open_metrics=one) for one in (False, True))
    assert httpx.get(f"{closed.url}/metrics").status_code == 401
    assert httpx.get(f"{opened.url}/metrics").status_code == 200
    assert httpx.get(f"{opened.url}/v1/maps").status_code == 401


def test_a_correction_is_answered_with_the_version_that_it_made(serve, tmp_path, picture_world, monkeypatch):
    """Not with what this server sees, which may be behind, or with what another request has made of it."""
    running = serve(storage_url=f"file://{tmp_path}/storage")
    put(running, "a", picture_world.rho()).raise_for_status()
    before = httpx.get(f"{running.url}/v1/maps/a").json()["version"]
    monkeypatch.setattr(Replica, "_see", lambda replica, changes: None)
    answer = httpx.post(f"{running.url}/v1/maps/a/corrections", json={"kind": "labels", "tags": ["bright"]})
    assert answer.json()["version"] == before + 1
