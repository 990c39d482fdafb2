"""Which maps a frame is localized in: those that were named, or of many those that it is most like."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

from rholoc.features import Extractor, FeatureSet
from rholoc.localization import MapFinder

MAX_ASKED = 5
"""Maps that a frame is localized in; of more, the index over all views chooses."""

_ASKED_AT_FIRST = 2
CONCLUSIVE = 0.9
"""The ``recognized`` of an answer after which maps that are far less likely are not asked."""

_RIVAL_SHARE = 0.8  # of the score of the map that gave it: what scores as much is asked as well


@dataclass(frozen=True)
class MapChoice:
    """The maps of a request.

    Attributes:
        names: of the maps, in the order in which they are asked where all of them are.
        named: whether somebody named them; else those that cannot be asked are passed over.
        finder: chooses from them where there are many; None: all are asked.
        is_all: whether these are all the maps there are.
        site: the site whose maps they are, where the request names it.
    """

    names: Collection[str]
    named: bool = True
    finder: MapFinder | None = None
    is_all: bool = False
    site: str | None = None

    @property
    def first(self) -> str:
        """One of them."""
        return next(iter(self.names))

    def candidates(self, features_by: Callable[[Extractor], FeatureSet]) -> Candidates:
        """The maps to ask, the likeliest first; ``features_by`` gives a frame's features by an extractor.

        A map whose views are not known yet is asked where fewer than ``MAX_ASKED`` are known to be likely.
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
    """Maps to ask, one after the other.

    Attributes:
        names: of the maps.
        passing_over: whether those that cannot be asked are passed over.
        scores: how likely each is; empty where that is not known, and all are asked.
    """

    names: tuple[str, ...]
    passing_over: bool
    scores: tuple[float, ...] = ()

    @property
    def are_ranked(self) -> bool:
        """Whether they were chosen from more, and others might have been."""
        return bool(self.scores)

    def at_first(self) -> Candidates:
        """The likeliest, and those that are about as likely: what a quick look at a frame is worth."""
        rivals = sum(score >= _RIVAL_SHARE * self.scores[0] for score in self.scores)
        return self._take(range(min(len(self.names), max(rivals, _ASKED_AT_FIRST))))

    def besides(self, asked: Candidates) -> Candidates:
        """Those that have not been asked; as many as may be, with those that have."""
        new = [row for row, name in enumerate(self.names) if name not in asked.names]
        return self._take(new[: MAX_ASKED - len(asked.names)])

    def _take(self, rows: Sequence[int]) -> Candidates:
        return replace(
            self, names=tuple(self.names[row] for row in rows), scores=tuple(self.scores[row] for row in rows)
        )

    def is_settled(self, asked: int, best: int, recognized: float) -> bool:
        """Whether no more need be asked after the first ``asked``, of which number ``best`` gave the surest pose."""
        if recognized < CONCLUSIVE or not self.scores:
            return False
        return all(score < _RIVAL_SHARE * self.scores[best] for score in self.scores[asked:])
