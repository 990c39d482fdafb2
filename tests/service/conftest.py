"""What tests of routes and streams share."""

import pytest

from rholoc.service.settings import KeyPolicy


@pytest.fixture(scope="module")
def locked(serve, picture_world):
    """A service that wants a key for everything."""
    running = serve(keys=KeyPolicy.ALWAYS)
    (running.settings.maps_dir / "room.rho").write_bytes(picture_world.rho())
    return running
