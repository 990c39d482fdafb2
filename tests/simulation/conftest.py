"""The room of the demo, furnished once."""

from __future__ import annotations

import pytest

from rholoc.simulation import Scene, make_test_site


@pytest.fixture(scope="session")
def site() -> Scene:
    """The demo's room by seed 0."""
    return make_test_site(0)
