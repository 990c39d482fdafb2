"""The room of the demo, furnished once."""

from __future__ import annotations

import pytest

from rholoc.simulation import Scene
from rholoc.simulation.recording import _test_site


@pytest.fixture(scope="session")
def site() -> Scene:
    """The demo's room by seed 0."""
    return _test_site(0)  # the one that simulated recordings are of
