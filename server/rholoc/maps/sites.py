"""Sites: maps of rooms and floors in one frame, and its pose on Earth."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

import numpy as np

from rholoc.errors import Conflict, InvalidInput, UnknownSite
from rholoc.geometry import FloatArray, Pose
from rholoc.geometry.earth import EarthPlace, enu_of, place_at
from rholoc.lazy import lazy
from rholoc.maps.catalogue import check_map_name, check_name, some_of
from rholoc.maps.documents import Documents, FolderDocuments, stored_names
from rholoc.reports import report_from_json, report_to_json

SITES_FOLDER = "sites"
MAX_MAPS = 2000
"""Of a site."""

_FORMAT, _FORMAT_VERSION = "rholoc-site", 1
_SUFFIX = ".json"
_MAX_LINKS = 10_000
_MAX_FLOOR = 100
_UNIT_TOLERANCE = 1e-2
_MAX_M, _MAX_HEIGHT_M = 1e6, 1e5
_NEGATIVE = -1e-6  # relative to the largest: minimum eigenvalue, negative by rounding


class LinkOrigin(StrEnum):
    """Origin of the relative pose of two maps."""

    GIVEN = "given"  # by people
    OVERLAP = "overlap"  # views of one were localized in the other
    WAYPOINTS = "waypoints"  # both have the same measured points


@dataclass(frozen=True)
class FramePose:
    """Pose of one frame in another.

    Attributes:
        position: (3,) metres, its origin.
        quaternion_xyzw: (4,) its rotation.
    """

    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quaternion_xyzw: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)

    @classmethod
    def of(cls, T: FloatArray) -> FramePose:
        """From a matrix (4, 4)."""
        pose = Pose(T)
        x, y, z = pose.position.tolist()
        qx, qy, qz, qw = pose.quaternion_xyzw.tolist()
        return cls((x, y, z), (qx, qy, qz, qw))

    @property
    def matrix(self) -> FloatArray:
        """(4, 4)."""
        return Pose.from_quaternion(np.array(self.position), np.array(self.quaternion_xyzw)).T_map_camera


@dataclass(frozen=True)
class SiteMap:
    """A map of a site.

    Attributes:
        map: its name.
        floor: such as "1" or "ground floor"; empty if unknown.
        given: T_site_map given by people, or None.
        pose: T_site_map, given or solved from links; None if unknown.
        covariance: (6, 6) of the pose: x, y, z [m], then a small rotation about the site's axes, from the left [rad];
            None if the pose is unknown.
    """

    map: str
    floor: str = ""
    given: FramePose | None = None
    pose: FramePose | None = None
    covariance: tuple[tuple[float, ...], ...] | None = None


@dataclass(frozen=True)
class SiteLink:
    """The pose between two maps of a site.

    Attributes:
        first, second: their names.
        pose: T_first_second.
        sigma_m: standard deviation of the position along each axis.
        sigma_deg: standard deviation of the rotation about each axis.
        origin: of the link.
    """

    first: str
    second: str
    pose: FramePose
    sigma_m: float = 0.05
    sigma_deg: float = 0.5
    origin: LinkOrigin = LinkOrigin.GIVEN


@dataclass(frozen=True)
class SiteOnEarth:
    """Pose of a site's frame on Earth; its z axis is up.

    Attributes:
        latitude_deg, longitude_deg, height_m: of its origin, WGS 84.
        heading_deg: of its y axis, clockwise from true north.
    """

    latitude_deg: float
    longitude_deg: float
    height_m: float = 0.0
    heading_deg: float = 0.0

    @property
    def origin(self) -> EarthPlace:
        """Place of the site's origin."""
        return EarthPlace(self.latitude_deg, self.longitude_deg, self.height_m)

    def enu(self, vector: FloatArray) -> FloatArray:
        """A vector (3,) of the site's frame as east, north, up."""
        turn = math.radians(self.heading_deg)
        x, y, z = vector
        return np.array([x * math.cos(turn) + y * math.sin(turn), y * math.cos(turn) - x * math.sin(turn), z])

    def place(self, position: FloatArray) -> EarthPlace:
        """Place on Earth of a position (3,) in the site's frame [m]."""
        return place_at(self.enu(position), self.origin)

    def heading_deg_of(self, direction: FloatArray) -> float | None:
        """Angle of a direction (3,) clockwise from true north, 0 to 360; None if vertical."""
        east, north, _ = self.enu(direction)
        return None if math.hypot(east, north) < 1e-6 else math.degrees(math.atan2(east, north)) % 360


