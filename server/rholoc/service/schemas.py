"""The models of requests and answers, with examples."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi.openapi.models import Example
from pydantic import BaseModel, ConfigDict, FailFast, Field, Strict
from pydantic.config import JsonDict

from rholoc.features import Channel
from rholoc.geometry import CAMERA_WRITTEN, Lens
from rholoc.jobs import JobKind, JobPriority, JobState, Obstacle, RecordedWaypoint
from rholoc.localization import Cause, Dof, Intrinsics, Reason
from rholoc.maps import (
    MOST_MAPS,
    Correction,
    DensityKind,
    FloorPlan,
    FramePose,
    LinkOrigin,
    MapLabels,
    MapNames,
    MapWaypoint,
    SiteLink,
    SiteOnEarth,
    Source,
)
from rholoc.progress import Stage
from rholoc.reports import LearningReport, MapReport
from rholoc.service.examples import CORRECTION, NAMES, REPORT, SOURCE, WAYPOINT, sent
from rholoc.service.keys import Scope
from rholoc.service.stream_kind import StreamKind
from rholoc.trajectory import PoseMethod, Scale

_LARGEST_SIZE_PX = 2**31
SizePx = Annotated[int, Strict(), Field(ge=-_LARGEST_SIZE_PX, le=_LARGEST_SIZE_PX)]  # Camera checks what is possible
Number = Annotated[float, Strict()]  # neither text nor true and false
Vector3 = Annotated[list[float], Field(min_length=3, max_length=3)]
Vector2 = Annotated[list[Number], Field(min_length=2, max_length=2)]
Quaternion = Annotated[list[float], Field(min_length=4, max_length=4)]

_MAP_ID = "4f1c2a9be07d4d0c8f5f6f0f3f1f7a11"
_POSE_EXAMPLE: JsonDict = {
    "position": [1.203, 0.412, 1.498],
    "heading": [1.0, 0.0, 0.0],
    "roll_deg": 0.0,
    "quaternion_xyzw": [-0.5, 0.5, -0.5, 0.5],
    "T_map_camera": [[0, 0, 1, 1.203], [-1, 0, 0, 0.412], [0, -1, 0, 1.498], [0, 0, 0, 1]],
}
_JOB_ID = "0b6e0f6f4f0c4d5f9a8b7c6d5e4f3a21"
_RECORDING_ID = "9c5d1c3f5b8e4a0d8e6f7a8b9c0d1e2f"
_CAMERA: JsonDict = {"width": 640, "height": 480, "fx": 525.5, "fy": 525.5, "cx": 320.0, "cy": 240.0, "distortion": []}
_PROFILE: JsonDict = {**_CAMERA, "calibration": {"rms_px": 0.21, "views": 24, "sigmas": {"fx": 0.6, "fy": 0.6}}}


_FRAME: JsonDict = {"position": [4.2, 0.0, 0.0], "quaternion_xyzw": [0.0, 0.0, 0.7071, 0.7071]}
_EARTH: JsonDict = {"latitude_deg": 52.52, "longitude_deg": 13.405, "height_m": 74.0, "heading_deg": 12.5}
_LINK: JsonDict = {
    "first": "hall", "second": "kitchen", "pose": _FRAME, "sigma_m": 0.05, "sigma_deg": 0.5, "origin": "given"
}  # fmt: skip
_SITE: JsonDict = {
    "maps": [{"map": "hall", "floor": "0"}, {"map": "kitchen", "floor": "0"}], "links": [_LINK], "earth": _EARTH
}  # fmt: skip
_SITE_ANSWER: JsonDict = {
    "name": "campus",
    "version": 1,
    "maps": [{"map": "hall", "floor": "0", "pose": _FRAME, "given": True, "covariance": None, "present": True}],
    "links": [_LINK],
    "earth": _EARTH,
}


class _In(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _Out(BaseModel):
    model_config = ConfigDict(frozen=True)


class ErrorAnswer(_Out):
    """The one shape of all errors."""

    model_config = ConfigDict(
        frozen=True,
        json_schema_extra={
            "example": {
                "code": "unknown_map",
                "message": "There is no map called 'kitchen'.",
                "hint": "GET /v1/maps lists the maps.",
                "request_id": "7d7f0a1c2b3d4e5f8091a2b3c4d5e6f7",
            }
        },
    )

    code: str = Field(description="Stable: programs tell errors apart by it.")
    message: str = Field(description="One line: what is wrong.")
    hint: str = Field(description="One line: what to do.")
    request_id: str = Field(description="The same as in the header X-Request-ID and in the service's log.")


CAMERA_TEXT = f"{CAMERA_WRITTEN}, in pixels, or a stored camera's name; default: the recording's own"
"""How users write a recording's camera."""


class CameraIn(_In):
    """Intrinsics in pixels; pixel (0, 0) is the centre of the top-left pixel.

    ``width`` and ``height`` are the size of the images that the intrinsics belong to; for an image of the same aspect
    ratio but another size they are scaled. Without ``fx`` the map's own camera is used if it has the same aspect ratio;
    an equirectangular picture is then a whole panorama.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, json_schema_extra={"example": _CAMERA})

    width: SizePx | None = Field(default=None, description="px; default: the image's")
    height: SizePx | None = Field(default=None, description="px; default: the image's")
    fx: Number | None = Field(default=None, description="px")
    fy: Number | None = Field(default=None, description="px; default: fx")
    cx: Number | None = Field(default=None, description="px; default: the middle of the image")
    cy: Number | None = Field(default=None, description="px; default: the middle of the image")
    distortion: list[Number] = Field(
        default_factory=list,
        max_length=8,
        description="OpenCV's k1, k2, p1, p2[, k3[, k4, k5, k6]]; of a fisheye its k1, k2, k3, k4",
    )
    lens: Lens = Field(default=Lens.PINHOLE, description="how the camera projects")


class CameraChoice(CameraIn):
    """Intrinsics, or the name of a stored camera instead: then ``width`` and ``height`` are the image's."""

    name: str | None = Field(default=None, description="a stored camera, instead of intrinsics")


class CameraProfileIn(_In):
    """A camera to store: its intrinsics, and how accurate they are."""

    model_config = ConfigDict(extra="forbid", frozen=True, json_schema_extra={"example": _PROFILE})

    width: SizePx
    height: SizePx
    fx: Number
    fy: Number
    cx: Number
    cy: Number
    distortion: list[Number] = Field(default_factory=list, max_length=8)
    lens: Lens = Field(default=Lens.PINHOLE, description="how the camera projects")
    calibration: dict[str, Any] = Field(
        default_factory=dict, description="how it was calibrated: rms_px, sigmas, views, …"
    )


