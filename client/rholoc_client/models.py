"""Requests and answers as frozen dataclasses."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, asdict, dataclass, field, fields, is_dataclass
from functools import cache, partial
from types import UnionType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from rholoc_client._images import ImageLike

T = TypeVar("T")
Vector3 = tuple[float, float, float]


@dataclass(frozen=True)
class Camera:
    """Intrinsics in pixels; pixel (0, 0) is the centre of the top-left pixel.

    ``width`` and ``height`` are the size of the images that they belong to; default: the image's own.
    ``lens`` is pinhole, fisheye or equirectangular. ``distortion`` holds OpenCV's k1, k2, p1, p2[, k3[, k4, k5, k6]],
    of a fisheye its k1, k2, k3, k4.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    width: int | None = None
    height: int | None = None
    lens: str = "pinhole"


@dataclass(frozen=True)
class CameraProfile:
    """A camera that is stored under a name, and how accurate its intrinsics are known to be."""

    name: str
    camera: Camera
    calibration: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class OfSite:
    """All maps of a site, where a request may name several maps."""

    site: str


@dataclass(frozen=True)
class NearPlace:
    """The maps of sites near a place on Earth, where a request may name several maps.

    Attributes:
        latitude_deg, longitude_deg: WGS 84.
        radius_m: how far from there a map's origin may lie.
    """

    latitude_deg: float
    longitude_deg: float
    radius_m: float = 100.0


@dataclass(frozen=True)
class SiteMap:
    """A map of a site.

    Attributes:
        map: its name.
        floor: empty where it is not said.
        position: (3,) of its origin in the site's frame, metres; None where the map has no place there.
        quaternion_xyzw: R_site_map; None likewise.
        given: whether somebody gave the pose; else it was found from links.
        covariance: 6×6 of the pose: metres, then radians, in the site's axes; None where there is no pose.
        present: whether there is a map of this name now.
    """

    map: str
    floor: str
    position: Vector3 | None
    quaternion_xyzw: tuple[float, float, float, float] | None
    given: bool
    covariance: tuple[tuple[float, ...], ...] | None
    present: bool


@dataclass(frozen=True)
class Site:
    """Maps in one frame.

    Attributes:
        name: the site's.
        version: counted up with every change.
        maps: its maps.
        links: the poses between pairs of them, as the service's ``links``.
        earth: where it lies on Earth, as the service's ``earth``; None where nobody said.
    """

    name: str
    version: int
    maps: tuple[SiteMap, ...]
    links: tuple[Mapping[str, Any], ...] = ()
    earth: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class OnEarth:
    """A camera on Earth, WGS 84; ``heading_deg`` is clockwise from true north, None where it looks up or down."""

    latitude_deg: float
    longitude_deg: float
    height_m: float
    heading_deg: float | None


@dataclass(frozen=True)
class SitePose:
    """A pose in the frame of a site.

    Attributes:
        site, version: which.
        floor: the map's; empty where it is not said.
        position: (3,) metres.
        heading: (3,) the optical axis.
        quaternion_xyzw: R_site_camera.
        covariance: as :attr:`Localization.covariance`, in the site's axes.
        earth: the same on Earth; None where nobody said where the site lies.
    """

    site: str
    version: int
    floor: str
    position: Vector3
    heading: Vector3
    quaternion_xyzw: tuple[float, float, float, float]
    covariance: tuple[tuple[float, ...], ...] | None
    earth: OnEarth | None


@dataclass(frozen=True)
class Prior:
    """The pose near which the answer is expected: metres and unit vectors in the map frame.

    ``quaternion_xyzw`` is the whole rotation, R_map_camera, where it is known: a heading alone says nothing about roll.
    """

    position: Vector3
    heading: Vector3
    radius_m: float = 1.0
    radius_deg: float = 35.0
    quaternion_xyzw: tuple[float, float, float, float] | None = None

    def as_sent(self) -> dict[str, Any]:
        """The prior as the service takes it in JSON: with its rotation where that is known, or else its heading."""
        fields = asdict(self)
        del fields["quaternion_xyzw" if self.quaternion_xyzw is None else "heading"]
        return fields


