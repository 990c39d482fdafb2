"""How long drawing a map's room takes, against its walk's length, and how large it is.

    python benchmarks/room_drawing.py MAP.rho RECORDING [MAP.rho RECORDING …]

Prints a line of JSON for each map: processor time and the walk's length [s], vertices of the surfaces, and the bytes
that they add to the map's file.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import replace
from pathlib import Path

from rholoc.mapping import draw_room
from rholoc.maps import Room, load_map, map_to_bytes
from rholoc.recordings import read_recording

FRAMES_PER_SECOND = 30.0  # of frames without times


def main() -> None:
    """Draw the rooms and print their figures."""
    for map_file, folder in zip(sys.argv[1::2], sys.argv[2::2], strict=True):
        map_, recording = replace(load_map(map_file), room=Room()), read_recording(Path(folder))
        times = recording.frames.times
        walk_s = times[-1] - times[0] if recording.frames.timed else len(times) / FRAMES_PER_SECOND
        began_s = time.process_time()
        drawn = draw_room(map_, [recording])
        cpu_s = time.process_time() - began_s
        figures = {
            "map": Path(map_file).stem,
            "cpu_s": round(cpu_s, 1),
            "walk_s": round(float(walk_s), 1),
            "vertices": len(drawn.room),
            "bytes": len(map_to_bytes(drawn)) - len(map_to_bytes(map_)),
        }
        print(json.dumps(figures))


if __name__ == "__main__":
    main()
