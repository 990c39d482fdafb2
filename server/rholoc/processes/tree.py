"""The processes of this machine: their parents, and how much memory they hold. Empty where there is no /proc."""

from __future__ import annotations

import os
import resource
import signal
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

_PARENT, _GROUP, _PAGES = 1, 2, 21  # fields of /proc/PID/stat after the process's name


@dataclass(frozen=True)
class _Process:
    pid: int
    parent: int
    group: int
    resident_pages: int


def descendants(pid: int) -> list[int]:
    """The processes that a process started, and those that they started."""
    children: dict[int, list[int]] = {}
    for process in _processes():
        children.setdefault(process.parent, []).append(process.pid)
    found = list(children.get(pid, ()))
    for one in found:  # grows meanwhile
        found += children.get(one, ())
    return found


def group_memory_bytes(group: int) -> int:
    """The resident memory of all processes of a process group."""
    return resource.getpagesize() * sum(one.resident_pages for one in _processes() if one.group == group)


def kill(pids: Iterable[int]) -> None:
    """Kill processes; those that have already ended are skipped."""
    for pid in pids:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


def _processes() -> Iterator[_Process]:
    for folder in Path("/proc").iterdir():
        if not folder.name.isdigit():
            continue
        with suppress(OSError):  # it has ended
            text = (folder / "stat").read_text(encoding="utf-8", errors="replace")
            fields = text.rsplit(")", 1)[1].split()
            yield _Process(int(folder.name), int(fields[_PARENT]), int(fields[_GROUP]), int(fields[_PAGES]))
