"""Choice of maps for a frame, the named ones or of many the most similar ones, and of the best of their answers."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

from rholoc.errors import DeadlineExceeded, InvalidCamera, InvalidDescriptors
from rholoc.features import Extractor, FeatureSet
from rholoc.localization import AnyLocalizer, MapFinder
from rholoc.service.frames.localizers import LocalizerSource, MapNotHereError
from rholoc.service.http.stopwatch import Stopwatch

MAX_ASKED = 5
"""Maximum number of maps that a frame is localized in; of more, the index over all views chooses."""

_ASKED_AT_FIRST = 2
CONCLUSIVE = 0.9
"""The ``recognized`` of an answer after which maps that are far less likely are not asked."""

_RIVAL_SHARE = 0.8  # maps with at least this share of the best score are asked as well


@dataclass(frozen=True)
class MapChoice:
    """The maps of a request.

    Attributes:
        names: of the maps, in the order of asking if all are asked.
        named: whether the request named them; otherwise unusable maps are skipped.
        finder: chooses from many maps; None to ask all.
        is_all: whether these are all maps of the library.
        site: the site of the maps, if the request names it.
    """

    names: Collection[str]
    named: bool = True
    finder: MapFinder | None = None
    is_all: bool = False
    site: str | None = None

    @property
    def first(self) -> str:
        """The first name; raises StopIteration if there is none."""
        return next(iter(self.names))

    def candidates(self, features_by: Callable[[Extractor], FeatureSet]) -> Candidates:
        """The maps to ask, the likeliest first; ``features_by`` extracts the frame's features.

        All, in their order, if there are at most ``MAX_ASKED``, no finder, or no likely ones. Otherwise the likeliest,
        and maps that are not indexed yet, ``MAX_ASKED`` together.
        """
        finder = self.finder
        if finder is None or len(self.names) <= MAX_ASKED:
            return Candidates(tuple(self.names), passing_over=not self.named)
        likely = finder.likeliest(features_by, MAX_ASKED, None if self.is_all else self.names)
        if not likely:
            return Candidates(tuple(self.names), passing_over=True)
        wanted = None if self.is_all else set(self.names)
        others = [name for name in finder.unknown if wanted is None or name in wanted]
        names = (*(one.name for one in likely), *others)[:MAX_ASKED]
        scores = tuple(one.score for one in likely) + (1.0,) * (len(names) - len(likely))
        return Candidates(names, passing_over=True, scores=scores)


@dataclass(frozen=True)
class Candidates:
    """Maps to ask one after another.

    Attributes:
        names: of the maps.
        passing_over: whether unusable maps are skipped.
        scores: similarity of each map to the frame; empty if all maps are asked.
    """

    names: tuple[str, ...]
    passing_over: bool
    scores: tuple[float, ...] = ()

    @property
    def are_ranked(self) -> bool:
        """Whether they were chosen from more maps by similarity."""
        return bool(self.scores)

    def at_first(self) -> Candidates:
        """The likeliest map and those with 0.8 of its score, at least two, for the search with the quick features.

        Requires :attr:`are_ranked`.
        """
        rivals = sum(score >= _RIVAL_SHARE * self.scores[0] for score in self.scores)
        return self._take(range(min(len(self.names), max(rivals, _ASKED_AT_FIRST))))

    def besides(self, asked: Candidates) -> Candidates:
        """Candidates not in ``asked``, at most ``MAX_ASKED`` together with these."""
        new = [row for row, name in enumerate(self.names) if name not in asked.names]
        return self._take(new[: MAX_ASKED - len(asked.names)])

    def _take(self, rows: Sequence[int]) -> Candidates:
        """The candidates in ``rows``, in their order."""
        scores = tuple(self.scores[row] for row in rows) if self.scores else ()
        return replace(self, names=tuple(self.names[row] for row in rows), scores=scores)

    def is_settled(self, asked: int, best: int, recognized: float) -> bool:
        """Whether the first ``asked`` maps suffice: row ``best`` is best, its pose of probability ``recognized``.

        ``recognized`` must be at least ``CONCLUSIVE``, and the score of each map not asked below 0.8 of the best map's.
        False without scores.
        """
        if recognized < CONCLUSIVE or not self.scores:
            return False
        return all(score < _RIVAL_SHARE * self.scores[best] for score in self.scores[asked:])


T = TypeVar("T")
_log = logging.getLogger("rholoc.service")


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
            _log.warning("map_passed_over", extra={"map": name, "error": repr(error)[:200]})
            refused = refused or error
    if not asked and refused is not None:
        raise refused