@dataclass(frozen=True)
class Features:
    """The features of one image of ``width`` × ``height`` px; each list has one entry per feature.

    Attributes:
        width, height: the size of the image in pixels.
        pixels: u and v of each feature.
        descriptors: each feature's descriptor.
        channels: each feature's channel by number or name; None where the map has only one.
        sizes_px: the diameter of each described patch, 0 where unknown; None where all are.
        angles_deg: each patch's orientation in degrees clockwise from +u, None or NaN where unknown; None where all
            are.
    """

    width: int
    height: int
    pixels: Sequence[tuple[float, float]]
    descriptors: Sequence[bytes]
    channels: Sequence[int | str] | None = None
    sizes_px: Sequence[float] | None = None
    angles_deg: Sequence[float | None] | None = None


@dataclass(frozen=True)
class Frame:
    """One of several frames that are localized together.

    Attributes:
        picture: a JPEG or PNG as bytes or as a path, an array (H, W, 3) BGR or (H, W) grey of uint8, or its features.
        position: of its camera in the frames' common frame (a rig's, or odometry's), metres.
        quaternion_xyzw: of its camera's rotation, R_common_camera.
        camera: its intrinsics, or a stored camera's name; None: as for all frames.
        gravity: the direction of gravity (down) in the camera frame, or None.
    """

    picture: ImageLike | Features
    position: Vector3
    quaternion_xyzw: tuple[float, float, float, float]
    camera: Camera | str | None = None
    gravity: Vector3 | None = None


@dataclass(frozen=True)
class Pose:
    """Where a camera is and where it looks, in the map frame (right-handed, z up).

    Attributes:
        position: x, y, z in metres.
        heading: the optical axis, unit length.
        roll_deg: the rotation about the heading against the upright camera.
        quaternion_xyzw: R_map_camera.
        T_map_camera: 4×4, takes points of the camera frame to the map frame.
    """

    position: Vector3
    heading: Vector3
    roll_deg: float
    quaternion_xyzw: tuple[float, float, float, float]
    T_map_camera: tuple[tuple[float, ...], ...]

    def as_prior(self, radius_m: float = 1.0, radius_deg: float = 35.0) -> Prior:
        """This pose as the prior of the next request: how a robot keeps track."""
        return Prior(self.position, self.heading, radius_m, radius_deg, self.quaternion_xyzw)


@dataclass(frozen=True)
class Diagnosis:
    """The most likely reason why there is no pose: a name for programs, a sentence that describes it, and one on what
    to try."""

    cause: str
    message: str
    hint: str


@dataclass(frozen=True)
class FramePose:
    """One of several frames that were localized together: its pose, or None, and how many of its matches agree."""

    pose: Pose | None
    inliers: int


@dataclass(frozen=True)
class Matches:
    """The matches that agree with a pose: pixels (u, v) of the frame, and the landmarks (x, y, z) that they show, map
    frame."""

    pixels: tuple[tuple[float, float], ...]
    landmarks: tuple[Vector3, ...]


@dataclass(frozen=True)
class Alternative:
    """Another pose that the frame may have been taken from.

    Attributes:
        weight: 0..1, the probability that it is of the right place.
        pose: the pose.
        covariance: 6×6, as of :class:`Localization`; None where it is unbounded.
    """

    weight: float
    pose: Pose
    covariance: tuple[tuple[float, ...], ...] | None


