"""How long a process may run, and how much memory it may hold."""

from __future__ import annotations

import math
import os
import resource
from dataclasses import dataclass
from pathlib import Path

_CONTAINER_MEMORY = Path("/sys/fs/cgroup/memory.max")
_RESERVED_BYTES = 2**30  # address space that libraries and threads reserve and never touch


@dataclass(frozen=True)
class Limits:
    """What a process may take.

    Attributes:
        time_s: how long it may run.
        memory_bytes: how much memory it and the processes that it starts may hold together; enforced on Linux only.
    """

    time_s: float = math.inf
    memory_bytes: float = math.inf


class LimitExceeded(Exception):
    """A process exceeded a limit, and was killed."""


class TimeLimitExceeded(LimitExceeded):
    """It ran too long."""


class MemoryLimitExceeded(LimitExceeded):
    """It held too much memory: ``held_bytes``."""

    def __init__(self, held_bytes: float) -> None:
        self.held_bytes = held_bytes
        super().__init__(f"the process held {held_bytes:.0f} bytes of memory")


def machine_memory_bytes() -> float:
    """How much memory this machine has, or its container may use, whichever is less."""
    machine = float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    try:
        container = _CONTAINER_MEMORY.read_text(encoding="ascii").strip()
    except OSError:
        return machine
    return min(machine, float(container)) if container.isdigit() else machine


def limit_own_memory(memory_bytes: float) -> None:
    """Make a single too large allocation fail at once; the parent process watches for slow growth."""
    if math.isfinite(memory_bytes):
        _, hard = resource.getrlimit(resource.RLIMIT_DATA)
        soft = int(memory_bytes) + _RESERVED_BYTES
        resource.setrlimit(resource.RLIMIT_DATA, (soft if hard == resource.RLIM_INFINITY else min(soft, hard), hard))