class CameraProfileOut(CameraProfileIn):
    """A stored camera."""

    model_config = ConfigDict(frozen=True, json_schema_extra={"example": {"name": "pixel-7", **_PROFILE}})

    name: str


class CameraList(_Out):
    """All stored cameras, by name; files that cannot be read are listed separately."""

    model_config = ConfigDict(
        frozen=True, json_schema_extra={"example": {"cameras": [{"name": "pixel-7", **_PROFILE}], "unreadable": {}}}
    )

    cameras: list[CameraProfileOut]
    unreadable: dict[str, str] = Field(description="names of camera files that cannot be read, and why")


class PriorIn(_In):
    """The pose near which the answer is expected: a position and either a heading or a quaternion."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        json_schema_extra={"example": {"position": [1.2, 0.4, 1.5], "heading": [1, 0, 0], "radius_m": 0.5}},
    )

    position: Vector3 = Field(description="m, map frame")
    heading: Vector3 | None = Field(default=None, description="the optical axis in the map frame")
    quaternion_xyzw: Quaternion | None = Field(default=None, description="of R_map_camera")
    radius_m: float = Field(default=1.0, gt=0, description="how far the position may be from it, m")
    radius_deg: float = Field(default=35.0, gt=0, le=180, description="how far the heading may be from it, degrees")


class LocalizeOptions(_In):
    """How to localize one frame: the part ``request`` of a multipart body."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, json_schema_extra={"example": {"camera": _CAMERA, "dof": 6, "deadline_ms": 500}}
    )

    camera: CameraChoice = Field(default_factory=CameraChoice)
    dof: Dof = Field(
        default=Dof.AUTO,
        description="'auto': 6, roll being improbable where the map's own views were upright; 5: the camera does not "
        "roll; 6: roll is estimated too",
    )
    intrinsics: Intrinsics = Field(
        default=Intrinsics.GIVEN,
        description="'unknown': the focal length is estimated along with the pose; then no camera may be given but its "
        "width and height",
    )
    prior: PriorIn | None = None
    gravity: Vector3 | None = Field(default=None, description="the direction of gravity (down) in the camera frame")
    deadline_ms: float | None = Field(default=None, gt=0, le=600_000, description="how long the answer may take")
    max_sigma_m: float | None = Field(
        default=None,
        gt=0,
        le=1000,
        description="the position's greatest standard deviation along any axis, m; a less exact pose is withheld",
    )
    max_sigma_deg: float | None = Field(
        default=None, gt=0, le=180, description="the rotation's, degrees; a less exact pose is withheld"
    )
    with_matches: bool = Field(
        default=False, description="whether the answer lists the matches that agree with the pose"
    )


class FirstError(FailFast):
    """Reports a list's first error, not each of a million."""

    __hash__ = object.__hash__  # which a union needs


class FeaturesIn(_In):
    """The features of one frame, as the map's own extractor finds them: one entry of each list per feature."""

    pixels: Annotated[list[tuple[float, float]], FirstError()] = Field(description="u and v of each feature, px")
    descriptors: Annotated[list[str], FirstError()] | str = Field(
        description="one string of hex digits per feature, or all descriptors in a row as one base64 string"
    )
    channels: Annotated[list[int | str], FirstError()] | None = Field(
        default=None,
        description="each feature's channel by number or name: "
        + ", ".join(f"{channel.value} {channel.name}" for channel in Channel)
        + ". May be left out where the map has one channel only.",
    )
    sizes_px: Annotated[list[float], FirstError()] | None = Field(
        default=None, description="the diameter of each described patch, px; 0 where unknown"
    )
    angles_deg: Annotated[list[float | None], FirstError()] | None = Field(
        default=None, description="each patch's orientation, degrees clockwise from +u; null where unknown"
    )


class DescriptorQuery(LocalizeOptions):
    """A frame by its features alone: the picture stays with the robot."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        json_schema_extra={
            "example": {
                "camera": _CAMERA,
                "features": {
                    "pixels": [[100.5, 80.25], [320.0, 200.75]],
                    "channels": ["L", "L"],
                    "descriptors": ["9f" * 32, "0a" * 32],
                    "sizes_px": [31.0, 31.0],
                    "angles_deg": [12.5, 270.0],
                },
                "dof": 6,
            }
        },
    )

    features: FeaturesIn


class FrameIn(_In):
    """One of several frames: a picture or a descriptor set, and where its camera was relative to the others."""

    camera: CameraChoice | None = Field(default=None, description="its intrinsics; default: the request's `camera`")
    image: str | None = Field(
        default=None, description="a JPEG or PNG as base64; in a multipart body a part `image0`, `image1`, … instead"
    )
    features: FeaturesIn | None = Field(default=None, description="its features, instead of an image")
    position: Vector3 = Field(description="of the camera in the frames' common frame, m")
    quaternion_xyzw: Quaternion = Field(description="of its rotation, R_common_camera")
    gravity: Vector3 | None = Field(default=None, description="the direction of gravity (down) in the camera frame")


class FramesQuery(_In):
    """2 to 10 frames whose poses relative to each other are known: a rig's cameras, or one camera with odometry."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        json_schema_extra={
            "example": {
                "camera": _CAMERA,
                "frames": [
                    {"image": "/9j/4AAQ…", "position": [0, 0, 0], "quaternion_xyzw": [0, 0, 0, 1]},
                    {"image": "/9j/4AAQ…", "position": [0.21, 0, 0.02], "quaternion_xyzw": [0, 0.087, 0, 0.996]},
                ],
                "sigma_m": 0.01,
                "sigma_deg": 0.5,
            }
        },
    )

    frames: list[FrameIn]
    camera: CameraChoice = Field(default_factory=CameraChoice, description="of frames that name none of their own")
    dof: Dof = Dof.AUTO
    sigma_m: Number = Field(default=0.005, description="one sigma of a frame's position as its predecessor sees it, m")
    sigma_deg: Number = Field(default=0.2, description="one sigma of its rotation, degrees")
    deadline_ms: float | None = Field(default=None, gt=0, le=600_000, description="how long the answer may take")
    max_sigma_m: float | None = Field(
        default=None,
        gt=0,
        le=1000,
        description="the position's greatest standard deviation along any axis, m; a less exact pose is withheld",
    )
    max_sigma_deg: float | None = Field(
        default=None, gt=0, le=180, description="the rotation's, degrees; a less exact pose is withheld"
    )


