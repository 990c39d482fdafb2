"""What both clients share: each method's request, and how its answer is read."""

from __future__ import annotations

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
    CameraProfile,
    Features,
    Frame,
    Job,
    Localization,
    MapSummary,
    NearPlace,
    OfSite,
    Place,
    Prior,
    Site,
    parse_job,
    parse_localization,
    parse_map,
    parse_place,
    parse_profile,
    parse_site,
)

T = TypeVar("T")

Standing = tuple[int, str | None]  # of an upload: how many bytes the service has; the job's id once it has all
Outcome = httpx.Response | httpx.TransportError
Maps = str | Sequence[str] | OfSite | NearPlace | None  # one map, several, a site's, those near a place, or all

NOT_FOUND, PRECONDITION_FAILED = 404, 412
_MINUTES_S = 600.0
_DRAWING_S = 120.0
_PIECE_S = 60.0  # of an upload; the last one is answered once the recording is safe on disk
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
    except (ValueError, KeyError, TypeError) as error:
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


def localize_image(maps: Maps, image: ImageLike, options: Mapping[str, Any]) -> Call[Localization]:
    """Localize a picture."""
    content, media_type = encoded(image)
    files = {
        "image": ("image", content, media_type),
        "request": ("request.json", json.dumps(options).encode(), "application/json"),
    }
    work_s = _work_s(options.get("deadline_ms"))
    return Call("POST", _localize_path(maps), _localization, work_s=work_s, params=_several(maps), files=files)


def localize_features(maps: Maps, features: Features, options: Mapping[str, Any]) -> Call[Localization]:
    """Localize a descriptor set."""
    size = {"width": features.width, "height": features.height}
    body = {**options, "camera": {**size, **options.get("camera", {})}, "features": _features(features)}
    return Call(
        "POST",
        _localize_path(maps),
        _localization,
        work_s=_work_s(options.get("deadline_ms")),
        params=_several(maps),
        headers={"Content-Type": "application/json"},
        content=json.dumps(body).encode(),
    )


def find_places(maps: str | Sequence[str] | None, image: ImageLike, limit: int) -> Call[list[Place]]:
    """The most similar views for a picture."""
    content, media_type = encoded(image)
    names = maps if isinstance(maps, str) else _several(maps)["maps"]
    return Call(
        "POST",
        "/v1/places",
        lambda response: [parse_place(one) for one in response.json()["places"]],
        params={"maps": names, "limit": limit},
        headers={"Content-Type": media_type},
        content=content,
    )


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
            content, media_type = encoded(frame.picture)
            files[f"image{number}"] = (f"image{number}", content, media_type)
        placed = {"position": frame.position, "quaternion_xyzw": frame.quaternion_xyzw}
        sent.append({**_without_none(own), **placed})
    options = {"camera": _chosen(camera), "dof": dof, "deadline_ms": deadline_ms}
    uncertainty = {
        "sigma_m": sigma_m,
        "sigma_deg": sigma_deg,
        "max_sigma_m": max_sigma_m,
        "max_sigma_deg": max_sigma_deg,
        "geopose": geopose,
    }
    body = json.dumps({**_without_none({**options, **uncertainty}), "frames": sent}).encode()
    path, params, work_s = f"{_localize_path(maps)}/frames", _several(maps), _work_s(deadline_ms)
    if not files:
        headers = {"Content-Type": "application/json"}
        return Call("POST", path, _localization, work_s=work_s, params=params, headers=headers, content=body)
    files["request"] = ("request.json", body, "application/json")
    return Call("POST", path, _localization, work_s=work_s, params=params, files=files)


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
    return _without_none(given)


def list_maps() -> Call[list[MapSummary]]:
    """All maps."""
    return Call("GET", "/v1/maps", lambda response: [parse_map(one) for one in response.json()["maps"]])


def get_map(name: str) -> Call[MapSummary]:
    """One map."""
    return Call("GET", _map_path(name), _map)


