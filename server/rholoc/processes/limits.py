"""Limits of a process's time and memory."""

import math
import os
import resource
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

_OWN_GROUPS, _GROUPS = Path("/proc/self/cgroup"), Path("/sys/fs/cgroup")
_RESERVED_BYTES = 2**30  # address space that libraries and threads reserve and never touch


@dataclass(frozen=True)
class Limits:
    """Limits of a process.

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
    """Memory of this machine or of its container [bytes], whichever is less."""
    machine = float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return min(machine, *_control_group_limits(_OWN_GROUPS, _GROUPS))


def _control_group_limits(own_groups: Path, groups: Path) -> list[float]:
    """Memory limits of this process's control groups and of those around them [bytes], of either version of them.

    Args:
        own_groups: /proc/self/cgroup, with lines ``number:controllers:path``.
        groups: where the groups are mounted.
    """
    limits = [math.inf]
    try:
        lines = own_groups.read_text(encoding="utf-8").splitlines()
    except OSError:
        return limits
    for _, controllers, path in (line.split(":", 2) for line in lines if line.count(":") >= 2):
        if controllers and "memory" not in controllers.split(","):
            continue
        root, name = (groups / "memory", "memory.limit_in_bytes") if controllers else (groups, "memory.max")
        group = root / path.lstrip("/")
        for folder in (group, *group.parents):  # within a container the outermost may be all that is seen
            if folder != root and root not in folder.parents:
                break
            with suppress(OSError):
                limit = (folder / name).read_text(encoding="ascii").strip()
                limits += [float(limit)] if limit.isdigit() else []
    return limits


def limit_own_memory(memory_bytes: float) -> None:
    """Limit this process's data to ``memory_bytes`` + 1 GiB, so that one too large allocation fails; inf: no limit."""
    if math.isfinite(memory_bytes):
        _, hard = resource.getrlimit(resource.RLIMIT_DATA)
        soft = int(memory_bytes) + _RESERVED_BYTES
        resource.setrlimit(resource.RLIMIT_DATA, (soft if hard == resource.RLIM_INFINITY else min(soft, hard), hard))
