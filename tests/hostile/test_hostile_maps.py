"""Map files that say what no reader can use: refused before they replace anything, and harmless where they lie."""

import asyncio
import json
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import httpx
import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import save
from starlette.requests import ClientDisconnect

from rholoc.errors import InvalidMap
from rholoc.exports import ExportFormat
from rholoc.library.maps import MapLibrary
from rholoc.maps import load_map, map_to_bytes
from rholoc.maps.formats.rho_file import _checksum
from rholoc.service import libraries
from rholoc.service.maps.exports import ExportRequest, Exports, is_long

PNG = {"Content-Type": "image/png"}


def rewritten(content: bytes, tmp_path, text=None, **changes) -> bytes:
    """A map's file with other members in its description, or another description, and the checksum that belongs."""
    path = tmp_path / "original.rho"
    path.write_bytes(content)
    with safe_open(path, framework="numpy") as file:
        metadata = dict(file.metadata())
        arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    info = json.loads(metadata["info"])
    for name, value in changes.items():
        *outer, last = name.split("__")
        target = info
        for member in outer:
            target = target.setdefault(member, {})
        target[last] = value
    metadata["info"] = json.dumps(info) if text is None else text(json.dumps(info))
    metadata["checksum"] = _checksum(metadata["info"], arrays)
    return bytes(save(arrays, metadata))


HELD_OUT = {"frames": 1, "localized": 1, "median_m": 1.0, "p90_m": 1.0}
STRANGE = {
    "waypoints that are text": {"waypoints": ["a"]},
    "sources that are numbers": {"sources": [1]},
    "a waypoint nowhere": {"waypoints": [{"name": "a", "position": [1, 2]}]},
    "half a pixel": {"camera__width": 640.5},
    "a camera without a size": {"camera": {}},
    "an id that is half a character": {"id": "\ud800"},
    "a long id": {"id": "x" * 100_000},
    "a time that is half a character": {"created": "\udfff"},
    "no time": {"created": ""},
    "a figure beyond all numbers": {"report": {"held_out": {**HELD_OUT, "median_m": 10**400}}},
    "a figure that is text": {"report": {"held_out": {**HELD_OUT, "median_m": "far"}}},
    "a figure that is not one": {"report": {"held_out": {**HELD_OUT, "median_m": float("nan")}}},
    "a version that is text": {"version": "one"},
    "a density of another kind": {"density": "cloud"},
    "tensors without arrays": {"density": "tensor"},
}
TEXTS = {
    "a deep report": lambda text: text.replace('"report": {', '"report": {"x": ' + "[" * 10**5 + "]" * 10**5 + ", "),
    "an infinite figure": lambda text: text.replace('"report": {', '"report": {"features_per_view_median": 1e999, '),
    "not JSON": lambda text: text[:-5],
    "a list": lambda text: "[]",
}


@pytest.fixture
def http(service):
    with httpx.Client(base_url=service.url, timeout=30) as client:
        before = client.get("/v1/maps/room").json()
        yield client
        assert client.get("/v1/maps/room").json() == before
        listed = client.get("/v1/maps")
        assert (listed.status_code, listed.json()["unreadable"]) == (200, {})


def refused(answer: httpx.Response) -> None:
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid_map"), answer.text[:300]
    assert len(answer.content) < 3000


@pytest.mark.parametrize("changes", STRANGE.values(), ids=STRANGE)
def test_a_description_that_no_answer_could_hold_replaces_nothing(http, picture_world, tmp_path, changes):
    refused(http.put("/v1/maps/room", content=rewritten(picture_world.rho(), tmp_path, **changes)))


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS)
def test_a_description_that_is_no_description_replaces_nothing(http, picture_world, tmp_path, text):
    refused(http.put("/v1/maps/room", content=rewritten(picture_world.rho(), tmp_path, text)))


def without_landmarks(map_):
    none = np.zeros(0, np.int32)
    return replace(
        map_,
        landmarks=map_.landmarks.take(none),
        descriptors=map_.descriptors.take(none),
        observations=map_.observations.take(none),
    )


