"""Pictures that the cameras of a rig took at the same moment."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np

from rholoc.geometry import FloatArray
from rholoc.recordings.readers._frames import TimedFrames
from rholoc.recordings.recording import Mounted


def mounted_frames(
    timed: TimedFrames, moments: Sequence[Hashable], T_rig_cameras: Sequence[FloatArray | None]
) -> tuple[Mounted, ...]:
    """Pairs of each frame of a moment with the moment's first one.

    Args:
        timed: frames, whose ``rows`` are places in the lists below.
        moments: of each picture listed; equal for pictures of one rig and moment.
        T_rig_cameras: (4, 4) mounting of each picture's camera; None for cameras that are not on a rig.
    """
    first: dict[Hashable, tuple[int, FloatArray]] = {}
    found = []
    for number, row in zip(timed.frames.numbers.tolist(), timed.rows.tolist(), strict=True):
        T = T_rig_cameras[row]
        if T is None:
            continue
        if moments[row] in first:
            other, T_other = first[moments[row]]
            found.append(Mounted(other, number, np.linalg.inv(T_other) @ T))
        else:
            first[moments[row]] = number, T
    return tuple(found)
