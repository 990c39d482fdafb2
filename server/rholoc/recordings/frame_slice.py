"""A choice of a recording's frames by their numbers."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rholoc.errors import InvalidRecording
from rholoc.geometry import ByteArray, FloatArray, IntArray
from rholoc.recordings.recording import FrameSource, Recording, Waypoint

_NUMBERS = 2**63  # what an int64 holds


@dataclass(frozen=True, eq=False)
class SelectedFrames:
    """Some rows of another source, see :class:`rholoc.recordings.FrameSource`; ``rows`` (N,) increase."""

    source: FrameSource
    rows: IntArray

    @property
    def times(self) -> FloatArray:
        """(N,) seconds, or rows of this selection where the source has no times."""
        return self.source.times[self.rows] if self.timed else np.arange(len(self.rows), dtype=np.float64)

    @property
    def timed(self) -> bool:
        """Whether the source's times were measured."""
        return self.source.timed

    @property
    def numbers(self) -> IntArray:
        """Numbers (N,) that the frames have in the whole recording."""
        return self.source.numbers[self.rows]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.source.size

    def images(self, rows: Sequence[int]) -> Iterator[ByteArray]:
        """The images (H, W, 3) BGR of the rows, which must increase."""
        return self.source.images([int(self.rows[row]) for row in rows])


def parse_frame_slice(text: str) -> slice:
    """Parse ``start:stop[:step]``, each a frame number or empty, as in Python's slices (``stop`` excluded).

    Raises:
        InvalidRecording: the text has another form, a number is negative or at least 2⁶³, or the step is 0.
    """
    parts = text.split(":")
    try:
        values = [int(part) if part.strip() else None for part in parts]
    except ValueError:
        values = []
    are_numbers = all(value is None or 0 <= value < _NUMBERS for value in values)
    if not 2 <= len(values) <= 3 or not are_numbers or values[2:] == [0]:
        raise InvalidRecording(
            f"'{text}' is not a valid selection of frames.", "Give start:stop or start:stop:step, like 400:1000."
        )
    return slice(*values)


def select_frames(recording: Recording, chosen: slice) -> Recording:
    """The recording with only the frames whose *numbers* are in the slice.

    A step counts from the slice's start, or from the first frame's number if the slice has none. Drops poses, lengths,
    mountings, intrinsics and depths of other frames, and waypoints outside the chosen frames' time span. The tables of
    IMU and odometry stay whole.

    Raises:
        InvalidRecording: no frame is in the slice.
    """
    numbers = recording.frames.numbers
    start = int(numbers[0]) if chosen.start is None else chosen.start
    inside = (numbers >= start) & ((numbers - start) % (chosen.step or 1) == 0)
    if chosen.stop is not None:
        inside &= numbers < chosen.stop
    rows = np.flatnonzero(inside)
    if len(rows) == 0:
        raise InvalidRecording(
            f"No frame of {recording.name} is in the chosen {_text(chosen)}.",
            f"Its frames are {numbers[0]} to {numbers[-1]}.",
        )
    frames = SelectedFrames(recording.frames, rows)
    chosen_numbers = set(frames.numbers.tolist())
    return replace(
        recording,
        frames=frames,
        waypoints=_waypoints_within(recording, frames),
        lengths=tuple(one for one in recording.lengths if {one.first, one.second} <= chosen_numbers),
        mounted=tuple(one for one in recording.mounted if {one.first, one.second} <= chosen_numbers),
        lenses=_lenses_of(recording, frames.numbers.tolist()),
        poses=(
            None
            if recording.poses is None
            else replace(
                recording.poses,
                known=recording.poses.known[rows],
                T_map_camera=recording.poses.T_map_camera[rows],
            )
        ),
        frame_intrinsics=None if recording.frame_intrinsics is None else recording.frame_intrinsics[rows],
        depth=None if recording.depth is None else recording.depth.select(rows),
    )


def _lenses_of(recording: Recording, numbers: list[int]) -> dict[int, int]:
    """Lens by frame number, for the frames ``numbers``; empty if one lens took all of them.

    Lenses are renumbered without gaps, the commonest first, except that lens 0 stays 0.
    """
    known = {number: recording.lenses[number] for number in numbers if number in recording.lenses}
    kinds = sorted(Counter(known.values()).items(), key=lambda one: (one[0] != 0, -one[1]))
    renumbered = {lens: place for place, (lens, _) in enumerate(kinds)}
    return {number: renumbered[lens] for number, lens in known.items()} if len(kinds) > 1 else {}


def _waypoints_within(recording: Recording, frames: SelectedFrames) -> tuple[Waypoint, ...]:
    """The waypoints within the chosen frames' time span, and those without a time (NaN).

    For untimed frames, the waypoints at chosen frames; a waypoint's time becomes its frame's row in the selection.
    """
    if recording.frames.timed:
        first, last = frames.times[0], frames.times[-1]
        return tuple(one for one in recording.waypoints if not (one.time < first or one.time > last))
    place = {float(row): float(new) for new, row in enumerate(frames.rows.tolist())}
    return tuple(replace(one, time=place[one.time]) for one in recording.waypoints if one.time in place)


def _text(chosen: slice) -> str:
    """A slice as :func:`parse_frame_slice` reads it."""
    parts = [chosen.start, chosen.stop, *([chosen.step] if chosen.step is not None else [])]
    return ":".join("" if part is None else str(part) for part in parts)
