"""Localize one frame, with the time of each stage. Runs in a compute thread."""

from collections.abc import Callable

from rholoc import telemetry
from rholoc.errors import DeadlineExceeded, RholocError
from rholoc.features import widened
from rholoc.localization import (
    AnyLocalizer,
    Intrinsics,
    Localization,
    Query,
    likeliest_views,
)
from rholoc.service.frames.answer_models import LocalizationOut, PlaceOut, PlacesOut, answer_of, pose_out, too_late
from rholoc.service.frames.frame_features import FrameFeatures
from rholoc.service.frames.kept.learning import Lesson, Listener
from rholoc.service.frames.localizers import LocalizerSource
from rholoc.service.frames.map_choice import CONCLUSIVE, Candidates, MapChoice, best_map, choose_candidates, each_map
from rholoc.service.frames.queries import Frame, camera_for, gravity_of, max_sigmas, prior_of
from rholoc.service.http.stopwatch import Stopwatch, frame_deadline_s
from rholoc.service.settings import Settings

_Answered = tuple[str, AnyLocalizer, Localization]  # map, its localizer, its answer


def localize_frame(
    frame: Frame,
    maps: MapChoice,
    localizers: LocalizerSource,
    settings: Settings,
    clock: Stopwatch,
    listener: Listener | None = None,
) -> LocalizationOut:
    """The best answer of some maps: one with a pose if possible, then the likeliest of the right place; without a pose
    at the deadline.

    Of several maps, those with unsuitable features or camera are skipped; if the request did not name them, so are maps
    unusable for any other reason. ``listener`` is called with a pose found with known intrinsics.

    Raises:
        UnknownMap, InvalidMap, InvalidImage, InvalidCamera, InvalidDescriptors, InvalidInput: what was sent is not
            valid; with several maps, only if none could be used.
        DeadlineExceeded: the deadline passed while the picture was decoded.
        MapNotHereError: a map is not on this machine.
    """
    clock.stages_ms["queue"] = 1000 * clock.elapsed_s
    telemetry.note("queue", clock.elapsed_s)
    deadline_s = frame_deadline_s(frame.options.deadline_ms, settings)
    features = FrameFeatures(frame, settings, clock, deadline_s)

    def surest(asked: Candidates) -> _Answered:
        def localize(localizer: AnyLocalizer) -> Localization:
            return _localize(frame, localizer, features, deadline_s, clock)

        return best_map(asked, localizers, localize, _rank, clock)

    likely = choose_candidates(maps, features.by_quick, clock)
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
    """The views of some maps that a picture resembles most, the best first, at most ``most`` in all.

    Raises:
        UnknownMap, InvalidMap, InvalidImage, InvalidCamera, InvalidDescriptors, InvalidInput: what was sent is not
            valid; with several maps, only if none could be used.
        DeadlineExceeded, MapNotHereError: as :func:`localize_frame` does.
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

    each_map(choose_candidates(maps, features.by, clock), localizers, ask, clock)
    return PlacesOut(places=sorted(places, key=lambda place: -place.score)[:most])


def _looking_twice(
    at_first: Candidates,
    maps: MapChoice,
    features: FrameFeatures,
    surest: Callable[[Candidates], _Answered],
    clock: Stopwatch,
) -> _Answered:
    """The surest answer of the maps ``at_first``; if that is not conclusive (0.9), of those found with all features
    too. Raises RholocError: no map could be used.
    """
    answers: list[_Answered] = []
    refusals: list[RholocError] = []

    def ask(asked: Candidates) -> None:
        try:
            answers.append(surest(asked))
        except DeadlineExceeded:
            raise
        except RholocError as error:
            refusals.append(error)

    ask(at_first)
    if not answers or _rank(answers[0][2]) < (True, CONCLUSIVE):
        others = choose_candidates(maps, features.by, clock).besides(at_first)
        if others.names:
            ask(others)
    if not answers:
        raise refusals[0]
    return max(answers, key=lambda answer: _rank(answer[2]))


def _rank(found: Localization) -> tuple[bool, float]:
    """Key by which the answers of several maps are compared; the greatest is best."""
    return found.localized, found.recognized


def _localize(
    frame: Frame, localizer: AnyLocalizer, features: FrameFeatures, deadline_s: float, clock: Stopwatch
) -> Localization:
    """Answer of one map; without a pose at the deadline [s of the clock]. Adds its timings to the clock's stages."""
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
