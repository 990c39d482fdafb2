"""What all tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

_REAL_DATA = Path(__file__).parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real recordings beside the project; skips where it is absent, unless they are required."""
    if not _REAL_DATA.is_dir():
        if os.environ.get("RHOLOC_REQUIRE_REAL_DATA") == "1":
            pytest.fail("RHOLOC_REQUIRE_REAL_DATA=1, but the real recordings are absent.")
        pytest.skip("the real recordings are absent")
    return _REAL_DATA