def without_descriptors(map_):
    return replace(map_, descriptors=map_.descriptors.take(np.zeros(0, np.int32)))


@pytest.mark.parametrize("less", [without_landmarks, without_descriptors])
def test_a_map_to_localize_nothing_in_is_refused(http, picture_world, less):
    refused(http.put("/v1/maps/room", content=map_to_bytes(less(picture_world.map_))))


def test_what_cannot_be_rehearsed_is_not_published(http, picture_world, monkeypatch):
    def fail(*_args):
        raise IndexError("index 3 is out of bounds")

    monkeypatch.setattr("rholoc.service.maps.publishing.localizer_of", fail)
    refused(http.put("/v1/maps/room", content=picture_world.rho(version=9)))


def test_a_bad_map_does_not_spoil_the_answers_of_the_others(serve, picture_world, monkeypatch):
    running = serve()
    folder = running.settings.maps_dir
    (folder / "good.rho").write_bytes(picture_world.rho())
    (folder / "empty.rho").write_bytes(map_to_bytes(without_landmarks(picture_world.map_)))
    (folder / "bare.rho").write_bytes(map_to_bytes(without_descriptors(picture_world.map_)))
    picture = {"content": picture_world.png(), "headers": PNG}
    assert httpx.post(f"{running.url}/v1/localize?maps=all&dof=6", **picture).json()["map"] == "good"
    alone = httpx.post(f"{running.url}/v1/maps/empty/localize", **picture)
    assert (alone.status_code, alone.json()["code"]) == (422, "invalid_map")
    monkeypatch.setattr(MapLibrary, "readable", lambda _: ["gone", "good"])  # deleted meanwhile
    assert httpx.post(f"{running.url}/v1/localize?maps=all&dof=6", **picture).json()["map"] == "good"


def test_a_large_map_that_is_read_keeps_nobody_from_another(tmp_path, picture_world, monkeypatch):
    library = MapLibrary(tmp_path)
    for name in ("slow", "quick"):
        library.put_file(name, picture_world.rho())
    reading, go_on = threading.Event(), threading.Event()

    def read(path, *args):
        if path.name == "slow.rho":
            reading.set()
            assert go_on.wait(20)
        return load_map(path, *args)

    monkeypatch.setattr("rholoc.library.maps.load_map", read)
    slow = threading.Thread(target=library.get, args=("slow",))
    slow.start()
    assert reading.wait(20)
    assert len(library.get("quick")) == len(picture_world.map_)
    go_on.set()
    slow.join(20)


def test_a_file_is_put_piece_by_piece(tmp_path, picture_world, monkeypatch):
    monkeypatch.setattr("rholoc.library.maps._PIECE_BYTES", 1000)
    monkeypatch.setattr("pathlib.Path.read_bytes", lambda path: pytest.fail("read whole"))
    (tmp_path / "arrived").write_bytes(picture_world.rho(version=5))
    assert MapLibrary(tmp_path / "maps").put_file("room", tmp_path / "arrived").info.version == 5


@pytest.mark.slow
def test_a_download_is_of_one_version_whatever_happens_meanwhile(serve, picture_world):
    running = serve()
    path = running.settings.maps_dir / "room.rho"
    first = picture_world.rho()
    second = picture_world.rho(id="f" * 32) + b""
    path.write_bytes(first)
    with httpx.stream("GET", f"{running.url}/v1/maps/room/download") as answer:
        assert answer.headers["Cache-Control"] == "no-store"
        path.unlink()
        assert answer.read() == first
    stop, sizes = threading.Event(), set()

    def replace_often():
        library = MapLibrary(running.settings.maps_dir)
        while not stop.is_set():
            library.put_file("room", first)
            library.put_file("room", second)
            if not stop.wait(0.002):
                library.delete("room")

    writer = threading.Thread(target=replace_often)
    writer.start()
    try:
        for _ in range(60):
            answer = httpx.get(f"{running.url}/v1/maps/room/download", timeout=60)
            assert answer.status_code in (200, 404, 409), answer.text
            if answer.status_code == 200:
                sizes.add(answer.content)
    finally:
        stop.set()
        writer.join(60)
    assert sizes <= {first, second}


