"""One frame → one answer, timed stage by stage. Runs in a thread of the compute pool."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from typing import TypeVar

import cv2
import numpy as np
import structlog

from rholoc import telemetry
from rholoc.errors import DeadlineExceeded, InvalidCamera, InvalidDescriptors, RholocError
from rholoc.features import Extractor, FeatureSet, widened
from rholoc.geometry import ByteArray, FloatArray, Pose
from rholoc.lazy import lazy
from rholoc.localization import (
    NO_BELIEF,
    TOO_LITTLE_TIME,
    AnyLocalizer,
    Intrinsics,
    Localization,
    Query,
    Reason,
    likeliest_views,
)
from rholoc.maps import areas_at, points_near, trust_of
from rholoc.recordings.frames.image import SENT_FORMATS, decode_image, image_size
from rholoc.service.learning import Lesson, Listener
from rholoc.service.localizers import LocalizerSource, MapNotHereError
from rholoc.service.map_choice import CONCLUSIVE, Candidates, MapChoice
from rholoc.service.queries import Frame, camera_for, feature_set, gravity_of, max_sigmas, prior_of
from rholoc.service.schemas import (
    AlternativeOut,
    DiagnosisOut,
    EstimatedCameraOut,
    LocalizationOut,
    MatchesOut,
    PlaceOut,
    PlacesOut,
    PoseOut,
)
from rholoc.service.settings import Settings
from rholoc.trajectory import Scale

_log = structlog.get_logger("rholoc.service")
T = TypeVar("T")
_Answered = tuple[str, AnyLocalizer, Localization]  # by which map

_NEAR_M = 2.0  # named points within it are listed
_STAGES = ("queue", "load", "decode", "extract", "match", "seed", "ascend", "verify", "diagnose")
_DEGREES = np.array([1, 1, 1, *[180 / np.pi] * 3])


@dataclass
class Stopwatch:
    """Milliseconds by stage since the request came in."""

    start_s: float = field(default_factory=time.perf_counter)
    stages_ms: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time of the block to a stage."""
        start = time.perf_counter()
        try:
            yield
        finally:
            took_s = time.perf_counter() - start
            self.stages_ms[name] = self.stages_ms.get(name, 0.0) + 1000 * took_s
            telemetry.note(name, took_s)

    def check(self, deadline_s: float) -> None:
        """Raise DeadlineExceeded once ``deadline_s`` seconds have passed."""
        if self.elapsed_s >= deadline_s:
            raise DeadlineExceeded("The deadline passed before the work was done.", "Allow more time.")

    @property
    def worked_ms(self) -> float:
        """All stages together."""
        return sum(self.stages_ms.values())

    @property
    def elapsed_s(self) -> float:
        """Seconds since the request came in."""
        return time.perf_counter() - self.start_s


def frame_deadline_s(asked_ms: float | None, settings: Settings) -> float:
    """How long after its request arrived a frame is answered at the latest, with a pose or without."""
    return (asked_ms or settings.default_deadline_ms) / 1000


def late_answer(name: str, localizer: AnyLocalizer, clock: Stopwatch) -> LocalizationOut:
    """The answer where the deadline passed before the map was searched."""
    return answer_of(name, localizer, too_late(), clock, with_matches=False)


