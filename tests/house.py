"""A house of three rooms whose maps are placed by the points that they share."""

from fake_pipeline import tiny_map
from rholoc.library.maps import MapLibrary
from rholoc.library.sites import SiteLibrary
from rholoc.mapping.sites.poses import solve_site
from rholoc.maps import Site, SiteMap

# Three rooms in a row, each with the doors to the next at positions of its own.
DOORS = {
    "hall": {"a": (0.0, 0.0, 0.0), "b": (1.0, 0.0, 0.0), "c": (0.0, 2.0, 0.0)},
    "kitchen": {"a": (5.0, 0.0, 0.0), "b": (6.0, 0.0, 0.0), "c": (5.0, 2.0, 0.0), "d": (0.0, 0.0, 1.0),
                "e": (1.0, 0.0, 1.0), "f": (0.0, 3.0, 1.0)},
    "study": {"d": (0.0, 0.0, 0.0), "e": (1.0, 0.0, 0.0), "f": (0.0, 3.0, 0.0)},
}  # fmt: skip
IN_SITE = {"hall": (0.0, 0.0, 0.0), "kitchen": (-5.0, 0.0, 0.0), "study": (-5.0, 0.0, 1.0)}
PAIRS = ["hall and kitchen", "hall and study", "kitchen and study"]


def put_rooms(library: MapLibrary) -> MapLibrary:
    """Store the maps."""
    for name, doors in DOORS.items():
        library.put(name, tiny_map(waypoints=doors))
    return library


def put_house(sites: SiteLibrary) -> SiteLibrary:
    """Store a site of the maps, of which only the first has a pose: its frame is the site's."""
    sites.put("house", solve_site(Site(maps=tuple(SiteMap(name) for name in DOORS))))
    return sites


def placed(site: Site) -> dict[str, tuple[float, ...]]:
    """The positions of the maps that have a pose."""
    return {one.map: one.pose.position for one in site.maps if one.pose is not None}
