"""The library of sites."""

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from rholoc.errors import Conflict, InvalidInput, UnknownSite
from rholoc.lazy import lazy
from rholoc.library.folder_documents import Documents, NamedDocuments
from rholoc.maps.sites import Site, check_site
from rholoc.reports import report_from_json, report_to_json

_FORMAT, _FORMAT_VERSION = "rholoc-site", 1


@dataclass(frozen=True)
class _AllSites:
    """Cached sites, valid while the files have this stamp."""

    stamp: object
    sites: Mapping[str, Site]

    @lazy
    def site_by_map(self) -> dict[str, str]:
        """Map name → name of the first site in which the map has a pose."""
        found: dict[str, str] = {}
        for name, site in self.sites.items():
            for one in site.maps:
                if one.pose is not None:
                    found.setdefault(one.map, name)
        return found


def _with_renamed(site: Site, name: str, new_name: str) -> Site:
    """The site with the map ``name`` called ``new_name``, in its links too."""

    def now(one: str) -> str:
        return new_name if one == name else one

    maps = tuple(replace(one, map=now(one.map)) for one in site.maps)
    links = tuple(replace(link, first=now(link.first), second=now(link.second)) for link in site.links)
    return replace(site, maps=maps, links=links)


class SiteLibrary(NamedDocuments[Site]):
    """Sites by name. Errors: UnknownSite, InvalidInput. Deleting one leaves its maps.

    Args:
        files: as for :class:`NamedDocuments`.
    """

    _folder, _kind, _unknown = "sites", "site", UnknownSite

    def __init__(self, files: Path | Documents) -> None:
        super().__init__(files)
        self._read: dict[str, tuple[bytes, Site]] = {}
        self._all = _AllSites(None, {})

    def put(self, name: str, site: Site, replaces: int | None = None) -> Site:
        """Store a site with the next version number; returns it.

        Args:
            name: of the site.
            site: a valid site; its own version is ignored.
            replaces: the version that it must replace; None for any.

        Raises:
            InvalidName, InvalidInput, StorageFull: nothing was replaced.
            Conflict: the site has changed since that version.
        """
        file_name = self._file_name(name)
        check_site(site)
        while True:
            before, version = self._stored(name)
            if replaces is not None and replaces != version:
                raise Conflict(f"The site {name} was changed in the meantime.", f"Begin from version {version}.")
            site = replace(site, version=version + 1)
            document = {"format": _FORMAT, "format_version": _FORMAT_VERSION, **report_to_json(site)}
            content = f"{json.dumps(document, indent=1, allow_nan=False)}\n".encode()
            if self._files.exchange(file_name, before, content, called=file_name):
                return site

    def _stored(self, name: str) -> tuple[bytes | None, int]:
        """Content of a site's file (None if missing), and its version (0 if it holds no site). Raises InvalidInput if
        unreadable.
        """
        try:
            content = self._files.read(self._file_name(name))
        except FileNotFoundError:
            return None, 0
        except OSError as error:
            raise InvalidInput(f"The file of the site {name} cannot be read.", "Check its permissions.") from error
        try:
            return content, _from_json(name, content).version
        except InvalidInput:
            return content, 0

    def all(self) -> dict[str, Site]:
        """All readable sites by name, cached until a file changes."""
        return dict(self._present().sites)

    def site_of(self, map_name: str) -> str | None:
        """Name of the first site in which a map has a pose; None if there is none."""
        return self._present().site_by_map.get(map_name)

    def rename_map(self, name: str, new_name: str) -> None:
        """Rename a map in its sites; skips sites that list the new name already.

        Raises:
            InvalidName, StorageFull: not all sites were changed.
        """
        for site_name, site in self.all().items():
            if site.member(name) is not None and site.member(new_name) is None:
                self.put(site_name, _with_renamed(site, name, new_name))

    def _present(self) -> _AllSites:
        """All readable sites; read again if a file has changed, or may have."""
        stamp = self._files.stamp()  # before the files are read
        if stamp is None or stamp != self._all.stamp:
            sites = {}
            for name in self.names():
                with suppress(UnknownSite, InvalidInput):
                    sites[name] = self.get(name)
            self._all = _AllSites(stamp, sites)
        return self._all

    def _parsed(self, name: str, content: bytes) -> Site:
        """The site in a file's content, cached while the content stays. Raises InvalidInput if it holds none."""
        known = self._read.get(name)
        if known is None or known[0] != content:
            known = self._read[name] = (content, _from_json(name, content))
        return known[1]

    def _unreadable(self, name: str) -> InvalidInput:
        """Error for a site's file that cannot be read."""
        return InvalidInput(f"The site {name} cannot be read.", "Put it again.")


def _from_json(name: str, content: bytes) -> Site:
    """The checked site in a file's content. Raises InvalidInput if it is not one, or of a later version."""
    try:
        document = json.loads(content)
        if document.pop("format") != _FORMAT or document.pop("format_version") > _FORMAT_VERSION:
            raise ValueError("it is of a later version, or no site")
        return check_site(report_from_json(Site, document))
    except (ArithmeticError, ValueError, TypeError, KeyError, AttributeError, RecursionError, InvalidInput) as error:
        raise InvalidInput(
            f"The file of the site {name} is broken: {str(error)[:200]}.", "Put the site again."
        ) from error
