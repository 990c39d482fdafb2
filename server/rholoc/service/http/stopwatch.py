"""Time of each stage of a request."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from rholoc import telemetry
from rholoc.errors import DeadlineExceeded
from rholoc.service.settings import Settings


@dataclass
class Stopwatch:
    """Milliseconds by stage since the request came in."""

    start_s: float = field(default_factory=time.perf_counter)
    stages_ms: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time of the block to a stage, and to the request's trace."""
        start = time.perf_counter()
        try:
            yield
        finally:
            took_s = time.perf_counter() - start
            self.stages_ms[name] = self.stages_ms.get(name, 0.0) + 1000 * took_s
            telemetry.note(name, took_s)

    def check(self, deadline_s: float) -> None:
        """Raise DeadlineExceeded once ``deadline_s`` seconds have passed since the request came in."""
        if self.elapsed_s >= deadline_s:
            raise DeadlineExceeded("The deadline passed before the work was done.", "Allow more time.")

    @property
    def worked_ms(self) -> float:
        """Sum of all stages [ms]."""
        return sum(self.stages_ms.values())

    @property
    def elapsed_s(self) -> float:
        """Seconds since the request came in."""
        return time.perf_counter() - self.start_s


def frame_deadline_s(asked_ms: float | None, settings: Settings) -> float:
    """Deadline of a frame's answer, in seconds after its request arrived: ``asked_ms``, or the settings'."""
    return (asked_ms or settings.default_deadline_ms) / 1000
