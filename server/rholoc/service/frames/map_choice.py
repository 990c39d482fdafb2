"""Choice of maps for a frame: the named ones, or of many the most similar ones."""

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
        """The likeliest map and those with 0.8 of its score, at least two, for the search with the quick features."""
        rivals = sum(score >= _RIVAL_SHARE * self.scores[0] for score in self.scores)
        return self._take(range(min(len(self.names), max(rivals, _ASKED_AT_FIRST))))

    def besides(self, asked: Candidates) -> Candidates:
        """Candidates not in ``asked``, at most ``MAX_ASKED`` together with these."""
        new = [row for row, name in enumerate(self.names) if name not in asked.names]
        return self._take(new[: MAX_ASKED - len(asked.names)])

    def _take(self, rows: Sequence[int]) -> Candidates:
        return replace(
            self, names=tuple(self.names[row] for row in rows), scores=tuple(self.scores[row] for row in rows)
        )

    def is_settled(self, asked: int, best: int, recognized: float) -> bool:
        """Whether the first ``asked`` maps suffice: the best is number ``best``, with a pose of probability
        ``recognized``.

        That must be at least ``CONCLUSIVE``, and the scores of the maps not asked below 0.8 of its own. False without
        scores.
        """
        if recognized < CONCLUSIVE or not self.scores:
            return False
        return all(score < _RIVAL_SHARE * self.scores[best] for score in self.scores[asked:])