def map_report(name: str) -> Call[dict[str, Any]]:
    """A map's own quality report."""
    return Call("GET", f"{_map_path(name)}/report", lambda response: dict(response.json()["report"]))


def map_preview(name: str) -> Call[bytes]:
    """A map from above, as PNG."""
    return Call("GET", f"{_map_path(name)}/preview.png", lambda response: response.content, work_s=_DRAWING_S)


def upload_map(name: str, content: bytes, condition: Mapping[str, str]) -> Call[MapSummary]:
    """Put a map under a name, if it meets a condition: HTTP's ``If-Match`` or ``If-None-Match``, or none."""
    headers = {"Content-Type": "application/octet-stream", **condition}
    return Call("PUT", _map_path(name), _map, idempotent=False, work_s=_MINUTES_S, headers=headers, content=content)


def stored_map(name: str) -> Call[tuple[bytes | None, dict[str, str]]]:
    """A map's file, None if there is none, and the condition that this is still so, empty if it cannot be said."""

    def read(response: httpx.Response) -> tuple[bytes | None, dict[str, str]]:
        if response.status_code == NOT_FOUND:
            return None, {"If-None-Match": "*"}
        etag = response.headers.get("ETag")
        return response.content, {} if etag is None else {"If-Match": etag}

    return Call("GET", f"{_map_path(name)}/download", read, answers=frozenset({NOT_FOUND}))


def map_report_picture(name: str) -> Call[bytes]:
    """A map's own quality report, as PNG."""
    return Call("GET", f"{_map_path(name)}/report.png", lambda response: response.content, work_s=_DRAWING_S)


def download_map(name: str, format: str, degree: int | None, features: Sequence[int] | None) -> Call[bytes]:
    """A map's file."""
    chosen = None if features is None else ",".join(map(str, features))
    params = _without_none({"format": format, "degree": degree, "features": chosen})
    made = params != {"format": "rho"}
    return Call(
        "GET",
        f"{_map_path(name)}/download",
        lambda response: response.content,
        idempotent=not made,
        work_s=_MINUTES_S if made else 0.0,
        params=params,
    )


def rename_map(name: str, new_name: str) -> Call[MapSummary]:
    """Give a map another name."""
    return Call(
        "PATCH",
        _map_path(name),
        _map,
        idempotent=False,
        headers={"Content-Type": "application/json"},
        content=json.dumps({"name": new_name}).encode(),
    )


def update_map(name: str, fields: Mapping[str, Any]) -> Call[Job]:
    """Learn a stored recording into a map; the answer is the job that does this."""
    return _post(f"{_map_path(name)}/update", _without_none(fields), _job)


def learn_from_users(name: str) -> Call[Job]:
    """Let a map learn from the queries that are kept for it; the answer is the job that does."""
    return _post(f"{_map_path(name)}/learn", {}, _job)


def merge_maps(name: str, other: str, into: str) -> Call[MapSummary]:
    """Merge another map into a map's frame."""
    return _post(f"{_map_path(name)}/merge", {"other": other, "into": into}, _map, _MINUTES_S)


def forget_recording(name: str, source: str) -> Call[MapSummary]:
    """Take a recording out of a map."""
    return _post(f"{_map_path(name)}/forget", {"source": source}, _map, _MINUTES_S)


def correct_map(name: str, correction: Mapping[str, Any]) -> Call[MapSummary]:
    """Correct a map."""
    return _post(f"{_map_path(name)}/corrections", dict(correction), _map, _MINUTES_S)


def restore_map(name: str, number: int) -> Call[MapSummary]:
    """Put back a map that was replaced."""
    return Call("POST", f"{_map_path(name)}/restore", _map, idempotent=False, params={"number": number})


def put_names(name: str, source: PlaceSource, level: str | None) -> Call[MapSummary]:
    """Set a map's named points and areas."""
    return _put_file(f"{_map_path(name)}/names", source, {"level": level})


def put_floor_plan(name: str, source: PlaceSource, params: Mapping[str, Any]) -> Call[MapSummary]:
    """Keep a floor plan with a map."""
    return _put_file(f"{_map_path(name)}/plan", source, params)


