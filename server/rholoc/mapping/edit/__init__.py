"""Map → map: corrected, cut, moved, joined, a recording forgotten."""
