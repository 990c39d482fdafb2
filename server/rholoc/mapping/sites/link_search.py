"""Links between the maps of a site: search pair by pair until all maps have a pose."""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

from rholoc.errors import InvalidInput, InvalidMap, MappingFailed, UnknownMap
from rholoc.mapping.sites.linking import find_link
from rholoc.mapping.sites.poses import solve_site, with_link
from rholoc.maps import Map, Site, SiteLink
from rholoc.progress import ProgressListener, Stage, silent


@dataclass(frozen=True)
class SearchedPair:
    """Two maps of a site between which a link was looked for.

    Attributes:
        first, second: the maps' names.
        states: the :func:`map_state` of each map at the search; both empty if a map could not be read.
        link: the link found, or None.
        reason: one line that says why there is no link; empty if there is one.
    """

    first: str
    second: str
    states: tuple[str, str]
    link: SiteLink | None = None
    reason: str = ""

    @property
    def names(self) -> tuple[str, str]:
        """The names of both maps."""
        return self.first, self.second


def map_state(map_id: str, version: int) -> str:
    """Key of a map's content: changes whenever its frame, landmarks or views do."""
    return f"{map_id} {version}"


def search_links(
    site: Site,
    load: Callable[[str], Map],
    present: Collection[str],
    searched: Sequence[SearchedPair] = (),
    progress: ProgressListener = silent,
) -> Iterator[SearchedPair]:
    """Look for links until all maps are placed, or there is no pair of maps left that could help.

    Args:
        site: site with maps to place.
        load: returns a map by its name; if it raises UnknownMap or InvalidMap, the pair gets no link.
        present: names of the existing maps; others are skipped.
        searched: results of an earlier search; their pairs are not searched again.
        progress: called with :attr:`Stage.LINKS` and the share of all pairs done.

    Yields:
        Result of each pair whose relative pose was unknown, including earlier results, with or without a link. A link
        that contradicts others is replaced by the reason.

    Raises:
        InvalidInput: the site's own links contradict each other.
        Cancelled: ``progress`` asked to stop.
    """
    site = solve_site(site)
    known = {pair.names: pair for pair in searched}
    pairs = list(combinations([one.map for one in site.maps if one.map in set(present)], 2))
    for number, (first, second) in enumerate(pairs):
        note = _of_pair(progress, number, len(pairs))
        if _in_one_frame(site, first, second):
            continue
        note(Stage.LINKS, 0.0, f"{first} and {second}")
        pair = known.get((first, second))
        if pair is None:
            pair = _search(first, second, load, note)
        site, pair = _with_pair(site, pair)
        yield pair


def add_links(
    site: Site, searched: Sequence[SearchedPair], state_of: Callable[[str], str | None]
) -> tuple[Site, list[str]]:
    """Add the links that a search found to a site, and report why some maps still have no pose.

    Ignores links that the site already has, and links of maps that left the site. A link of a map that has changed
    since the search is not added, but reported.

    Args:
        site: the present site.
        searched: results of the search.
        state_of: returns the present :func:`map_state` of a map by its name; None if there is no such map.

    Returns:
        The site, and one line per problem; no lines if all maps have poses and all links were added.
    """
    problems = []
    for pair in searched:
        if pair.link is None or pair.link in site.links or any(site.member(name) is None for name in pair.names):
            continue
        if tuple(map(state_of, pair.names)) != pair.states:
            problems.append(f"{pair.first} or {pair.second} has changed since the search for a link.")
            continue
        site, added = _with_pair(site, pair)
        if added.link is None:
            problems.append(f"{pair.first} and {pair.second}: {added.reason}")
    unplaced = [one.map for one in site.maps if one.pose is None]
    if unplaced:
        tried = [pair for pair in searched if pair.reason and not set(unplaced).isdisjoint(pair.names)]
        problems.append(f"Nothing joins {', '.join(unplaced)} to the others.")
        problems += [f"{pair.first} and {pair.second}: {pair.reason}" for pair in tried]
    return site, problems


def _of_pair(progress: ProgressListener, number: int, pairs: int) -> ProgressListener:
    """Progress listener that maps one pair's progress onto the progress of all pairs."""

    def note(stage: Stage, fraction: float, message: str = "") -> None:
        progress(Stage.LINKS, (number + fraction) / pairs, message)

    return note


def _search(first: str, second: str, load: Callable[[str], Map], progress: ProgressListener) -> SearchedPair:
    """Link between two maps, or the reason why none was found."""
    maps = []
    for name in (first, second):
        try:
            maps.append(load(name))
        except (UnknownMap, InvalidMap) as error:
            return SearchedPair(first, second, ("", ""), reason=error.message)
    a, b = maps
    states = (map_state(a.info.id, a.info.version), map_state(b.info.id, b.info.version))
    try:
        return SearchedPair(first, second, states, find_link(first, a, second, b, progress))
    except (MappingFailed, InvalidInput) as error:
        return SearchedPair(first, second, states, reason=error.message)


def _with_pair(site: Site, pair: SearchedPair) -> tuple[Site, SearchedPair]:
    """The site with the pair's link, and the pair. If the link contradicts others, the same site, and the pair with the
    reason in place of the link.
    """
    if pair.link is None:
        return site, pair
    try:
        return with_link(site, pair.link), pair
    except InvalidInput as error:
        return site, SearchedPair(pair.first, pair.second, pair.states, reason=error.message)


def _in_one_frame(site: Site, first: str, second: str) -> bool:
    """Whether the relative pose of two maps is known: both have a pose, or links lead from one to the other."""
    poses = [one.pose for one in site.maps if one.map in (first, second)]
    if all(pose is not None for pose in poses):
        return True
    reached, before = {first}, 0
    while len(reached) > before:
        before = len(reached)
        reached |= {end for one in site.links for end in (one.first, one.second) if {one.first, one.second} & reached}
    return second in reached
