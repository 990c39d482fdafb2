"""Sites: maps of rooms and floors in one frame, and its pose on Earth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from rholoc.errors import InvalidInput
from rholoc.geometry import UP, FloatArray, Pose, Similarity, angles_between, upright_umeyama
from rholoc.geometry.earth import EarthPlace, R_enu_enu, enu_of, place_at
from rholoc.maps.name_rules import check_map_name

MAX_MAPS = 2000
"""Of a site."""

_MAX_LINKS = 10_000
_MAX_FLOOR = 100
_UNIT_TOLERANCE = 1e-2
_MAX_M, _MAX_HEIGHT_M = 1e6, 1e5
_MIN_APART_M, _SCALE_TOLERANCE = 0.5, 0.05  # of points that give a direction
_UPRIGHT_RAD = math.radians(1.0)
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
        """Pose with the position and rotation of a rigid matrix (4, 4)."""
        pose = Pose(T)
        x, y, z = pose.position.tolist()
        qx, qy, qz, qw = pose.quaternion_xyzw.tolist()
        return cls((x, y, z), (qx, qy, qz, qw))

    @property
    def matrix(self) -> FloatArray:
        """The pose as a matrix (4, 4)."""
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
        sigma_m: standard deviation of the position of ``at`` along each axis.
        sigma_deg: standard deviation of the rotation about each axis.
        origin: of the link.
        at: (3,) point of the second map's frame at which the link was measured [m], such as the middle of an overlap.
    """

    first: str
    second: str
    pose: FramePose
    sigma_m: float = 0.05
    sigma_deg: float = 0.5
    origin: LinkOrigin = LinkOrigin.GIVEN
    at: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class SiteOnEarth:
    """Pose of a site's or a map's frame on Earth; its z axis is up.

    Attributes:
        latitude_deg, longitude_deg, height_m: of its origin, WGS 84.
        heading_deg: of its y axis, clockwise from true north.
    """

    latitude_deg: float
    longitude_deg: float
    height_m: float = 0.0
    heading_deg: float = 0.0

    @classmethod
    def through(
        cls, points: FloatArray, places: Sequence[EarthPlace], heading_deg: float | None = None
    ) -> tuple[SiteOnEarth, float]:
        """Least-squares pose on Earth of a frame with z up, from points with known places on Earth.

        Args:
            points: (N, 3) of the frame [m], N ≥ 1 with a heading, else N ≥ 2.
            places: the same points on Earth.
            heading_deg: direction of the y axis, clockwise from true north; None to estimate it from the points.

        Returns:
            The pose, at whose origin the points fit best, and the root mean square distance between points and places
                [m].

        Raises:
            InvalidInput: there are too few points; or, without a heading, they are within 0.5 m seen from above, or
                their distances differ by over 5 % from those on Earth.
        """
        if len(points) != len(places) or len(points) < (2 if heading_deg is None else 1):
            raise InvalidInput("A place on Earth needs two points, or one and a heading.", "Give another point.")
        enu = np.array([enu_of(place, places[0]) for place in places])
        spread_m, spread_enu_m = (float(np.ptp(one[:, :2], axis=0).max()) for one in (points, enu))
        if heading_deg is None:
            if min(spread_m, spread_enu_m) < _MIN_APART_M:
                message = f"The points lie within {_MIN_APART_M:g} m seen from above: they give no direction."
                raise InvalidInput(message, "Give points that are further apart, or one and a heading.")
            turn = upright_umeyama(points, enu)
            if abs(turn.scale - 1) > _SCALE_TOLERANCE:
                message = f"On Earth the points are {turn.scale:.3g} times as far apart as in the map."
                raise InvalidInput(message, "Check them, and the map's scale.")
            heading_deg = math.degrees(math.atan2(*turn.rotation[:2, 1])) % 360
        turned = cls(places[0].latitude_deg, places[0].longitude_deg, places[0].height_m, heading_deg)
        there = np.array([turned.enu(point) for point in points])
        origin = place_at((enu - there).mean(axis=0), places[0])
        found = cls(origin.latitude_deg, origin.longitude_deg, origin.height_m, heading_deg)
        missed = [enu_of(found.place(point), place) for point, place in zip(points, places, strict=True)]
        return found, float(np.sqrt(np.mean(np.sum(np.square(missed), axis=1))))

    @property
    def origin(self) -> EarthPlace:
        """Place of the site's origin."""
        return EarthPlace(self.latitude_deg, self.longitude_deg, self.height_m)

    @property
    def R_enu_site(self) -> FloatArray:
        """Rotation (3, 3) from the site's axes to east, north and up at its origin."""
        turn = math.radians(self.heading_deg)
        c, s = math.cos(turn), math.sin(turn)
        return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])

    def moved(self, similarity: Similarity) -> SiteOnEarth | None:
        """The pose of a frame after ``similarity`` moved its points; None if its z axis is no longer up (within 1°)."""
        back = similarity.rotation.T
        heading_deg = self.heading_deg_of(back[:, 1])
        if heading_deg is None or angles_between(back[:, 2], UP) > _UPRIGHT_RAD:
            return None
        there = self.place(-back @ similarity.translation / similarity.scale)
        return SiteOnEarth(there.latitude_deg, there.longitude_deg, there.height_m, heading_deg)

    def R_enu_of(self, R_site_body: FloatArray, place: EarthPlace) -> FloatArray:
        """Rotation (3, 3) from a body's axes to east, north and up at ``place``, where the body is."""
        return np.asarray(R_enu_enu(place, self.origin) @ self.R_enu_site @ R_site_body)

    def enu(self, vector: FloatArray) -> FloatArray:
        """A vector (3,) of the site's frame as east, north, up."""
        return np.asarray(self.R_enu_site @ vector)

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
        """The site's entry for the map of that name; None if it has none."""
        return next((one for one in self.maps if one.map == map_name), None)

    def earth_of(self, map_name: str) -> SiteOnEarth | None:
        """Pose on Earth of a map's frame; None if it is unknown, or the map's z is not up."""
        member = self.member(map_name)
        if self.earth is None or member is None or member.pose is None:
            return None
        T_map_site = np.linalg.inv(member.pose.matrix)
        return self.earth.moved(Similarity(1.0, T_map_site[:3, :3], T_map_site[:3, 3]))

    def maps_near(self, place: EarthPlace, radius_m: float) -> list[str]:
        """Names of the maps with an origin within ``radius_m`` of a place, seen from above, the nearest first; none
        without a pose on Earth.
        """
        if self.earth is None:
            return []
        there = enu_of(place, self.earth.origin)[:2]
        placed = [(one.map, self.earth.enu(np.array(one.pose.position))[:2]) for one in self.maps if one.pose]
        apart = sorted((float(np.hypot(*(at - there))), name) for name, at in placed)
        return [name for distance_m, name in apart if distance_m <= radius_m]


