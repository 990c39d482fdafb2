"""Which maps a request is for."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from typing import Annotated

from fastapi import Query

from rholoc.errors import UnknownMap
from rholoc.geometry.earth import EarthPlace
from rholoc.service.errors import InvalidRequest
from rholoc.service.frames.map_choice import MOST_ASKED, MapChoice
from rholoc.service.state import State

MapNames = Annotated[
    str | None, Query(description="names separated by commas, or 'all', the default", examples=["all", "hall,kitchen"])
]
SiteName = Annotated[str | None, Query(description="a site, instead of maps: all of its maps", examples=["campus"])]
Latitude = Annotated[
    float | None,
    Query(ge=-90, le=90, description="with `longitude`, instead of maps: those near there, WGS 84", examples=[52.52]),
]
Longitude = Annotated[float | None, Query(ge=-180, le=180, description="degrees east, WGS 84", examples=[13.405])]
Radius = Annotated[
    float, Query(gt=0, le=100_000, description="how far from that place a map's origin may lie, m", examples=[100])
]
RADIUS_M = 100.0


async def requested_maps(
    maps: str | None, site: str | None, place: EarthPlace | None, radius_m: float, service: State
) -> MapChoice:
    """The maps that a request is for, by their names, their site or where on Earth they are.

    Raises:
        InvalidRequest: it says more than one of them.
        UnknownSite, UnknownMap: there is no such site, or no map of it, or none there.
    """
    if sum(one is not None for one in (maps, site, place)) > 1:
        raise InvalidRequest("The request names its maps in two ways.", "Send one of maps, site, and a place on Earth.")
    if site is not None:
        members = [one.map for one in (await service.threads.database(service.sites.get, site)).maps]
        what = f"No map of the site {site} is here."
    elif place is not None:
        sites = await service.threads.database(service.sites.all)
        near = [name for one in sites.values() for name in one.maps_near(place, radius_m)]
        members = list(dict.fromkeys(near))
        what = f"No site has a map within {radius_m:g} m of there."
    else:
        return await named_maps(maps, service)
    names = await service.threads.files(_existing, members, service)
    if not names:
        raise UnknownMap(what, "GET /v1/sites lists the sites and their maps.")
    return MapChoice(names, named=False, finder=service.finder, site=site)


def _existing(names: list[str], service: State) -> list[str]:
    """Those names that maps have now."""
    found = []
    for name in names:
        with suppress(UnknownMap):
            service.library.stat(name)
            found.append(name)
    return found


def place_on_earth(latitude_deg: float | None, longitude_deg: float | None) -> EarthPlace | None:
    if latitude_deg is None and longitude_deg is None:
        return None
    if latitude_deg is None or longitude_deg is None:
        raise InvalidRequest("A place on Earth has a latitude and a longitude.", "Send both.")
    return EarthPlace(latitude_deg, longitude_deg)


async def named_maps(maps: str | None, service: State) -> MapChoice:
    """The maps that a request names."""
    names = list(dict.fromkeys(name.strip() for name in (maps or "all").split(",")))
    if names != ["all"]:
        return MapChoice(names, finder=service.finder)
    present = service.finder.present
    if len(present) <= MOST_ASKED:  # the library itself knows of a map that was published this moment
        present = await service.threads.files(service.library.readable)
    if not present:
        raise UnknownMap("There is no map yet.", "Upload one, or a recording.")
    return MapChoice(present, named=False, finder=service.finder, is_all=True)


async def check_known(names: Iterable[str], service: State) -> None:
    """Refuse an unknown map before a request takes a place in the queue. Known ones cost no wait for a disk.

    Raises:
        InvalidName, UnknownMap: by the library.
    """
    for name in names:
        if not service.library.is_known(name):
            await service.threads.files(service.library.stat, name)
