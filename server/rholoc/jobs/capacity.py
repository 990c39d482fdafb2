"""How much a worker takes on, and how much memory a job needs."""

from __future__ import annotations

import math
from dataclasses import dataclass

from rholoc.recordings import Recording

# The most that all processes of a mapping job held: 0.91 GB for 5 s of a drone, 0.98 GB for 24 s with a phone, and of
# simulated walks 1.12 GB for 30 s, 1.43 GB for 2 minutes, 2.3 GB for 5 and 3.7 GB for 10. None held more than is
# expected here.
_BASE_BYTES = 1e9
_BYTES_PER_SECOND = 5e6
SECONDS_PER_PICTURE = 1.0  # of a walk, that a picture without a time takes as much memory as
_BYTES_PER_PIXEL = 60.0  # some twenty images at a time, of three bytes a pixel
_MARGIN = 1.5  # times what a job held when it was killed


@dataclass(frozen=True)
class Capacity:
    """How much a worker takes on.

    Attributes:
        jobs: at a time.
        memory_bytes: what all their processes may hold together.
    """

    jobs: int = 1
    memory_bytes: float = math.inf


@dataclass(frozen=True)
class MoreMemoryNeeded:
    """A job was found to need more memory than it may take where it is.

    Attributes:
        memory_bytes: how much it needs.
    """

    memory_bytes: int

    @classmethod
    def after(cls, held_bytes: float, granted_bytes: float, most_bytes: float) -> MoreMemoryNeeded | None:
        """What a job needs that was killed for its memory, roughly; None where nobody has more than it had.

        Args:
            held_bytes: how much it was seen to hold.
            granted_bytes: how much it could have.
            most_bytes: how much the worker has that has most.
        """
        if not most_bytes > granted_bytes:
            return None
        return cls(int(min(max(_MARGIN * held_bytes, granted_bytes + 1), most_bytes)))


def memory_for(recording: Recording) -> int:
    """About how many bytes mapping a recording takes."""
    times, (width, height) = recording.frames.times, recording.frames.size
    length_s = float(times[-1] - times[0]) if recording.frames.timed else len(times) * SECONDS_PER_PICTURE
    return memory_for_walk(length_s, width * height)


def memory_for_walk(length_s: float, frame_pixels: int) -> int:
    """About how many bytes mapping a walk of that length takes, by frames of so many pixels."""
    return int(_BASE_BYTES + _BYTES_PER_SECOND * length_s + _BYTES_PER_PIXEL * frame_pixels)