@dataclass(frozen=True)
class Site:
    """Maps in one frame.

    Attributes:
        version: 1 for a new site, counted up with every change.
        maps: its maps.
        links: relative poses of maps, to solve poses that are not given.
        earth: pose on Earth, or None.
    """

    version: int = 1
    maps: tuple[SiteMap, ...] = ()
    links: tuple[SiteLink, ...] = ()
    earth: SiteOnEarth | None = None

    def member(self, map_name: str) -> SiteMap | None:
        """The map of that name, if it is one of the site's."""
        return next((one for one in self.maps if one.map == map_name), None)

    def maps_near(self, place: EarthPlace, radius_m: float) -> list[str]:
        """Names of the maps with an origin within ``radius_m`` of a place on Earth, the nearest first."""
        if self.earth is None:
            return []
        there = enu_of(place, self.earth.origin)[:2]
        placed = [(one.map, self.earth.enu(np.array(one.pose.position))[:2]) for one in self.maps if one.pose]
        apart = sorted((float(np.hypot(*(at - there))), name) for name, at in placed)
        return [name for distance_m, name in apart if distance_m <= radius_m]


def check_site(site: Site) -> Site:
    """Return the site, checked.

    Raises:
        InvalidInput: there are too many maps or links, a map is named twice, a link is between maps that are not the
            site's, something is no pose, no covariance or no place on Earth.
        InvalidName: a map's name is not valid.
    """
    names = [one.map for one in site.maps]
    for name in names:
        check_map_name(name)
    if len(names) > MAX_MAPS or len(site.links) > _MAX_LINKS:
        raise InvalidInput(f"A site has at most {MAX_MAPS} maps and {_MAX_LINKS} links.", "Make several sites.")
    twice = next((name for name in names if names.count(name) > 1), None) if len(set(names)) < len(names) else None
    if twice is not None:
        raise InvalidInput(f"The map {twice} is listed twice.", "List each map of the site once.")
    for one in site.maps:
        for pose in (one.given, one.pose):
            if pose is not None:
                _check_pose(pose, f"The pose of the map {one.map}")
        if len(one.floor) > _MAX_FLOOR or (one.floor and not one.floor.isprintable()):
            raise InvalidInput(f"The floor of the map {one.map} is not valid.", f"Use at most {_MAX_FLOOR} characters.")
        if one.covariance is not None:
            _check_covariance(one.covariance, one.map)
    known = set(names)
    for link in site.links:
        stranger = next((name for name in (link.first, link.second) if name not in known), None)
        if stranger is not None:
            raise InvalidInput(f"A link names the map {stranger[:64]}, which is not the site's.", "List it as a map.")
        if link.first == link.second:
            raise InvalidInput(f"A link joins the map {link.first} to itself.", "Name two maps.")
        what = f"The link between {link.first} and {link.second}"
        _check_pose(link.pose, what)
        if not (0 < link.sigma_m <= _MAX_M and 0 < link.sigma_deg <= 180):
            raise InvalidInput(f"{what} has sigmas that are not possible.", "Give metres and degrees above 0.")
    if site.earth is not None:
        _check_earth(site.earth)
    return site


def _check_pose(pose: FramePose, what: str) -> None:
    values = (*pose.position, *pose.quaternion_xyzw)
    if not all(math.isfinite(value) for value in values) or max(map(abs, pose.position)) > _MAX_M:
        raise InvalidInput(f"{what} is not a pose: a number is not finite, or beyond 1000 km.", "Give metres.")
    length = math.hypot(*pose.quaternion_xyzw)
    if abs(length - 1) > _UNIT_TOLERANCE:
        raise InvalidInput(
            f"{what} has no rotation: its quaternion's length is {length:.3g}.", "Give a unit quaternion, x, y, z, w."
        )


def _check_covariance(rows: tuple[tuple[float, ...], ...], name: str) -> None:
    square = np.array(rows, dtype=np.float64) if [len(row) for row in rows] == [6] * 6 else None
    if square is not None and np.isfinite(square).all() and np.allclose(square, square.T):
        values = np.linalg.eigvalsh(square)
        if values[0] >= _NEGATIVE * max(values[-1], 1e-12):
            return
    raise InvalidInput(f"The covariance of the map {name} is not one.", "Give 6×6 numbers, symmetric, none negative.")


