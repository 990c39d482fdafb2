"""A room that is lit quickly."""

from dataclasses import replace

import pytest

from rholoc.simulation import Scene


@pytest.fixture(scope="session")
def sparse_site(site: Scene) -> Scene:
    """The demo's room with three of its boxes."""
    return replace(site, boxes=site.boxes[:3])