def localize_frame(
    frame: Frame,
    maps: MapChoice,
    localizers: LocalizerSource,
    settings: Settings,
    clock: Stopwatch,
    listener: Listener | None = None,
) -> LocalizationOut:
    """The best answer of some maps: the one whose place is recognized most surely, with a pose if any has one.

    Of several maps, those whose features or camera do not fit the frame are passed over; where nobody named them, so
    are those that cannot be used for any other reason. ``listener`` hears of a pose found by a camera whose
    intrinsics are known.

    Raises:
        UnknownMap, InvalidMap, InvalidImage, InvalidCamera, InvalidDescriptors, InvalidInput: what was sent is not
            valid; with several maps, only if none could be used.
    """
    clock.stages_ms["queue"] = 1000 * clock.elapsed_s
    telemetry.note("queue", clock.elapsed_s)
    deadline_s = frame_deadline_s(frame.options.deadline_ms, settings)
    features = FrameFeatures(frame, settings, clock, deadline_s)

    def surest(asked: Candidates) -> _Answered:
        def localize(localizer: AnyLocalizer) -> Localization:
            return _localize(frame, localizer, features, deadline_s, clock)

        return best_map(asked, localizers, localize, _rank, clock)

    likely = chosen(maps, features.by_quick, clock)
    if likely.are_ranked:
        name, localizer, found = _looking_twice(likely.at_first(), maps, features, surest, clock)
    else:
        name, localizer, found = surest(likely)
    if listener is not None and found.localized and frame.options.intrinsics is Intrinsics.GIVEN:
        info = localizer.map.info
        camera = camera_for(frame, features.size, info.camera)
        listener(Lesson(info.id, widened(localizer.extractor, camera), camera, found, features.by))
    return answer_of(name, localizer, found, clock, frame.options.with_matches)


def likeliest_places(
    frame: Frame, maps: MapChoice, localizers: LocalizerSource, settings: Settings, clock: Stopwatch, most: int
) -> PlacesOut:
    """The views of some maps that a picture resembles most, at most ``most`` in all.

    Raises:
        As :func:`localize_frame`.
    """
    features = FrameFeatures(frame, settings, clock, frame_deadline_s(frame.options.deadline_ms, settings))
    places: list[PlaceOut] = []

    def ask(name: str, localizer: AnyLocalizer) -> None:
        info = localizer.map.info
        places.extend(
            PlaceOut(
                map=name,
                map_id=info.id,
                map_version=info.version,
                view=found.view,
                pose=pose_out(found.pose),
                score=found.score,
            )
            for found in likeliest_views(localizer, features.by(localizer.extractor), most)
        )

    each_map(chosen(maps, features.by, clock), localizers, ask, clock)
    return PlacesOut(places=sorted(places, key=lambda place: -place.score)[:most])


def chosen(maps: MapChoice, features_by: Callable[[Extractor], FeatureSet], clock: Stopwatch) -> Candidates:
    """The maps to ask for a frame, the likeliest first; what extracting its features takes is not part of the stage."""
    before_ms, start_s = clock.worked_ms, time.perf_counter()
    found = maps.candidates(features_by)
    if found.are_ranked:
        spent_ms = 1000 * (time.perf_counter() - start_s) - (clock.worked_ms - before_ms)
        clock.stages_ms["choose"] = clock.stages_ms.get("choose", 0.0) + spent_ms
    return found


def _looking_twice(
    at_first: Candidates,
    maps: MapChoice,
    features: FrameFeatures,
    surest: Callable[[Candidates], _Answered],
    clock: Stopwatch,
) -> _Answered:
    """The surest answer of the maps that a quick look at a frame finds; where it is not sure, of those that a closer
    look finds as well.

    Raises:
        RholocError: none of them could be asked.
    """
    answers, refused = [], None
    try:
        answers.append(surest(at_first))
    except DeadlineExceeded:
        raise
    except RholocError as error:
        refused = error
    if not answers or _rank(answers[0][2]) < (True, CONCLUSIVE):
        others = chosen(maps, features.by, clock).besides(at_first)
        if others.names:
            answers.append(surest(others))
    if not answers and refused is not None:
        raise refused
    return max(answers, key=lambda answer: _rank(answer[2]))


def _rank(found: Localization) -> tuple[bool, float]:
    return found.localized, found.recognized


