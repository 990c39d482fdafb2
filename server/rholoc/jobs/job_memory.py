"""A worker's capacity, and a job's memory."""

from __future__ import annotations

import math
from dataclasses import dataclass

from rholoc.recordings import Recording

# Peak memory of all processes of a mapping job: 0.91 GB for 5 s of a drone, 0.98 GB for 24 s with a phone, and for
# simulated walks 1.12 GB for 30 s, 1.43 GB for 2 minutes, 2.3 GB for 5 and 3.7 GB for 10. None held more than is
# expected here.
_BASE_BYTES = 1e9
_BYTES_PER_SECOND = 5e6
SECONDS_PER_PICTURE = 1.0  # of a walk that take as much memory as a picture without a time
_BYTES_PER_PIXEL = 60.0  # some twenty images at a time, of three bytes a pixel
_MARGIN = 1.5  # times the memory that a killed job held


@dataclass(frozen=True)
class Capacity:
    """Capacity of a worker.

    Attributes:
        jobs: maximum number at a time.
        memory_bytes: maximum memory of all their processes together.
    """

    jobs: int = 1
    memory_bytes: float = math.inf


@dataclass(frozen=True)
class MoreMemoryNeeded:
    """A job needs more memory than its worker grants it.

    Attributes:
        memory_bytes: required memory.
    """

    memory_bytes: int

    @classmethod
    def after(cls, held_bytes: float, granted_bytes: float, most_bytes: float) -> MoreMemoryNeeded | None:
        """Estimated need of a job killed for its memory: 1.5 × ``held_bytes``, more than ``granted_bytes``, at most
        ``most_bytes``.

        None if the largest worker has no more than was granted.

        Args:
            held_bytes: measured memory before it was killed.
            granted_bytes: memory that it was granted.
            most_bytes: memory of the largest worker.
        """
        if not most_bytes > granted_bytes:
            return None
        return cls(int(min(max(_MARGIN * held_bytes, granted_bytes + 1), most_bytes)))


def memory_for(recording: Recording) -> int:
    """Estimated memory for mapping a recording [bytes]; frames without times count as a second each."""
    times, (width, height) = recording.frames.times, recording.frames.size
    length_s = float(times[-1] - times[0]) if recording.frames.timed else len(times) * SECONDS_PER_PICTURE
    return memory_for_walk(length_s, width * height)


def memory_for_walk(length_s: float, frame_pixels: int) -> int:
    """Estimated memory for mapping a walk [bytes]: 1 GB, 5 MB per second of ``length_s``, 60 bytes per pixel."""
    return int(_BASE_BYTES + _BYTES_PER_SECOND * length_s + _BYTES_PER_PIXEL * frame_pixels)
