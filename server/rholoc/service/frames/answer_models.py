"""The models of answers to frames."""

from dataclasses import asdict, replace

import numpy as np
from pydantic import Field

from rholoc.geometry import FloatArray, Pose
from rholoc.localization import TOO_LITTLE_TIME, AnyLocalizer, Cause, Localization, Reason
from rholoc.maps import areas_at, points_near, trust_of
from rholoc.service.frames.geoposes import GeoPoseOut
from rholoc.service.http.models import AnswerModel
from rholoc.service.http.stopwatch import Stopwatch
from rholoc.trajectory import Scale


class PoseOut(AnswerModel):
    """A pose in the map frame (right-handed, z up)."""

    position: list[float] = Field(description="the camera's centre: x, y, z in m")
    heading: list[float] = Field(description="the optical axis, unit length")
    roll_deg: float = Field(description="the rotation about the heading against the upright camera")
    quaternion_xyzw: list[float] = Field(description="R_map_camera as x, y, z, w")
    T_map_camera: list[list[float]] = Field(description="4×4, takes points of the camera frame to the map frame")


class MatchesOut(AnswerModel):
    """The matches that agree with a pose: one entry of each list per match."""

    pixels: list[list[float]] = Field(description="u and v of the feature in the frame, px")
    landmarks: list[list[float]] = Field(description="x, y, z of the landmark in the map, m")


class DiagnosisOut(AnswerModel):
    """The most likely reason why there is no pose, and what to try."""

    cause: Cause
    message: str = Field(description="one sentence: what it looks like")
    hint: str = Field(description="one sentence: what to try")


class EstimatedCameraOut(AnswerModel):
    """The camera as estimated from the picture."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    focal_sigma_px: float = Field(description="one sigma of fx and fy")


class FramePoseOut(AnswerModel):
    """One of several frames that were localized together."""

    pose: PoseOut | None
    inliers: int = Field(description="how many of its matches agree with the pose")


class EarthOut(AnswerModel):
    """A camera on Earth, WGS 84."""

    latitude_deg: float
    longitude_deg: float
    height_m: float = Field(description="above the ellipsoid")
    heading_deg: float | None = Field(
        description="where it looks: degrees from true north, clockwise; null where it looks straight up or down"
    )


class SitePoseOut(AnswerModel):
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


class AlternativeOut(AnswerModel):
    """Another pose that the frame may have been taken from."""

    weight: float = Field(description="0..1, the probability that it is of the right place")
    pose: PoseOut
    covariance: list[list[float]] | None = Field(description="6×6, as `covariance` of the answer")


class LocalizationOut(AnswerModel):
    """The answer for one frame. ``localized`` false is an answer, not an error."""

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
    geopose: GeoPoseOut | None = Field(
        default=None,
        description="the camera on Earth as OGC GeoPose 1.0, where `geopose` asks for it and the map or its site has a "
        "place on Earth; the body's axes are x forward, y left, z up",
    )
    timings_ms: dict[str, float] = Field(
        description="milliseconds: queue, load (of a map that was not in memory), decode, extract, match, seed, "
        "ascend, verify, diagnose, total; in a large map also place, which finds the place first; of more than five "
        "maps also choose, which finds those to ask"
    )


class PlaceOut(AnswerModel):
    """A view of a map that may show much the same as the picture."""

    map: str
    map_id: str
    map_version: int
    view: int = Field(description="its number in the map")
    pose: PoseOut = Field(description="where the view was taken: near the picture's place, not the picture's pose")
    score: float = Field(description="how strongly the picture speaks for it; for ranking")


class PlacesOut(AnswerModel):
    """The most similar views of all maps that were asked, the best match first."""

    places: list[PlaceOut]


_NEAR_M = 2.0  # named points within it are listed
_STAGES = ("queue", "load", "decode", "extract", "match", "seed", "ascend", "verify", "diagnose")
_DEGREES = np.array([1, 1, 1, *[180 / np.pi] * 3])


def late_answer(name: str, localizer: AnyLocalizer, clock: Stopwatch) -> LocalizationOut:
    """The answer without a pose, if the deadline passed before the map ``name`` was searched."""
    return answer_of(name, localizer, too_late(), clock, with_matches=False)


def too_late() -> Localization:
    """The localizer's answer without a pose, of reason DEADLINE, as if it had been asked."""
    return Localization.refused(Reason.DEADLINE, diagnosis=TOO_LITTLE_TIME)


