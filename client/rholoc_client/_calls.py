"""What both clients share: each method's request, and how its answer is read."""

import base64
import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Generic, TypeVar
from urllib.parse import quote

import httpx

from rholoc_client._images import ImageLike, encoded
from rholoc_client._plans import PlaceSource, plan_content
from rholoc_client.errors import BY_CODE, ConnectionFailed, InvalidAnswer, ServiceError
from rholoc_client.models import (
    Camera,
    Features,
    Frame,
    Localization,
    MapSummary,
    NearPlace,
    OfSite,
    Place,
    Prior,
    parse_localization,
    parse_map,
    parse_place,
)

T = TypeVar("T")

Standing = tuple[int, str | None]  # of an upload: how many bytes the service has; the job's id once it has all
Outcome = httpx.Response | httpx.TransportError
Maps = str | Sequence[str] | OfSite | NearPlace | None  # one map, several, a site's, those near a place, or all

NOT_FOUND, PRECONDITION_FAILED = 404, 412
MINUTES_S = 600.0
_DRAWING_S = 120.0
_PIECE_S = 60.0  # of an upload; the last one is answered once the recording is safe on disk
_JSON = {"Content-Type": "application/json"}
_TUS = {"Tus-Resumable": "1.0.0"}


@dataclass(frozen=True)
class Call(Generic[T]):
    """One request and how to read its answer.

    ``idempotent``: sending it twice does no harm. ``answers``: error statuses that are answers all the same.
    ``work_s``: how long the service may work before it answers, beyond the client's own timeout [s].
    """

    method: str
    path: str
    read: Callable[[httpx.Response], T]
    idempotent: bool = True
    answers: frozenset[int] = frozenset()
    work_s: float = 0.0
    params: Mapping[str, Any] = field(default_factory=dict)
    headers: Mapping[str, str] = field(default_factory=dict)
    content: bytes | None = None
    files: Mapping[str, Any] | None = None


def result_of(call: Call[T], outcome: Outcome) -> T:
    """What the answer says.

    Raises:
        ConnectionFailed: there was no answer.
        ServiceError: the service answered with an error.
        InvalidAnswer: the answer is not this service's.
    """
    if isinstance(outcome, httpx.TransportError):
        raise unreachable(outcome) from outcome
    if outcome.is_error and outcome.status_code not in call.answers:
        raise error_of(outcome)
    try:
        return call.read(outcome)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InvalidAnswer(f"{outcome.url} did not answer as the rholoc service does: {error!r}.") from error


def unreachable(error: httpx.TransportError) -> ConnectionFailed:
    """The exception for a request without an answer."""
    return ConnectionFailed(f"{error.request.url} did not answer: {str(error) or type(error).__name__}.")


def error_of(response: httpx.Response) -> ServiceError:
    """The exception for an answer that is an error."""
    try:
        body = response.json()
        code, message = str(body["code"]), str(body["message"])
        hint, request_id = str(body.get("hint", "")), str(body.get("request_id", ""))
    except (ValueError, KeyError, TypeError, AttributeError):
        code, message, hint = "error", f"{response.url} answered with status {response.status_code}.", ""
        request_id = response.headers.get("X-Request-ID", "")
    return BY_CODE.get(code, ServiceError)(message, hint, request_id, response.status_code, code)


def path_of(*parts: str | int) -> str:
    """The path ``/v1/part/part…``, each part escaped."""
    return "/".join(["/v1", *(_segment(str(part)) for part in parts)])


def json_of(parse: Callable[[Any], T]) -> Callable[[httpx.Response], T]:
    """Reader of an answer: ``parse`` of its JSON."""
    return lambda answer: parse(answer.json())


def fetch(parse: Callable[[Any], T], *parts: str | int, **params: Any) -> Call[T]:
    """JSON of ``/v1/part/part…``."""
    return Call("GET", path_of(*parts), json_of(parse), params=without_none(params))


def fetch_list(member: str, parse: Callable[[Any], T], *parts: str | int, **params: Any) -> Call[list[T]]:
    """List of objects that is one member of the JSON of ``/v1/part/part…``."""
    return fetch(lambda body: [parse(one) for one in body[member]], *parts, **params)


def fetch_bytes(*parts: str | int, **params: Any) -> Call[bytes]:
    """Bytes of ``/v1/part/part…``, which the service may have to draw."""
    return Call("GET", path_of(*parts), lambda answer: answer.content, work_s=_DRAWING_S, params=without_none(params))