def delete_floor_plan(name: str) -> Call[MapSummary]:
    """Remove a map's floor plan."""
    return Call("DELETE", f"{_map_path(name)}/plan", _map, idempotent=False)


def landscape(name: str, image: ImageLike, camera: Camera | str | None) -> Call[dict[str, Any]]:
    """Where a picture may have been taken."""
    content, media_type = encoded(image)
    options = _without_none({"camera": _chosen(camera)})
    files = {
        "image": ("image", content, media_type),
        "request": ("request.json", json.dumps(options).encode(), "application/json"),
    }
    return Call("POST", f"{_map_path(name)}/landscape", _dict, work_s=_MINUTES_S, files=files)


def localize_visitor(site: str, image: ImageLike, camera: Camera | None) -> Call[dict[str, Any]]:
    """Localize a visitor's picture in a site."""
    content, media_type = encoded(image)
    given = _intrinsics(camera) if camera is not None else {}
    params = {key: ",".join(map(str, value)) if key == "distortion" else value for key, value in given.items()}
    headers = {"Content-Type": media_type}
    path = _path("here", site, "localize")
    return Call("POST", path, _dict, params=_without_none(params), headers=headers, content=content)


def geopose(request: Mapping[str, Any], maps: Maps) -> Call[dict[str, Any]]:
    """A request of OSCP's GeoPoseProtocol."""
    kind = "application/vnd.oscp+json;version=2.0"
    params = {"maps": maps} if isinstance(maps, str) else _several(maps)
    headers = {"Content-Type": "application/json", "Accept": kind}
    return Call("POST", "/geopose", _dict, params=params, headers=headers, content=json.dumps(dict(request)).encode())


def fetch(*parts: str | int, **params: Any) -> Call[dict[str, Any]]:
    """JSON of ``/v1/part/part…``."""
    return Call("GET", _path(*parts), _dict, params=_without_none(params))


def fetch_list(member: str, *parts: str | int, **params: Any) -> Call[list[dict[str, Any]]]:
    """List of objects that is one member of the JSON of ``/v1/part/part…``."""
    return Call("GET", _path(*parts), lambda answer: list(answer.json()[member]), params=_without_none(params))


def fetch_bytes(*parts: str | int, **params: Any) -> Call[bytes]:
    """Bytes of ``/v1/part/part…``."""
    return Call("GET", _path(*parts), lambda answer: answer.content, work_s=_DRAWING_S, params=_without_none(params))


def fetch_plain(path: str) -> Call[str]:
    """Text of a path."""
    return Call("GET", path, lambda answer: answer.text)


def fetch_root(path: str) -> Call[dict[str, Any]]:
    """JSON of a path outside ``/v1``."""
    return Call("GET", path, _dict)


def send(method: str, *parts: str | int, body: Mapping[str, Any] | None = None) -> Call[dict[str, Any]]:
    """JSON that answers a change of ``/v1/part/part…``; empty where nothing is answered."""
    headers = {} if body is None else {"Content-Type": "application/json"}
    content = None if body is None else json.dumps(dict(body)).encode()
    return Call(
        method,
        _path(*parts),
        lambda answer: _dict(answer) if answer.content else {},
        False,
        headers=headers,
        content=content,
    )


def delete_queries(name: str, asker: str | None) -> Call[int]:
    """Delete a map's kept queries."""
    path, params = f"{_map_path(name)}/learning", _without_none({"asker": asker})
    return Call("DELETE", path, lambda answer: int(answer.json()["deleted"]), idempotent=False, params=params)


def map_recording(recording: str, fields: Mapping[str, Any]) -> Call[Job]:
    """Map a stored recording."""
    return _post(f"{_recording_path(recording)}/jobs", _without_none(fields), _job)


def draw_qr(text: str) -> Call[str]:
    """A QR code, as SVG."""
    return _post("/v1/qr", {"text": text}, lambda answer: answer.text)