class PoseOut(_Out):
    """A pose in the map frame (right-handed, z up)."""

    position: list[float] = Field(description="the camera's centre: x, y, z in m")
    heading: list[float] = Field(description="the optical axis, unit length")
    roll_deg: float = Field(description="the rotation about the heading against the upright camera")
    quaternion_xyzw: list[float] = Field(description="R_map_camera as x, y, z, w")
    T_map_camera: list[list[float]] = Field(description="4×4, takes points of the camera frame to the map frame")


class MatchesOut(_Out):
    """The matches that agree with a pose: one entry of each list per match."""

    pixels: list[list[float]] = Field(description="u and v of the feature in the frame, px")
    landmarks: list[list[float]] = Field(description="x, y, z of the landmark in the map, m")


class DiagnosisOut(_Out):
    """The most likely reason why there is no pose, and what to try."""

    cause: Cause
    message: str = Field(description="one sentence: what it looks like")
    hint: str = Field(description="one sentence: what to try")


class EstimatedCameraOut(_Out):
    """The camera as estimated from the picture."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    focal_sigma_px: float = Field(description="one sigma of fx and fy")


class FramePoseOut(_Out):
    """One of several frames that were localized together."""

    pose: PoseOut | None
    inliers: int = Field(description="how many of its matches agree with the pose")


class EarthOut(_Out):
    """A camera on Earth, WGS 84."""

    latitude_deg: float
    longitude_deg: float
    height_m: float = Field(description="above the ellipsoid")
    heading_deg: float | None = Field(
        description="where it looks: degrees from true north, clockwise; null where it looks straight up or down"
    )


class SitePoseOut(_Out):
    """The pose in the frame of a site that the map belongs to."""

    site: str
    version: int = Field(description="of the site")
    floor: str = Field(description="the map's; empty where it is not said")
    position: list[float] = Field(description="the camera's centre: x, y, z in m")
    heading: list[float] = Field(description="the optical axis, unit length")
    quaternion_xyzw: list[float] = Field(description="R_site_camera as x, y, z, w")
    covariance: list[list[float]] | None = Field(
        description="as `covariance` of the answer, in the site's axes; how well the map is placed is part of it"
    )
    earth: EarthOut | None = Field(description="the same on Earth; null where nobody said where the site lies")


class AlternativeOut(_Out):
    """Another pose that the frame may have been taken from."""

    weight: float = Field(description="0..1, the probability that it is of the right place")
    pose: PoseOut
    covariance: list[list[float]] | None = Field(description="6×6, as `covariance` of the answer")


class LocalizationOut(_Out):
    """The answer for one frame. ``localized`` false is an answer, not an error."""

    model_config = ConfigDict(
        frozen=True,
        json_schema_extra={
            "example": {
                "localized": True,
                "reason": None,
                "pose": _POSE_EXAMPLE,
                "covariance": [[1e-4 if row == column else 0.0 for column in range(6)] for row in range(6)],
                "recognized": 0.998,
                "confidence": 0.97,
                "alternatives": [],
                "matches": 412,
                "inliers": 164,
                "map": "testsite",
                "map_id": _MAP_ID,
                "map_version": 1,
                "scale": "metric",
                "map_trusted": True,
                "expected_error_m": 0.012,
                "agreeing": None,
                "diagnosis": None,
                "near_prior": None,
                "camera": None,
                "areas": ["kitchen"],
                "near": [],
                "frames": None,
                "site": None,
                "timings_ms": {
                    "queue": 0.1, "load": 0.0, "decode": 2.1, "extract": 11.0, "match": 9.5, "seed": 14.2,
                    "ascend": 20.3, "verify": 1.7, "diagnose": 0.0, "total": 59.4,
                },
            }
        },
    )  # fmt: skip

    localized: bool
    reason: Reason | None = Field(description="why there is no pose, else null")
    pose: PoseOut | None
    covariance: list[list[float]] | None = Field(
        description="6×6, of x, y, z in m and of a small rotation about the map's x, y, z axes in degrees; "
        "the map's own uncertainty is part of it"
    )
    recognized: float = Field(
        description="0..1, the probability that the pose is of the right place: within 50 cm and 20° of the truth, the "
        "map's errors included; `localized` goes by it"
    )
    confidence: float = Field(
        description="0..1, the probability that the pose is within 10 cm and 5° of the truth, the map's errors "
        "included: at most `recognized`"
    )
    alternatives: list[AlternativeOut] = Field(
        description="at most four other poses that the frame may have been taken from, the likeliest first; a pose "
        "that was withheld as not recognized is the first of them"
    )
    matches: int
    inliers: int
    map: str
    map_id: str
    map_version: int
    scale: Scale = Field(description="'arbitrary': the map's unit of length is not the metre")
    map_trusted: bool | None = Field(
        description="whether the frame poses that the map was built on passed every check; null where it does not say"
    )
    expected_error_m: float | None = Field(
        description="how far the map itself is expected to be off here, root mean square, m; null where it is not known"
    )
    agreeing: MatchesOut | None = Field(description="the matches behind `inliers`, where `with_matches` asks for them")
    diagnosis: DiagnosisOut | None = Field(description="the most likely cause where there is no pose, else null")
    near_prior: bool | None = Field(description="whether the pose is within the prior's radii; null without a prior")
    camera: EstimatedCameraOut | None = Field(description="where `intrinsics` is 'unknown': the camera as estimated")
    areas: list[str] = Field(description="the named areas of the map that the camera is in, the smallest first")
    near: list[str] = Field(description="its named points within 2 m of the camera, the nearest first")
    frames: list[FramePoseOut] | None = Field(
        default=None, description="each frame's pose where several were sent; `pose` is the first one's"
    )
    site: SitePoseOut | None = Field(
        default=None, description="the pose in the frame of the map's site; null without one"
    )
    timings_ms: dict[str, float] = Field(
        description="milliseconds: queue, load (of a map that was not in memory), decode, extract, match, seed, "
        "ascend, verify, diagnose, total; in a large map also place, which finds the place first; of more than five "
        "maps also choose, which finds those to ask"
    )


class PlaceOut(_Out):
    """A view of a map that may show much the same as the picture."""

    map: str
    map_id: str
    map_version: int
    view: int = Field(description="its number in the map")
    pose: PoseOut = Field(description="where the view was taken: near the picture's place, not the picture's pose")
    score: float = Field(description="how strongly the picture speaks for it; for ranking")


class PlacesOut(_Out):
    """The most similar views of all maps that were asked, the best match first."""

    model_config = ConfigDict(
        frozen=True,
        json_schema_extra={
            "example": {
                "places": [
                    {
                        "map": "testsite",
                        "map_id": _MAP_ID,
                        "map_version": 1,
                        "view": 41,
                        "pose": _POSE_EXAMPLE,
                        "score": 6.3,
                    }
                ]
            }
        },
    )

    places: list[PlaceOut]


class FeatureOut(_Out):
    """A feature of a map, and where it may be seen from: a truncated cone."""

    model_config = ConfigDict(
        frozen=True,
        json_schema_extra={
            "example": {
                "feature": 100,
                "position": [3.1, 0.4, 1.7],
                "sigma": 0.008,
                "direction": [-0.98, 0.2, 0.0],
                "half_angle_deg": 52.0,
                "nearest": 0.9,
                "farthest": 5.8,
                "views": [3, 4, 5, 9],
            }
        },
    )

    feature: int
    position: list[float] = Field(description="of its landmark")
    sigma: float = Field(description="its standard deviation, root mean square of the axes")
    direction: list[float] = Field(
        description="the cone's axis: unit vector from the landmark to where it was seen from"
    )
    half_angle_deg: float = Field(description="between the cone's axis and its edge")
    nearest: float = Field(description="the shortest distance from which it is expected to be seen")
    farthest: float = Field(description="the longest distance from which it is expected to be seen")
    views: list[int] = Field(description="the views that saw it, by number")


class WayOut(_Out):
    """The path of an ascent."""

    positions: list[list[float]] = Field(description="x, y, z of the camera, step by step, the start first")
    gain_nats: float = Field(description="what the densities say for its end, Σ log((ε + ρ) / ε)")


class LandscapeOut(_Out):
    """The densities of the features that a frame shows, around its pose."""

    model_config = ConfigDict(
        frozen=True,
        json_schema_extra={
            "example": {
                "localized": True,
                "map": "testsite",
                "map_id": _MAP_ID,
                "map_version": 1,
                "scale": "metric",
                "pose": _POSE_EXAMPLE,
                "origin": [0.7, -0.1, 1.5],
                "spacing": 0.5,
                "values": [[12.1, 80.4, 9.3], [95.7, 912.8, 101.2], [7.7, 88.1, 14.9]],
                "tolerance_px": 12.0,
                "ways": [{"positions": [[0.9, 0.1, 1.5], [1.18, 0.38, 1.5], [1.2, 0.4, 1.5]], "gain_nats": 912.8}],
            }
        },
    )

    localized: bool = Field(description="whether the frame has a pose; without one it is the best optimum's landscape")
    map: str
    map_id: str
    map_version: int
    scale: Scale
    pose: PoseOut | None = Field(description="the pose; null where too little matches to climb by")
    origin: list[float] | None = Field(description="the position of the first value")
    spacing: float | None = Field(description="between neighbouring positions")
    values: list[list[float]] = Field(
        description="Σ log((ε + ρ) / ε), nats, of a camera at the pose's height that is turned as it is: rows of "
        "increasing y, in a row by increasing x"
    )
    tolerance_px: float | None = Field(description="how far a feature may be off and still count")
    ways: list[WayOut] = Field(description="from the places that most matches speak for, the best last")


_SUMMARY: JsonDict = {
    "name": "testsite",
    "id": _MAP_ID,
    "version": 1,
    "density": "ray",
    "features": "lab3",
    "scale": "metric",
    "upright": True,
    "created": "2026-01-05T10:00:00Z",
    "landmarks": 5120,
    "views": 60,
    "size_bytes": 480_000,
    "trusted": True,
    "trust_reason": "Two reconstructions agree.",
    "expected_error_m": 0.014,
    "consistency_m": 0.006,
    "camera": _CAMERA,
    "labels": {"site": "plant 2", "floor": "1", "tags": []},
}


class MapSummary(_Out):
    """A map in a list."""

    model_config = ConfigDict(frozen=True, json_schema_extra={"example": _SUMMARY})

    name: str
    id: str = Field(description="unique for each built map")
    version: int
    density: DensityKind
    features: str = Field(description="the extractor's name")
    scale: Scale
    upright: bool = Field(description="whether z points up")
    created: str = Field(description="ISO 8601, UTC")
    landmarks: int = Field(description="how many features it holds")
    views: int = Field(description="how many keyframes it was seen from")
    size_bytes: int
    trusted: bool | None = Field(
        description="whether the frame poses that it was built on passed every check; null where it does not say"
    )
    trust_reason: str = Field(description="why it is trusted, or which checks failed")
    expected_error_m: float | None = Field(
        description="how far its poses are expected to be from the truth, root mean square, m; null where unknown"
    )
    consistency_m: float | None = Field(
        description="median distance, m, between where frames of the walk that were held out of the map are localized "
        "and where the walk has them: how well the map agrees with itself, not how right it is; null if none were held "
        "out"
    )
    camera: CameraIn
    labels: MapLabels = Field(description="its site, floor and tags, as people set them")


class PreviousMap(_Out):
    """The map that a map replaced."""

    number: int = Field(default=1, description="the number that restores it: 1 was replaced last")
    id: str
    version: int
    created: str = Field(description="ISO 8601, UTC")


class MapVersions(_Out):
    """The maps that a map replaced and that are kept, the latest first."""

    model_config = ConfigDict(
        frozen=True,
        json_schema_extra={
            "example": {"versions": [{"number": 1, "id": _MAP_ID, "version": 1, "created": "2026-01-05T10:00:00Z"}]}
        },
    )

    versions: list[PreviousMap]


class LearningOut(_Out):
    """What is kept for a map to learn from, and what it last learned."""

    model_config = ConfigDict(
        frozen=True,
        json_schema_extra={
            "example": {
                "map": "hall",
                "learns": True,
                "queries": 214,
                "size_bytes": 9_630_000,
                "askers": 3,
                "oldest": 1767607200.0,
                "newest": 1767693600.0,
                "fewest": 30,
                "last": None,
                "job": None,
                "latest": None,
            }
        },
    )

    map: str
    learns: bool = Field(description="whether this server keeps queries for its maps to learn from")
    queries: int = Field(description="how many are kept for this map")
    size_bytes: int
    askers: int = Field(description="how many asked them")
    oldest: float | None = Field(description="s since the epoch")
    newest: float | None = Field(description="s since the epoch")
    fewest: int = Field(description="how many a map learns from at least")
    last: LearningReport | None = Field(description="what the map last learned from its users")
    job: str | None = Field(description="the id of the job by which it is learning now, or will be")
    latest: JobOut | None = Field(
        description="the job by which it last learned from its users, or could not: its `error` says why; null where "
        "there was none, or it was deleted"
    )


class DeletedQueries(_Out):
    """How many queries were deleted."""

    model_config = ConfigDict(frozen=True, json_schema_extra={"example": {"deleted": 214}})

    deleted: int


class MapDetail(MapSummary):
    """A map with its sources and its extent."""

    model_config = ConfigDict(
        frozen=True,
        json_schema_extra={
            "example": {
                **_SUMMARY,
                "sources": [sent(SOURCE)],
                "waypoints": [sent(WAYPOINT)],
                "bounds_m": [[-1.0, -2.0, 0.0], [5.0, 3.0, 2.8]],
                "previous": None,
                "names": sent(NAMES),
                "corrections": [sent(CORRECTION)],
                "plan": None,
                "points": 24180,
                "pictures": False,
                "levelling": None,
            }
        },
    )

    sources: tuple[Source, ...]
    waypoints: tuple[MapWaypoint, ...]
    bounds_m: list[list[float]] | None = Field(description="the lowest and the highest x, y, z of its landmarks")
    previous: PreviousMap | None = Field(description="the map that it replaced, which can be restored")
    names: MapNames = Field(description="of points and areas")
    corrections: tuple[Correction, ...] = Field(description="what people corrected in it, the latest last")
    plan: FloorPlan | None = Field(
        description="the floor plan that it keeps, and where it lies; null where there is none"
    )
    points: int = Field(description="how many further points of the room it keeps, for people to see")
    pictures: bool = Field(description="whether it keeps pictures of its views, and this server shows them")
    levelling: list[list[float]] | None = Field(
        description="3×3, a rotation of the map for display that makes up z and walls parallel to x and y, both as "
        "estimated; null where the map is upright, or where up cannot be estimated"
    )
    live: bool = Field(default=False, description="whether this server shows who asks for poses in it")
    keeps_failures: bool = Field(default=False, description="whether this server keeps where requests fail in it")


class MapList(_Out):
    """All maps that are served, by name; files that cannot be read are listed separately."""

    model_config = ConfigDict(frozen=True, json_schema_extra={"example": {"maps": [_SUMMARY], "unreadable": {}}})

    maps: list[MapSummary]
    unreadable: dict[str, str] = Field(description="names of map files that cannot be read, and why")


class MapPatch(_In):
    """What may be changed of a map: its name."""

    model_config = ConfigDict(extra="forbid", frozen=True, json_schema_extra={"example": {"name": "ground-floor"}})

    name: str


class _CorrectionIn(_In):
    version: int | None = Field(
        default=None,
        description="the version to correct: if it is no longer the present one, nothing changes",
    )


class OriginIn(_CorrectionIn):
    """A point becomes the origin."""

    kind: Literal["origin"]
    at: Vector3 = Field(description="m, present frame")


class NorthIn(_CorrectionIn):
    """A direction, seen from above, becomes y; the map turns about its origin."""

    kind: Literal["north"]
    direction: Vector3 = Field(description="present frame; its length does not matter")


class WallIn(_CorrectionIn):
    """A direction along a wall, seen from above, becomes x; the map turns about its origin."""

    kind: Literal["wall"]
    direction: Vector3 = Field(description="present frame; its length does not matter")


class UpIn(_CorrectionIn):
    """A direction becomes z, and the map upright."""

    kind: Literal["up"]
    direction: Vector3 | None = Field(
        default=None, description="present frame; default: the direction that the map's views hold upright"
    )


class ScaleIn(_CorrectionIn):
    """A measured distance between two points: the map takes that scale, and is metric from then on."""

    kind: Literal["scale"]
    start: Vector3 = Field(description="present frame")
    end: Vector3 = Field(description="present frame")
    length_m: Number = Field(gt=0, description="the measured distance between them, m")


class PlanPoint(_In):
    """A point of the map, and where it is on a floor plan."""

    map: Vector3 = Field(description="present frame")
    plan: Vector2 = Field(description="m, in the plan's frame: x and y")


class PlanIn(_CorrectionIn):
    """The map is aligned with a floor plan, whose frame becomes the map's; heights stay."""

    kind: Literal["plan"]
    points: list[PlanPoint] = Field(description="two pairs or more")
    scaled: bool = Field(default=False, description="whether the map takes the plan's scale, and is metric")


