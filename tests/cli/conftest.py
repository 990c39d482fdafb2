"""``rholoc map``, run in this process."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import pytest

from rholoc.cli import main

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def rholoc(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs ``rholoc map``: arguments → (exit status, standard output, standard error)."""

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["rholoc", "map", *map(str, arguments)])
        try:
            main()
            status: Any = 0
        except SystemExit as ended:
            status = ended.code or 0
        printed = capsys.readouterr()
        return int(status), printed.out, printed.err

    return run
