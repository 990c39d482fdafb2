"""``rholoc map``, run in this process."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from rholoc.maps import Map, save_map

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def rholoc(command: Run) -> Run:
    """Runs ``rholoc map``: arguments → (exit status, standard output, standard error)."""
    return partial(command, "map")


@pytest.fixture
def file(hall: Map, tmp_path: Path) -> Path:
    """The module's own ``hall``, as a file."""
    path = tmp_path / "hall.rho"
    save_map(hall, path)
    return path
