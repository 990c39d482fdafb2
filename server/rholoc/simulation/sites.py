"""The places that can be walked through, each with its walks."""

from __future__ import annotations

from enum import StrEnum

from rholoc.simulation.building import make_building
from rholoc.simulation.building_walk import make_building_walk
from rholoc.simulation.rooms import make_test_site
from rholoc.simulation.scene import Building, Scene
from rholoc.simulation.walk import Motion, make_walk


class Site(StrEnum):
    """A simulated place."""

    ROOM = "room"  # the paper's test site
    BUILDING = "building"  # two storeys, fourteen rooms, corridors, stairs


def make_site(site: Site, seed: int = 0) -> Scene | Building:
    """The site of a seed, in the map frame that begins with its first walk."""
    if site is Site.ROOM:
        return make_test_site(seed)
    return make_building(seed).moved(-make_building_walk(1, 30.0, seed).origin)


def make_site_walk(site: Site, number: int, seconds: float, seed: int) -> Motion:
    """The walk of a number through the site."""
    return (make_walk if site is Site.ROOM else make_building_walk)(number, seconds, seed)