@dataclass(frozen=True)
class Localization:
    """The answer for one frame.

    Attributes:
        localized: whether there is a pose to rely on.
        reason: why it was not localized, else None.
        pose: the pose, or None.
        covariance: 6×6, of the position in metres and a small rotation about the map's axes in degrees, or None. The
            map's own uncertainty is part of it.
        recognized: 0..1, the probability that the pose is of the right place: within 50 cm and 20° of the truth.
            ``localized`` goes by it.
        confidence: 0..1, the probability that the pose is within 10 cm and 5° of the truth; at most ``recognized``.
        matches, inliers: how many matches there were, and how many of them agree with the pose.
        map, map_id, map_version: the map that answered.
        scale: "metric", or "arbitrary" where the map's unit of length is not the metre.
        timings_ms: milliseconds by stage, as the service measured them.
        map_trusted: whether the frame poses that the map was built on passed every check; None where it does not say.
        expected_error_m: how far the map itself is expected to be off here, root mean square; None where unknown.
        diagnosis: the most likely cause where there is no pose, else None.
        near_prior: whether the pose is within the prior's radii; None without a prior.
        camera: the camera as estimated, where its intrinsics were unknown.
        focal_sigma_px: one sigma of its focal length.
        frames: each frame's pose and how many of its matches agree, where several were localized together; ``pose`` is
            the first one's.
        agreeing: the matches that agree with the pose, where they were asked for.
        areas: the named areas of the map that the camera is in, the smallest first.
        near: its named points within 2 m of the camera, the nearest first.
        site: the pose in the frame of the map's site; None where it belongs to none.
        alternatives: at most four other poses that the frame may have been taken from, the likeliest first.
        geopose: the camera on Earth as OGC GeoPose, where it was asked for and the map's place is known.
    """

    localized: bool
    reason: str | None
    pose: Pose | None
    covariance: tuple[tuple[float, ...], ...] | None
    recognized: float
    confidence: float
    matches: int
    inliers: int
    map: str
    map_id: str
    map_version: int
    scale: str
    timings_ms: Mapping[str, float]
    map_trusted: bool | None = None
    expected_error_m: float | None = None
    diagnosis: Diagnosis | None = None
    near_prior: bool | None = None
    camera: Camera | None = None
    focal_sigma_px: float | None = None
    frames: tuple[FramePose, ...] = ()
    agreeing: Matches | None = None
    areas: tuple[str, ...] = ()
    near: tuple[str, ...] = ()
    site: SitePose | None = None
    alternatives: tuple[Alternative, ...] = ()
    geopose: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class Place:
    """A view of a map that may show much the same as the picture.

    Attributes:
        map, map_id, map_version: the map.
        view: the view's number in it.
        pose: where the view was taken: near the picture's place, not the picture's pose.
        score: how strongly the picture speaks for it; for ranking.
    """

    map: str
    map_id: str
    map_version: int
    view: int
    pose: Pose
    score: float


@dataclass(frozen=True)
class MapSummary:
    """A map of the service.

    Attributes:
        camera: the intrinsics of its first recording.
        trusted: whether the frame poses that it was built on passed every check; None where that is not known.
        trust_reason: why it is trusted, or which checks failed.
        expected_error_m: how far its poses are expected to be from the truth, root mean square; None where unknown.
        consistency_m: the median distance between where frames of the same walk are localized and where the walk has
            them: how well the map agrees with itself, not how right it is.
    """

    name: str
    id: str
    version: int
    density: str
    features: str
    scale: str
    upright: bool
    created: str
    landmarks: int
    views: int
    size_bytes: int
    camera: Camera
    trusted: bool | None = None
    trust_reason: str = ""
    expected_error_m: float | None = None
    consistency_m: float | None = None