def best_map(
    maps: Candidates,
    localizers: LocalizerSource,
    localize: Callable[[AnyLocalizer], T],
    rank: Callable[[T], tuple[bool, float]],
    clock: Stopwatch,
) -> tuple[str, AnyLocalizer, T]:
    """The map whose answer ranks highest: its name, its localizer and the answer.

    Raises:
        InvalidCamera, InvalidDescriptors: the frame fits none of the maps.
        RholocError: a map cannot be used; where maps may be passed over, only where none can.
    """
    best: tuple[str, AnyLocalizer, T] | None = None

    def ask(name: str, localizer: AnyLocalizer) -> bool:
        nonlocal best
        found = localize(localizer)
        if best is None or rank(found) > rank(best[2]):
            best = (name, localizer, found)
        is_localized, recognized = rank(best[2])
        asked = maps.names.index(name) + 1
        return is_localized and maps.is_settled(asked, maps.names.index(best[0]), recognized)

    each_map(maps, localizers, ask, clock)
    assert best is not None
    return best


def each_map(
    maps: Candidates, localizers: LocalizerSource, ask: Callable[[str, AnyLocalizer], bool | None], clock: Stopwatch
) -> None:
    """Ask maps one after another until ``ask`` says that it is enough, passing over those that a frame does not fit.

    Raises:
        InvalidCamera, InvalidDescriptors: the frame fits none of the maps.
        RholocError: a map cannot be used; where maps may be passed over, only where none can.
    """
    asked = 0
    refused: Exception | None = None
    for name in maps.names:
        try:
            with clock.stage("load"):
                localizer = localizers.get(name)
            enough = ask(name, localizer)
            asked += 1
            if enough:
                return
        except (InvalidCamera, InvalidDescriptors) as error:
            refused = refused or error
        except (DeadlineExceeded, MapNotHereError):
            raise
        except Exception as error:
            if not maps.passing_over:
                raise
            _log.warning("map_passed_over", map=name, error=repr(error)[:200])
            refused = refused or error
    if not asked and refused is not None:
        raise refused


