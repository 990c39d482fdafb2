"""Answers in the frame of the site that a map belongs to, and on Earth."""

from dataclasses import dataclass

import numpy as np

from rholoc.errors import InvalidInput, NotFound
from rholoc.geometry import FloatArray, Pose
from rholoc.library.sites import SiteLibrary
from rholoc.mapping.sites.poses import pose_in_site
from rholoc.maps import Site, SiteMap, SiteOnEarth
from rholoc.service.frames.answer_models import EarthOut, LocalizationOut, SitePoseOut
from rholoc.service.frames.geoposes import GeoPoseKind, geopose_of

_DEGREES = np.array([1, 1, 1, *[180 / np.pi] * 3])


@dataclass(frozen=True, eq=False)
class _InSite:
    """A camera's pose in a site: T_site_camera (4, 4), and its covariance (6, 6) [m, rad] or None."""

    name: str
    site: Site
    member: SiteMap
    T_site_camera: FloatArray
    covariance: FloatArray | None


def on_earth(
    answer: LocalizationOut,
    sites: SiteLibrary,
    asked: str | None,
    own: SiteOnEarth | None,
    kind: GeoPoseKind | None,
) -> LocalizationOut:
    """The answer with the pose in the frame of a site, and a GeoPose, if there are any; unchanged without a pose.

    Args:
        answer: of a map.
        sites: the sites.
        asked: the site asked for; None: the first one with the map.
        own: the map's own pose on Earth, or None: then the site's is used.
        kind: encoding of the GeoPose; None: none was asked for.
    """
    if answer.pose is None:
        return answer
    found = _in_site(answer, sites, asked)
    update: dict[str, object] = {} if found is None else {"site": _pose_out(found)}
    if kind is not None and own is not None:
        update["geopose"] = geopose_of(np.array(answer.pose.T_map_camera), own, kind)
    elif kind is not None and found is not None and found.site.earth is not None:
        update["geopose"] = geopose_of(found.T_site_camera, found.site.earth, kind)
    return answer.model_copy(update=update) if update else answer


def _in_site(answer: LocalizationOut, sites: SiteLibrary, asked: str | None) -> _InSite | None:
    """The answer's pose in the site ``asked``, else in its map's first; None if answer or map has no pose there."""
    name = asked or sites.site_of(answer.map)
    if answer.pose is None or name is None:
        return None
    try:
        site = sites.get(name)
    except (NotFound, InvalidInput):  # deleted meanwhile
        return None
    member = site.member(answer.map)
    if member is None or member.pose is None:
        return None
    known = None if answer.covariance is None else np.array(answer.covariance) / np.outer(_DEGREES, _DEGREES)
    T_site_camera, covariance = pose_in_site(member, np.array(answer.pose.T_map_camera), known)
    return _InSite(name, site, member, T_site_camera, covariance)


def _pose_out(found: _InSite) -> SitePoseOut:
    """The pose as it is sent, with the covariance in m and degrees, and on Earth if the site is."""
    site, covariance = found.site, found.covariance
    pose, earth = Pose(found.T_site_camera), None
    if site.earth is not None:
        there = site.earth.place(pose.position)
        heading_deg = site.earth.heading_deg_of(pose.heading)
        earth = EarthOut(
            latitude_deg=there.latitude_deg,
            longitude_deg=there.longitude_deg,
            height_m=there.height_m,
            heading_deg=heading_deg,
        )
    return SitePoseOut(
        site=found.name,
        version=site.version,
        floor=found.member.floor,
        position=pose.position.tolist(),
        heading=pose.heading.tolist(),
        quaternion_xyzw=pose.quaternion_xyzw.tolist(),
        covariance=None if covariance is None else (covariance * np.outer(_DEGREES, _DEGREES)).tolist(),
        earth=earth,
    )