def upload_rules() -> Call[dict[str, str]]:
    """What the service takes of resumable uploads."""
    return Call("OPTIONS", "/v1/recordings", lambda answer: dict(answer.headers))


def stream(http: httpx.Client | httpx.AsyncClient, *parts: str | int) -> dict[str, Any]:
    """What ``http.stream`` takes for a stream of server-sent events, between which much time may pass."""
    own = http.timeout
    timeout = httpx.Timeout(connect=own.connect, read=None, write=own.write, pool=own.pool)
    return {"url": _path(*parts), "headers": {"Accept": "text/event-stream"}, "timeout": timeout}


def event_data(lines: list[str]) -> Any:
    """The JSON of a server-sent event's lines; None if it has none."""
    data = "\n".join(line[5:].removeprefix(" ") for line in lines if line.startswith("data:"))
    return json.loads(data) if data else None


def list_cameras() -> Call[list[CameraProfile]]:
    """All stored cameras."""
    return Call("GET", "/v1/cameras", lambda response: [parse_profile(one) for one in response.json()["cameras"]])


def get_camera(name: str) -> Call[CameraProfile]:
    """One stored camera."""
    return Call("GET", _camera_path(name), _profile)


def put_camera(name: str, camera: Camera, calibration: Mapping[str, Any] | None) -> Call[CameraProfile]:
    """Store a camera under a name."""
    body = {**_intrinsics(camera), "calibration": dict(calibration or {})}
    headers = {"Content-Type": "application/json"}
    return Call("PUT", _camera_path(name), _profile, headers=headers, content=json.dumps(body).encode())


def delete_camera(name: str) -> Call[None]:
    """Delete a stored camera."""
    return Call("DELETE", _camera_path(name), lambda response: None, idempotent=False)


def list_sites() -> Call[list[Site]]:
    """All sites."""
    return Call("GET", "/v1/sites", lambda response: [parse_site(one) for one in response.json()["sites"]])


def get_site(name: str) -> Call[Site]:
    """One site."""
    return Call("GET", _site_path(name), _site)


def put_site(name: str, document: Mapping[str, Any]) -> Call[Site]:
    """Store a site."""
    headers = {"Content-Type": "application/json"}
    content = json.dumps(dict(document)).encode()
    return Call("PUT", _site_path(name), _site, "version" not in document, headers=headers, content=content)


def find_site_link(name: str, first: str, second: str) -> Call[Site]:
    """Find the pose between two maps of a site."""
    return _post(f"{_site_path(name)}/links", {"first": first, "second": second}, _site, _MINUTES_S)


def place_site(name: str) -> Call[Job]:
    """Place the maps of a site; the answer is the job that does."""
    return _post(f"{_site_path(name)}/place", {}, _job)


def delete_site(name: str) -> Call[None]:
    """Delete a site."""
    return Call("DELETE", _site_path(name), lambda response: None, idempotent=False)


def delete_map(name: str) -> Call[None]:
    """Delete a map."""
    return Call("DELETE", _map_path(name), lambda response: None, idempotent=False)


def begin_upload(name: str, length: int, fields: Mapping[str, str | None]) -> Call[str]:
    """Announce a recording's file of ``length`` bytes; the answer is the recording's id.

    If it is announced twice, the service drops the one that stays empty.
    """
    metadata_fields = {"filename": name, **_without_none(fields)}
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
    path = _recording_path(recording)
    return Call("PATCH", path, _standing, idempotent=False, work_s=_PIECE_S, headers=headers, content=piece)


def upload_standing(recording: str) -> Call[Standing]:
    """Where the upload stands."""
    return Call("HEAD", _recording_path(recording), _standing, headers=_TUS)


def get_job(job_id: str) -> Call[Job]:
    """One job."""
    return Call("GET", _job_path(job_id), _job)


def list_jobs(before: str | None = None) -> Call[list[Job]]:
    """The newest jobs, or those before one of them, the newest first."""
    params = _without_none({"before": before})
    return Call("GET", "/v1/jobs", lambda response: [parse_job(one) for one in response.json()["jobs"]], params=params)