class FrameFeatures:
    """The frame's features by extractor; the image is decoded once, each extractor runs once."""

    def __init__(self, frame: Frame, settings: Settings, clock: Stopwatch, deadline_s: float) -> None:
        self._frame = frame
        self._settings = settings
        self._clock = clock
        self._deadline_s = deadline_s
        self._extracted: dict[Extractor, FeatureSet] = {}
        if frame.image is not None:
            with clock.stage("decode"):
                self._image_size = image_size(frame.image, settings.max_image_pixels, SENT_FORMATS)

    @lazy
    def image(self) -> ByteArray | None:
        """The picture (H, W, 3); None if features were sent instead. It is decoded when it is first asked for."""
        if self._frame.image is None:
            return None
        with self._clock.stage("decode"):
            return decode_image(
                self._frame.image,
                self._settings.max_image_pixels,
                SENT_FORMATS,
                lambda: self._clock.check(self._deadline_s),
            )

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the image in pixels, by its header."""
        if self._frame.image is not None:
            return self._image_size
        camera = self._frame.options.camera
        if camera.width is None or camera.height is None:
            raise InvalidCamera(
                "The size of the image that the features come from is missing.", "Send camera.width and camera.height."
            )
        return camera.width, camera.height

    def by(self, extractor: Extractor) -> FeatureSet:
        """The features as this extractor gives them, or as they were sent."""
        if extractor not in self._extracted:
            if self.image is not None:
                with self._clock.stage("extract"):
                    found = self._found(extractor, self.image)
            else:
                assert self._frame.features is not None
                with self._clock.stage("decode"):
                    found = feature_set(self._frame.features, extractor, self._settings.max_features)
            self._extracted[extractor] = found
        return self._extracted[extractor]

    def by_quick(self, extractor: Extractor) -> FeatureSet:
        """The features that a quick look at the frame finds."""
        return self.by(extractor.quick)

    def more_by(self, extractor: Extractor) -> Callable[[], FeatureSet] | None:
        """A function that finds more features than the quick extractor does; None where there are no more."""
        image = self.image
        if image is None or extractor.quick is extractor:
            return None

        def more() -> FeatureSet:
            if extractor not in self._extracted:  # the localizer measures its time
                self._extracted[extractor] = self._found(extractor, image)
            return self._extracted[extractor]

        return more

    def _found(self, extractor: Extractor, image: ByteArray) -> FeatureSet:
        return extract_bounded(extractor, image, self._settings.max_feature_pixels)


def extract_bounded(extractor: Extractor, image: ByteArray, max_pixels: int) -> FeatureSet:
    """The features of an image (H, W, 3), in its own pixels; found in a smaller copy if it has over ``max_pixels``."""
    height, width = image.shape[:2]
    if width * height <= max_pixels:
        return extractor.extract(image)
    scale = math.sqrt(max_pixels / (width * height))
    small = cv2.resize(image, (max(1, int(width * scale)), max(1, int(height * scale))), interpolation=cv2.INTER_AREA)
    found = extractor.extract(np.asarray(small, dtype=np.uint8))
    factors = np.array([width / small.shape[1], height / small.shape[0]])
    pixels = ((found.pixels + 0.5) * factors - 0.5).astype(np.float32)
    return replace(found, pixels=pixels, sizes=(found.sizes * factors.mean()).astype(np.float32))


def _localize(
    frame: Frame, localizer: AnyLocalizer, features: FrameFeatures, deadline_s: float, clock: Stopwatch
) -> Localization:
    camera = camera_for(frame, features.size, localizer.map.info.camera)
    prior, gravity = prior_of(frame.options.prior), gravity_of(frame.options.gravity)
    if clock.elapsed_s >= deadline_s:
        return too_late()
    extractor = widened(localizer.extractor, camera)
    found = features.by(extractor.quick)
    left_s = deadline_s - clock.elapsed_s
    if left_s <= 0:
        return too_late()
    options = frame.options
    more = features.more_by(extractor)
    answer = localizer.localize(
        Query(
            found,
            camera,
            options.dof,
            prior,
            gravity,
            left_s,
            options.intrinsics,
            features.image,
            more,
            *max_sigmas(options),
        )
    )
    for stage, duration_ms in answer.timings_ms.items():
        clock.stages_ms[stage] = clock.stages_ms.get(stage, 0.0) + duration_ms
    return answer


def too_late() -> Localization:
    """The localizer's answer where the deadline passed before it was asked."""
    nothing = np.zeros(0, np.int64)
    return Localization(
        False, Reason.DEADLINE, None, None, NO_BELIEF, 0, 0, np.zeros((0, 2)), nothing, diagnosis=TOO_LITTLE_TIME
    )


def answer_of(
    name: str, localizer: AnyLocalizer, found: Localization, clock: Stopwatch, with_matches: bool
) -> LocalizationOut:
    """A map's answer as it is sent."""
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
    camera = found.camera
    if camera is None or found.focal_sigma_px is None:
        return None
    return EstimatedCameraOut(
        width=camera.width,
        height=camera.height,
        fx=camera.fx,
        fy=camera.fy,
        cx=camera.cx,
        cy=camera.cy,
        focal_sigma_px=found.focal_sigma_px,
    )


def _agreeing(localizer: AnyLocalizer, found: Localization) -> MatchesOut:
    landmarks = localizer.map.landmarks.positions[found.inlier_features]
    return MatchesOut(pixels=found.inlier_pixels.round(1).tolist(), landmarks=landmarks.round(4).tolist())


def pose_out(pose: Pose) -> PoseOut:
    """A pose as it is sent."""
    return PoseOut(
        position=pose.position.tolist(),
        heading=pose.heading.tolist(),
        roll_deg=float(np.degrees(pose.roll)),
        quaternion_xyzw=pose.quaternion_xyzw.tolist(),
        T_map_camera=pose.T_map_camera.tolist(),
    )


def _covariance(covariance: FloatArray) -> list[list[float]] | None:
    """(m, rad) → (m, deg); None where it is unbounded."""
    scaled = covariance * np.outer(_DEGREES, _DEGREES)
    return scaled.tolist() if np.isfinite(scaled).all() else None
