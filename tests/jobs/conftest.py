"""Sites for jobs: folders, a queue, real workers."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from job_site import Site


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    """A site without workers."""
    site = Site(tmp_path)
    yield site
    site.close()


@pytest.fixture(scope="module")
def busy_site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """A site with one worker, shared by tests that do not harm it."""
    site = Site(tmp_path_factory.mktemp("site"))
    site.start_worker()
    yield site
    site.close()