class RegionIn(_CorrectionIn):
    """The landmarks inside a region are removed, or all others."""

    kind: Literal["region"]
    outline: list[Vector2] = Field(description="its corners, seen from above, m: 3 to 200")
    bottom_m: Number | None = Field(default=None, description="its lowest z; default: no bound")
    top_m: Number | None = Field(default=None, description="its highest z; default: no bound")
    keep: Literal["inside", "outside"] = Field(description="what stays")


class WalkIn(_CorrectionIn):
    """A piece of a walk is removed: its views, and the landmarks that only they saw."""

    kind: Literal["walk"]
    first_view: int = Field(description="its first view, by number in the map, from 0")
    last_view: int = Field(description="its last view, inclusive")


class NamedPointIn(_In):
    """A point with a name."""

    name: str
    position: Vector3 = Field(description="m")


class NamedAreaIn(_In):
    """An area with a name, seen from above; areas may overlap."""

    name: str
    outline: list[Vector2] = Field(description="its corners in order, m: 3 to 200")


class NamesIn(_CorrectionIn):
    """Names of points and areas, replacing those that the map has."""

    kind: Literal["names"]
    points: list[NamedPointIn] = Field(default_factory=list)
    areas: list[NamedAreaIn] = Field(default_factory=list)


class LabelsIn(_CorrectionIn):
    """The map's site, floor and tags, replacing those that it has."""

    kind: Literal["labels"]
    site: str = Field(default="", description="such as a building")
    floor: str = Field(default="", description="of the site")
    tags: list[str] = Field(default_factory=list, description="further words; 20 at most")