def change(
    parse: Callable[[Any], T],
    method: str,
    *parts: str | int,
    body: Mapping[str, Any] | None = None,
    idempotent: bool = False,
    work_s: float = 0.0,
    **params: Any,
) -> Call[T]:
    """Request that changes ``/v1/part/part…``. Its answer: ``parse`` of the JSON, of {} without content."""
    path, given = path_of(*parts), without_none(params)
    headers = {} if body is None else _JSON
    content = None if body is None else json.dumps(dict(body)).encode()

    def read(answer: httpx.Response) -> T:
        return parse(answer.json() if answer.content else {})

    return Call(method, path, read, idempotent, work_s=work_s, params=given, headers=headers, content=content)


def draw_qr(text: str) -> Call[str]:
    """A QR code, as SVG."""
    content = json.dumps({"text": text}).encode()
    return Call("POST", "/v1/qr", lambda answer: answer.text, idempotent=False, headers=_JSON, content=content)


def put_file(source: PlaceSource, *parts: str, **params: Any) -> Call[MapSummary]:
    """Keep a file with a map."""
    content, media_type = plan_content(source)
    return _put_map({"Content-Type": media_type}, content, *parts, **params)


def _put_map(headers: Mapping[str, str], content: bytes, *parts: str, **params: Any) -> Call[MapSummary]:
    path, given, read = path_of(*parts), without_none(params), json_of(parse_map)
    return Call("PUT", path, read, False, work_s=MINUTES_S, params=given, headers=headers, content=content)


def localize_image(maps: Maps, image: ImageLike, options: Mapping[str, Any]) -> Call[Localization]:
    """Localize a picture."""
    return _localize(maps, (), options, _picture_form(image, options))


def localize_features(maps: Maps, features: Features, options: Mapping[str, Any]) -> Call[Localization]:
    """Localize a descriptor set."""
    size = {"width": features.width, "height": features.height}
    body = {**options, "camera": {**size, **options.get("camera", {})}, "features": _features(features)}
    return _localize(maps, (), body)


def _localize(
    maps: Maps, parts: tuple[str, ...], request: Mapping[str, Any], files: Mapping[str, Any] | None = None
) -> Call[Localization]:
    """Localize by ``request``, sent as JSON, or as one of ``files``, which hold it already. ``parts`` end the path."""
    path = path_of(*(("maps", maps) if isinstance(maps, str) else ()), "localize", *parts)
    work_s, read = (request.get("deadline_ms") or 0.0) / 1000, json_of(parse_localization)
    if files is not None:
        return Call("POST", path, read, work_s=work_s, params=_several(maps), files=files)
    content = json.dumps(request).encode()
    return Call("POST", path, read, work_s=work_s, params=_several(maps), headers=_JSON, content=content)


def _picture_form(image: ImageLike, request: Mapping[str, Any]) -> dict[str, Any]:
    """The parts of a form with a picture and a request."""
    return {"image": ("image", *encoded(image)), "request": _request_part(request)}


def _request_part(request: Mapping[str, Any]) -> tuple[str, bytes, str]:
    return "request.json", json.dumps(request).encode(), "application/json"


def find_places(maps: str | Sequence[str] | None, image: ImageLike, limit: int) -> Call[list[Place]]:
    """The most similar views for a picture."""
    content, media_type = encoded(image)
    names = maps if isinstance(maps, str) else _several(maps)["maps"]
    params, headers = {"maps": names, "limit": limit}, {"Content-Type": media_type}
    read = json_of(lambda body: [parse_place(one) for one in body["places"]])
    return Call("POST", "/v1/places", read, params=params, headers=headers, content=content)


def localize_frames(
    maps: Maps,
    frames: Sequence[Frame],
    camera: Camera | str | None,
    dof: int | str | None,
    sigma_m: float | None,
    sigma_deg: float | None,
    deadline_ms: float | None,
    max_sigma_m: float | None = None,
    max_sigma_deg: float | None = None,
    geopose: str | None = None,
) -> Call[Localization]:
    """Localize several frames together."""
    files: dict[str, Any] = {}
    sent = []
    for number, frame in enumerate(frames):
        own: dict[str, Any] = {"camera": _chosen(frame.camera), "gravity": frame.gravity}
        if isinstance(frame.picture, Features):
            size = {"width": frame.picture.width, "height": frame.picture.height}
            own["camera"] = {**size, **(own["camera"] or _chosen(camera) or {})}
            own["features"] = _features(frame.picture)
        else:
            files[f"image{number}"] = (f"image{number}", *encoded(frame.picture))
        placed = {"position": frame.position, "quaternion_xyzw": frame.quaternion_xyzw}
        sent.append({**without_none(own), **placed})
    options = {"camera": _chosen(camera), "dof": dof, "deadline_ms": deadline_ms}
    uncertainty = {
        "sigma_m": sigma_m,
        "sigma_deg": sigma_deg,
        "max_sigma_m": max_sigma_m,
        "max_sigma_deg": max_sigma_deg,
        "geopose": geopose,
    }
    body = {**without_none({**options, **uncertainty}), "frames": sent}
    return _localize(maps, ("frames",), body, {**files, "request": _request_part(body)} if files else None)


