"""For offers and keep, which are also run by hand."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
