"""The maps that a request is for."""

from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Query

from rholoc.errors import UnknownMap
from rholoc.geometry.earth import EarthPlace
from rholoc.service.errors import InvalidRequest
from rholoc.service.frames.map_choice import MAX_ASKED, MapChoice
from rholoc.service.state import State

MapNames = Annotated[
    str | None, Query(description="names separated by commas, or 'all', the default", examples=["all", "hall,kitchen"])
]
_Latitude = Annotated[
    float | None,
    Query(ge=-90, le=90, description="with `longitude`, instead of maps: those near there, WGS 84", examples=[52.52]),
]
_Longitude = Annotated[float | None, Query(ge=-180, le=180, description="degrees east, WGS 84", examples=[13.405])]


@dataclass(frozen=True)
class RequestedMaps:
    """The maps that a request is for, by their names, their site or where on Earth they are."""

    maps: MapNames = None
    site: Annotated[str | None, Query(description="a site, instead of maps: all of its maps", examples=["campus"])] = (
        None
    )
    latitude: _Latitude = None
    longitude: _Longitude = None
    radius_m: Annotated[
        float, Query(gt=0, le=100_000, description="how far from that place a map's origin may lie, m", examples=[100])
    ] = 100.0

    async def choice(self, service: State) -> MapChoice:
        """The maps to ask: those named, of the site, near the place, or without any of these all; unknown ones of a
        site are left out.

        Raises:
            InvalidRequest: the request says more than one of names, site and place, or half a place.
            UnknownSite, UnknownMap: there is no such site, or no map of it, or none there.
        """
        place = self._place()
        if sum(one is not None for one in (self.maps, self.site, place)) > 1:
            hint = "Send one of maps, site, and a place on Earth."
            raise InvalidRequest("The request names its maps in two ways.", hint)
        if self.site is not None:
            members = [one.map for one in (await service.sites.get(self.site)).maps]
            what = f"No map of the site {self.site} is here."
        elif place is not None:
            sites = await service.sites.all()
            near = [name for one in sites.values() for name in one.maps_near(place, self.radius_m)]
            members = list(dict.fromkeys(near))
            what = f"No site has a map within {self.radius_m:g} m of there."
        else:
            return await named_maps(self.maps, service)
        names = await service.maps.existing(members)
        if not names:
            raise UnknownMap(what, "GET /v1/sites lists the sites and their maps.")
        return MapChoice(names, named=False, finder=service.frames.finder, site=self.site)

    def _place(self) -> EarthPlace | None:
        if self.latitude is None and self.longitude is None:
            return None
        if self.latitude is None or self.longitude is None:
            raise InvalidRequest("A place on Earth has a latitude and a longitude.", "Send both.")
        return EarthPlace(self.latitude, self.longitude)


Requested = Annotated[RequestedMaps, Depends()]


async def named_maps(maps: str | None, service: State) -> MapChoice:
    """The maps of some names separated by commas, which are not checked; all for None and "all".

    Raises:
        UnknownMap: all are asked for, and there is none.
    """
    names = list(dict.fromkeys(name.strip() for name in (maps or "all").split(",")))
    if names != ["all"]:
        return MapChoice(names, finder=service.frames.finder)
    present = service.frames.finder.present
    if len(present) <= MAX_ASKED:  # the library itself knows of a map that was published this moment
        present = await service.maps.readable()
    if not present:
        raise UnknownMap("There is no map yet.", "Upload one, or a recording.")
    return MapChoice(present, named=False, finder=service.frames.finder, is_all=True)
