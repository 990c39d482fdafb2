"""What commands print with: figures on standard output, everything else on standard error."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from rholoc.progress import ProgressListener, Stage

output = Console(highlight=False)
notices = Console(stderr=True, highlight=False)


def print_json(values: Any) -> None:
    """Print values as indented JSON, and nothing else, so that scripts can read it."""
    typer.echo(json.dumps(values, indent=2, ensure_ascii=False))


def print_error(message: str, hint: str = "") -> None:
    """Say in one line what is wrong and what to do."""
    print_notice(f"rholoc: {message} {hint}".strip())


def print_notice(text: str) -> None:
    """Print one line on standard error, not wrapped and without markup."""
    notices.print(" ".join(text.split()), markup=False, soft_wrap=True)


def print_figures(title: str, figures: Mapping[str, str]) -> None:
    """Print a two-column table of names and figures."""
    table = Table(title=title, title_justify="left", show_header=False, box=None, pad_edge=False)
    table.add_column(style="dim")
    table.add_column()
    for name, figure in figures.items():
        table.add_row(name, figure)
    output.print(table)


@contextmanager
def stage_progress() -> Iterator[ProgressListener]:
    """A bar that shows the stages of mapping; nothing where standard error is no terminal."""
    with Progress(
        SpinnerColumn(),
        TextColumn("{task.fields[stage]:<12}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("{task.fields[message]}", markup=False),
        console=notices,
        transient=True,
        disable=not notices.is_terminal,
    ) as progress:
        task = progress.add_task("", total=1.0, stage="", message="")

        def listen(stage: Stage, fraction: float, message: str = "") -> None:
            progress.update(task, completed=fraction, stage=stage.value, message=message)

        yield listen


@contextmanager
def frame_progress(what: str, total: int) -> Iterator[Progress]:
    """A bar that counts frames: ``progress.advance(task)`` with the only task, 0; nothing where no terminal is."""
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=notices,
        transient=True,
        disable=not notices.is_terminal,
    ) as progress:
        progress.add_task(what, total=total)
        yield progress
