"""The places that can be walked through, each with its walks."""

from enum import StrEnum
from functools import lru_cache
from pathlib import Path
from typing import Any

from rholoc.simulation.recording import SimulatedRecording, simulate_recording
from rholoc.simulation.rooms import make_test_site
from rholoc.simulation.scene import Building, Scene
from rholoc.simulation.walk import Motion, make_walk
from rholoc_lab.simulation.building import make_building
from rholoc_lab.simulation.building_walk import make_building_walk


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


def simulate_site(
    out: Path, site: Site, walk: int = 1, seconds: float = 30.0, seed: int = 0, **options: Any
) -> SimulatedRecording:
    """Simulate a recording of walk number ``walk`` through a site into the folder ``out``.

    ``options`` are those of :func:`simulate_recording`: light, frame rate, camera, read-out time, progress.
    """
    motion = make_site_walk(site, walk, seconds, seed)
    return simulate_recording(out, walk=motion, scene=_kept_site(site, seed), seconds=seconds, seed=seed, **options)


@lru_cache(maxsize=2)
def _kept_site(site: Site, seed: int) -> Scene | Building:
    """The same object for every recording of a site, so that its lighting is computed once."""
    return make_site(site, seed)
