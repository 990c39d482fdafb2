"""Sites: maps of rooms and floors in one frame."""

from fastapi import APIRouter, Request, Response
from pydantic import Field

from rholoc.errors import (
    Busy,
    Conflict,
    InvalidInput,
    InvalidMap,
    InvalidName,
    MappingFailed,
    RholocError,
    StorageFull,
    UnknownMap,
    UnknownSite,
)
from rholoc.mapping.sites.linking import find_link
from rholoc.mapping.sites.poses import solve_site, with_link
from rholoc.service.access.scopes import NEEDS_ADMIN, NEEDS_MAP, NEEDS_READ, request_key
from rholoc.service.http.models import AnswerModel, RequestModel
from rholoc.service.http.openapi import declared
from rholoc.service.maps.job_events import JobOut, begun
from rholoc.service.maps.site_documents import SiteIn, SiteOut, site_of, site_out
from rholoc.service.state import Service
from rholoc.service.threads.compute import Effort


class SiteLinkWanted(RequestModel):
    """Two maps of a site between which to find the pose."""

    first: str
    second: str


class SiteList(AnswerModel):
    """All sites."""

    sites: list[SiteOut]
    unreadable: dict[str, str] = Field(description="names of site files that cannot be read, and why")


router = APIRouter(prefix="/v1/sites", tags=["sites"])


@router.get("", **declared(NEEDS_READ, "All sites"))
async def list_sites(service: Service) -> SiteList:
    """The sites by name; files that cannot be read are listed separately."""
    found: list[SiteOut] = []
    unreadable: dict[str, str] = {}
    present = set(await service.maps.names())
    for name in await service.sites.names():
        try:
            found.append(site_out(name, await service.sites.get(name), present))
        except UnknownSite:
            continue  # deleted meanwhile
        except RholocError as error:
            unreadable[name] = error.message
    return SiteList(sites=found, unreadable=unreadable)


@router.get("/{site}", **declared(NEEDS_READ, "One site", UnknownSite, InvalidName, InvalidInput))
async def get_site(site: str, service: Service) -> SiteOut:
    """The site's maps with their poses, and the links that these follow from."""
    return site_out(site, await service.sites.get(site), await service.maps.names())


@router.put(
    "/{site}",
    **declared(
        NEEDS_MAP,
        "Store a site",
        UnknownMap,
        InvalidName,
        InvalidInput,
        Conflict,
        StorageFull,
        also={201: {"model": SiteOut, "description": "The site is new."}},
    ),
)
async def put_site(site: str, wanted: SiteIn, service: Service, response: Response) -> SiteOut:
    """Stores a site. Poses that are not given are found from links; without any given pose the first map's frame is the
    site's. Links that contradict each other are refused, with the residual around their loop. A map that no link joins
    to the others stays without a pose: frames are localized in it, and answered in the map's frame alone.
    """
    present = set(await service.maps.names())
    for one in wanted.maps:
        if one.map not in present:
            await service.maps.stat(one.map)  # which says what there is
    solved = await service.frames.compute.run(lambda: solve_site(site_of(wanted)), Effort.LARGE)
    stored = site_out(site, await service.sites.put(site, solved, wanted.version), present)
    response.status_code = 201 if stored.version == 1 else 200
    return stored


@router.delete("/{site}", status_code=204, **declared(NEEDS_ADMIN, "Delete a site", UnknownSite, InvalidName))
async def delete_site(site: str, service: Service) -> None:
    """Deletes the site; its maps stay."""
    await service.sites.delete(site)


@router.post(
    "/{site}/links",
    **declared(
        NEEDS_MAP, "Find the pose between two maps of a site", UnknownSite, UnknownMap, InvalidName, InvalidMap,
        InvalidInput, MappingFailed, Conflict, Busy, StorageFull,
    ),
)  # fmt: skip
async def find_site_link(site: str, wanted: SiteLinkWanted, service: Service) -> SiteOut:
    """Finds the pose between two maps: by three measured or named points that both have, else by views of the second
    localized in the first. The link replaces one that was found before, and the poses that are not given are
    solved anew.
    """
    before = await service.sites.get(site)
    for name in (wanted.first, wanted.second):
        if before.member(name) is None:
            raise InvalidInput(f"The map {name[:64]} is not one of the site {site}.", "Put the site with it first.")
    a = await service.maps.get(wanted.first)
    b = await service.maps.get(wanted.second)
    link = await service.frames.compute.run(lambda: find_link(wanted.first, a, wanted.second, b), Effort.LARGE)
    stored = await service.sites.put(site, with_link(before, link), before.version)
    return site_out(site, stored, await service.maps.names())


@router.post(
    "/{site}/place",
    status_code=202,
    **declared(NEEDS_MAP, "Place the maps of a site", UnknownSite, InvalidName, InvalidInput, Conflict, StorageFull),
)
async def place_site(site: str, request: Request, service: Service, response: Response) -> JobOut:
    """A job finds the poses between pairs of maps, as `POST …/links` does for one pair, until all are placed or no
    further two overlap; `Location` names the job. What it finds is added to the site as it is then, and the job's
    `warnings` say what is still not placed."""
    await service.sites.get(site)
    job = await service.jobs.begin(request_key(request.scope), "", lambda jobs: jobs.submit_placing(site))
    return begun(job, response)
