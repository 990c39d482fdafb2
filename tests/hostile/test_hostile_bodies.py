"""Bodies that are small to send and large to read: refused at once, and kept from whoever asks next."""

import json

import httpx
import pytest

from rholoc.service import Settings
from rholoc.service.http.json_bodies import JsonLimits
from rholoc_client import Client

JSON = {"Content-Type": "application/json"}
CAMERA = {"width": 640, "height": 480, "fx": 520.0, "fy": 520.0, "cx": 320.0, "cy": 240.0}
BOUNDARY = b"----frontier"
MULTIPART = {"Content-Type": f"multipart/form-data; boundary={BOUNDARY.decode()}"}


@pytest.fixture
def http(service):
    with httpx.Client(base_url=service.url, timeout=30) as client:
        yield client
        assert client.get("/v1/cameras").status_code == 200
        assert client.get("/v1/maps").status_code == 200


def code(answer: httpx.Response) -> str:
    assert 400 <= answer.status_code < 500, answer.text[:300]
    assert len(answer.content) < 2000
    return answer.json()["code"]


@pytest.mark.parametrize(
    "features",
    [
        {"pixels": [1] * 200_000, "descriptors": "AAAA"},
        {"pixels": [[1, 2]] * 100_000, "descriptors": "AAAA"},
        {"pixels": [[1, 2]], "descriptors": [[]] * 200_000},
        {"pixels": [[1, 2]], "descriptors": "AAAA", **{str(i): 1 for i in range(5000)}},
    ],
    ids=["numbers for pairs", "too many pixels", "lists for text", "unknown members"],
)
def test_a_descriptor_set_is_measured_before_it_is_parsed(http, features, monkeypatch):
    def parse(*_args, **_options):
        raise AssertionError("parsed")

    monkeypatch.setattr("rholoc.service.frames.request_models.DescriptorQuery.model_validate_json", parse)
    body = json.dumps({"camera": {"width": 640, "height": 480}, "features": features})
    assert code(http.post("/v1/maps/room/localize", content=body, headers=JSON)) == "too_large"


def test_of_many_errors_the_first_is_reported(http):
    for name, wrong in (("pixels", 1), ("sizes_px", "x"), ("channels", []), ("descriptors", [])):
        features = {"pixels": [[1, 2]], "descriptors": "AAAA", name: [wrong] * 5000}
        answer = http.post("/v1/maps/room/localize", content=json.dumps({"features": features}), headers=JSON)
        assert code(answer) == "invalid_request"
        more = answer.json()["message"].partition("(")[2].partition(" more")[0]
        assert int(more or 0) <= 2, name  # of one list two kinds are possible


def test_every_feature_that_is_allowed_is_within_the_limit():
    n = Settings().max_features
    features = {
        "pixels": [[1.5, 2.5]] * n,
        "channels": [0] * n,
        "descriptors": ["00"] * n,
        "sizes_px": [1.0] * n,
        "angles_deg": [1.0] * n,
    }
    JsonLimits.of_features(Settings().max_request_bytes, n).check(json.dumps({"features": features}).encode())


@pytest.mark.parametrize("form", ["file", "field"])
def test_the_options_beside_a_picture_are_measured_too(http, picture_world, form):
    options = json.dumps({str(i): 1 for i in range(2000 if form == "field" else 200_000)})
    request = ("request.json", options) if form == "file" else (None, options)
    files = {"image": ("a.png", picture_world.png()), "request": request}
    assert code(http.post("/v1/maps/room/localize", files=files)) in ("too_large", "invalid_request")


@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("PUT", "/v1/cameras/big"),
        ("PATCH", "/v1/maps/room"),
        ("POST", "/v1/maps/room/forget"),
        ("POST", "/v1/maps/room/merge"),
        ("POST", "/v1/maps/room/update"),
    ],
)
def test_json_bodies_have_a_limit(http, method, path):
    long = json.dumps({**CAMERA, "calibration": {"notes": "x" * 100_000}})
    assert code(http.request(method, path, content=long, headers=JSON)) == "too_large"
    many = json.dumps({str(i): 1 for i in range(3000)})
    assert code(http.request(method, path, content=many, headers=JSON)) == "too_large"