CorrectionIn = Annotated[
    OriginIn | NorthIn | WallIn | UpIn | ScaleIn | PlanIn | RegionIn | WalkIn | NamesIn | LabelsIn,
    Field(discriminator="kind"),
]

CORRECTION_EXAMPLES: dict[str, Example] = {
    "origin": {"value": {"kind": "origin", "at": [1.2, 0.4, 0.0]}},
    "wall": {"value": {"kind": "wall", "direction": [0.98, 0.17, 0.0]}},
    "scale": {"value": {"kind": "scale", "start": [0.0, 0.0, 1.0], "end": [0.0, 2.1, 1.0], "length_m": 2.05}},
    "plan": {
        "value": {
            "kind": "plan",
            "points": [{"map": [0.1, 0.2, 0.0], "plan": [4.0, 2.0]}, {"map": [3.1, 0.3, 0.0], "plan": [4.0, 5.0]}],
        }
    },
    "region": {"value": {"kind": "region", "outline": [[0, 0], [4, 0], [4, 3], [0, 3]], "keep": "inside"}},
    "names": {
        "value": {
            "kind": "names",
            "points": [{"name": "charger", "position": [0.2, 3.1, 0.0]}],
            "areas": [{"name": "kitchen", "outline": [[0, 0], [4, 0], [4, 3], [0, 3]]}],
        }
    },
    "labels": {"value": {"kind": "labels", "site": "plant 2", "floor": "1", "tags": ["night shift"]}},
}


