"""Sites: maps of rooms and floors in one frame, and its pose on Earth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from rholoc.errors import InvalidInput
from rholoc.geometry import FloatArray, Pose
from rholoc.geometry.earth import EarthPlace, enu_of, place_at
from rholoc.maps.naming import check_map_name

MAX_MAPS = 2000
"""Of a site."""

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
