"""Output of commands: figures on standard output, everything else on standard error."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
)
from rich.table import Table
from rich.text import Text

from rholoc.progress import ProgressListener, Stage

if TYPE_CHECKING:
    from rholoc_client import Job

output = Console(highlight=False)
notices = Console(stderr=True, highlight=False)


def print_json(values: Any) -> None:
    """Print values as indented JSON on standard output, and nothing else, so that scripts can read it."""
    typer.echo(json.dumps(values, indent=2, ensure_ascii=False))


def print_error(message: str, hint: str = "") -> None:
    """Print one line on standard error that says what is wrong and what to do."""
    print_notice(f"rholoc: {message} {hint}".strip())


def print_notice(text: str) -> None:
    """Print one line on standard error, not wrapped and without markup."""
    notices.print(" ".join(text.split()), markup=False, soft_wrap=True)


def print_qr_code(text: str) -> None:
    """Print a text as a QR code on standard error, if that is a terminal."""
    if notices.is_terminal:
        from rholoc.service.qr_code import qr_for_terminal

        sys.stderr.write(f"{qr_for_terminal(text)}\n")


def print_figures(title: str, figures: Mapping[str, str]) -> None:
    """Print a title line and a two-column table of names and figures on standard output."""
    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_column(style="dim")
    table.add_column()
    for name, figure in figures.items():
        table.add_row(name, Text(figure))
    output.print(title, style="bold", markup=False, soft_wrap=True)
    output.print(table)


@contextmanager
def stage_progress() -> Iterator[ProgressListener]:
    """Show a bar with the stages of mapping within the block, if standard error is a terminal; yields its listener."""
    with _progress("{task.fields[stage]:<12}") as progress:
        task = progress.add_task("", total=1.0, stage="", message="")

        def listen(stage: Stage, fraction: float, message: str = "") -> None:
            progress.update(task, completed=fraction, stage=stage.value, message=message)

        yield listen


@contextmanager
def job_progress() -> Iterator[Callable[[Job], None]]:
    """Show a bar with a mapping job's progress; yields a function that takes the job and prints new stages."""
    with _progress("mapping, {task.fields[stage]:<12}") as progress:
        task = progress.add_task("", total=1.0, stage="", message="")
        start_s = time.monotonic()
        seen: list[str] = []

        def look(job: Job) -> None:
            if job.stage not in seen:
                seen.append(job.stage)
                print_notice(f"mapping: {time.monotonic() - start_s:5.1f} s  {job.stage}")
            progress.update(task, completed=job.progress, stage=job.stage, message=job.message)

        yield look


@contextmanager
def fraction_progress(what: str) -> Iterator[Callable[[float], None]]:
    """Show a bar for ``what``; yields a function that takes the fraction done, 0..1. Only on a terminal."""
    with _progress("{task.description}") as progress:
        task = progress.add_task(what, total=1.0, message="")
        yield lambda fraction: progress.update(task, completed=fraction)


@contextmanager
def frame_progress(what: str, total: int | None) -> Iterator[Callable[[], None]]:
    """Show a bar that counts frames, of ``total`` if known; yields a function that counts one. Only on a terminal."""
    with _progress("{task.description}", MofNCompleteColumn()) as progress:
        task = progress.add_task(what, total=total, message="")
        yield lambda: progress.advance(task)


def _progress(description: str, *columns: ProgressColumn) -> Progress:
    """Bar with a description, percentage or ``columns``, and the task's field ``message``; shown only on a terminal."""
    return Progress(
        SpinnerColumn(),
        TextColumn(description),
        BarColumn(),
        *(columns or (TextColumn("{task.percentage:>3.0f} %"),)),
        TimeElapsedColumn(),
        TextColumn("{task.fields[message]}", markup=False),
        console=notices,
        transient=True,
        disable=not notices.is_terminal,
    )