class UpdateIn(_In):
    """A stored recording for a map to learn."""

    model_config = ConfigDict(extra="forbid", frozen=True, json_schema_extra={"example": {"recording": _RECORDING_ID}})

    recording: str = Field(description="the recording's id")
    poses: PoseMethod | None = Field(
        default=None, description="where frame poses come from; default: its own, else each frame is localized"
    )
    camera: str | None = Field(
        default=None,
        description=CAMERA_TEXT,
    )
    priority: JobPriority = Field(
        default=JobPriority.NORMAL, description="how soon its turn comes, among jobs submitted within a day"
    )


class MergeIn(_In):
    """Another map to merge with, and the name of the merged one."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, json_schema_extra={"example": {"other": "kitchen", "into": "ground-floor"}}
    )

    other: str = Field(description="the map whose frame is given up")
    into: str = Field(description="the name of the merged map; a map of that name is replaced")


class ForgetIn(_In):
    """A recording for a map to forget."""

    model_config = ConfigDict(extra="forbid", frozen=True, json_schema_extra={"example": {"source": "walk-1"}})

    source: str = Field(description="its id or name in the map's sources")


class FramePoseIn(_In):
    """Where one frame lies in another."""

    position: tuple[Number, Number, Number] = Field(default=(0.0, 0.0, 0.0), description="of its origin, m")
    quaternion_xyzw: tuple[Number, Number, Number, Number] = Field(
        default=(0.0, 0.0, 0.0, 1.0), description="its rotation, x, y, z, w"
    )


class SiteMapIn(_In):
    """A map of a site."""

    map: str
    floor: str = Field(default="", description="such as '1' or 'ground floor'")
    pose: FramePoseIn | None = Field(default=None, description="T_site_map; without one it is found from links")
    covariance: list[list[Number]] | None = Field(
        default=None,
        max_length=6,
        description="6×6 of a given pose: x, y, z in m, then a small rotation about the site's axes in radians",
    )


class SiteLinkIn(_In):
    """The pose between two maps."""

    first: str
    second: str
    pose: FramePoseIn = Field(description="T_first_second")
    sigma_m: Number = Field(default=0.05, description="one sigma of its position, m")
    sigma_deg: Number = Field(default=0.5, description="one sigma of its rotation, degrees")
    origin: LinkOrigin = Field(default=LinkOrigin.GIVEN, description="where it comes from")


class SiteEarthIn(_In):
    """Where a site's frame lies on Earth, WGS 84; its z axis is up."""

    latitude_deg: Number
    longitude_deg: Number
    height_m: Number = 0.0
    heading_deg: Number = Field(default=0.0, description="of the site's y axis: degrees from true north, clockwise")


class SiteIn(_In):
    """A site: maps in one frame."""

    model_config = ConfigDict(extra="forbid", frozen=True, json_schema_extra={"example": _SITE})

    maps: list[SiteMapIn] = Field(max_length=MOST_MAPS)
    links: list[SiteLinkIn] = Field(default_factory=list, max_length=10_000)
    earth: SiteEarthIn | None = None
    version: int | None = Field(default=None, description="the version that this was made from; default: whichever")


