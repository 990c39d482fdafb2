"""Place the maps of a site: look for links between them, then store the links."""

import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from rholoc.disk import replace_file
from rholoc.errors import Conflict, InvalidMap, UnknownMap
from rholoc.library.maps import MapLibrary
from rholoc.library.sites import SiteLibrary
from rholoc.mapping.sites.link_search import SearchedPair, add_links, map_state, search_links
from rholoc.progress import ProgressListener
from rholoc.reports import report_from_json, report_to_json

_UNFINISHED = ".unfinished"
_TRIES = 10  # to store a site that others change at the same time


@dataclass(frozen=True)
class _Search:
    """Content of a search's file.

    Attributes:
        pairs: pairs of maps searched so far.
    """

    pairs: tuple[SearchedPair, ...] = ()


def write_links(maps_dir: Path, site_name: str, file: Path, progress: ProgressListener) -> None:
    """Look for links between the maps of a site, and write them to ``file``; do nothing if it exists.

    Progress is saved after each pair: an interrupted search continues there.

    Args:
        maps_dir: the folder of the maps and the site.
        site_name: name of the site.
        file: input of :func:`store_links`. It exists only once the search is complete.
        progress: called with ``Stage.LINKS``.

    Raises:
        UnknownSite, InvalidInput: there is no such site, its file is damaged, or its links contradict each other.
        Cancelled: ``progress`` asked to stop.
    """
    if file.exists():
        return
    unfinished = file.with_name(file.name + _UNFINISHED)
    library, site = MapLibrary(maps_dir), SiteLibrary(maps_dir).get(site_name)
    before = [pair for pair in _read(unfinished) if tuple(_state(library, name) for name in pair.names) == pair.states]
    kept, pairs = {pair.names: pair for pair in before}, []
    for pair in search_links(site, library.get, library.names(), before, progress):
        pairs.append(pair)
        if pair.names not in kept:
            kept[pair.names] = pair
            _write(unfinished, list(kept.values()))
    _write(file, pairs)


def store_links(file: Path, site_name: str, sites: SiteLibrary, library: MapLibrary) -> tuple[str, ...]:
    """Add the links of :func:`write_links` to the present site; idempotent.

    Returns:
        Reasons why maps of the site are not placed, one line each.

    Raises:
        UnknownSite: it was deleted.
        Conflict: the site has changed at each of eleven attempts.
        InvalidInput, StorageFull: nothing was stored.
    """
    pairs = _read(file)
    for _ in range(_TRIES):
        with suppress(Conflict):
            return _store(pairs, site_name, sites, library)
    return _store(pairs, site_name, sites, library)


def _store(pairs: Sequence[SearchedPair], site_name: str, sites: SiteLibrary, library: MapLibrary) -> tuple[str, ...]:
    """Add the links to the site; returns why maps are not placed. Raises Conflict if the site changes meanwhile."""
    before = sites.get(site_name)
    site, problems = add_links(before, pairs, lambda name: _state(library, name))
    if site != before:
        sites.put(site_name, site, before.version)
    return tuple(problems)


def _state(library: MapLibrary, name: str) -> str | None:
    """The :func:`map_state` of the present map; None if there is none or it is damaged."""
    try:
        info = library.outline(name).info
    except (UnknownMap, InvalidMap):
        return None
    return map_state(info.id, info.version)


def _read(file: Path) -> Sequence[SearchedPair]:
    """Pairs in a search's file; empty without the file."""
    with suppress(FileNotFoundError):
        return report_from_json(_Search, json.loads(file.read_text(encoding="utf-8"))).pairs
    return ()


def _write(file: Path, pairs: Sequence[SearchedPair]) -> None:
    """Write the pairs of a search to its file, atomically."""
    replace_file(file, json.dumps(report_to_json(_Search(tuple(pairs)))).encode())