def _features(features: Features) -> dict[str, Any]:
    sent: dict[str, Any] = {
        "pixels": [[float(u), float(v)] for u, v in features.pixels],
        "descriptors": _base64(b"".join(bytes(one) for one in features.descriptors)),
    }
    if features.channels is not None:
        sent["channels"] = [one if isinstance(one, str) else int(one) for one in features.channels]
    if features.sizes_px is not None:
        sent["sizes_px"] = [float(one) for one in features.sizes_px]
    if features.angles_deg is not None:
        sent["angles_deg"] = [_number_or_none(one) for one in features.angles_deg]
    return sent


def _number_or_none(value: float | None) -> float | None:
    """JSON has no NaN."""
    return None if value is None or math.isnan(value) else float(value)


def localize_options(
    camera: Camera | str | None,
    prior: Prior | None,
    dof: int | str | None,
    gravity: tuple[float, float, float] | None,
    deadline_ms: float | None,
    intrinsics: str | None = None,
    with_matches: bool = False,
    max_sigma_m: float | None = None,
    max_sigma_deg: float | None = None,
    geopose: str | None = None,
) -> dict[str, Any]:
    """The options of a localization as the service takes them, without those that are None."""
    given = {
        "camera": _chosen(camera),
        "prior": None if prior is None else prior.as_sent(),
        "dof": dof,
        "gravity": gravity,
        "deadline_ms": deadline_ms,
        "intrinsics": intrinsics,
        "with_matches": with_matches or None,
        "max_sigma_m": max_sigma_m,
        "max_sigma_deg": max_sigma_deg,
        "geopose": geopose,
    }
    return without_none(given)


def upload_map(name: str, content: bytes, condition: Mapping[str, str]) -> Call[MapSummary]:
    """Put a map under a name, if it meets a condition: HTTP's ``If-Match`` or ``If-None-Match``, or none."""
    return _put_map({"Content-Type": "application/octet-stream", **condition}, content, "maps", name)


def stored_map(name: str) -> Call[tuple[bytes | None, dict[str, str]]]:
    """A map's file, None if there is none, and the condition that this is still so, empty if it cannot be said."""

    def read(response: httpx.Response) -> tuple[bytes | None, dict[str, str]]:
        if response.status_code == NOT_FOUND:
            return None, {"If-None-Match": "*"}
        etag = response.headers.get("ETag")
        return response.content, {} if etag is None else {"If-Match": etag}

    return Call("GET", path_of("maps", name, "download"), read, answers=frozenset({NOT_FOUND}))


def download_map(name: str, format: str, degree: int | None, features: Sequence[int] | None) -> Call[bytes]:
    """A map's file."""
    chosen = None if features is None else ",".join(map(str, features))
    params = without_none({"format": format, "degree": degree, "features": chosen})
    made = params != {"format": "rho"}
    return Call(
        "GET",
        path_of("maps", name, "download"),
        lambda answer: answer.content,
        idempotent=not made,
        work_s=MINUTES_S if made else 0.0,
        params=params,
    )


def landscape(name: str, image: ImageLike, camera: Camera | str | None) -> Call[dict[str, Any]]:
    """Where a picture may have been taken."""
    files = _picture_form(image, without_none({"camera": _chosen(camera)}))
    return Call("POST", path_of("maps", name, "landscape"), json_of(dict), work_s=MINUTES_S, files=files)


def localize_visitor(site: str, image: ImageLike, camera: Camera | None) -> Call[dict[str, Any]]:
    """Localize a visitor's picture in a site."""
    content, media_type = encoded(image)
    given = intrinsics(camera) if camera is not None else {}
    params = {key: ",".join(map(str, value)) if key == "distortion" else value for key, value in given.items()}
    headers = {"Content-Type": media_type}
    path = path_of("here", site, "localize")
    return Call("POST", path, json_of(dict), params=without_none(params), headers=headers, content=content)


def geopose(request: Mapping[str, Any], maps: Maps) -> Call[dict[str, Any]]:
    """A request of OSCP's GeoPoseProtocol."""
    kind = "application/vnd.oscp+json;version=2.0"
    params = {"maps": maps} if isinstance(maps, str) else _several(maps)
    headers, content = {**_JSON, "Accept": kind}, json.dumps(dict(request)).encode()
    return Call("POST", "/geopose", json_of(dict), params=params, headers=headers, content=content)


