"""``rholoc site``: maps of rooms and floors in one frame."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rholoc.cli import options
from rholoc.cli.console import output, print_error, print_json, print_notice
from rholoc.cli.operate.jobs import open_queue
from rholoc.cli.operate.serve import Data, service_settings
from rholoc.errors import InvalidInput

if TYPE_CHECKING:
    from rholoc.maps import Site

app = typer.Typer(no_args_is_help=True, help="Group maps of rooms and floors, with the poses between them.")

Name = Annotated[str, typer.Argument(metavar="NAME", help="The site's name.")]
Maps = Annotated[
    Path,
    typer.Option("--maps", metavar="DIR", envvar=options.MAPS_VARIABLE, help="The folder of the maps and their sites."),
]
_MAPS = Path(options.DEFAULT_MAPS)


@app.command(name="list")
def list_sites(maps: Maps = _MAPS, as_json: options.Json = False) -> None:
    """List the sites."""
    from rholoc.library.sites import SiteLibrary

    sites = SiteLibrary(maps).all()
    if as_json:
        print_json([_shown(name, site, maps) for name, site in sites.items()])
        return
    if not sites:
        print_notice(f"There are no sites in {maps}. Make one with rholoc site put.")
    for name, site in sites.items():
        placed = sum(one.pose is not None for one in site.maps)
        output.print(f"{name}: {len(site.maps)} maps, {placed} of them placed", markup=False, soft_wrap=True)


@app.command()
def show(name: Name, maps: Maps = _MAPS, as_json: options.Json = False) -> None:
    """Show a site: the poses of its maps, and the links that they follow from."""
    from rholoc.library.sites import SiteLibrary

    _print(name, SiteLibrary(maps).get(name), maps, as_json)


@app.command()
def put(
    name: Name,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The site as JSON, as PUT /v1/sites/NAME takes it.")],
    maps: Maps = _MAPS,
    as_json: options.Json = False,
) -> None:
    """Store a site; its links place the maps whose poses are not given."""
    from pydantic import ValidationError

    from rholoc.library.maps import MapLibrary
    from rholoc.library.sites import SiteLibrary
    from rholoc.mapping.sites.poses import solve_site
    from rholoc.service.maps.site_documents import SiteIn, site_of

    try:
        wanted = SiteIn.model_validate_json(file.read_bytes())
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise InvalidInput(f"{file} is no site: {where or 'the file'}: {first['msg']}.", "Mend it.") from error
    library = MapLibrary(maps)
    for one in wanted.maps:
        library.stat(one.map)
    _print(name, SiteLibrary(maps).put(name, solve_site(site_of(wanted)), wanted.version), maps, as_json)


@app.command()
def link(
    name: Name,
    first: Annotated[str, typer.Argument(metavar="FIRST", help="A map of the site.")],
    second: Annotated[str, typer.Argument(metavar="SECOND", help="Another one.")],
    maps: Maps = _MAPS,
    as_json: options.Json = False,
) -> None:
    """Find the pose between two maps, by points that both have or by overlap, and place the site's maps anew."""
    from rholoc.library.maps import MapLibrary
    from rholoc.library.sites import SiteLibrary
    from rholoc.mapping.sites.linking import find_link
    from rholoc.mapping.sites.poses import with_link

    sites, library = SiteLibrary(maps), MapLibrary(maps)
    site = sites.get(name)
    for one in (first, second):
        if site.member(one) is None:
            raise InvalidInput(f"The map {one} is not one of the site {name}.", "Put the site with it first.")
    found = find_link(first, library.get(first), second, library.get(second))
    _print(name, sites.put(name, with_link(site, found), site.version), maps, as_json)


@app.command()
def place(
    name: Name,
    maps: Maps = _MAPS,
    queue: Annotated[bool, typer.Option("--queue", help="Leave it to the server's workers, as a job.")] = False,
    data: Data = None,
    as_json: options.Json = False,
) -> None:
    """Look for links until all maps are placed, or no further two of them overlap."""
    if queue:
        _queue_placing(name, maps, data, as_json)
    else:
        _place(name, maps, as_json)


def _queue_placing(name: str, maps: Path, data: Path | None, as_json: bool) -> None:
    """Queue the job that places a site's maps, and print it. Raises UnknownSite, Conflict."""
    from dataclasses import asdict

    from rholoc.library.sites import SiteLibrary

    settings = service_settings(data_dir=data)
    if settings.shared_storage is None:
        SiteLibrary(maps).get(name)
    with open_queue(settings) as jobs:
        job = jobs.submit_placing(name)
    if as_json:
        print_json(asdict(job))
    else:
        print_notice(f"The job {job.id} places the maps of the site {name}. See rholoc job list.")


def _place(name: str, maps: Path, as_json: bool) -> None:
    """Search links between a site's maps, store the poses that they give, and print them."""
    from rholoc.library.maps import MapLibrary
    from rholoc.library.sites import SiteLibrary
    from rholoc.mapping.sites.link_search import search_links
    from rholoc.mapping.sites.poses import solve_site, with_link

    sites, library = SiteLibrary(maps), MapLibrary(maps)
    stored = sites.get(name)
    site = solve_site(stored)
    for pair in search_links(site, library.get, library.names()):
        print_notice(f"{pair.first} and {pair.second}: {'found' if pair.link else pair.reason}")
        if pair.link is not None:
            site = with_link(site, pair.link)
    _print(name, sites.put(name, site, stored.version), maps, as_json)
    left = [one.map for one in site.maps if one.pose is None]
    if left:
        print_error(
            f"Nothing joins {', '.join(left)} to the others.", "Give a link or a pose, or map what lies between."
        )


@app.command()
def delete(name: Name, maps: Maps = _MAPS) -> None:
    """Delete a site; its maps stay."""
    from rholoc.library.sites import SiteLibrary

    SiteLibrary(maps).delete(name)
    print_notice(f"The site {name} is deleted; its maps stay.")


def _shown(name: str, site: Site, maps: Path) -> dict[str, object]:
    """A site as the service sends it, JSON-serialisable."""
    from rholoc.library.maps import MapLibrary
    from rholoc.service.maps.site_documents import site_out

    return site_out(name, site, set(MapLibrary(maps).names())).model_dump(mode="json")


def _print(name: str, site: Site, maps: Path, as_json: bool) -> None:
    """Print a site with its maps and links, or as JSON."""
    from rholoc.library.maps import MapLibrary

    if as_json:
        print_json(_shown(name, site, maps))
        return
    present = set(MapLibrary(maps).names())
    output.print(f"{name}, version {site.version}", style="bold", markup=False, soft_wrap=True)
    for one in site.maps:
        floor = f", floor {one.floor}" if one.floor else ""
        at = (
            "not placed"
            if one.pose is None
            else "at " + ", ".join(f"{value:.2f}" for value in one.pose.position) + " m"
        )
        gone = "" if one.map in present else "; there is no such map any more"
        output.print(f"  {one.map}{floor}: {at}{gone}", markup=False, soft_wrap=True)
    for link in site.links:
        output.print(
            f"  {link.first} – {link.second}: {link.origin}, ±{link.sigma_m:.2f} m, ±{link.sigma_deg:.1f}°",
            markup=False,
            soft_wrap=True,
        )