@pytest.mark.parametrize(
    "calibration",
    [
        '{"a": ' + "[" * 400 + "]" * 400 + "}",
        '{"a": ' + "[" * 30_000 + "]" * 30_000 + "}",
        '{"a": "\\ud800"}',
        '{"\\udfff": 1}',
        '{"a": NaN}',
        '{"a": 1e999}',
        '{"a": 1' + "0" * 400 + "}",
    ],
    ids=["deep", "deeper", "surrogate", "surrogate name", "nan", "infinite", "huge"],
)
def test_what_no_reader_of_json_could_read_is_not_stored(http, calibration):
    body = json.dumps({**CAMERA, "calibration": 0}).replace('"calibration": 0', f'"calibration": {calibration}')
    answer = http.put("/v1/cameras/strange", content=body, headers=JSON)
    assert code(answer) in ("invalid_request", "invalid_input", "too_large")
    assert code(http.get("/v1/cameras/strange")) == "unknown_camera"


@pytest.mark.parametrize(
    "change", [{"cy": False}, {"width": 10**320}, {"fx": 10**400}, {"width": 640.5}, {"fx": "520"}]
)
def test_the_intrinsics_of_a_camera_are_numbers(http, change):
    body = json.dumps({**CAMERA, **change})
    refused = http.put("/v1/cameras/strange", content=body, headers=JSON)
    assert code(refused) in ("invalid_request", "invalid_camera")


def test_a_camera_file_that_no_answer_could_hold_is_named_apart(service, http):
    folder = service.settings.maps_dir / "cameras"
    folder.mkdir(exist_ok=True)
    (folder / "deep.json").write_text(
        json.dumps({**CAMERA, "calibration": {"a": 0}}).replace("0}", "[" * 400 + "]" * 400 + "}")
    )
    (folder / "odd.json").write_text(json.dumps({**CAMERA, "calibration": {"a": "\ud800"}}))
    (folder / "half.json").write_text(json.dumps({**CAMERA, "width": 640.5}))
    try:
        listed = http.get("/v1/cameras")
        assert (listed.status_code, set(listed.json()["unreadable"])) == (200, {"deep", "odd", "half"})
    finally:
        for name in ("deep", "odd", "half"):
            (folder / f"{name}.json").unlink()


@pytest.mark.parametrize("source", ["\\ud800", "x" * 60_000])
def test_a_source_that_cannot_be_named(http, source):
    answer = http.post("/v1/maps/room/forget", content=f'{{"source": "{source}"}}', headers=JSON)
    assert code(answer) in ("invalid_request", "invalid_input")


def part(name: str, content: bytes = b"", header: bytes = b"") -> bytes:
    disposition = f'Content-Disposition: form-data; name="file"; filename="{name}"\r\n'.encode()
    return b"--" + BOUNDARY + b"\r\n" + disposition + header + b"\r\n" + content + b"\r\n"


def test_a_form_has_a_limit_of_parts_and_of_their_headers(serve):
    running = serve(max_upload_files=50)
    end = b"--" + BOUNDARY + b"--\r\n"
    url = f"{running.url}/v1/recordings"
    many = b"".join(part("same.csv") for _ in range(200)) + end
    assert code(httpx.post(url, content=many, headers=MULTIPART)) == "too_large"
    fields = b"".join(
        b"--" + BOUNDARY + b'\r\nContent-Disposition: form-data; name="a"\r\n\r\n\r\n' for _ in range(101)
    )
    assert code(httpx.post(url, content=fields + end, headers=MULTIPART)) == "invalid_request"
    long = part("a.csv", header=b"X-Long: " + b"x" * 20_000 + b"\r\n") + end
    assert code(httpx.post(url, content=long, headers=MULTIPART)) == "invalid_request"
    assert not [path for path in (running.settings.data_dir / "recordings").iterdir() if path.is_dir()]


def test_made_up_methods_and_paths_are_not_counted_one_by_one(http):
    for i in range(20):
        http.request(f"METHOD{i}", "/v1/maps")
        http.get(f"/path{i}")
        http.request(f"METHOD{i}", "/v1/maps/room")
    text = http.get("/metrics").text
    assert "METHOD" not in text
    assert "path1" not in text


def test_a_query_name_that_no_route_takes_is_named(http, picture_world):
    answer = http.post(
        "/v1/maps/room/localize?dofs=6", content=picture_world.png(), headers={"Content-Type": "image/png"}
    )
    assert code(answer) == "invalid_request"
    assert "dofs" in answer.json()["message"]
    assert "dof" in answer.json()["hint"]
    assert http.get("/healthz?cache=1").is_success


def test_honest_clients_are_still_served(service, picture_world):
    with Client(service.url) as client:
        assert client.localize("room", picture_world.png(), dof=6).localized