def readiness() -> Call[dict[str, str]]:
    """What is ready."""
    return Call("GET", "/readyz", json_of(lambda body: dict(body["checks"])), answers=frozenset({503}))


def stream(http: httpx.Client | httpx.AsyncClient, *parts: str | int) -> dict[str, Any]:
    """What ``http.stream`` takes for a stream of server-sent events, between which much time may pass."""
    own = http.timeout
    timeout = httpx.Timeout(connect=own.connect, read=None, write=own.write, pool=own.pool)
    return {"url": path_of(*parts), "headers": {"Accept": "text/event-stream"}, "timeout": timeout}


def event_data(lines: list[str]) -> Any:
    """The JSON of a server-sent event's lines; None if it has none."""
    data = "\n".join(line[5:].removeprefix(" ") for line in lines if line.startswith("data:"))
    return json.loads(data) if data else None


def begin_upload(name: str, length: int, fields: Mapping[str, str | None]) -> Call[str]:
    """Announce a recording's file of ``length`` bytes; the answer is the recording's id.

    If it is announced twice, the service drops the one that stays empty.
    """
    metadata_fields = {"filename": name, **without_none(fields)}
    metadata = ",".join(f"{key} {_base64(value.encode())}" for key, value in metadata_fields.items())
    headers = {**_TUS, "Upload-Length": str(length), "Upload-Metadata": metadata}
    return Call("POST", "/v1/recordings", lambda response: _last_part(response.headers["Location"]), headers=headers)


def continue_upload(recording: str, offset: int, piece: bytes) -> Call[Standing]:
    """Send the bytes from ``offset`` on; the answer is where the upload stands."""
    headers = {
        **_TUS,
        "Upload-Offset": str(offset),
        "Upload-Checksum": f"sha256 {_base64(hashlib.sha256(piece).digest())}",
        "Content-Type": "application/offset+octet-stream",
    }
    path = path_of("recordings", recording)
    return Call("PATCH", path, _standing, idempotent=False, work_s=_PIECE_S, headers=headers, content=piece)


def upload_standing(recording: str) -> Call[Standing]:
    """Where the upload stands."""
    return Call("HEAD", path_of("recordings", recording), _standing, headers=_TUS)


def _standing(response: httpx.Response) -> Standing:
    return int(response.headers["Upload-Offset"]), response.headers.get("Rholoc-Job")


def _last_part(address: str) -> str:
    return address.rstrip("/").rsplit("/", 1)[1]


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def _several(maps: Maps) -> dict[str, Any]:
    match maps:
        case str():
            return {}
        case None:
            return {"maps": "all"}
        case OfSite():
            return {"site": maps.site}
        case NearPlace():
            return {"latitude": maps.latitude_deg, "longitude": maps.longitude_deg, "radius_m": maps.radius_m}
        case _:
            return {"maps": ",".join(maps)}


def _segment(text: str) -> str:
    """A path segment; dots alone would be taken for a way up, so they are escaped too."""
    return quote(text, safe="") if text.strip(".") else "%2E" * len(text)


def _chosen(camera: Camera | str | None) -> dict[str, Any] | None:
    return {"name": camera} if isinstance(camera, str) else _camera(camera)


def _camera(camera: Camera | None) -> dict[str, Any] | None:
    return None if camera is None else intrinsics(camera)


def intrinsics(camera: Camera) -> dict[str, Any]:
    """A camera as JSON; of a pinhole without its lens, which earlier servers do not know."""
    fields = without_none(asdict(camera))
    return {name: value for name, value in fields.items() if (name, value) != ("lens", "pinhole")}


def without_none(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values that are not None."""
    return {name: value for name, value in values.items() if value is not None}


def headers(api_key: str | None) -> dict[str, str]:
    """The headers of every request."""
    return {} if api_key is None else {"Authorization": f"Bearer {api_key}"}


def request(http: httpx.Client | httpx.AsyncClient, call: Call[T]) -> httpx.Request:
    """A call as a request of ``http``, with time for the service to work on it."""
    own = http.timeout
    read_s = None if own.read is None else own.read + call.work_s
    return http.build_request(
        call.method,
        call.path,
        params=call.params,
        headers=call.headers,
        content=call.content,
        files=call.files,
        timeout=httpx.Timeout(connect=own.connect, read=read_s, write=own.write, pool=own.pool),
    )


def camera_text(camera: Camera | str | None) -> str | None:
    """Intrinsics as the fields of a form have them; a stored camera's name is returned unchanged."""
    if camera is None or isinstance(camera, str):
        return camera
    values = (camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion)
    text = ",".join(repr(float(value)) for value in values)
    return text if camera.lens == "pinhole" else f"{camera.lens}:{text}"