class SiteLinkWanted(_In):
    """Two maps of a site, the pose between which is looked for."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, json_schema_extra={"example": {"first": "hall", "second": "kitchen"}}
    )

    first: str
    second: str


class SiteMapOut(_Out):
    """A map of a site."""

    map: str
    floor: str
    pose: FramePose | None = Field(description="T_site_map; null where neither anybody nor a link says")
    given: bool = Field(description="whether somebody gave the pose")
    covariance: list[list[float]] | None = Field(
        description="6×6 of the pose: x, y, z in m, then a small rotation about the site's axes in radians"
    )
    present: bool = Field(description="whether there is a map of this name now")


class SiteOut(_Out):
    """A site."""

    model_config = ConfigDict(frozen=True, json_schema_extra={"example": _SITE_ANSWER})

    name: str
    version: int
    maps: list[SiteMapOut]
    links: tuple[SiteLink, ...]
    earth: SiteOnEarth | None


class SiteList(_Out):
    """All sites."""

    model_config = ConfigDict(frozen=True, json_schema_extra={"example": {"sites": [_SITE_ANSWER], "unreadable": {}}})

    sites: list[SiteOut]
    unreadable: dict[str, str] = Field(description="names of site files that cannot be read, and why")


class MapReportOut(_Out):
    """What the map found out about itself while it was built."""

    model_config = ConfigDict(
        frozen=True,
        json_schema_extra={
            "example": {
                "map": "testsite",
                "map_id": _MAP_ID,
                "map_version": 1,
                "report": sent(REPORT),
            }
        },
    )

    map: str
    map_id: str
    map_version: int
    report: MapReport


class ChangeOut(_Out):
    """A request that changed something."""

    time: float = Field(description="s since the epoch")
    who: str = Field(description="the name of the API key, or the address where no key is needed")
    method: str
    path: str
    status: int = Field(description="of the answer")
    job: str = Field(description="the job that it began, empty where it began none")
    request_id: str


class ChangesOut(_Out):
    """The last changes, the newest first."""

    model_config = ConfigDict(
        frozen=True,
        json_schema_extra={
            "example": {
                "changes": [
                    {
                        "time": 1767607200.0,
                        "who": "alice",
                        "method": "PUT",
                        "path": "/v1/maps/hall",
                        "status": 200,
                        "job": "",
                        "request_id": "7d7f0a1c2b3d4e5f8091a2b3c4d5e6f7",
                    }
                ]
            }
        },
    )

    changes: list[ChangeOut]


class FailureOut(_Out):
    """Where a request found no pose, or an unsure one."""

    time: float = Field(description="s since the epoch")
    position: list[float] = Field(description="m")
    heading: list[float] | None = Field(description="where the camera looked; null where that is not known")
    confidence: float
    reason: str | None = Field(description="why there is no pose; null where there is an unsure one")


class FailuresOut(_Out):
    """The failures of the last day, the oldest first."""

    model_config = ConfigDict(
        frozen=True,
        json_schema_extra={
            "example": {
                "failures": [
                    {
                        "time": 1767607200.0,
                        "position": [2.1, 0.4, 1.5],
                        "heading": None,
                        "confidence": 0.31,
                        "reason": "not_recognized",
                    }
                ]
            }
        },
    )

    failures: list[FailureOut]


class JobError(_Out):
    """Why a job failed."""

    code: str
    message: str
    hint: str


_JOB: JsonDict = {
    "id": _JOB_ID,
    "kind": "build",
    "recording": _RECORDING_ID,
    "map": "testsite",
    "site": None,
    "state": "running",
    "stage": "poses",
    "progress": 0.42,
    "message": "31 of 60 keyframes placed",
    "log": ["60 keyframes chosen"],
    "warnings": [],
    "trusted": None,
    "error": None,
    "created": 1767607200.0,
    "started": 1767607201.5,
    "ended": None,
    "attempts": 1,
    "priority": "normal",
    "memory_bytes": 1_100_000_000,
    "obstacle": None,
}


class JobOut(_Out):
    """A mapping job."""

    model_config = ConfigDict(frozen=True, json_schema_extra={"example": _JOB})

    id: str
    kind: JobKind
    recording: str = Field(description="the recording's id; empty where the job needs none")
    map: str = Field(description="the name of the map that it publishes; empty where it places a site's maps")
    site: str | None = Field(description="the site whose maps it places; null where it makes a map")
    state: JobState
    stage: Stage
    progress: float = Field(description="0..1 over all stages")
    message: str
    log: list[str]
    warnings: list[str] = Field(
        description="why its published map is not to be trusted, or why maps of its site are not placed"
    )
    trusted: bool | None = Field(
        description="whether its published map is to be trusted; `warnings` say why not; null before it is published, "
        "and for a job that publishes none"
    )
    error: JobError | None
    created: float = Field(description="s since the epoch")
    started: float | None
    ended: float | None
    attempts: int
    priority: JobPriority
    memory_bytes: int | None = Field(description="about how much memory it needs; null until its recording was read")
    obstacle: Obstacle | None = Field(
        description="why no worker can take it, as `message` says: none is running, those that are started die, or "
        "none has as much memory; null where one can"
    )


class JobChange(_In):
    """What of a job can be changed."""

    model_config = ConfigDict(extra="forbid", frozen=True, json_schema_extra={"example": {"priority": "high"}})

    priority: JobPriority


class JobList(_Out):
    """Jobs, the newest first."""

    model_config = ConfigDict(frozen=True, json_schema_extra={"example": {"jobs": [_JOB], "more": False}})

    jobs: list[JobOut]
    more: bool = Field(default=False, description="Whether there are older ones: ask with `before`, the last one's id.")


_RECORDING: JsonDict = {
    "id": _RECORDING_ID,
    "files": ["walk.mp4"],
    "size_bytes": 60_000_000,
    "created": 1767607200.0,
    "content": {"length_s": 31.2, "frames": 936, "width": 1280, "height": 720, "format": "video", "imu": False},
    "thumbnail": True,
}
_RECORDED_WAYPOINT: JsonDict = {"name": "W1", "position": [2.0, 0.0, 1.5], "time_s": 8.4, "sigma_m": 0.02}


class RecordingContent(_Out):
    """What a job read from a recording."""

    length_s: float | None
    frames: int
    width: int = Field(description="of a frame, px")
    height: int
    format: str = Field(description="how it is laid out")
    imu: bool = Field(description="whether it has an IMU's table")


class RecordingOut(_Out):
    """A stored recording."""

    model_config = ConfigDict(frozen=True, json_schema_extra={"example": _RECORDING})

    id: str
    files: list[str]
    size_bytes: int
    created: float = Field(description="s since the epoch")
    content: RecordingContent | None = Field(description="null until a job has read it")
    thumbnail: bool = Field(description="whether there is a small picture of it that this client may see")


class WaypointIn(_In):
    """A measured point of a recording."""

    name: str
    position: Vector3 = Field(description="m")
    time_s: Number | None = Field(
        default=None, description="when the camera was there, s on the recording's clock; default: found by the order"
    )
    sigma_m: Number = Field(default=0.02, description="how well the camera was held to it, m: 0.001 to 1")


class WaypointsIn(_In):
    """Waypoints that replace a recording's own, in the order of the walk."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, json_schema_extra={"example": {"waypoints": [_RECORDED_WAYPOINT]}}
    )

    waypoints: list[WaypointIn] = Field(max_length=1000, description="three or more")


class RecordingDetail(RecordingOut):
    """A stored recording with its waypoints."""

    model_config = ConfigDict(
        frozen=True,
        json_schema_extra={"example": {**_RECORDING, "waypoints": [_RECORDED_WAYPOINT], "corrected": False}},
    )

    waypoints: tuple[RecordedWaypoint, ...] = Field(description="as corrected, else as a job read them from it")
    corrected: bool = Field(description="whether they replace the recording's own")


class RecordingList(_Out):
    """All stored recordings, the newest first."""

    model_config = ConfigDict(frozen=True, json_schema_extra={"example": {"recordings": [_RECORDING]}})

    recordings: list[RecordingOut]


