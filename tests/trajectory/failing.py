"""A function that fails in a child process, which imports little else."""

from __future__ import annotations


def fail(text: str, _: object) -> None:
    """Raise RuntimeError."""
    raise RuntimeError(text)
