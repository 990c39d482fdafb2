# Written by client/write_sync.py from _async/client.py: change that one, and run `make format`.
"""The client: each method's request is sent, again if need be, and its answer read."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import httpx

from rholoc_client import _calls
from rholoc_client._calls import (
    Call,
    Maps,
    Outcome,
    camera_text,
    change,
    fetch,
    fetch_bytes,
    fetch_list,
    put_file,
    without_none,
)
from rholoc_client._images import ImageLike
from rholoc_client._plans import PlaceSource
from rholoc_client._retry import Attempts, Backoff
from rholoc_client._uploads import (
    UploadProgress,
    content_of,
    map_upload_steps,
    opened_recording,
    recording_fields,
    upload_steps,
)
from rholoc_client._waiting import JobProgress, deadline_of, next_look_s, published
from rholoc_client.errors import RholocClientError
from rholoc_client.models import (
    Camera,
    CameraProfile,
    Features,
    Frame,
    Job,
    Localization,
    MapSummary,
    Place,
    Prior,
    Site,
    Vector3,
    parse_job,
    parse_map,
    parse_profile,
    parse_site,
)

T = TypeVar("T")


class Client:
    """The service. Use it in a ``with`` statement.

    :class:`Client` blocks until the service answers and is safe to share between threads. :class:`AsyncClient` is for
    asyncio, with ``async with`` and ``await``.

    Args:
        base_url: where the service is, ``http://host:port``.
        api_key: sent as a bearer token, where the service requires one.
        timeout_s: how long to wait for a connection, and for each piece of an answer; for an answer that the service
            works on, so much longer than a request's ``deadline_ms``, or than the minutes that the work may take.
        retries: how often to ask again when the service is busy, or when the connection failed and asking twice
            does no harm; with exponential back-off, jitter, and the service's ``Retry-After``.
        transport: an httpx transport to use instead of the network.

    Every method raises :class:`ConnectionFailed`, :class:`InvalidAnswer`, or the :class:`ServiceError` that the
    service answered with.
    """

    def __init__(
        self,
        base_url: str,
        api_key: str | None = None,
        timeout_s: float | None = 10.0,
        retries: int = 4,
        transport: httpx.BaseTransport | None = None,
    ) -> None:
        self._http = httpx.Client(
            base_url=base_url, headers=_calls.headers(api_key), timeout=timeout_s, transport=transport
        )
        self._backoff = Backoff(retries)

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def localize(
        self,
        maps: Maps,
        image: ImageLike,
        *,
        camera: Camera | str | None = None,
        prior: Prior | None = None,
        dof: int | str | None = None,
        gravity: Vector3 | None = None,
        deadline_ms: float | None = None,
        max_sigma_m: float | None = None,
        max_sigma_deg: float | None = None,
        intrinsics: str | None = None,
        with_matches: bool = False,
        geopose: str | None = None,
    ) -> Localization:
        """Where a picture was taken. "No pose" is an answer: look at ``localized``.

        Args:
            maps: a map's name; or several names, :class:`OfSite`, :class:`NearPlace`, or None for all: the most
                confident answer is returned.
            image: a JPEG or PNG as bytes or by its path, or an array (H, W, 3) BGR or (H, W) grey of uint8.
            camera: the picture's intrinsics, or a stored camera's name; None: the map's own, where they fit.
            prior: where the pose is expected.
            dof: "auto" (the service's default: 6, roll being improbable where the map's own views were upright), 5 (the
                camera does not roll) or 6.
            gravity: the direction of gravity (down) in the camera frame.
            deadline_ms: how long the service may take.
            max_sigma_m: the position's greatest standard deviation along any axis that is of use to you; a pose that is
                less exact is withheld.
            max_sigma_deg: the rotation's, likewise.
            intrinsics: "unknown" if the camera is not known; the answer's ``camera`` is then the estimated one.
            with_matches: whether the answer's ``agreeing`` lists the matches that agree with the pose.
            geopose: "quaternion", "ypr" or "advanced": encoding of the answer's ``geopose``, the camera on Earth.
        """
        options = _calls.localize_options(
            camera, prior, dof, gravity, deadline_ms, intrinsics, with_matches, max_sigma_m, max_sigma_deg, geopose
        )
        return self._send(_calls.localize_image(maps, image, options))

    def localize_together(
        self,
        maps: Maps,
        frames: Sequence[Frame],
        *,
        camera: Camera | str | None = None,
        dof: int | str | None = None,
        sigma_m: float | None = None,
        sigma_deg: float | None = None,
        deadline_ms: float | None = None,
        max_sigma_m: float | None = None,
        max_sigma_deg: float | None = None,
        geopose: str | None = None,
    ) -> Localization:
        """Where several frames were taken, whose poses relative to each other are known: one answer for all.

        Args:
            maps: a map's name; or several names, :class:`OfSite`, :class:`NearPlace`, or None for all: the most
                confident answer is returned.
            frames: 2 to 10 of them: of a rig, or of one camera with its own odometry.
            camera: the intrinsics of the frames that have none of their own, or a stored camera's name.
            dof: as for one frame.
            sigma_m: one sigma of a frame's position as its predecessor sees it; None: 5 mm, a rig's.
            sigma_deg: one sigma of its rotation in degrees; None: 0.2.
            deadline_ms: how long the service may take.
            max_sigma_m: the position's greatest standard deviation along any axis that is of use to you; a pose that is
                less exact is withheld.
            max_sigma_deg: the rotation's, likewise.
            geopose: as of :meth:`localize`.
        """
        return self._send(
            _calls.localize_frames(
                maps, frames, camera, dof, sigma_m, sigma_deg, deadline_ms, max_sigma_m, max_sigma_deg, geopose
            )
        )

    def places(self, maps: str | Sequence[str] | None, image: ImageLike, *, limit: int = 10) -> list[Place]:
        """Which views a picture resembles most, the best match first; without a pose, and faster than with one.

        Args:
            maps: a map's name; or several names, or None for all.
            image: as for :meth:`localize`.
            limit: how many views at most.
        """
        return self._send(_calls.find_places(maps, image, limit))

    def localize_descriptors(
        self,
        maps: Maps,
        features: Features,
        *,
        camera: Camera | str | None = None,
        prior: Prior | None = None,
        dof: int | str | None = None,
        gravity: Vector3 | None = None,
        deadline_ms: float | None = None,
        max_sigma_m: float | None = None,
        max_sigma_deg: float | None = None,
        intrinsics: str | None = None,
        with_matches: bool = False,
        geopose: str | None = None,
    ) -> Localization:
        """Where a picture was taken, from its features alone. Arguments as of :meth:`localize`."""
        options = _calls.localize_options(
            camera, prior, dof, gravity, deadline_ms, intrinsics, with_matches, max_sigma_m, max_sigma_deg, geopose
        )
        return self._send(_calls.localize_features(maps, features, options))

    def maps(self) -> list[MapSummary]:
        """All maps."""
        return self._send(fetch_list("maps", parse_map, "maps"))

    def map(self, name: str) -> MapSummary:
        """One map."""
        return self._send(fetch(parse_map, "maps", name))

    def map_report(self, name: str) -> dict[str, Any]:
        """What the map found out about itself while it was built."""
        return self._send(fetch(lambda body: dict(body["report"]), "maps", name, "report"))

    def map_report_picture(self, name: str) -> bytes:
        """The map's report as PNG: where it works and where not, how consistent it is, how exact its landmarks are."""
        return self._send(fetch_bytes("maps", name, "report.png"))

    def map_preview(self, name: str) -> bytes:
        """The map from above, as PNG."""
        return self._send(fetch_bytes("maps", name, "preview.png"))

    def upload_map(self, name: str, source: Path | str | bytes) -> MapSummary:
        """Publish a map under a name, replacing any map of that name.

        If the answer is lost, the client looks whether a ``.rho`` file arrived, and sends it again if it did not. A
        CSV is sent once.

        Args:
            name: the map's.
            source: a ``.rho`` file or a map as CSV: its path, or its content as bytes.
        """
        return self._run(map_upload_steps(name, content_of(source), self._backoff.retries))

    def download_map(
        self, name: str, format: str = "rho", *, degree: int | None = None, features: Sequence[int] | None = None
    ) -> bytes:
        """The map's file, or the map for other programs.

        Args:
            name: the map.
            format: ``rho``; ``csv``, which can be uploaded again; ``observations``, ``trajectory``: tables; ``ply``,
                ``vtp``, ``gltf``: landmarks and views; ``surfaces``: where densities peak; ``png``: a picture.
            degree: of ``csv``: tensor densities fitted with it; None: the map's own densities.
            features: of ``surfaces``: whose; None: those seen most often.
        """
        return self._send(_calls.download_map(name, format, degree, features))

    def rename_map(self, name: str, new_name: str) -> MapSummary:
        """Give a map another name, which must be free."""
        return self._send(change(parse_map, "PATCH", "maps", name, body={"name": new_name}))

    def update_map(
        self, name: str, recording: str, *, poses: str | None = None, camera: Camera | str | None = None
    ) -> Job:
        """Have a map learn a stored recording, by its id; the job that does so.

        Args:
            name: the map.
            recording: the recording's id: :attr:`Job.recording` of the job that its upload started.
            poses: where frame poses come from; None: the recording's own, else each frame is localized.
            camera: the intrinsics, or the name of a stored camera, instead of the recording's own.
        """
        body = without_none({"recording": recording, "poses": poses, "camera": camera_text(camera)})
        return self._send(change(parse_job, "POST", "maps", name, "update", body=body))

    def learn_from_users(self, name: str) -> Job:
        """Let a map learn from the queries that the service has kept for it; the job that does so."""
        return self._send(change(parse_job, "POST", "maps", name, "learn", body={}))

    def merge_maps(self, name: str, other: str, into: str) -> MapSummary:
        """Merge ``other`` into the frame of the map ``name``; the merged map is published as ``into``."""
        body = {"other": other, "into": into}
        return self._send(change(parse_map, "POST", "maps", name, "merge", body=body, work_s=_calls.MINUTES_S))

    def forget_recording(self, name: str, source: str) -> MapSummary:
        """Take out of a map what it learned from a recording, named by its id or name in the map's sources."""
        body = {"source": source}
        return self._send(change(parse_map, "POST", "maps", name, "forget", body=body, work_s=_calls.MINUTES_S))

    def correct_map(self, name: str, correction: Mapping[str, Any]) -> MapSummary:
        """Correct a map's frame, scale, extent or names, such as ``{"kind": "origin", "at": [1.2, 0.4, 0]}``.

        The service's ``/docs`` has all kinds. The answer is the map's next version.
        """
        return self._send(
            change(parse_map, "POST", "maps", name, "corrections", body=correction, work_s=_calls.MINUTES_S)
        )

    def map_names(self, name: str) -> dict[str, Any]:
        """The map's named points and areas as a GeoJSON FeatureCollection.

        Coordinates are longitude, latitude and height in a map with a place on Earth; else metres of the map, and its
        member ``frame`` is ``map``.
        """
        return self._send(fetch(dict, "maps", name, "names"))

    def put_map_names(self, name: str, source: PlaceSource, *, level: str | None = None) -> MapSummary:
        """Replace the map's named points and areas.

        Args:
            name: the map.
            source: GeoJSON, as :meth:`map_names` returns it; or the path or content of a GeoJSON file or IMDF archive.
            level: of an IMDF archive; None: the only one.
        """
        return self._send(put_file(source, "maps", name, "names", level=level))

    def floor_plan(self, name: str) -> bytes:
        """The floor plan that the map keeps: a picture's or GeoJSON's file."""
        return self._send(fetch_bytes("maps", name, "plan"))

    def put_floor_plan(
        self,
        name: str,
        source: PlaceSource,
        *,
        x: float | None = None,
        y: float | None = None,
        turn_deg: float | None = None,
        m_per_unit: float | None = None,
        level: str | None = None,
    ) -> MapSummary:
        """Keep a floor plan with a map, which does not move.

        Args:
            name: the map.
            source: GeoJSON, or the path or content of a picture (PNG, JPEG, WebP), a GeoJSON file or an IMDF archive;
                or the path of a ``map_server`` yaml, with its picture beside it.
            x, y: of its lower left corner [m], map frame; None: as the file says, else 0.
            turn_deg: angle of its lower edge from the map's x towards y; None: likewise.
            m_per_unit: size of a pixel [m]; None: as the file says, else 1.
            level: of an IMDF archive; None: the only one.
        """
        params = {"x": x, "y": y, "turn_deg": turn_deg, "m_per_unit": m_per_unit, "level": level}
        return self._send(put_file(source, "maps", name, "plan", **params))

    def delete_floor_plan(self, name: str) -> MapSummary:
        """Remove the map's floor plan; the map itself does not move."""
        return self._send(change(parse_map, "DELETE", "maps", name, "plan"))

    def map_versions(self, name: str) -> list[dict[str, Any]]:
        """The maps that this one replaced, the newest first; :meth:`restore_map` takes their ``number``."""
        return self._send(fetch_list("versions", dict, "maps", name, "versions"))

    def map_coverage(self, name: str) -> dict[str, Any]:
        """Where the map works: landmarks in view, by position and heading."""
        return self._send(fetch(dict, "maps", name, "coverage"))

    def map_scene(self, name: str, *, landmarks: int | None = None, level: bool = False) -> bytes:
        """Landmarks and views for a 3-D view, as the service's ``/docs`` describe them.

        Args:
            name: the map.
            landmarks: at most so many, evenly chosen; None: all.
            level: whether a map that is not upright is turned upright.
        """
        return self._send(fetch_bytes("maps", name, "scene", landmarks=landmarks, level=level or None))

    def map_points(self, name: str) -> bytes:
        """Further points of the room in colour, as the service's ``/docs`` describe them."""
        return self._send(fetch_bytes("maps", name, "points"))

    def map_room(self, name: str, *, level: bool = False) -> bytes:
        """Surfaces of the map's room, as the service's ``/docs`` describe them; ``level`` as of :meth:`map_scene`."""
        return self._send(fetch_bytes("maps", name, "room", level=level or None))

    def map_feature(self, name: str, feature: int) -> dict[str, Any]:
        """A feature of the map by number, and where it may be seen from."""
        return self._send(fetch(dict, "maps", name, "features", feature))

    def view_picture(self, name: str, view: int) -> bytes:
        """The small picture of one of the map's views, as JPEG, where the service keeps pictures."""
        return self._send(fetch_bytes("maps", name, "views", view, "picture.jpg"))

    def landscape(self, name: str, image: ImageLike, *, camera: Camera | str | None = None) -> dict[str, Any]:
        """Where in the map a picture may have been taken: the log-likelihood over positions."""
        return self._send(_calls.landscape(name, image, camera))

    def live(self, name: str) -> Iterator[list[dict[str, Any]]]:
        """Poses of everyone who is localized in the map, as they come; where the service's setting ``live`` is on."""
        return self._events("maps", name, "live")

    def failures(self, name: str) -> dict[str, Any]:
        """The last day's requests without a pose or with little confidence; where the service keeps them."""
        return self._send(fetch(dict, "maps", name, "failures"))

    def refusals(self, name: str) -> dict[str, Any]:
        """Pictures that were refused, by cause; where the service keeps them."""
        return self._send(fetch(dict, "maps", name, "refusals"))

    def refusal(self, name: str, number: int) -> dict[str, Any]:
        """The map's view that is most like a refused picture, and their matches."""
        return self._send(fetch(dict, "maps", name, "refusals", number))

    def refusal_picture(self, name: str, number: int) -> bytes:
        """A refused picture, as JPEG."""
        return self._send(fetch_bytes("maps", name, "refusals", number, "picture.jpg"))

    def kept_queries(self, name: str) -> dict[str, Any]:
        """What is kept of users' queries for the map to learn from."""
        return self._send(fetch(dict, "maps", name, "learning"))

    def delete_kept_queries(self, name: str, asker: str | None = None) -> int:
        """Delete the map's kept queries, all or those of one client; how many there were."""
        return self._send(change(lambda body: int(body["deleted"]), "DELETE", "maps", name, "learning", asker=asker))

    def restore_map(self, name: str, number: int = 1) -> MapSummary:
        """Put a map that was replaced back in its place; 1 is the one that was replaced last."""
        return self._send(change(parse_map, "POST", "maps", name, "restore", number=number))

    def cameras(self) -> list[CameraProfile]:
        """All cameras that are stored under a name."""
        return self._send(fetch_list("cameras", parse_profile, "cameras"))

    def camera(self, name: str) -> CameraProfile:
        """One stored camera."""
        return self._send(fetch(parse_profile, "cameras", name))

    def put_camera(self, name: str, camera: Camera, calibration: Mapping[str, Any] | None = None) -> CameraProfile:
        """Store a camera, including its ``width`` and ``height``, under a name that requests may then use."""
        body = {**_calls.intrinsics(camera), "calibration": dict(calibration or {})}
        return self._send(change(parse_profile, "PUT", "cameras", name, body=body, idempotent=True))

    def delete_camera(self, name: str) -> None:
        """Delete a stored camera; maps that were made with it keep it."""
        self._send(change(dict, "DELETE", "cameras", name))

    def sites(self) -> list[Site]:
        """All sites."""
        return self._send(fetch_list("sites", parse_site, "sites"))

    def site(self, name: str) -> Site:
        """One site: its maps, where they lie, and the links that this follows from."""
        return self._send(fetch(parse_site, "sites", name))

    def put_site(self, name: str, document: Mapping[str, Any]) -> Site:
        """Store a site: ``maps``, ``links``, ``earth`` and ``version`` as the service's documentation says.

        Poses of maps that are not given are found from the links.
        """
        repeatable = "version" not in document
        return self._send(change(parse_site, "PUT", "sites", name, body=document, idempotent=repeatable))

    def find_site_link(self, name: str, first: str, second: str) -> Site:
        """Find the pose between two maps of a site, by points that both have or by overlap; places the site anew."""
        body = {"first": first, "second": second}
        return self._send(change(parse_site, "POST", "sites", name, "links", body=body, work_s=_calls.MINUTES_S))

    def place_site(self, name: str) -> Job:
        """Let a job look for links between the maps of a site until all are placed; wait for it as for a map's."""
        return self._send(change(parse_job, "POST", "sites", name, "place", body={}))

    def delete_site(self, name: str) -> None:
        """Delete a site; its maps stay."""
        self._send(change(dict, "DELETE", "sites", name))

    def visitors_site(self, site: str) -> dict[str, Any]:
        """What the visitors' page shows of a site."""
        return self._send(fetch(dict, "here", site))

    def visitors_room(self, site: str, map_name: str) -> bytes:
        """Surfaces of one of the site's rooms, as the visitors' page draws them."""
        return self._send(fetch_bytes("here", site, "rooms", map_name))

    def localize_visitor(self, site: str, image: ImageLike, *, camera: Camera | None = None) -> dict[str, Any]:
        """Where in a site a visitor's picture was taken; with a visitor's key."""
        return self._send(_calls.localize_visitor(site, image, camera))

    def geopose(self, request: Mapping[str, Any], maps: Maps = None) -> dict[str, Any]:
        """Answer to a request of OSCP's GeoPoseProtocol, version 2."""
        return self._send(_calls.geopose(request, maps))

    def geopose_status(self) -> dict[str, Any]:
        """Status of the service in OSCP's GeoPoseProtocol."""
        return self._send(Call("GET", "/geopose", _calls.json_of(dict)))

    def delete_map(self, name: str) -> None:
        """Delete a map for good."""
        self._send(change(dict, "DELETE", "maps", name))

    def upload_recording(
        self,
        path: Path | str,
        map_name: str,
        *,
        kind: str | None = None,
        features: str | None = None,
        density: str | None = None,
        poses: str | None = None,
        camera: Camera | str | None = None,
        waypoints: Path | str | None = None,
        priority: str | None = None,
        progress: UploadProgress | None = None,
    ) -> Job:
        """Upload a recording and have it mapped. If the connection breaks, the upload resumes where it stopped.

        Args:
            path: a video, a ZIP file, or a recording's folder, which is packed first.
            map_name: the name of the map to publish.
            kind: "build" a new map, or "update" the one of that name; None: build.
            features, density, poses: how to build it; the service's defaults where None.
            camera: the intrinsics, or the name of a stored camera, instead of the recording's own.
            waypoints: a CSV file of measured waypoints; in a ZIP file it is ``waypoints.csv``.
            priority: "high", "normal" or "low": how soon its turn comes; None: normal.
            progress: called with how many bytes the service has, and how many there are.
        """
        fields = recording_fields(map_name, kind, features, density, poses, camera, priority)
        with opened_recording(path, waypoints) as (name, file):
            return self._run(upload_steps(name, file, fields, self._backoff.retries, progress))

    def upload_rules(self) -> dict[str, str]:
        """Headers that say what the service takes of resumable uploads (tus)."""
        return self._send(Call("OPTIONS", "/v1/recordings", lambda answer: dict(answer.headers)))

    def uploads(self) -> list[dict[str, Any]]:
        """Resumable uploads that are not complete; :meth:`delete_recording` abandons one by its id."""
        return self._send(fetch_list("uploads", dict, "uploads"))

    def recordings(self) -> list[dict[str, Any]]:
        """The stored recordings, the newest first."""
        return self._send(fetch_list("recordings", dict, "recordings"))

    def recording(self, recording: str) -> dict[str, Any]:
        """A stored recording by its id: what it holds, and what is wrong with it."""
        return self._send(fetch(dict, "recordings", recording))

    def recording_thumbnail(self, recording: str) -> bytes:
        """A small picture of the recording, as JPEG."""
        return self._send(fetch_bytes("recordings", recording, "thumbnail.jpg"))

    def map_recording(
        self,
        recording: str,
        map_name: str,
        *,
        kind: str | None = None,
        features: str | None = None,
        density: str | None = None,
        poses: str | None = None,
        camera: Camera | str | None = None,
        priority: str | None = None,
    ) -> Job:
        """Map a stored recording; arguments as of :meth:`upload_recording`."""
        fields = recording_fields(map_name, kind, features, density, poses, camera, priority)
        return self._send(change(parse_job, "POST", "recordings", recording, "jobs", body=without_none(fields)))

    def put_waypoints(self, recording: str, waypoints: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        """Set a stored recording's measured waypoints, as the service's ``/docs`` describe them."""
        body = {"waypoints": [dict(one) for one in waypoints]}
        return self._send(change(dict, "PUT", "recordings", recording, "waypoints", body=body))

    def delete_waypoints(self, recording: str) -> dict[str, Any]:
        """Remove the waypoints that were set; those of the recording itself count again."""
        return self._send(change(dict, "DELETE", "recordings", recording, "waypoints"))

    def delete_recording(self, recording: str) -> None:
        """Delete a stored recording, or abandon an upload; maps that were made from it stay."""
        self._send(change(dict, "DELETE", "recordings", recording))

    def job_events(self, job_id: str) -> Iterator[Job]:
        """A job as it is now, and whenever it has changed, until it ends."""
        for event in self._events("jobs", job_id, "events"):
            yield parse_job(event)

    def jobs(self, before: str | None = None) -> list[Job]:
        """The newest 500 jobs, the newest first; ``before``: only those older than the job with this id."""
        return self._send(fetch_list("jobs", parse_job, "jobs", before=before))

    def job(self, job_id: str) -> Job:
        """One job."""
        return self._send(fetch(parse_job, "jobs", job_id))

    def cancel_job(self, job_id: str) -> Job:
        """End a job; its recording is kept."""
        return self._send(change(parse_job, "DELETE", "jobs", job_id))

    def retry_job(self, job_id: str) -> Job:
        """Queue a failed or cancelled job again."""
        return self._send(change(parse_job, "POST", "jobs", job_id, "retry"))

    def prioritize_job(self, job_id: str, priority: str) -> Job:
        """Change how soon a queued job's turn comes: "high", "normal" or "low"."""
        body = {"priority": priority}
        return self._send(change(parse_job, "PATCH", "jobs", job_id, body=body, idempotent=True))

    def wait_for_job(
        self,
        job_id: str,
        *,
        timeout_s: float | None = None,
        poll_s: float = 1.0,
        progress: JobProgress | None = None,
    ) -> Job:
        """Wait until a job has published its map; ``progress`` is called with the job at every poll.

        Raises:
            JobFailed: it failed or was cancelled.
            WaitTimedOut: it did not end in ``timeout_s``.
        """
        deadline = deadline_of(timeout_s)
        while True:
            job = self.job(job_id)
            if progress is not None:
                progress(job)
            if job.has_ended:
                return published(job)
            time.sleep(next_look_s(job, deadline, poll_s))

    def readiness(self) -> dict[str, str]:
        """The service's checks of itself by name: "ok", or what is wrong."""
        return self._send(_calls.readiness())

    def health(self) -> dict[str, Any]:
        """The service's name and version; it answers as soon as it runs."""
        return self._send(Call("GET", "/healthz", _calls.json_of(dict)))

    def metrics(self) -> str:
        """Counters and timings in Prometheus's text format."""
        return self._send(Call("GET", "/metrics", lambda answer: answer.text))

    def audit(self, *, limit: int | None = None, map_name: str | None = None) -> list[dict[str, Any]]:
        """The last requests that changed something, or a map, the newest first."""
        return self._send(fetch_list("changes", dict, "audit", limit=limit, map=map_name))

    def streams(self) -> list[dict[str, Any]]:
        """The streams that are open to the server, the oldest first."""
        return self._send(fetch_list("streams", dict, "streams"))

    def close_stream(self, stream: str) -> None:
        """Close an open stream."""
        self._send(change(dict, "DELETE", "streams", stream))

    def keys(self) -> list[dict[str, Any]]:
        """Names and scopes of the service's keys."""
        return self._send(fetch_list("keys", dict, "keys"))

    def key(self, name: str) -> dict[str, Any]:
        """A key's scope, limits and use."""
        return self._send(fetch(dict, "keys", name))

    def hand_on_key(self, key: Mapping[str, Any]) -> dict[str, Any]:
        """Make a key that lives for a while, such as a visitor's: ``scope``, ``lifetime_s``, ``site``, ``limits``."""
        return self._send(change(dict, "POST", "keys", body=key))

    def limit_key(self, name: str, limits: Mapping[str, Any]) -> dict[str, Any]:
        """Set a key's limits: ``requests_per_s``, ``burst``, ``maps``, ``stored_bytes``, ``jobs``."""
        return self._send(change(dict, "PUT", "keys", name, "limits", body=limits))

    def delete_key(self, name: str) -> None:
        """Revoke a key."""
        self._send(change(dict, "DELETE", "keys", name))

    def draw_qr(self, text: str) -> str:
        """A QR code of a text, as SVG."""
        return self._send(_calls.draw_qr(text))

    def _events(self, *parts: str) -> Iterator[Any]:
        try:
            with self._http.stream("GET", **_calls.stream(self._http, *parts)) as response:
                if response.is_error:
                    response.read()
                    raise _calls.error_of(response)
                lines: list[str] = []
                for line in response.iter_lines():
                    if line:
                        lines.append(line)
                        continue
                    event = _calls.event_data(lines)
                    lines = []
                    if event is not None:
                        yield event
        except httpx.TransportError as error:
            raise _calls.unreachable(error) from error

    def _run(self, steps: Generator[Call[Any], Any, T]) -> T:
        try:
            call = next(steps)
            while True:
                try:
                    answer = self._send(call)
                except RholocClientError as error:
                    call = steps.throw(error)
                else:
                    call = steps.send(answer)
        except StopIteration as ended:
            result: T = ended.value
            return result

    def _send(self, call: Call[T]) -> T:
        attempts = Attempts(self._backoff, call)
        while True:
            outcome = self._attempt(call)
            wait_s = attempts.wait_s(outcome)
            if wait_s is None:
                return _calls.result_of(call, outcome)
            time.sleep(wait_s)

    def _attempt(self, call: Call[T]) -> Outcome:
        try:
            return self._http.send(_calls.request(self._http, call))
        except httpx.TransportError as error:
            return error