def test_only_long_exports_are_left_to_a_process():
    assert not is_long(300, ExportFormat.CSV, None, None)
    assert is_long(5000, ExportFormat.CSV, None, None)
    assert is_long(300, ExportFormat.CSV, 3, None)
    assert is_long(5000, ExportFormat.SURFACES, None, None)
    assert not is_long(5000, ExportFormat.SURFACES, None, [1, 2])
    assert not is_long(10**6, ExportFormat.PLY, None, None)


@pytest.fixture
def every_export_is_long(monkeypatch):
    monkeypatch.setattr("rholoc.service.maps.exports.SHORT_NUMBERS", 0)


@pytest.mark.usefixtures("every_export_is_long")
def test_an_export_that_takes_too_long_ends_with_its_process(serve, picture_world):
    running = serve(export_time_limit_s=0.01)
    (running.settings.maps_dir / "room.rho").write_bytes(picture_world.rho())
    for _ in range(2):  # the first gives its place back
        answer = httpx.get(f"{running.url}/v1/maps/room/download?format=csv", timeout=30)
        assert (answer.status_code, answer.json()["code"]) == (504, "deadline_exceeded")


def test_an_export_whose_client_leaves_before_it_begins_is_given_up(tmp_path, monkeypatch):
    monkeypatch.setattr("rholoc.service.maps.exports._LOOK_EVERY_S", 0.05)

    async def is_gone():
        return True

    async def ask():
        exports = Exports(time_limit_s=1000)
        wanted = ExportRequest(tmp_path / "missing.rho", "room", ExportFormat.CSV)
        for _ in range(3):
            with pytest.raises(ClientDisconnect):
                await exports.answer(wanted, {}, is_gone)
        assert (exports._open, exports._turn.locked()) == (0, False)

    asyncio.run(ask())


@pytest.mark.slow
@pytest.mark.usefixtures("every_export_is_long")
def test_an_export_that_nobody_waits_for_gives_its_place_back(serve, picture_world):
    running = serve()
    (running.settings.maps_dir / "room.rho").write_bytes(picture_world.rho())
    url = f"{running.url}/v1/maps/room/download?format=csv"
    for _ in range(3):
        with httpx.stream("GET", url, timeout=60) as answer:
            assert next(answer.iter_raw(100))
    whole = httpx.get(url, timeout=120)
    assert whole.is_success
    refused = httpx.get(f"{url}&degree=7", timeout=120)
    assert (refused.status_code, refused.json()["code"]) == (422, "invalid_input")


def test_a_map_file_has_a_limit_and_maps_are_checked_one_at_a_time(serve, picture_world, monkeypatch):
    content = picture_world.rho()
    running = serve(max_map_bytes=len(content))
    url = f"{running.url}/v1/maps"
    refused = httpx.put(f"{url}/room", content=content + b"x")
    assert (refused.status_code, refused.json()["code"]) == (413, "too_large")
    at_work, most, both = 0, 0, threading.Lock()
    really = libraries.publish_file

    def publish(*args):
        nonlocal at_work, most
        with both:
            at_work += 1
            most = max(most, at_work)
        really(*args)
        with both:
            at_work -= 1

    monkeypatch.setattr(libraries, "publish_file", publish)
    with ThreadPoolExecutor(4) as pool:
        answers = list(pool.map(lambda i: httpx.put(f"{url}/room-{i}", content=content, timeout=60), range(4)))
    assert ([answer.status_code for answer in answers], most) == ([201] * 4, 1)


def test_a_description_beyond_all_measure_is_not_parsed(picture_world, tmp_path):
    content = rewritten(picture_world.rho(), tmp_path, waypoints=[{"name": "x" * 2**24, "position": [0, 0, 0]}])
    (tmp_path / "long.rho").write_bytes(content)
    with pytest.raises(InvalidMap, match="longer than"):
        load_map(tmp_path / "long.rho")