def _check_earth(earth: SiteOnEarth) -> None:
    values = (earth.latitude_deg, earth.longitude_deg, earth.height_m, earth.heading_deg)
    possible = all(math.isfinite(value) for value in values) and abs(earth.height_m) <= _MAX_HEIGHT_M
    if not possible or abs(earth.latitude_deg) > 90 or abs(earth.longitude_deg) > 180 or abs(earth.heading_deg) > 360:
        raise InvalidInput(
            "The site's place on Earth is not possible.",
            "Give a latitude of -90 to 90°, a longitude of -180 to 180°, a heading of -360 to 360°.",
        )


@dataclass(frozen=True)
class _AllSites:
    """Cached sites, valid while the files have this stamp."""

    stamp: object
    sites: Mapping[str, Site]

    @lazy
    def site_by_map(self) -> dict[str, str]:
        """The name of the first site in which each map has a pose."""
        found: dict[str, str] = {}
        for name, site in self.sites.items():
            for one in site.maps:
                if one.pose is not None:
                    found.setdefault(one.map, name)
        return found


def _with_renamed(site: Site, name: str, new_name: str) -> Site:
    """The site with a map under a new name."""

    def now(one: str) -> str:
        return new_name if one == name else one

    maps = tuple(replace(one, map=now(one.map)) for one in site.maps)
    links = tuple(replace(link, first=now(link.first), second=now(link.second)) for link in site.links)
    return replace(site, maps=maps, links=links)


class SiteLibrary:
    """Sites by name; safe to share between threads and processes.

    Args:
        maps_dir: the folder of maps, with sites as ``sites/NAME.json``.
        files: used instead of ``maps_dir``.
    """

    def __init__(self, maps_dir: Path, files: Documents | None = None) -> None:
        self._files = files or FolderDocuments(maps_dir / SITES_FOLDER)
        self._read: dict[str, tuple[bytes, Site]] = {}
        self._all = _AllSites(None, {})

    def names(self) -> list[str]:
        """The names of all sites, sorted."""
        return stored_names(self._files, _SUFFIX)

    def get(self, name: str) -> Site:
        """The site of that name.

        Raises:
            InvalidName: it is not a valid name.
            UnknownSite: there is no such site.
            InvalidInput: its file is damaged.
        """
        try:
            content = self._files.read(_file_name(name))
        except FileNotFoundError as error:
            raise self._unknown(name) from error
        except OSError as error:
            raise InvalidInput(f"The site {name} cannot be read.", "Put it again.") from error
        known = self._read.get(name)
        if known is None or known[0] != content:
            known = self._read[name] = (content, _from_json(name, content))
        return known[1]

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
        file_name = _file_name(name)
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
        """Content of a site's file (None if missing), and its version (0 if it holds no site)."""
        try:
            content = self._files.read(_file_name(name))
        except FileNotFoundError:
            return None, 0
        except OSError as error:
            raise InvalidInput(f"The file of the site {name} cannot be read.", "Check its permissions.") from error
        try:
            return content, _from_json(name, content).version
        except InvalidInput:
            return content, 0

    def delete(self, name: str) -> None:
        """Delete a site; its maps stay.

        Raises:
            InvalidName: it is not a valid name.
            UnknownSite: there is no such site.
        """
        try:
            self._files.delete(_file_name(name))
        except FileNotFoundError as error:
            raise self._unknown(name) from error

    def all(self) -> dict[str, Site]:
        """All readable sites by name, cached until a file changes."""
        return dict(self._present().sites)

    def site_of(self, map_name: str) -> str | None:
        """Name of the first site in which a map has a pose, or None."""
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
        stamp = self._files.stamp()  # before the files are read
        if stamp is None or stamp != self._all.stamp:
            sites = {}
            for name in self.names():
                with suppress(UnknownSite, InvalidInput):
                    sites[name] = self.get(name)
            self._all = _AllSites(stamp, sites)
        return self._all

    def _unknown(self, name: str) -> UnknownSite:
        names = self.names()
        return UnknownSite(
            f"There is no site {name}.", f"There are: {some_of(names)}." if names else "There are none yet."
        )


def _file_name(name: str) -> str:
    return check_name(name, "site") + _SUFFIX


def _from_json(name: str, content: bytes) -> Site:
    try:
        document = json.loads(content)
        if document.pop("format") != _FORMAT or document.pop("format_version") > _FORMAT_VERSION:
            raise ValueError("it is of a later version, or no site")
        return check_site(report_from_json(Site, document))
    except (ArithmeticError, ValueError, TypeError, KeyError, AttributeError, RecursionError, InvalidInput) as error:
        raise InvalidInput(
            f"The file of the site {name} is broken: {str(error)[:200]}.", "Put the site again."
        ) from error
