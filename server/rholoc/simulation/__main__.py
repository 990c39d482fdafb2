"""Simulate a walk in a process of its own: ``python -m rholoc.simulation FOLDER WALK SECONDS SEED``."""

import sys
from pathlib import Path

from rholoc.simulation import simulate_recording

if __name__ == "__main__":
    folder, walk, seconds, seed = sys.argv[1:]
    simulate_recording(Path(folder), walk=int(walk), seconds=float(seconds), seed=int(seed))
