"""Sites as they are sent, and as they are shown."""

from __future__ import annotations

from collections.abc import Collection

from rholoc.maps import FramePose, Site, SiteLink, SiteMap, SiteOnEarth, check_site
from rholoc.service.schemas import FramePoseIn, SiteIn, SiteMapOut, SiteOut


def site_of(given: SiteIn) -> Site:
    """The site that was sent, its poses not found yet.

    Raises:
        InvalidInput, InvalidName: it cannot be one.
    """
    return check_site(
        Site(
            maps=tuple(
                SiteMap(
                    one.map,
                    one.floor.strip(),
                    None if one.pose is None else _frame(one.pose),
                    covariance=None if one.covariance is None else tuple(map(tuple, one.covariance)),
                )
                for one in given.maps
            ),
            links=tuple(
                SiteLink(link.first, link.second, _frame(link.pose), link.sigma_m, link.sigma_deg, link.origin)
                for link in given.links
            ),
            earth=None if given.earth is None else SiteOnEarth(**given.earth.model_dump()),
        )
    )


def _frame(given: FramePoseIn) -> FramePose:
    return FramePose(given.position, given.quaternion_xyzw)


def site_out(name: str, site: Site, present: Collection[str]) -> SiteOut:
    maps = [
        SiteMapOut(
            map=one.map,
            floor=one.floor,
            pose=one.pose,
            given=one.given is not None,
            covariance=None if one.covariance is None else [list(row) for row in one.covariance],
            present=one.map in present,
        )
        for one in site.maps
    ]
    return SiteOut(name=name, version=site.version, maps=maps, links=site.links, earth=site.earth)