def cancel_job(job_id: str) -> Call[Job]:
    """Cancel a job."""
    return Call("DELETE", _job_path(job_id), _job, idempotent=False)


def retry_job(job_id: str) -> Call[Job]:
    """Try a job again."""
    return Call("POST", f"{_job_path(job_id)}/retry", _job, idempotent=False)


def prioritize_job(job_id: str, priority: str) -> Call[Job]:
    """Change how soon a job's turn comes."""
    body = json.dumps({"priority": priority}).encode()
    return Call("PATCH", _job_path(job_id), _job, headers={"Content-Type": "application/json"}, content=body)


def readiness() -> Call[dict[str, str]]:
    """What is ready."""
    return Call("GET", "/readyz", lambda response: dict(response.json()["checks"]), answers=frozenset({503}))


def _put_file(path: str, source: PlaceSource, params: Mapping[str, Any]) -> Call[MapSummary]:
    content, media_type = plan_content(source)
    headers, params = {"Content-Type": media_type}, _without_none(params)
    return Call("PUT", path, _map, False, work_s=_MINUTES_S, params=params, headers=headers, content=content)


def _dict(response: httpx.Response) -> dict[str, Any]:
    return dict(response.json())


def _path(*parts: str | int) -> str:
    return "/".join(["/v1", *(_segment(str(part)) for part in parts)])


def _standing(response: httpx.Response) -> Standing:
    return int(response.headers["Upload-Offset"]), response.headers.get("Rholoc-Job")


def _last_part(address: str) -> str:
    return address.rstrip("/").rsplit("/", 1)[1]


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def _post(path: str, body: Mapping[str, Any], read: Callable[[httpx.Response], T], work_s: float = 0.0) -> Call[T]:
    headers, content = {"Content-Type": "application/json"}, json.dumps(body).encode()
    return Call("POST", path, read, idempotent=False, work_s=work_s, headers=headers, content=content)


def _work_s(deadline_ms: float | None) -> float:
    return 0.0 if deadline_ms is None else deadline_ms / 1000


def _localization(response: httpx.Response) -> Localization:
    return parse_localization(response.json())


def _map(response: httpx.Response) -> MapSummary:
    return parse_map(response.json())


def _profile(response: httpx.Response) -> CameraProfile:
    return parse_profile(response.json())


def _job(response: httpx.Response) -> Job:
    return parse_job(response.json())


def _localize_path(maps: Maps) -> str:
    return f"{_map_path(maps)}/localize" if isinstance(maps, str) else "/v1/localize"


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


def _site_path(name: str) -> str:
    return f"/v1/sites/{_segment(name)}"


def _site(response: httpx.Response) -> Site:
    return parse_site(response.json())


def _map_path(name: str) -> str:
    return f"/v1/maps/{_segment(name)}"


def _camera_path(name: str) -> str:
    return f"/v1/cameras/{_segment(name)}"


def _recording_path(recording: str) -> str:
    return f"/v1/recordings/{_segment(recording)}"


def _job_path(job_id: str) -> str:
    return f"/v1/jobs/{_segment(job_id)}"


def _segment(text: str) -> str:
    """A path segment; dots alone would be taken for a way up, so they are escaped too."""
    return quote(text, safe="") if text.strip(".") else "%2E" * len(text)


def _chosen(camera: Camera | str | None) -> dict[str, Any] | None:
    return {"name": camera} if isinstance(camera, str) else _camera(camera)


def _camera(camera: Camera | None) -> dict[str, Any] | None:
    return None if camera is None else _intrinsics(camera)


def _intrinsics(camera: Camera) -> dict[str, Any]:
    """A camera as JSON; of a pinhole without its lens, which earlier servers do not know."""
    fields = _without_none(asdict(camera))
    return {name: value for name, value in fields.items() if (name, value) != ("lens", "pinhole")}


def _without_none(values: Mapping[str, Any]) -> dict[str, Any]:
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