@dataclass(frozen=True)
class Job:
    """A mapping job.

    Attributes:
        id, recording, map: its id, the recording's id, the name of the map that it publishes; empty where it has none.
        state: queued, running, published, failed or cancelled.
        stage: the stage it is in or ended in.
        progress: 0..1 over all stages.
        message: one line for people.
        log: the last lines of its log.
        warnings: why its published map is not to be trusted, or why maps of its site are not placed.
        error_code, error_message, error_hint: why it failed, or None.
        created, started, ended: seconds since the epoch, or None.
        attempts: how many workers have taken it up.
        priority: how soon its turn comes: high, normal or low.
        memory_bytes: about how much memory it needs; None until its recording was read.
        obstacle: why no worker can take it: "no_worker", "worker_fails" or "memory"; None where one can.
        kind: build, update, learn, or place the maps of a site.
        site: the site whose maps it places; None where it makes a map.
    """

    id: str
    recording: str
    map: str
    state: str
    stage: str
    progress: float
    message: str
    log: tuple[str, ...]
    warnings: tuple[str, ...]
    error_code: str | None
    error_message: str | None
    error_hint: str | None
    created: float
    started: float | None
    ended: float | None
    attempts: int
    priority: str = "normal"
    memory_bytes: int | None = None
    obstacle: str | None = None
    kind: str = "build"
    site: str | None = None

    @property
    def trusted(self) -> bool | None:
        """Whether the map that it published is to be trusted; ``warnings`` say why not. None before that, and where it
        makes none."""
        return not self.warnings if self.state == "published" and self.site is None else None

    @property
    def has_ended(self) -> bool:
        """Whether the job will no longer change by itself."""
        return self.state in ("published", "failed", "cancelled")


def parsed(kind: Callable[..., T], answer: Mapping[str, Any]) -> T:
    """A JSON object as a dataclass: lists become tuples, objects dataclasses, as its fields' types say.

    Further members are ignored; a member of null counts as missing where its field has a default.

    Raises:
        KeyError: a member is missing.
    """
    given = {}
    for name, read, required in _members(kind):
        value = answer[name] if required else answer.get(name)
        if value is not None:
            given[name] = read(value)
        elif required:
            given[name] = None
    return kind(**given)


@cache
def _members(kind: Any) -> list[tuple[str, Callable[[Any], Any], bool]]:
    """Name of each field, reader of its JSON value, and whether it is required: it has no default."""
    hints = get_type_hints(kind)
    return [
        (one.name, _reader(hints[one.name]), one.default is MISSING and one.default_factory is MISSING)
        for one in fields(kind)
    ]


def _reader(hint: Any) -> Callable[[Any], Any]:
    """Function that turns a JSON value other than null into the type ``hint``."""
    if isinstance(hint, UnionType):
        return _reader(get_args(hint)[0])
    if get_origin(hint) is tuple:
        read = _reader(get_args(hint)[0])
        return tuple if read is _as_it_is else lambda values: tuple(map(read, values))
    return partial(parsed, hint) if isinstance(hint, type) and is_dataclass(hint) else _as_it_is


def _as_it_is(value: Any) -> Any:
    return value


def parse_localization(answer: Mapping[str, Any]) -> Localization:
    """The JSON of an answer → :class:`Localization`."""
    focal_sigma_px = (answer.get("camera") or {}).get("focal_sigma_px")
    return parsed(Localization, {**answer, "focal_sigma_px": focal_sigma_px})


def parse_site(answer: Mapping[str, Any]) -> Site:
    """The JSON of a site → :class:`Site`."""
    nowhere = {"position": None, "quaternion_xyzw": None}
    return parsed(Site, {**answer, "maps": [{**one, **(one["pose"] or nowhere)} for one in answer["maps"]]})


def parse_place(answer: Mapping[str, Any]) -> Place:
    """The JSON of a place → :class:`Place`."""
    return parsed(Place, answer)


def parse_map(answer: Mapping[str, Any]) -> MapSummary:
    """The JSON of a map → :class:`MapSummary`."""
    return parsed(MapSummary, answer)


def parse_profile(answer: Mapping[str, Any]) -> CameraProfile:
    """The JSON of a stored camera → :class:`CameraProfile`."""
    return parsed(CameraProfile, {**answer, "camera": answer})


def parse_job(answer: Mapping[str, Any]) -> Job:
    """The JSON of a job → :class:`Job`."""
    error = answer["error"] or {}
    apart = {f"error_{name}": error.get(name) for name in ("code", "message", "hint")}
    return parsed(Job, {"warnings": (), **answer, **apart})
