"""The commands of rholoc-lab: part of ``rholoc`` where it is installed, else a line on how to install it."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import typer.main

from rholoc.cli import app

Run = Callable[..., tuple[int, str, str]]


@pytest.mark.parametrize("name", ["compare", "evaluate", "paper", "simulate", "evaluate-track"])
def test_commands_of_the_lab_are_offered(name: str) -> None:
    assert name in typer.main.get_command(app).commands


@pytest.mark.parametrize(
    "words", [("evaluate", "a.csv", "b.csv"), ("paper",), ("map", "density", "a.rho"), ("recording", "flow", "walk")]
)
def test_without_it_they_say_how_to_install_it(
    command: Run, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    monkeypatch.setattr("typer.core.TyperGroup.get_command", _without_the_lab)
    status, printed, errors = command(*words)
    assert (status, printed) == (1, "")
    assert "rholoc-lab, which is not installed. pip install rholoc-lab" in errors
    assert errors.count("\n") == 1


def _without_the_lab(group, context, name):
    of_lab = group.commands.get(name)
    return None if of_lab is None or name in ("evaluate", "paper", "density", "flow") else of_lab