class RecordingAccepted(_Out):
    """A completed upload, and the mapping job that it started."""

    model_config = ConfigDict(
        frozen=True, json_schema_extra={"example": {"recording": _RECORDING_ID, "job": {**_JOB, "state": "queued"}}}
    )

    recording: str = Field(description="the recording's id")
    job: JobOut


class KeyLimitsIn(_In):
    """How much a key allows, with all keys that it handed on; what is null or missing is not limited."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        json_schema_extra={"example": {"requests_per_s": 5, "burst": 20, "maps": 10, "stored_bytes": 1e10, "jobs": 2}},
    )

    requests_per_s: Number | None = Field(
        default=None, ge=0.001, le=1e6, description="requests a second, to each server"
    )
    burst: int | None = Field(
        default=None, ge=1, le=10**6, description="how many requests may come at once; default: those of a second"
    )
    maps: int | None = Field(default=None, ge=0, le=10**9, description="maps, with those that its jobs will publish")
    stored_bytes: int | None = Field(default=None, ge=0, le=2**53, description="bytes of maps and recordings")
    jobs: int | None = Field(default=None, ge=0, le=10**9, description="jobs that are queued or running")


class KeyLimitsOut(KeyLimitsIn):
    """How much a key allows; null: not limited."""


class KeyUsageOut(_Out):
    """What a key holds, with all keys that it handed on."""

    maps: int = Field(description="with those that its jobs will publish")
    stored_bytes: int = Field(description="of maps and recordings; an unfinished upload counts whole")
    jobs: int = Field(description="queued or running, or to come with an unfinished upload")


class KeyIn(_In):
    """A key to hand on."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, json_schema_extra={"example": {"scope": "read", "lifetime_s": 86400}}
    )

    scope: Scope = Field(default=Scope.READ, description="what it allows; no more than the request's own key")
    lifetime_s: Number = Field(
        default=86400, ge=60, le=31 * 86400, description="how long it is valid, s: a minute to 31 days"
    )
    limits: KeyLimitsIn = Field(
        default_factory=KeyLimitsIn, description="how much it allows; never more than the request's own key"
    )


class KeyOut(_Out):
    """A key's name, and what it allows."""

    name: str
    scope: Scope
    created: float = Field(description="s since the epoch")
    expires: float | None = Field(description="s since the epoch; null: never")
    limits: KeyLimitsOut = Field(description="how much it allows")
    handed_on_by: str | None = Field(default=None, description="the name of the key that handed it on; null: none did")


class KeyDetail(KeyOut):
    """A key, and what it holds."""

    model_config = ConfigDict(
        frozen=True,
        json_schema_extra={
            "example": {
                "name": "robot-7",
                "scope": "map",
                "created": 1767607200.0,
                "expires": None,
                "limits": {"requests_per_s": 5.0, "maps": 10},
                "used": {"maps": 2, "stored_bytes": 48_211_004, "jobs": 0},
            }
        },
    )

    used: KeyUsageOut


class KeyList(_Out):
    """All keys, the oldest first."""

    model_config = ConfigDict(
        frozen=True,
        json_schema_extra={
            "example": {
                "keys": [
                    {
                        "name": "robot-7",
                        "scope": "localize",
                        "created": 1767607200.0,
                        "expires": None,
                        "limits": {"requests_per_s": 5.0},
                    }
                ],
            }
        },
    )

    keys: list[KeyOut]


class OpenStreamOut(_Out):
    """An open stream."""

    id: str
    kind: StreamKind = Field(description="`frames`: a WebSocket; `events`: server-sent events")
    key: str | None = Field(description="the name of the key that it was opened with; null where none is needed")
    counted_to: str = Field(description="the first of the keys that handed that key on, or an address")
    path: str
    since: float = Field(description="s since the epoch")


class OpenStreamList(_Out):
    """The open streams of a server, the oldest first."""

    model_config = ConfigDict(
        frozen=True,
        json_schema_extra={
            "example": {
                "streams": [
                    {
                        "id": "5f0c3a52d1c24e0f8d1c8f1a8f0e6c11",
                        "kind": "events",
                        "key": "handed-1f2e3d4c",
                        "counted_to": "alice",
                        "path": "/v1/maps/hall/live",
                        "since": 1767607200.0,
                    }
                ]
            }
        },
    )

    streams: list[OpenStreamOut]


class UploadOut(_Out):
    """An unfinished upload."""

    id: str = Field(description="of the upload, and of the recording that it becomes")
    map: str = Field(description="the map that it is for")
    size_bytes: int = Field(description="once it is complete; 0 where no key is needed")
    key: str | None = Field(description="the name of the key that began it; null where none is needed")
    counted_to: str | None = Field(description="the first of the keys that handed that key on, or the key itself")


class UploadList(_Out):
    """The unfinished uploads."""

    model_config = ConfigDict(
        frozen=True,
        json_schema_extra={
            "example": {
                "uploads": [
                    {
                        "id": "9b2ad7a3f3c84a1fb0f5c5b4f1a0d6ee",
                        "map": "hall",
                        "size_bytes": 48_211_004,
                        "key": "handed-1f2e3d4c",
                        "counted_to": "alice",
                    }
                ]
            }
        },
    )

    uploads: list[UploadOut]


class HandedKeyOut(_Out):
    """A key that was handed on."""

    model_config = ConfigDict(
        frozen=True,
        json_schema_extra={
            "example": {"key": "rho_…", "name": "handed-1f2e3d4c", "scope": "read", "expires": 1767693600.0}
        },
    )

    key: str | None = Field(description="the key; null where the server requires none")
    name: str | None = Field(description="the name to revoke it by")
    scope: Scope
    expires: float | None = Field(description="s since the epoch")


class QrIn(_In):
    """A text for a QR code."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, json_schema_extra={"example": {"text": "https://maps.example/record"}}
    )

    text: str = Field(min_length=1, max_length=1000)


class Health(_Out):
    """The process answers."""

    model_config = ConfigDict(frozen=True, json_schema_extra={"example": {"status": "ok", "version": "0.1.0"}})

    status: str
    version: str


class Readiness(_Out):
    """Whether the service can do its work, and what prevents it."""

    model_config = ConfigDict(
        frozen=True, json_schema_extra={"example": {"ready": False, "checks": {"maps": "ok", "jobs": "not running"}}}
    )

    ready: bool
    checks: dict[str, str] = Field(description="'ok', or what is not ready")
