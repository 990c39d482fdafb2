"""What the trajectory tests share lies in modules beside them."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # for hand_held and synthetic_walk
