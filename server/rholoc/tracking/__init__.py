"""Frames of a recording or a live camera → a pose for each, by a map on this machine; and where the poses go."""