def answer_of(
    name: str, localizer: AnyLocalizer, found: Localization, clock: Stopwatch, with_matches: bool
) -> LocalizationOut:
    """A map's answer as it is sent, with inliers if ``with_matches``; in degrees. A refused pose is an alternative."""
    info = localizer.map.info
    total_ms = 1000 * clock.elapsed_s
    timings_ms = {**dict.fromkeys(_STAGES, 0.0), **clock.stages_ms, "total": total_ms}
    given_out = found if found.localized else replace(found, pose=None, covariance=None)
    return LocalizationOut(
        localized=found.localized,
        reason=found.reason,
        pose=None if given_out.pose is None else pose_out(given_out.pose),
        covariance=None if given_out.covariance is None else _covariance(given_out.covariance),
        recognized=found.recognized,
        confidence=found.confidence,
        alternatives=[
            AlternativeOut(weight=one.weight, pose=pose_out(one.pose), covariance=_covariance(one.covariance))
            for one in found.alternatives
        ],
        matches=found.matches,
        inliers=found.inliers,
        map=name,
        map_id=info.id,
        map_version=info.version,
        scale=Scale.METRIC if info.metric else Scale.ARBITRARY,
        map_trusted=trust_of(info).trusted,
        expected_error_m=found.expected_error_m,
        agreeing=_agreeing(localizer, found) if with_matches else None,
        diagnosis=None if found.diagnosis is None else DiagnosisOut(**asdict(found.diagnosis)),
        near_prior=found.near_prior,
        camera=_estimated_camera(found),
        areas=[] if given_out.pose is None else list(areas_at(info.names, given_out.pose.position)),
        near=[] if given_out.pose is None else list(points_near(info.names, given_out.pose.position, _NEAR_M)),
        timings_ms={stage: round(value, 3) for stage, value in timings_ms.items()},
    )


def _estimated_camera(found: Localization) -> EstimatedCameraOut | None:
    """The camera that the localizer estimated; None if the intrinsics were given."""
    camera = found.camera
    if camera is None or found.focal_sigma_px is None:
        return None
    return EstimatedCameraOut.model_validate({**camera.to_dict(), "focal_sigma_px": found.focal_sigma_px})


def _agreeing(localizer: AnyLocalizer, found: Localization) -> MatchesOut:
    """Pixels and landmarks of the answer's inliers, one entry of each list per inlier."""
    landmarks = localizer.map.landmarks.positions[found.inlier_features]
    return MatchesOut(pixels=found.inlier_pixels.round(1).tolist(), landmarks=landmarks.round(4).tolist())


def pose_out(pose: Pose) -> PoseOut:
    """A pose as it is sent: position, heading, roll in degrees, quaternion and matrix."""
    return PoseOut(
        position=pose.position.tolist(),
        heading=pose.heading.tolist(),
        roll_deg=float(np.degrees(pose.roll)),
        quaternion_xyzw=pose.quaternion_xyzw.tolist(),
        T_map_camera=pose.T_map_camera.tolist(),
    )


def _covariance(covariance: FloatArray) -> list[list[float]] | None:
    """Covariance (6, 6) of (m, rad) → of (m, deg) as lists; None if it is not finite."""
    scaled = covariance * np.outer(_DEGREES, _DEGREES)
    return scaled.tolist() if np.isfinite(scaled).all() else None
