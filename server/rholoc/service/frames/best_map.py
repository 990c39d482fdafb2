"""Query maps for a frame one after another, and choose the best answer."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

import structlog

from rholoc.errors import DeadlineExceeded, InvalidCamera, InvalidDescriptors
from rholoc.features import Extractor, FeatureSet
from rholoc.localization import AnyLocalizer
from rholoc.service.frames.localizers import LocalizerSource, MapNotHereError
from rholoc.service.frames.map_choice import Candidates, MapChoice
from rholoc.service.http.stopwatch import Stopwatch

T = TypeVar("T")
_log = structlog.get_logger("rholoc.service")


def choose_candidates(maps: MapChoice, features_by: Callable[[Extractor], FeatureSet], clock: Stopwatch) -> Candidates:
    """Candidate maps for a frame: of more than can be asked, the likeliest first, if they can be ranked; else all.

    The time of ranking, without feature extraction, is added to the clock's stage "choose".
    """
    before_ms, start_s = clock.worked_ms, time.perf_counter()
    found = maps.candidates(features_by)
    if found.are_ranked:
        spent_ms = 1000 * (time.perf_counter() - start_s) - (clock.worked_ms - before_ms)
        clock.stages_ms["choose"] = clock.stages_ms.get("choose", 0.0) + spent_ms
    return found


def best_map(
    maps: Candidates,
    localizers: LocalizerSource,
    localize: Callable[[AnyLocalizer], T],
    rank: Callable[[T], tuple[bool, float]],
    clock: Stopwatch,
) -> tuple[str, AnyLocalizer, T]:
    """Name, localizer and answer of the map with the highest rank: whether there is a pose, and its probability.

    Maps are asked in order, until the rest are too unlikely (:meth:`Candidates.is_settled`).

    Raises:
        InvalidCamera, InvalidDescriptors: the frame fits none of the maps.
        RholocError: a map cannot be used; where maps may be passed over, only where none can.
        DeadlineExceeded, MapNotHereError: at once.
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
    """Call ``ask`` for maps one after another until it returns True; skips maps that do not fit the frame.

    Raises:
        InvalidCamera, InvalidDescriptors: the frame fits none of the maps. DeadlineExceeded, MapNotHereError: at once.
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
