"""Matches → pose: seeds, ascent, re-matching, and the evidence for the pose."""
