"""Poses of a site's maps from links between pairs of maps."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rholoc.errors import InvalidInput
from rholoc.geometry import FloatArray, Pose, pose_distances
from rholoc.localization.index.map_error import carried_covariances, worst_sigma
from rholoc.maps import FramePose, LinkOrigin, Site, SiteLink, SiteMap

_GIVEN_SIGMA_M, _GIVEN_SIGMA_RAD = 1e-3, np.deg2rad(0.01)  # of a pose that was given without a covariance
_HELD_SIGMA = 1e-5  # m and rad, of a given pose while others are placed by it
_CONTRADICTION_SIGMAS = 5.0


def solve_site(site: Site) -> Site:
    """The site with the poses of all maps that given poses and links determine.

    Given poses stay; others follow from links by least squares. Without any given pose, the first map's frame becomes
    the site's. A map that no links connect to a map with a pose gets None.

    Raises:
        InvalidInput: links and given poses contradict each other; says around which maps, and by how much.
    """
    maps = site.maps
    frames = {one.map: (one.given.matrix, _given_covariance(one)) for one in maps if one.given is not None}
    if maps and not frames:
        frames[maps[0].map] = np.eye(4), _given_covariance(SiteMap(maps[0].map))
    graph = _Graph.of(site.links)
    placed = graph.spread(frames)
    graph.check(placed)
    poses, covariances = _adjusted(site, frames, placed)
    return replace(site, maps=tuple(_with_pose(one, poses, covariances) for one in maps))


def _given_covariance(one: SiteMap) -> FloatArray:
    """Covariance (6, 6) of a map's given pose; of 1 mm and 0.01° if none was given with it."""
    if one.covariance is not None:
        return np.array(one.covariance)
    return np.diag(np.repeat([_GIVEN_SIGMA_M**2, _GIVEN_SIGMA_RAD**2], 3))


def _with_pose(one: SiteMap, poses: Mapping[str, FloatArray], covariances: Mapping[str, FloatArray]) -> SiteMap:
    """The map with its given pose, else with that of ``poses``, else without any."""
    if one.given is not None:
        return replace(one, pose=one.given, covariance=_as_rows(_given_covariance(one)))
    if one.map not in poses:
        return replace(one, pose=None, covariance=None)
    return replace(one, pose=FramePose.of(poses[one.map]), covariance=_as_rows(covariances[one.map]))


def _as_rows(covariance: FloatArray) -> tuple[tuple[float, ...], ...]:
    """Covariance (6, 6), made symmetric, as six rows."""
    symmetric = (covariance + covariance.T) / 2
    return tuple(tuple(row) for row in symmetric.tolist())


@dataclass(frozen=True, eq=False)
class _Placed:
    """A map connected by links to a map with a known pose.

    Attributes:
        T: T_site_map (4, 4).
        way: names of the maps along the chain of links, from the one with the known pose to this map.
        variance_m2, variance_deg2: sum over the known pose and the links, along and about the worst axis.
    """

    T: FloatArray
    way: tuple[str, ...]
    variance_m2: float
    variance_deg2: float


@dataclass(frozen=True, eq=False)
class _Graph:
    """Links by the maps that they join.

    Attributes:
        links: all links.
        of_map: links of each map, the smallest ``sigma_m`` first.
    """

    links: Sequence[SiteLink]
    of_map: Mapping[str, Sequence[SiteLink]]

    @classmethod
    def of(cls, links: Sequence[SiteLink]) -> _Graph:
        """Graph of links, each map's sorted by ``sigma_m``."""
        of_map: dict[str, list[SiteLink]] = defaultdict(list)
        for link in sorted(links, key=lambda link: link.sigma_m):
            of_map[link.first].append(link)
            of_map[link.second].append(link)
        return cls(links, of_map)

    def spread(self, known: Mapping[str, tuple[FloatArray, FloatArray]]) -> dict[str, _Placed]:
        """Poses of all maps that links connect to the ``known`` ones, along the fewest links, with summed variances.

        ``known`` has T_site_map (4, 4) and its covariance (6, 6), position first, by map; these maps are included.
        """
        placed = {
            name: _Placed(T, (name,), worst_sigma(of_T[:3, :3]) ** 2, np.degrees(worst_sigma(of_T[3:, 3:])) ** 2)
            for name, (T, of_T) in known.items()
        }
        waiting = deque(known)
        while waiting:
            here = waiting.popleft()
            for link in self.of_map.get(here, ()):
                there = link.second if link.first == here else link.first
                if there not in placed:
                    placed[there] = _beyond(placed[here], link, there)
                    waiting.append(there)
        return placed

    def check(self, placed: Mapping[str, _Placed]) -> None:
        """Compare every link with the relative pose of its maps in ``placed``.

        Raises:
            InvalidInput: a link is off by more than five standard deviations of link and poses; names the worst.
        """
        worst, worst_share = "", 1.0
        for link in self.links:
            if link.first not in placed:
                continue
            one, other = placed[link.first], placed[link.second]
            apart_m, apart_rad = pose_distances((one.T @ link.pose.matrix)[None], other.T[None])
            off_m, off_deg = float(apart_m[0]), float(np.degrees(apart_rad[0]))
            around = tuple(dict.fromkeys((*one.way, *reversed(other.way))))
            lever_m = max(np.linalg.norm(placed[name].T[:3, 3] - other.T[:3, 3]) for name in around)
            variance_deg2 = one.variance_deg2 + other.variance_deg2 + link.sigma_deg**2
            turned_m2 = variance_deg2 * (np.deg2rad(1) * lever_m) ** 2
            allowed_deg = _CONTRADICTION_SIGMAS * np.sqrt(variance_deg2)
            variance_m2 = one.variance_m2 + other.variance_m2 + _origin_variance_m2(link) + turned_m2
            allowed_m = _CONTRADICTION_SIGMAS * np.sqrt(variance_m2)
            share = max(off_m / allowed_m, off_deg / allowed_deg)
            if share > worst_share:
                worst_share = share
                worst = (
                    f"The links contradict each other: around {' → '.join((*around, around[0]))}, {off_m:.2f} m and "
                    f"{off_deg:.1f}° are left over, where they allow {allowed_m:.2f} m and {allowed_deg:.1f}°."
                )
        if worst:
            raise InvalidInput(worst, "Leave the wrong link out, or give it a greater sigma.")


