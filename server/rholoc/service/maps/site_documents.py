"""Models of sites in requests and answers."""

from collections.abc import Collection

from pydantic import Field

from rholoc.maps import MAX_MAPS, FramePose, LinkOrigin, Site, SiteLink, SiteMap, SiteOnEarth, check_site
from rholoc.service.http.models import AnswerModel, Number, RequestModel


class FramePoseIn(RequestModel):
    """Where one frame lies in another."""

    position: tuple[Number, Number, Number] = Field(default=(0.0, 0.0, 0.0), description="of its origin, m")
    quaternion_xyzw: tuple[Number, Number, Number, Number] = Field(
        default=(0.0, 0.0, 0.0, 1.0), description="its rotation, x, y, z, w"
    )


class SiteMapIn(RequestModel):
    """A map of a site."""

    map: str
    floor: str = Field(default="", description="such as '1' or 'ground floor'")
    pose: FramePoseIn | None = Field(default=None, description="T_site_map; without one it is found from links")
    covariance: list[list[Number]] | None = Field(
        default=None,
        max_length=6,
        description="6×6 of a given pose: x, y, z in m, then a small rotation about the site's axes in radians",
    )


class SiteLinkIn(RequestModel):
    """The pose between two maps."""

    first: str
    second: str
    pose: FramePoseIn = Field(description="T_first_second")
    sigma_m: Number = Field(default=0.05, description="one sigma of the position of `at`, m")
    sigma_deg: Number = Field(default=0.5, description="one sigma of its rotation, degrees")
    origin: LinkOrigin = Field(default=LinkOrigin.GIVEN, description="where it comes from")
    at: tuple[Number, Number, Number] = Field(
        default=(0.0, 0.0, 0.0), description="point of the second map at which the link was measured, m"
    )


class SiteEarthIn(RequestModel):
    """Where a site's frame lies on Earth, WGS 84; its z axis is up."""

    latitude_deg: Number
    longitude_deg: Number
    height_m: Number = 0.0
    heading_deg: Number = Field(default=0.0, description="of the site's y axis: degrees from true north, clockwise")


class SiteIn(RequestModel):
    """A site: maps in one frame."""

    maps: list[SiteMapIn] = Field(max_length=MAX_MAPS)
    links: list[SiteLinkIn] = Field(default_factory=list, max_length=10_000)
    earth: SiteEarthIn | None = None
    version: int | None = Field(default=None, description="the version that this was made from; default: whichever")


class SiteMapOut(AnswerModel):
    """A map of a site."""

    map: str
    floor: str
    pose: FramePose | None = Field(description="T_site_map; null where neither anybody nor a link says")
    given: bool = Field(description="whether somebody gave the pose")
    covariance: list[list[float]] | None = Field(
        description="6×6 of the pose: x, y, z in m, then a small rotation about the site's axes in radians"
    )
    present: bool = Field(description="whether there is a map of this name now")


class SiteOut(AnswerModel):
    """A site."""

    name: str
    version: int
    maps: list[SiteMapOut]
    links: tuple[SiteLink, ...]
    earth: SiteOnEarth | None


def site_of(given: SiteIn) -> Site:
    """The site that was sent, checked, with given poses only.

    Raises:
        InvalidInput, InvalidName: it is not a valid site.
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
                SiteLink(link.first, link.second, _frame(link.pose), link.sigma_m, link.sigma_deg, link.origin, link.at)
                for link in given.links
            ),
            earth=None if given.earth is None else SiteOnEarth(**given.earth.model_dump()),
        )
    )


def _frame(given: FramePoseIn) -> FramePose:
    """The pose as a site keeps it."""
    return FramePose(given.position, given.quaternion_xyzw)


def site_out(name: str, site: Site, present: Collection[str]) -> SiteOut:
    """A site as it is sent; ``present`` are the names of all existing maps."""
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
