"""Answers in the frame of the site that a map belongs to, and on Earth."""

from __future__ import annotations

import numpy as np

from rholoc.errors import InvalidInput, NotFound
from rholoc.geometry import Pose
from rholoc.library import SiteLibrary
from rholoc.mapping import pose_in_site
from rholoc.maps import Site, SiteMap
from rholoc.service.frames.answers import EarthOut, LocalizationOut, SitePoseOut

_DEGREES = np.array([1, 1, 1, *[180 / np.pi] * 3])


def in_site(answer: LocalizationOut, sites: SiteLibrary, asked: str | None = None) -> LocalizationOut:
    """Add the pose in the frame of the site ``asked``, by default of the first site with the map."""
    name = asked or sites.site_of(answer.map)
    if answer.pose is None or name is None:
        return answer
    try:
        site = sites.get(name)
    except (NotFound, InvalidInput):  # deleted meanwhile
        return answer
    member = site.member(answer.map)
    if member is None or member.pose is None:
        return answer
    return answer.model_copy(update={"site": _pose_out(name, site, member, answer)})


def _pose_out(name: str, site: Site, member: SiteMap, answer: LocalizationOut) -> SitePoseOut:
    assert answer.pose is not None
    scale = np.outer(_DEGREES, _DEGREES)
    known = None if answer.covariance is None else np.array(answer.covariance) / scale
    T_site_camera, covariance = pose_in_site(member, np.array(answer.pose.T_map_camera), known)
    pose, earth = Pose(T_site_camera), None
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
        site=name,
        version=site.version,
        floor=member.floor,
        position=pose.position.tolist(),
        heading=pose.heading.tolist(),
        quaternion_xyzw=pose.quaternion_xyzw.tolist(),
        covariance=None if covariance is None else (covariance * scale).tolist(),
        earth=earth,
    )