def _beyond(here: _Placed, link: SiteLink, there: str) -> _Placed:
    """Pose and variances of the map ``there``, from ``here`` over a link."""
    step = link.pose.matrix if link.second == there else Pose(link.pose.matrix).inverse()
    return _Placed(
        here.T @ step,
        (*here.way, there),
        here.variance_m2 + _origin_variance_m2(link),
        here.variance_deg2 + link.sigma_deg**2,
    )


def _origin_variance_m2(link: SiteLink) -> float:
    """Variance [m²] of the second map's origin along the worst axis.

    The sum of ``sigma_m``² and the effect of the rotation about ``link.at``.
    """
    return link.sigma_m**2 + float(np.deg2rad(link.sigma_deg) * np.linalg.norm(link.at)) ** 2


def _adjusted(
    site: Site, frames: Mapping[str, tuple[FloatArray, FloatArray]], placed: Mapping[str, _Placed]
) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Least squares over all links: T_site_map (4, 4) and its covariance (6, 6), position first, in the site's axes, by
    map.

    Args:
        site: maps and links.
        frames: the poses held fixed, and their covariances. A map moves rigidly with the one that its way begins at,
            and has its covariance, too.
        placed: the starting values.
    """
    if not placed:
        return {}, {}
    import gtsam  # of all that a service does, only placing maps needs it
    from gtsam.symbol_shorthand import X

    number = {name: row for row, name in enumerate(placed)}
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for name, one in placed.items():
        values.insert(X(number[name]), gtsam.Pose3(one.T))
    held = gtsam.noiseModel.Isotropic.Sigma(6, _HELD_SIGMA)
    for name, (T, _) in frames.items():
        graph.add(gtsam.PriorFactorPose3(X(number[name]), gtsam.Pose3(T), held))
    for link in site.links:
        if link.first in placed:
            to_origin = gtsam.Pose3(gtsam.Rot3(), np.array(link.at)).AdjointMap()
            at = np.diag(np.repeat([np.deg2rad(link.sigma_deg) ** 2, link.sigma_m**2], 3))
            noise = gtsam.noiseModel.Gaussian.Covariance(to_origin @ at @ to_origin.T)
            between = gtsam.Pose3(link.pose.matrix)
            graph.add(gtsam.BetweenFactorPose3(X(number[link.first]), X(number[link.second]), between, noise))
    solved = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    marginals = gtsam.Marginals(graph, solved)
    poses: dict[str, FloatArray] = {name: solved.atPose3(X(row)).matrix() for name, row in number.items()}
    covariances = {}
    for name, T in poses.items():
        T_given, of_given = frames[placed[name].way[0]]
        carried = carried_covariances(of_given[None], T_given[None, :3, 3], T[:3, 3])[0]
        covariances[name] = carried + _in_site(marginals.marginalCovariance(X(number[name])), T)
    return poses, covariances


def _in_site(covariance: FloatArray, T: FloatArray) -> FloatArray:
    """GTSAM's covariance (6, 6) (rotation, position; map's own axes) as (position, rotation) in the site's axes."""
    turn = np.zeros((6, 6))
    turn[:3, 3:] = turn[3:, :3] = T[:3, :3]
    return np.asarray(turn @ covariance @ turn.T)


def with_link(site: Site, link: SiteLink) -> Site:
    """The site with ``link``, and all poses solved again.

    Replaces links found earlier between the same two maps; links given by people stay.

    Raises:
        InvalidInput: the links contradict each other.
    """
    pair = {link.first, link.second}
    kept = [other for other in site.links if {other.first, other.second} != pair or other.origin is LinkOrigin.GIVEN]
    return solve_site(replace(site, links=(*kept, link)))


def pose_in_site(
    member: SiteMap, T_map_camera: FloatArray, covariance: FloatArray | None
) -> tuple[FloatArray, FloatArray | None]:
    """A camera's pose T_site_camera (4, 4) in the frame of a site, and its covariance (6, 6), m and rad; None for None.

    The covariance is of the position, then of a small rotation from the left, each in the axes of the frame; that of
    the map's own pose is added. ``member`` must have a pose.
    """
    assert member.pose is not None
    T_site_map = member.pose.matrix
    T = T_site_map @ T_map_camera
    if covariance is None:
        return T, None
    turn = np.kron(np.eye(2), T_site_map[:3, :3])
    total = turn @ covariance @ turn.T
    if member.covariance is not None:
        total += carried_covariances(np.array(member.covariance)[None], T_site_map[None, :3, 3], T[:3, 3])[0]
    return T, total
