"""Requests that the service accepts, of every route, and the same requests after something has befallen them."""

import base64
import json
import random
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from urllib.parse import quote, urlencode

import httpx

from fuzz_readers import SHIPPED, STRANGE, damaged, drawing, number, own_recording, zipped

JSON, JPEG, BINARY = "application/json", "image/jpeg", "application/octet-stream"
MAP, SITE, CAMERA = "testsite", "campus", "phone"
TUS = {"Tus-Resumable": "1.0.0"}
POSE = {"position": [1.0, 0.5, 0.0], "quaternion_xyzw": [0.0, 0.0, 0.6, 0.8]}
NAMED = {  # parameters of paths; streams end with the request that opened them
    "map_name": MAP, "site": SITE, "camera": CAMERA, "feature": "7", "view": "1", "number": "0", "stream": "0" * 32,
}  # fmt: skip
SAME = {"position": [0.0, 0.0, 0.0], "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0]}
INTRINSICS = {"width": 640, "height": 480, "fx": 520.0, "fy": 520.0, "cx": 320.0, "cy": 240.0}
UPLOAD_BYTES = 100
MOST_VERSIONS = 40  # of the map, after which it is uploaded again: corrections have taken much of it away
HEX = "0123456789abcdef"
METHODS = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS")
TYPES = ("", "text/plain", JSON, JPEG, "image/png", BINARY, "multipart/form-data", "multipart/form-data; boundary=x")
HEADERS = (
    "Content-Type", "Accept", "If-None-Match", "Range", "Last-Event-ID", "Authorization", "X-Request-ID",
    "Upload-Length", "Upload-Offset", "traceparent",
)  # fmt: skip


@dataclass(frozen=True)
class Request:
    """A request.

    Attributes:
        method: of HTTP.
        path: its segments, not yet quoted.
        query: names and values.
        headers: as sent.
        body: as sent.
    """

    method: str
    path: tuple[str, ...]
    query: tuple[tuple[str, str], ...] = ()
    headers: tuple[tuple[str, str], ...] = ()
    body: bytes = b""

    @property
    def url(self) -> str:
        """Path and query."""
        path = "/" + "/".join(quote(segment, safe="", errors="replace") for segment in self.path)
        return f"{path}?{urlencode(self.query, errors='replace')}" if self.query else path

    def built(self, client: httpx.AsyncClient) -> httpx.Request:
        """As the client sends it.

        Raises:
            httpx.InvalidURL: it cannot.
        """
        headers = [(name.encode(), value.encode("latin-1", "replace")) for name, value in self.headers]
        return client.build_request(self.method, self.url, headers=headers, content=self.body)


@dataclass(frozen=True)
class World:
    """What a service has, for requests to be about.

    Attributes:
        recording: the id of a whole one.
        upload: that of an upload of ``UPLOAD_BYTES``, of which nothing has arrived.
        job: that of a job that waits.
        cancelled: that of a job that was cancelled.
        key: the name of a key.
    """

    recording: str
    upload: str
    job: str
    cancelled: str
    key: str


Send = Callable[[Request], Awaitable[httpx.Response]]


def request(
    method: str, path: str, body: object = None, kind: str = "", headers: dict[str, str] | None = None, **query: object
) -> Request:
    """A request; a body that is no bytes is JSON."""
    content = body if isinstance(body, bytes) else b"" if body is None else json.dumps(body).encode()
    chosen = {**({"Content-Type": kind or JSON} if body is not None else {}), **(headers or {})}
    pairs = tuple((name, str(value)) for name, value in query.items())
    return Request(method, tuple(path.strip("/").split("/")), pairs, tuple(chosen.items()), content)


def form(fields: dict[str, str | tuple[str, bytes]]) -> tuple[bytes, str]:
    """A multipart body of texts and files, and its type."""
    parts = b""
    for name, value in fields.items():
        text, content = ("", value.encode()) if isinstance(value, str) else (f'; filename="{value[0]}"', value[1])
        parts += f'--xyz\r\nContent-Disposition: form-data; name="{name}"{text}\r\n\r\n'.encode() + content + b"\r\n"
    return parts + b"--xyz--\r\n", "multipart/form-data; boundary=xyz"


def metadata(**values: str) -> str:
    """``Upload-Metadata`` of tus."""
    return ",".join(f"{name} {base64.b64encode(value.encode()).decode()}" for name, value in values.items())


def upload_request() -> Request:
    """The creation of a resumable upload."""
    named = metadata(filename="walk.zip", map="walked")
    headers = {**TUS, "Upload-Length": str(UPLOAD_BYTES), "Upload-Metadata": named}
    return request("POST", "/v1/recordings", headers=headers)


def recording_request() -> Request:
    """An upload of a whole recording."""
    fields: dict[str, str | tuple[str, bytes]] = {
        "map": "walked", "features": "gray", "frames": "0:20", "camera": "60,61,31.5,23.5", "priority": "low",
        "file": ("walk.zip", zipped(own_recording())),
    }  # fmt: skip
    return request("POST", "/v1/recordings", *form(fields))


def map_request(name: str) -> Request:
    """An upload of the shipped map."""
    return request("PUT", f"/v1/maps/{name}", (SHIPPED / "testsite.rho").read_bytes(), BINARY)


def site_request() -> Request:
    """A site of one map."""
    earth = {"latitude_deg": 52.5, "longitude_deg": 13.4, "height_m": 70.0, "heading_deg": 12.5}
    link = {"first": MAP, "second": "annex", "pose": SAME, "sigma_m": 0.05, "sigma_deg": 0.5}
    maps = [{"map": MAP, "floor": "0", "pose": POSE}, {"map": "annex", "floor": "0"}]
    return request("PUT", f"/v1/sites/{SITE}", {"maps": maps, "links": [link], "earth": earth})


def camera_request() -> Request:
    """A stored camera."""
    return request("PUT", f"/v1/cameras/{CAMERA}", {**INTRINSICS, "distortion": [], "calibration": {"rms_px": 0.2}})


async def prepared(send: Send, before: World | None = None) -> World:
    """The world, with what earlier requests took away put back."""

    async def found(path: str) -> httpx.Response | None:
        answer = await send(request("GET", path))
        return answer if answer.is_success else None

    for name in (MAP, "annex"):
        there = await found(f"/v1/maps/{name}")
        if there is None or there.json()["version"] > MOST_VERSIONS:
            await send(map_request(name))
    planned = (await found(f"/v1/maps/{MAP}/plan")) is not None
    if not planned:
        await send(request("PUT", f"/v1/maps/{MAP}/plan", drawing(".png"), "image/png", m_per_unit=0.01))
    for path, made in ((f"/v1/sites/{SITE}", site_request()), (f"/v1/cameras/{CAMERA}", camera_request())):
        if await found(path) is None:
            await send(made)
    recording, job = (before.recording, before.job) if before else ("", "")
    if not before or await found(f"/v1/recordings/{recording}") is None:
        recording = (await send(recording_request())).json()["recording"]
    if not before or not await _waits(send, job):
        job = (await send(request("POST", f"/v1/recordings/{recording}/jobs", {"map": "walked"}))).json()["id"]
    cancelled = before.cancelled if before else ""
    if not before or await _waits(send, cancelled) is not False:
        cancelled = (await send(request("POST", f"/v1/recordings/{recording}/jobs", {"map": "walked"}))).json()["id"]
        await send(request("DELETE", f"/v1/jobs/{cancelled}"))
    if before:
        await send(request("DELETE", f"/v1/recordings/{before.upload}", headers=TUS))
    upload = (await send(upload_request())).headers["Location"].rsplit("/", 1)[1]
    key = before.key if before else ""
    if not before or await found(f"/v1/keys/{key}") is None:
        key = (await send(request("POST", "/v1/keys", {"scope": "read", "lifetime_s": 86400}))).json()["name"]
    return World(recording, upload, job, cancelled, key)


async def _waits(send: Send, job: str) -> bool | None:
    """Whether a job waits; None where there is none."""
    answer = await send(request("GET", f"/v1/jobs/{job}"))
    return bool(answer.json()["state"] == "queued") if answer.is_success else None


def collection(*features: dict[str, object]) -> dict[str, object]:
    """A FeatureCollection of GeoJSON in the map's frame."""
    return {"type": "FeatureCollection", "frame": "map", "features": [{"type": "Feature", **one} for one in features]}


def good_requests(world: World, operation: str) -> list[Request]:
    """Requests of an operation of OpenAPI that are accepted; those of later operations may undo them."""
    method, path = operation.split(" ")
    of_world = {"recording": world.recording, "job": world.job, "name": world.key}
    plain = request(method, path.format(**NAMED, **of_world))
    return further_requests(world).get(operation, [plain])


def further_requests(world: World) -> dict[str, list[Request]]:
    """The good requests of operations that take more than the names in their path, or other names."""
    of_map, of_recording = f"/v1/maps/{MAP}", f"/v1/recordings/{world.recording}"
    of_upload, of_job = f"/v1/recordings/{world.upload}", f"/v1/jobs/{world.job}"
    corrections = [
        {"kind": "names", "points": [{"name": "door", "position": [0.2, 1.1, 0.0]}],
         "areas": [{"name": "hall", "outline": [[0, 0], [4, 0], [4, 3], [0, 3]]}]},
        {"kind": "labels", "site": "plant", "floor": "1", "tags": ["night"]},
        {"kind": "origin", "at": [0.1, 0.2, 0.0]},
        {"kind": "wall", "direction": [0.98, 0.17, 0.0]},
        {"kind": "north", "direction": [0.1, 0.9, 0.0]},
        {"kind": "up", "direction": [0.0, 0.01, 1.0]},
        {"kind": "scale", "start": [0.0, 0.0, 1.0], "end": [0.0, 2.1, 1.0], "length_m": 2.05},
        {"kind": "plan", "points": [{"map": [0.1, 0.2, 0], "plan": [0.1, 0.2]}, {"map": [3, 0, 0], "plan": [3, 0.1]}]},
        {"kind": "region", "outline": [[-1, -1], [1, -1], [1, 1], [-1, 1]], "keep": "outside"},
        {"kind": "walk", "first_view": 0, "last_view": 0},
    ]  # fmt: skip
    plan = {"type": "LineString", "coordinates": [[0, 0], [4, 0], [4, 3]]}
    ring = [[0, 0], [4, 0], [4, 3], [0, 0]]
    places = collection(
        {"geometry": {"type": "Point", "coordinates": [1, 2, 0]}, "properties": {"name": "dock", "kind": "charger"}},
        {"geometry": {"type": "Polygon", "coordinates": [ring]}, "properties": {"name": "hall", "seats": 4}},
    )
    level = collection(
        {"id": "level", "geometry": plan, "properties": {"level_id": "level", "short_name": {"en": "1"}}}
    )
    imdf = {f"{kind}.geojson": json.dumps(level).encode() for kind in ("level", "unit")}
    bare = replace(upload_request(), headers=())
    keyed = {"scope": "read", "lifetime_s": 3600, "limits": {"requests_per_s": 5, "burst": 20, "maps": 10, "jobs": 2}}
    waypoints = [{"name": f"W{i}", "position": [i, i * i, 1.5], "time_s": 1000.1 + i / 10} for i in range(3)]
    return {
        "POST /v1/maps/{map_name}/localize": asked(f"{of_map}/localize"),
        "POST /v1/maps/{map_name}/localize/frames": [asked_together(f"{of_map}/localize/frames")],
        "POST /v1/localize/frames": [replace(asked_together("v1/localize/frames"), query=(("maps", f"{MAP},annex"),))],
        "POST /v1/localize": [
            replace(one, query=(*one.query, ("maps", f"{MAP},annex"))) for one in asked("v1/localize")
        ],
        "POST /v1/places": [replace(one, query=(("maps", MAP),)) for one in asked("/v1/places")[:3:2]],
        "POST /v1/maps/{map_name}/landscape": asked(f"{of_map}/landscape")[:2],
        "PUT /v1/maps/{map_name}": [map_request("uploaded")],
        "PATCH /v1/maps/{map_name}": [request("PATCH", "/v1/maps/uploaded", {"name": "renamed"})],
        "DELETE /v1/maps/{map_name}": [request("DELETE", "/v1/maps/renamed")],
        "GET /v1/maps/{map_name}/download": [
            request("GET", f"{of_map}/download", format=form) for form in ("rho", "ply", "vtp", "trajectory")
        ],
        "POST /v1/maps/{map_name}/corrections": [request("POST", f"{of_map}/corrections", one) for one in corrections],
        "POST /v1/maps/{map_name}/restore": [request("POST", f"{of_map}/restore", number=1)],
        "PUT /v1/maps/{map_name}/plan": [
            request("PUT", f"{of_map}/plan", drawing(".png"), "image/png", x=1.5, y=-2, turn_deg=3, m_per_unit=0.01),
            request("PUT", f"{of_map}/plan", json.dumps(plan).encode(), "application/geo+json"),
            request("PUT", f"{of_map}/plan", zipped(imdf), "application/zip", x=0, level="1"),
        ],
        "PUT /v1/maps/{map_name}/names": [
            request("PUT", f"{of_map}/names", json.dumps(places).encode(), "application/geo+json"),
        ],
        "POST /v1/maps/{map_name}/update": [
            request("POST", f"{of_map}/update", {"recording": world.recording, "camera": "60,61,31.5,23.5"})
        ],
        "POST /v1/maps/{map_name}/merge": [request("POST", f"{of_map}/merge", {"other": "annex", "into": "merged"})],
        "POST /v1/maps/{map_name}/forget": [request("POST", f"{of_map}/forget", {"source": "walk-1"})],
        "GET /v1/maps/{map_name}/room": [request("GET", f"{of_map}/room", level="true")],
        "GET /v1/maps/{map_name}/scene": [request("GET", f"{of_map}/scene", landmarks=100, level="true")],
        "DELETE /v1/maps/{map_name}/learning": [request("DELETE", f"{of_map}/learning", asker="127.0.0.1")],
        "POST /v1/here/{site}/localize": asked(f"/v1/here/{SITE}/localize")[::2],
        "POST /geopose": [geopose_request()],
        "PUT /v1/sites/{site}": [site_request()],
        "POST /v1/sites/{site}/links": [request("POST", f"/v1/sites/{SITE}/links", {"first": MAP, "second": "annex"})],
        "PUT /v1/cameras/{camera}": [camera_request()],
        "POST /v1/recordings": [recording_request(), upload_request()],
        "OPTIONS /v1/recordings": [replace(bare, method="OPTIONS")],
        "HEAD /v1/recordings/{recording}": [request("HEAD", of_upload, headers=TUS)],
        "PATCH /v1/recordings/{recording}": [
            request("PATCH", of_upload, b"x" * 10, "application/offset+octet-stream", {**TUS, "Upload-Offset": "0"}),
        ],
        "DELETE /v1/recordings/{recording}": [request("DELETE", of_upload, headers=TUS)],
        "PUT /v1/recordings/{recording}/waypoints": [
            request("PUT", f"{of_recording}/waypoints", {"waypoints": waypoints})
        ],
        "POST /v1/recordings/{recording}/jobs": [
            request("POST", f"{of_recording}/jobs", {"map": "walked", "features": "gray", "frames": "0:20"})
        ],
        "GET /v1/jobs": [request("GET", "/v1/jobs", limit=20)],
        "PATCH /v1/jobs/{job}": [request("PATCH", of_job, {"priority": "high"})],
        "POST /v1/jobs/{job}/retry": [request("POST", f"/v1/jobs/{world.cancelled}/retry")],
        "POST /v1/keys": [request("POST", "/v1/keys", keyed)],
        "PUT /v1/keys/{name}/limits": [request("PUT", f"/v1/keys/{world.key}/limits", keyed["limits"])],
        "POST /v1/qr": [request("POST", "/v1/qr", {"text": "https://maps.example/record"})],
        "GET /v1/audit": [request("GET", "/v1/audit", limit=10)],
    }


def asked(path: str) -> list[Request]:
    """A frame, sent in every way there is: as it is, by its features, in a form, with others."""
    picture = a_picture()
    features = {
        "pixels": [[10.5 * i, 7.0 * i] for i in range(40)], "descriptors": ["5a" * 32] * 40,
        "channels": [0] * 40, "sizes_px": [31.0] * 40, "angles_deg": [90.0] * 40,
    }  # fmt: skip
    options = {
        "camera": INTRINSICS, "dof": 6, "gravity": [0.0, 1.0, 0.1], "deadline_ms": 30_000, "with_matches": True,
        "prior": {"position": [1.0, 0.5, 1.5], "heading": [1.0, 0.0, 0.0], "radius_m": 2.0, "radius_deg": 40.0},
    }  # fmt: skip
    parts: dict[str, str | tuple[str, bytes]] = {"image": ("a.jpg", picture), "request": json.dumps(options)}
    return [
        request("POST", path, picture, JPEG, fx=520, fy=520, cx=320, cy=240, dof=5, prior_position="1,0.5,1.5",
                prior_heading="1,0,0", prior_radius_m=2, gravity="0,1,0", deadline_ms=30_000),
        request("POST", path, *form(parts)),
        request("POST", path, picture, JPEG, intrinsics="unknown", deadline_ms=30_000),
        request("POST", path, {**options, "features": features}),
    ]  # fmt: skip


def geopose_request() -> Request:
    """A frame by OSCP's GeoPoseProtocol 2."""
    params = {"model": "PINHOLE", "modelParams": [520, 520, 320, 240]}
    picture = base64.b64encode(a_picture()).decode()
    readings = [{"size": [640, 480], "imageBytes": picture, "params": params}]
    body = {"id": "a1", "timestamp": 1767607200000, "type": "geopose", "sensorReadings": {"cameraReadings": readings}}
    return request("POST", "/geopose", body, site=SITE)


def asked_together(path: str) -> Request:
    """Two frames with relative poses."""
    picture = base64.b64encode(a_picture()).decode()
    posed = {"image": picture, "position": [0, 0, 0], "quaternion_xyzw": [0, 0, 0, 1]}
    frames = [posed, {**posed, "position": [0.1, 0, 0]}]
    return request("POST", path, {"frames": frames, "camera": INTRINSICS, "sigma_m": 0.01})


def a_picture() -> bytes:
    """A query of the shipped map."""
    return sorted((SHIPPED / "queries").glob("*.jpg"))[0].read_bytes()


def good_session() -> list[str | bytes]:
    """The messages of a stream of frames."""
    odometry = {"position": [0.0, 0.0, 0.0], "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0]}
    readings = [[i / 100, 0.0, -9.81, 0.0, 0.0, 0.0, 0.0] for i in range(5)]
    noise = {"drift": 0.02, "turn_drift": 0.01, "heading_drift_deg_m": 0.5}
    return [
        json.dumps({"type": "begin", "camera": INTRINSICS, "dof": 6, "odometry": noise}),
        json.dumps({"type": "frame", "time_s": 0.0, "odometry": odometry, "picture": True}),
        a_picture(),
        json.dumps(
            {"type": "frame", "time_s": 0.1, "odometry": {**odometry, "position": [0.01, 0, 0]}, "imu": readings}
        ),
        json.dumps({"type": "frame", "time_s": 0.2}),
    ]


def befallen(one: Request, choices: random.Random) -> Request:
    """A request to which one to three things have befallen."""
    for _ in range(choices.randint(1, 3)):
        kinds = ["path", "query", "header", "method"] + 8 * ["body"] * bool(one.body) + 3 * ["query"] * bool(one.query)
        one = _BEFALLEN[choices.choice(kinds)](one, choices)
    return one


def _text(choices: random.Random) -> str:
    value = choices.choice(STRANGE) if choices.random() < 0.7 else number(choices)
    return value.decode("utf-8", "replace")


def _path(one: Request, choices: random.Random) -> Request:
    at = choices.randrange(min(2, len(one.path) - 1), len(one.path))
    other = choices.choice((_text(choices)[:300], MAP, CAMERA, "".join(choices.choices(HEX, k=32))))
    return replace(one, path=(*one.path[:at], other, *one.path[at + 1 :]))


def _query(one: Request, choices: random.Random) -> Request:
    pairs = list(one.query)
    at = choices.randrange(len(pairs) + 1)
    if at == len(pairs):
        pairs.append(
            choices.choice(pairs) if pairs and choices.random() < 0.5 else (_text(choices)[:50], _text(choices))
        )
    elif choices.random() < 0.1:
        del pairs[at]
    else:
        value = damaged(pairs[at][1].encode(), choices).decode("utf-8", "replace")
        pairs[at] = (pairs[at][0], value[:5000])
    return replace(one, query=tuple(pairs))


def _header(one: Request, choices: random.Random) -> Request:
    headers = list(one.headers)
    if not headers or choices.random() < 0.3:
        name = choices.choice(HEADERS)
        headers.append((name, ""))
    at = choices.randrange(len(headers))
    value = choices.choice(
        (choices.choice(TYPES), _text(choices), damaged(headers[at][1].encode(), choices).decode("latin-1"))
    )
    printable = "".join(letter for letter in value if " " <= letter <= "~")[:5000]
    headers[at] = (headers[at][0], printable.strip())
    return replace(one, headers=tuple(headers))


def _method(one: Request, choices: random.Random) -> Request:
    return replace(one, method=choices.choice(METHODS))


def _body(one: Request, choices: random.Random) -> Request:
    return replace(one, body=damaged(one.body, choices))


_BEFALLEN: dict[str, Callable[[Request, random.Random], Request]] = {
    "path": _path, "query": _query, "header": _header, "method": _method, "body": _body,
}  # fmt: skip


def befallen_session(choices: random.Random) -> list[str | bytes]:
    """A stream to which one to three things have befallen."""
    messages = good_session()
    for _ in range(choices.randint(1, 3)):
        at = choices.randrange(len(messages))
        one = messages[at]
        content = one.encode("utf-8", "replace") if isinstance(one, str) else one
        how = choices.choice(("damaged", "damaged", "damaged", "lost", "doubled", "other kind"))
        if how == "lost" and len(messages) > 1:
            del messages[at]
        elif how == "doubled":
            messages.insert(at, one)
        else:
            content = damaged(content, choices) if how == "damaged" else content
            as_text = isinstance(one, str) is (how == "damaged")
            messages[at] = content.decode("utf-8", "replace") if as_text else content
    return messages
