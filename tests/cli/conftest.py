"""``rholoc map``, run in this process."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from rholoc.cli import main
from rholoc.maps import Map, save_map

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def rholoc(command: Run) -> Run:
    """Runs ``rholoc map``: arguments → (exit status, standard output, standard error)."""
    return partial(command, "map")


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs ``rholoc``: arguments → (exit status, standard output, standard error)."""

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["rholoc", *map(str, arguments)])
        try:
            main()
            status: Any = 0
        except SystemExit as ended:
            status = ended.code or 0
        printed = capsys.readouterr()
        return int(status), printed.out, printed.err

    return run


@pytest.fixture
def file(hall: Map, tmp_path: Path) -> Path:
    """The module's own ``hall``, as a file."""
    path = tmp_path / "hall.rho"
    save_map(hall, path)
    return path