def check_site(site: Site) -> Site:
    """Return the site, checked.

    Raises:
        InvalidInput: there are over 2000 maps or 10,000 links, a map is named twice, a link is between maps that are
            not the site's, or a floor, pose, sigma, covariance or place on Earth is invalid.
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
        _check_pose(FramePose(link.at), what)
        if not (0 < link.sigma_m <= _MAX_M and 0 < link.sigma_deg <= 180):
            raise InvalidInput(f"{what} has sigmas that are not possible.", "Give metres and degrees above 0.")
    if site.earth is not None:
        check_earth(site.earth)
    return site


def _check_pose(pose: FramePose, what: str) -> None:
    """Raise InvalidInput, naming ``what``, unless position and unit quaternion are plausible."""
    values = (*pose.position, *pose.quaternion_xyzw)
    if not all(math.isfinite(value) for value in values) or max(map(abs, pose.position)) > _MAX_M:
        raise InvalidInput(f"{what} is not a pose: a number is not finite, or beyond 1000 km.", "Give metres.")
    length = math.hypot(*pose.quaternion_xyzw)
    if abs(length - 1) > _UNIT_TOLERANCE:
        raise InvalidInput(
            f"{what} has no rotation: its quaternion's length is {length:.3g}.", "Give a unit quaternion, x, y, z, w."
        )


def _check_covariance(rows: tuple[tuple[float, ...], ...], name: str) -> None:
    """Raise InvalidInput, naming the map, unless the rows are finite, 6×6, symmetric and positive semidefinite."""
    square = np.array(rows, dtype=np.float64) if [len(row) for row in rows] == [6] * 6 else None
    if square is not None and np.isfinite(square).all() and np.allclose(square, square.T):
        values = np.linalg.eigvalsh(square)
        if values[0] >= _NEGATIVE * max(values[-1], 1e-12):
            return
    raise InvalidInput(f"The covariance of the map {name} is not one.", "Give 6×6 numbers, symmetric, none negative.")


def check_earth(earth: SiteOnEarth) -> SiteOnEarth:
    """Return the pose on Earth, checked.

    Raises:
        InvalidInput: a number is not finite, or out of range (90°, 180°, 100 km, 360°).
    """
    values = (earth.latitude_deg, earth.longitude_deg, earth.height_m, earth.heading_deg)
    possible = all(math.isfinite(value) for value in values) and abs(earth.height_m) <= _MAX_HEIGHT_M
    if not possible or abs(earth.latitude_deg) > 90 or abs(earth.longitude_deg) > 180 or abs(earth.heading_deg) > 360:
        raise InvalidInput(
            "The place on Earth is not possible.",
            "Give a latitude of -90 to 90°, a longitude of -180 to 180°, a heading of -360 to 360°.",
        )
    return earth
